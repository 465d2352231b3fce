"""A way from posture to posture that keeps clear, wherever it takes the tip: RRT-Connect.

Two trees grow from start and goal towards random postures and each other (Kuffner and LaValle
2000). This says whether an arm can get there at all; it says nothing where the search ends
without a way.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from benchmark.bodies import Bodies
from benchmark.closest_approach import Motion
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Of a branch, between postures that are looked at, and when coal looks at a way [rad].
_BRANCH, _GRAIN, _FINE_GRAIN = 0.4, 0.04, 0.005
# How many random postures the trees grow towards.
_MOST_TARGETS = 3000
_SHORTCUTS = 60


class FreeWay:
    """The search among obstacles that stand still."""

    def __init__(
        self, robot: Robot, capsules: Bodies, obstacles: tuple[Obstacle, ...], margin: float,
    ) -> None:
        """Prepare; the margin is kept from obstacles [m]."""
        p = PlannerParameters()
        self._robot, self._capsules, self._obstacles = robot, capsules, obstacles
        self._radii = np.array([c.radius for c in robot.capsules])
        self._inflated = inflated_obstacles(
            Scene.of(obstacles), self._radii + margin, moved=robot.moved)
        self._self_margin = p.clearance_self_margin
        self._low = robot.position_min + p.limits_position_margin
        self._high = robot.position_max - p.limits_position_margin

    def find(self, start: Array, goal: Array, seed: int = 0) -> Array | None:
        """Return postures (k, n), free in between as well, or None if none were found.

        Args:
            start, goal: (n,) free postures.
            seed: of the random numbers.
        """
        random = np.random.default_rng(seed)
        trees = [_Tree(start), _Tree(goal)]
        forward = True
        if self._free_edge(start, goal):
            return self._confirmed(np.array([start, goal]))
        for _ in range(_MOST_TARGETS):
            growing, other = trees if forward else trees[::-1]
            reached = self._grow(growing, random.uniform(self._low, self._high), once=True)
            if reached is not None:
                met = self._grow(other, growing.nodes[reached], once=False)
                if met is not None and np.allclose(other.nodes[met], growing.nodes[reached]):
                    there, back = growing.to_root(reached)[::-1], other.to_root(met)[1:]
                    way = np.vstack((there, back)) if len(back) else there
                    return self._confirmed(self._shortened(way if forward else way[::-1], random))
            forward = not forward
        return None

    def _grow(self, tree: _Tree, target: Array, *, once: bool) -> int | None:
        """Grow a tree towards a posture, by one branch or until something is in the way.

        Returns:
            The last new node, None if there is none.
        """
        at, last = tree.nearest(target), None
        while True:
            step = target - tree.nodes[at]
            size = float(np.linalg.norm(step))
            if size < 1e-9:
                return at if last is None and not once else last
            node = target if size <= _BRANCH else tree.nodes[at] + step * (_BRANCH / size)
            if not self._free_edge(tree.nodes[at], node):
                return last
            at = last = tree.add(node, at)
            if once or size <= _BRANCH:
                return last

    def _free_edge(self, one: Array, other: Array) -> bool:
        count = int(np.ceil(np.abs(other - one).max() / _GRAIN)) + 1
        shares = np.linspace(0.0, 1.0, max(count, 2))[1:, None]
        arms = self._robot.kinematics_along(one + shares * (other - one))
        starts, ends = arms.segment_start, arms.segment_end
        if len(self._obstacles) and link_clearance(
                self._inflated, starts, ends).distance.min() < 0.0:
            return False
        return all(
            link_distances(start, end, self._radii, self._robot.self_pairs).distance.min(
                initial=np.inf) > self._self_margin for start, end in zip(starts, ends))

    def _shortened(self, way: Array, random: np.random.Generator) -> Array:
        for _ in range(_SHORTCUTS):
            if len(way) < 3:
                break
            first, last = np.sort(random.choice(len(way), 2, replace=False))
            if last - first > 1 and self._free_edge(way[first], way[last]):
                way = np.vstack((way[:first + 1], way[last:]))
        return way

    def _confirmed(self, way: Array) -> Array | None:
        """Return the way if coal finds it free, None if it leads through something after all."""
        pieces = [
            np.linspace(one, other, int(np.ceil(np.abs(other - one).max() / _FINE_GRAIN)) + 1)
            for one, other in pairwise(way)]
        motion = Motion.through(self._capsules, np.vstack(pieces))
        free = min(motion.to_obstacles(self._obstacles, 0.0).distance,
                   motion.to_itself().distance) > 0.0
        return way if free else None


class _Tree:
    """Postures, each with the one that it grew from."""

    def __init__(self, root: Array) -> None:
        self._nodes, self._parents = np.empty((64, len(root))), [-1]
        self._nodes[0] = root

    @property
    def nodes(self) -> Array:
        """(k, n)."""
        return self._nodes[:len(self._parents)]

    def add(self, node: Array, parent: int) -> int:
        """Add a node and return its index."""
        index = len(self._parents)
        if index == len(self._nodes):
            self._nodes = np.vstack((self._nodes, np.empty_like(self._nodes)))
        self._nodes[index] = node
        self._parents.append(parent)
        return index

    def nearest(self, q: Array) -> int:
        """Return the index of the nearest node."""
        return int(np.square(self.nodes - q).sum(axis=1).argmin())

    def to_root(self, index: int) -> Array:
        """Return the postures (k, n) from a node to the root."""
        found = []
        while index >= 0:
            found.append(self._nodes[index])
            index = self._parents[index]
        return np.array(found)
