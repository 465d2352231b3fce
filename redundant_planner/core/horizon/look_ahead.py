"""When the null space follows the joint path ahead, and the upkeep of that path.

`variational` always follows it. `dynamic_factor` switches to it while Eq. 2's own motion would
run into something.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.errors import StateError
from redundant_planner.core.horizon.held_twist import continued, growth_of
from redundant_planner.core.horizon.horizon import Horizon
from redundant_planner.core.horizon.least_norm_path import path_joints

# The first preview must not have to load it in a tick.
import redundant_planner.core.horizon.mean_twists  # noqa: F401
from redundant_planner.core.horizon.poses_ahead import middles, node_times, poses_ahead
from redundant_planner.core.horizon.preview import Preview, PreviewAhead, TwistAhead
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.redundancy.reference import reference_of, Start
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import Limits

Array = npt.NDArray[np.float64]

# Time over which the trend of a held command, and the share of it that is followed, are averaged
# [s].
_TREND = 0.1
# The joint path ahead is improved at most this often [s]: it takes a sixth of a millisecond.
_PLANNING_PERIOD = 0.003
# No joint path is planned among more obstacles than this.
MOST_OBSTACLES = 50
# A tick that knows a way aside leaves the path as it is until that is so old [s]. One that has
# chosen its obstacles anew, which few do, leaves it for longer.
_OLDEST_PATH, OLDEST_PATH_CHOOSING = 0.04, 0.06
# An arm this slow stands [rad/s, m/s].
_STANDSTILL = 1e-3
# How long dynamic_factor takes to switch to the joint path ahead, and back [s]; and the share of
# it that remains while the path might come of use again.
_SWITCH_TIME, _RETURN_TIME, _STANDBY = 0.3, 1.0, 1e-3
# How long it stays with the path once the way is free without it: a way that is blocked in every
# other tick must not make it switch as often [s].
_STAY = 0.3
# Time over which the velocity of the path is averaged [s]; longer where it leads nowhere, and is
# another one at each look.
_SMOOTHING_TIME, _SMOOTHING_TIME_BLOCKED = 0.04, 0.3


class _Due(NamedTuple):
    """A step that is due to improve the path.

    Attributes:
        start, obstacles: of the tick that it belongs to.
        twists: (N, 6) mean twists from each node to the next.
        elapsed: since the step before [s].
    """

    start: Start
    obstacles: InflatedObstacles
    twists: Array
    elapsed: float


class LookAhead:
    """The joint path ahead of one arm, and how much of the null-space motion follows it.

    A step that improves the path takes longer than the rest of a tick. It is left to `catch_up`,
    once the tick's command is out, and the next tick uses it. Where obstacles had to be chosen
    meanwhile, it waits for a tick. Only a first path is planned at once.

    Attributes:
        guided: share of the null-space motion that follows it; 1 for `variational`.
    """

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, limits: Limits,
        constants: RobotConstants, gains: Gains,
    ) -> None:
        """Prepare for an arm; the other arguments are made of the parameters."""
        self._robot, self._constants = robot, constants
        self._always = parameters.method == 'variational'
        self._horizons = tuple(
            Horizon(robot, node_times(duration, parameters.horizon_nodes),
                    path_joints(constants, gains, limits))
            for duration in (parameters.horizon_duration, parameters.horizon_held_duration))
        self._controlled = robot.full_twist(np.ones(robot.m))
        self._gains = gains
        self.reset()

    def reset(self) -> None:
        """Forget the path, and what it was planned for."""
        self.guided = 1.0 if self._always else 0.0
        self._horizon: Horizon | None = None
        self._wanted: Array | None = None
        self._velocity: Array | None = None
        self._has_planned = False
        self._due: _Due | None = None
        self._waited = False  # what is due, for a tick
        self._prepared = False  # whether the arm has just started on a path planned before
        self._age = 0.0  # of the path, or of the attempt to find one [s]
        self._command: Array = np.zeros(len(self._controlled))
        self._growth = 0.0
        self._stay = 0.0
        self._scale = 1.0

    @property
    def cut_short(self) -> bool:
        """Whether the path's last problem took more iterations than it may."""
        return self._horizon is not None and self._horizon.cut_short

    def velocity(
        self, start: Start, obstacles: InflatedObstacles, ahead: Preview | TwistAhead | None,
        *, busy: bool, chose: bool, chose_ahead: bool,
    ) -> Array | None:
        """Return the velocity (n,) of the shortest joint path ahead, None where there is none.

        Args:
            start: of the tick.
            obstacles: the nearest obstacles.
            ahead: see `Planner.step`.
            busy: whether the tick has other work to do that takes long.
            chose, chose_ahead: whether it has chosen its obstacles anew, see `ObstacleWatch`.
        """
        if self._robot.n <= self._robot.m:
            return None if self.guided == 0.0 else np.zeros(self._robot.n)
        self.catch_up(chose_ahead)
        self._waited = self._due is not None
        self._age += start.dt
        oldest = OLDEST_PATH_CHOOSING if chose else _OLDEST_PATH if busy else 0.0
        if isinstance(ahead, Preview):
            ahead = ahead.ahead(0.0)
        if self.guided == 0.0:
            if self._has_planned or isinstance(ahead, PreviewAhead):  # else there is nothing to do
                self._prepare(start, obstacles, ahead, oldest)
            return None
        self._improve(start, obstacles, ahead, oldest)
        return self._smoothed(start.dt)

    def _prepare(
        self, start: Start, obstacles: InflatedObstacles, ahead: TwistAhead | None, oldest: float,
    ) -> None:
        """Plan the path of an announced motion before it begins, to start with it from rest."""
        if (np.abs(start.previous) > _STANDSTILL).any():
            if self._has_planned:
                self.reset()
        elif isinstance(ahead, PreviewAhead) and not start.command.any() and (
                ahead.rest > 0.0 and ahead.begin < self._horizons[0].times[-1]):
            self._improve(start, obstacles, ahead, oldest)
        elif self._age >= _OLDEST_PATH:
            self.reset()

    def _improve(
        self, start: Start, obstacles: InflatedObstacles, ahead: TwistAhead | None, oldest: float,
    ) -> None:
        """Note a step to improve the path as due; not before that is `oldest` old [s]."""
        if self._age < max(oldest, _PLANNING_PERIOD if self._has_planned else 0.0):
            return
        elapsed, self._age = self._age, 0.0
        growth = self._growth_of(start.command, elapsed)
        horizon = self._horizons[ahead is None]
        if horizon is not self._horizon:
            self._horizon = horizon
            horizon.reset()

        # A node that slid over the end of the motion would make the path another one each time.
        horizon.reach(ahead.rest if isinstance(ahead, PreviewAhead) else math.inf, start.dt)
        times = horizon.times
        twists = (continued(start.command, growth, middles(times)) if ahead is None
                  else self._controlled * self._asked(ahead, times))
        self._due = _Due(start, obstacles, twists, elapsed)
        if not self._has_planned:
            self.catch_up(chose_ahead=False)
        self._has_planned = True

    def _asked(self, ahead: TwistAhead, times: Array) -> Array:
        """Return the twists (N, 6) that are said to come at times (N + 1,); check their number."""
        twists = np.asarray(ahead(times), dtype=float)
        if twists.shape != (len(times) - 1, len(self._controlled)):
            raise StateError(
                f'ahead returned twists of shape {twists.shape} for {len(times)} times; it must '
                f'return one from each time to the next, ({len(times) - 1}, 6)')
        return twists

    def catch_up(self, chose_ahead: bool) -> bool:
        """Take the step that the last tick has left; return whether it did.

        Args:
            chose_ahead: whether obstacles had to be chosen after that tick.
        """
        if chose_ahead and not self._waited:
            return False
        due, self._due = self._due, None
        if due is None or self._horizon is None:
            return False
        start, times = due.start, self._horizon.times
        reference = reference_of(start, self._constants, self._gains)
        poses = poses_ahead(reference, due.twists, times, self._robot.in_tool)
        self._wanted = self._horizon.advance(start.arm.q, poses, due.obstacles, due.elapsed)
        return True

    def _smoothed(self, dt: float) -> Array | None:
        """Return the path's velocity (n,), smoothed: another path may take another direction.

        What is planned belongs to a tip at full speed. Where it leads nowhere, and the tip slows
        down in front of that, the joints slow down with it.
        """
        if self._wanted is None:
            self._velocity = None
            return None
        before, wanted, memory = self._velocity, self._wanted, _SMOOTHING_TIME
        if self._horizon is not None and not self._horizon.free:
            wanted, memory = self._scale * wanted, _SMOOTHING_TIME_BLOCKED
        if before is None:
            # A new path's first steps are far from its solution: it begins with nothing.
            before = wanted if self._prepared else np.zeros_like(wanted)
            self._prepared = False
        share = 1.0 - math.exp(-dt / memory)
        self._velocity = before + share * (wanted - before)
        return self._velocity

    def note(self, scale: float, dt: float) -> None:
        """Note which share of the commanded speed the last tick followed."""
        self._scale += (1.0 - math.exp(-dt / _TREND)) * (scale - self._scale)

    def switch(self, blocked: bool, dt: float, *, at_once: bool = False) -> None:
        """Follow the path gradually while the arm's own motion is blocked, and back afterwards.

        A path that leads nowhere either is kept up, but not followed.

        Args:
            blocked: whether it is.
            dt: [s].
            at_once: whether to turn back as soon as the way is free: among what moves, the path is
                soon out of date.
        """
        if self._always:
            return
        useful = blocked and (self._horizon is None or self._horizon.free)
        if useful and self.guided == 0.0 and self._has_planned:
            # The arm starts from rest on a path that was planned before: nothing has to fade in.
            # The path's next step, which the motion belongs to, is due at once.
            self.guided, self._prepared, self._has_planned = 1.0, True, False
        self._stay = _STAY if useful else 0.0 if at_once else self._stay - dt
        if self._stay > 0.0:
            self.guided = min(self.guided + dt / _SWITCH_TIME, 1.0)
        elif self.guided > 0.0:
            least = _STANDBY if blocked else 0.0
            self.guided = max(self.guided - dt / _RETURN_TIME, least)
            if self.guided == 0.0:
                self.reset()

    def _growth_of(self, command: Array, dt: float) -> float:
        """Return the rate at which the command has been growing or fading lately [1/s]."""
        rate = growth_of(self._command, command, dt)
        if math.isnan(rate):
            self._growth = 0.0
        else:
            self._growth += (1.0 - math.exp(-dt / _TREND)) * (rate - self._growth)
        self._command = command
        return self._growth
