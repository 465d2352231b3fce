"""A search for joint paths on other sides of the obstacles than the plan's own.

A linearised problem finds the best path on its own side of an obstacle, not the better side. The
search therefore looks at least-norm paths that start where the arm would be if it had moved aside
along its null space, further and further to one side and then to the other. Dynamic programming
picks the cheapest free way through all their postures.

With one spare degree of freedom a search sees every way within its reach. With more it sees a
slice, each time another one. The order is fixed, and so is the result.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import least_norm_path
from redundant_planner.core.horizon.path_qp import intrusion_price, PathQP, Plan
from redundant_planner.core.horizon.poses_ahead import Poses
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.redundancy import null_space

Array = npt.NDArray[np.float64]

# Steps aside to either side of the least-norm path, and their sizes in turn [rad, m].
_SIDE_STEPS = 9
_SIDE_STEP_SIZES = (0.3, 0.1)


@dataclass
class _Search:
    """What has been seen so far, on a snapshot of the problem.

    Attributes:
        q, poses, times, obstacles: the snapshot.
        aside: (n,) the direction looked in; its projection on the null space counts.
        size: of a step aside [rad, m].
        start: (n,) where the next path starts.
        elapsed: time since the snapshot [s].
        paths: what was seen to one side and then the other, outwards each: postures (N, n) and
            their price (N,).
    """

    q: Array
    poses: Poses
    times: Array
    obstacles: InflatedObstacles
    aside: Array
    size: float
    start: Array
    elapsed: float = 0.0
    paths: list[tuple[Array, Array]] = field(default_factory=list)


class MultiStart:
    """One search after the other, one path per step."""

    def __init__(self, problem: PathQP) -> None:
        """Prepare for one arm's problem."""
        self._problem = problem
        self.reset()

    def reset(self) -> None:
        """Begin again with the first search."""
        self._search: _Search | None = None
        self._searches = 0
        self._random = np.random.default_rng(0)

    def drop(self) -> None:
        """Give up the search under way; the next step begins another one."""
        self._search = None

    def pass_time(self, dt: float) -> None:
        """Take note that the problem has moved on by `dt` [s]."""
        if self._search is not None:
            self._search.elapsed += dt

    def step(
        self, q: Array, poses: Poses, obstacles: InflatedObstacles, away: Array | None,
    ) -> tuple[Plan, float] | None:
        """Look at one more path; at a search's end, return the cheapest way and its age.

        Args:
            q, poses, obstacles: the problem now, of which a new search takes a snapshot.
            away: (n,) the direction of a new search, away from what the plan is closest to;
                None if it is close to nothing.

        Returns:
            A plan, and how long ago it was to start [s]; None before the end.
        """
        if self._search is None:
            # Away from the obstacle that the plan is closest to, or just anywhere.
            aside = self._random.normal(size=len(q))
            if away is not None and self._searches % 4 < 2:
                aside = away
            size = _SIDE_STEP_SIZES[self._searches % len(_SIDE_STEP_SIZES)]
            self._searches += 1
            self._search = _Search(
                q, poses, self._problem.times, obstacles, aside, size, q)
        search, problem = self._search, self._problem
        nodes = least_norm_path(problem.robot, search.start, search.poses, problem.joints)
        search.paths.append((nodes, self._price(nodes, search)))
        if len(search.paths) > 2 * _SIDE_STEPS:
            self._search = None
            return Plan(self._cheapest(search), search.q, search.times), search.elapsed
        if len(search.paths) == _SIDE_STEPS + 1:
            search.start, search.aside = search.q, -search.aside
        search.start, search.aside = self._side_step(search.start, search.aside, search.size)
        return None

    def _side_step(self, q: Array, aside: Array, size: float) -> tuple[Array, Array]:
        """Return a posture (n,) a step aside with the same tip pose, and the step's direction."""
        robot, joints = self._problem.robot, self._problem.joints
        arm = robot.kinematics(q)
        step = null_space.project(
            null_space.decompose(arm.jacobian * joints.scaling), aside / joints.scaling)
        step *= joints.scaling / max(math.sqrt(step @ step), 1e-9)
        pose = Poses(arm.tip_position[None], arm.tip_rotation[None])
        return least_norm_path(robot, q + size * step, pose, joints)[0], step

    def _price(self, nodes: Array, search: _Search) -> Array:
        """Return the price of being at postures (N, n), (N,)."""
        arms = self._problem.robot.kinematics_along(nodes)
        pairs = link_clearance(
            search.obstacles, arms.segment_start, arms.segment_end, search.times[1:], -math.inf)
        return intrusion_price(-pairs.distance.min(axis=(1, 2), initial=np.inf))

    def _cheapest(self, search: _Search) -> Array:
        """Return the cheapest way (N, n) through a search's postures, by dynamic programming."""
        postures = np.array([nodes for nodes, _ in search.paths]).transpose(1, 0, 2)
        prices = np.array([price for _, price in search.paths]).T
        stiffness = 1.0 / np.diff(search.times)
        scaled = postures / self._problem.joints.scaling
        gaps = scaled[:-1, :, None] - scaled[1:, None]
        steps = (gaps * gaps).sum(axis=-1) * stiffness[1:, None, None]
        first = scaled[0] - search.q / self._problem.joints.scaling
        value = (first * first).sum(axis=-1) * stiffness[0] + prices[0]
        origins = []
        for step, price in zip(steps, prices[1:]):
            total = value[:, None] + step
            origins.append(total.argmin(axis=0))
            value = total.min(axis=0) + price
        at = int(value.argmin())
        way = [at]
        for origin in reversed(origins):
            at = int(origin[at])
            way.append(at)
        return postures[np.arange(len(way)), way[::-1]]
