"""The joint path ahead from tick to tick: whose turn it is to be improved."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import least_norm_path, PathJoints
from redundant_planner.core.horizon.multi_start import MultiStart
from redundant_planner.core.horizon.path_qp import PathQP, Plan, taken_along
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses

Array = npt.NDArray[np.float64]

# The poses of a plan get wrong when the command changes. Beyond the first error a plan is only
# kept if a new one is not better; beyond the second it is not even compared [m, rad].
_ERROR_TO_COMPARE = 1e-2
_ERROR_TO_REPLACE = 0.15
# A plan that is not free this often in a row leads nowhere: one step mends what a change of the
# command has done.
_LOOKS_UNTIL_BLOCKED = 2
# Another plan replaces this one if it costs less than this share.
_COST_SHARE_TO_SWITCH = 0.9
# Steps that a path found by the search gets to settle: at least, and at most.
_LEAST_SETTLING, _MOST_SETTLING = 3, 5


class Horizon:
    """The joint path ahead of one arm.

    It remembers the plan that the arm follows from tick to tick. Every other tick improves this
    plan. The others go to a search for other ways (`multi_start`). What a search finds settles
    for a few steps; it replaces the plan if the plan is not free or clearly longer. No tick looks
    at more than one plan, so that none takes long.

    Attributes:
        times: (N + 1,) of the nodes, from now [s].
    """

    def __init__(self, robot: Robot, times: Array, joints: PathJoints) -> None:
        """Prepare for an arm and times (N + 1,) ahead, from `node_times`."""
        self.times, self._longest = times, times
        self._robot, self._joints = robot, joints
        self._problem = PathQP(robot, times, joints)
        self._search = MultiStart(self._problem)
        self._fading = 1.0 - times[1:] / times[-1]
        self.reset()

    @property
    def nodes(self) -> Array | None:
        """The planned postures (N, n) at times[1:]; None before the first tick."""
        return None if self._plan is None else self._plan.nodes.copy()

    @property
    def free(self) -> bool:
        """Whether the plan led all the way when it was last looked at."""
        return self._plan is not None and self._plan.admissible

    @property
    def cut_short(self) -> bool:
        """Whether the last tick's problem took more iterations than it may."""
        return self._problem.cut_short

    def reach(self, rest: float, dt: float) -> None:
        """Have the nodes reach no further than a time `rest` from now [s].

        The first is never nearer than a tick of dt [s].
        """
        longest = self._longest
        share = max(min(rest / longest[-1], 1.0), dt / longest[1])
        self.times = self._problem.times = longest if share >= 1.0 else share * longest

    def reset(self) -> None:
        """Forget the plan and the search."""
        self._plan: Plan | None = None
        self._found: Plan | None = None
        self._closest: Array | None = None
        # The plan as it was when its poses got wrong, to be compared with a new one.
        self._doubted: Plan | None = None
        self._has_compared = False
        self._ticks, self._settled, self._troubled = 0, 0, 0
        self._search.reset()

    def advance(
        self, q: Array, poses: Poses, obstacles: InflatedObstacles, dt: float,
    ) -> Array | None:
        """Move the plan on by `dt`, take one step to improve it, and return its velocity (n,) now.

        None where the QP has no solution; the next tick then starts afresh.

        Args:
            q: (n,) where the arm is.
            poses: N, from `poses_ahead`.
            obstacles: the obstacles now, for links with their margin.
            dt: time since the last tick [s].
        """
        self._problem.cut_short = False
        if self._plan is not None:
            self._plan = self._moved_on(self._plan, q, dt)
        if self._found is not None:
            self._found = self._moved_on(self._found, q, dt)
        self._search.pass_time(dt)
        self._step(q, poses, obstacles)
        if self._plan is None:
            return None
        return (self._plan.nodes[0] - q) / float(self.times[1])

    def _step(self, q: Array, poses: Poses, obstacles: InflatedObstacles) -> None:
        """Give one step to the plan, to a new one, to the search or to what it has found."""
        self._ticks += 1
        if self._plan is None or self._doubted is not None:
            self._start_anew(q, poses, obstacles)
        elif self._ticks % (4 if self._blocked else 2) == 0:
            self._follow(self._plan, q, poses, obstacles)
        elif self._found is not None:
            self._settle(q, poses, obstacles)
        else:
            found = self._search.step(q, poses, obstacles, self._closest)
            if found is not None:
                plan, age = found
                self._found, self._settled = self._moved_on(plan, q, age), 0

    @property
    def _blocked(self) -> bool:
        """Whether the plan leads nowhere."""
        return self._troubled >= _LOOKS_UNTIL_BLOCKED

    def _follow(self, plan: Plan, q: Array, poses: Poses, obstacles: InflatedObstacles) -> None:
        """Take one step with the plan.

        If its poses have got wrong, the next step looks whether a new one is better than mending
        it; but not twice in a row, for the search has its turn, too.
        """
        plan, local = self._problem.look(q, plan.nodes, poses, obstacles)
        self._troubled = 0 if plan.admissible else self._troubled + 1
        self._closest = local.gradients[int(local.bounds.argmax())] if local.bounds.size else None
        self._plan = self._problem.improved(plan, local)
        if plan.measures.error >= _ERROR_TO_COMPARE and not self._has_compared:
            self._doubted = plan
        self._has_compared = False

    def _start_anew(self, q: Array, poses: Poses, obstacles: InflatedObstacles) -> None:
        """Take a step with a new plan, unless the one in doubt is as good."""
        doubted, self._doubted = self._doubted, None
        nodes = least_norm_path(self._robot, q, poses, self._joints)
        fresh, local = self._problem.look(q, nodes, poses, obstacles)
        self._has_compared = True
        if (self._plan is not None and doubted is not None
                and doubted.measures.error < _ERROR_TO_REPLACE
                and fresh.price >= _COST_SHARE_TO_SWITCH * doubted.price):
            return
        self._search.drop()
        self._found = None
        self._plan = self._problem.improved(fresh, local)
        self._troubled = 0

    def _settle(self, q: Array, poses: Poses, obstacles: InflatedObstacles) -> None:
        """Take one step with what a search has found; take it over if it is better."""
        assert self._found is not None and self._plan is not None
        found, local = self._problem.look(q, self._found.nodes, poses, obstacles)
        self._settled += 1
        shorter = found.measures.cost < _COST_SHARE_TO_SWITCH * self._plan.measures.cost
        if self._settled >= _LEAST_SETTLING and found.admissible and (self._blocked or shorter):
            self._plan, self._found, self._troubled = found, None, 0
        elif self._settled > _MOST_SETTLING:
            self._found = None
        else:
            self._found = self._problem.improved(found, local)

    def _moved_on(self, plan: Plan, q: Array, dt: float) -> Plan:
        """Return a plan at the new times; an arm that is beside its plan takes the plan along."""
        nodes = taken_along(
            plan.start, plan.nodes, plan.times, self.times + dt, q, self._fading)
        return plan._replace(nodes=nodes, start=q, times=self.times)
