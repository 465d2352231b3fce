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
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import least_norm_nodes, PathJoints
from redundant_planner.core.horizon.path_qp import intrusion_price, PathQP, Plan
from redundant_planner.core.kernels import compiled, entry, Matrix, Stack, Vector
from redundant_planner.core.obstacles.clearance import measure, Pairs
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.kinematics import (
    Chain,
    fill_tip,
    links_along,
    new_kinematics_compiled,
    new_places,
)
from redundant_planner.core.robot.se3 import Poses

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
        start: (n,) where the last path started.
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
        self._random = np.random.default_rng(0)
        self._first_number = self._random.bit_generator.state
        self.reset()

    def reset(self) -> None:
        """Begin again with the first search."""
        self._search: _Search | None = None
        self._searches = 0
        # A new generator takes a tenth of a millisecond.
        self._random.bit_generator.state = self._first_number

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
        search, looks = self._search, len(self._search.paths)
        if looks == _SIDE_STEPS + 1:
            search.start, search.aside = search.q, -search.aside
        seen = _look_aside(
            search.start, search.aside, search.size if looks else 0.0, _Snapshot(
                search.poses, search.times, search.obstacles),
            self._problem.robot.chain, self._problem.joints)
        search.start, search.aside = seen.start, seen.aside
        search.paths.append((seen.nodes, seen.price))
        if len(search.paths) <= 2 * _SIDE_STEPS:
            return None
        self._search = None
        nodes, prices = map(np.array, zip(*search.paths))
        way = _cheapest(search.q, nodes, prices, search.times, self._problem.joints.scaling)
        return Plan(way, search.q, search.times), search.elapsed


class _Snapshot(NamedTuple):
    """The problem when a search began; see `_Search`."""

    poses: Poses
    times: Vector
    obstacles: InflatedObstacles


class _Seen(NamedTuple):
    """One path of a search.

    Attributes:
        nodes: (N, n) its postures.
        price: (N,) of being there.
        start: (n,) where it starts.
        aside: (n,) the direction of the last step aside.
    """

    nodes: Matrix
    price: Vector
    start: Vector
    aside: Vector


@entry
def _look_aside(
    start: Vector, aside: Vector, size: float, problem: _Snapshot, chain: Chain,
    joints: PathJoints,
) -> _Seen:
    """Return the least-norm path from a posture a step aside of another one.

    The step leads along the null space, and back to the same tip pose.

    Args:
        start: (n,) the other posture.
        aside: (n,) where the step leads; its projection on the null space counts.
        size: of the step [rad, m]; 0 for the path from `start` itself.
        problem: what the path is for.
        chain, joints: the arm.
    """
    posture, step = start.copy(), aside.copy()
    if size > 0.0:
        arm = new_kinematics_compiled(start, len(chain.rows), len(chain.tip_joints), 0)
        fill_tip(chain, new_places(len(start)), arm)
        step = null_space.project(
            null_space.decompose(arm.jacobian * joints.scaling), aside / joints.scaling)
        step *= joints.scaling / max(math.sqrt(np.sum(step * step)), 1e-9)
        tips = Poses(arm.tip_positions, arm.tip_rotations)
        posture = least_norm_nodes(start + size * step, tips, chain, joints)[0].copy()
    nodes = least_norm_nodes(posture, problem.poses, chain, joints)
    begin, end = links_along(nodes, chain)
    price, shape = np.zeros(len(nodes)), problem.obstacles.smallest.shape
    pairs = Pairs(np.empty(shape), np.empty(shape), np.empty(shape))
    for i in range(len(nodes)):
        measure(problem.obstacles, begin[i], end[i], problem.times[i + 1], -np.inf, pairs)
        nearest = pairs.distance.min() if pairs.distance.size > 0 else np.inf
        price[i] = intrusion_price(-nearest)
    return _Seen(nodes, price, posture, step)


@compiled
def _cheapest(
    q: Vector, nodes: Stack, prices: Matrix, times: Vector, scaling: Vector,
) -> Array:
    """Return the cheapest way (N, n) through a search's postures, by dynamic programming.

    Args:
        q: (n,) where it starts.
        nodes: (p, N, n) the postures of p paths.
        prices: (p, N) of being there.
        times: (N + 1,) of start and nodes [s].
        scaling: (n,) of the joints, see `PathJoints`.
    """
    paths, count, n = nodes.shape
    value, origins = np.empty(paths), np.empty((count, paths), np.intp)
    totals = np.empty(paths)
    for i in range(count):
        stiffness = 1.0 / (times[i + 1] - times[i])
        for path in range(paths):
            least, origin = np.inf, 0
            for before in range(paths if i > 0 else 1):
                squared = 0.0
                for j in range(n):
                    at = nodes[before, i - 1, j] if i > 0 else q[j]
                    gap = (nodes[path, i, j] - at) / scaling[j]
                    squared += gap * gap
                total = stiffness * squared + (value[before] if i > 0 else 0.0)
                if total < least:
                    least, origin = total, before
            totals[path], origins[i, path] = least + prices[path, i], origin
        value[:] = totals
    way, path = np.empty((count, n)), int(value.argmin())
    for i in range(count - 1, -1, -1):
        way[i] = nodes[path, i]
        path = origins[i, path]
    return way
