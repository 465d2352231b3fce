"""How near an arm comes to obstacles and to itself, by coal, at every posture of a motion.

Distances are measured at few postures only. Between two of them no point of a body moves further
than its corners do, so a pair cannot be nearer than it was less that way. Where it could come
nearer than the nearest pair known, it is measured again: what is returned is the smallest
distance over all postures, to 10 µm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from benchmark.bodies import Bodies, shape_of
from redundant_planner.core.obstacles.obstacle import Obstacle

Array = npt.NDArray[np.float64]

# A pair is not measured again for coming nearer by less than this [m].
_RESOLUTION = 1e-5


class Approach(NamedTuple):
    """The nearest that two things came to each other.

    Attributes:
        distance: negative inside [m]; infinite where there was nothing to come near to.
        first, second: names.
        index: of the posture.
    """

    distance: float
    first: str
    second: str
    index: int

    def __str__(self) -> str:
        """Say what came near to what."""
        return f'{self.first} to {self.second}' if self.first else ''


NOTHING = Approach(np.inf, '', '', 0)


class Motion:
    """Where an arm's bodies are at each of k postures."""

    def __init__(self, bodies: Bodies, rotations: Array, positions: Array) -> None:
        """Take their places.

        Args:
            bodies: c shapes.
            rotations: (c, k, 3, 3) of the shapes in the base frame.
            positions: (c, k, 3) [m].
        """
        self.bodies = bodies
        self._rotations, self._positions = rotations, positions
        self._count = rotations.shape[1]
        self._ways = [self._way(body) for body in range(len(bodies.names))]

    @classmethod
    def through(cls, bodies: Bodies, postures: Array) -> Motion:
        """Return the motion through postures (k, n) [rad, m]."""
        rotations = np.empty((len(bodies.names), len(postures), 3, 3))
        positions = np.empty((len(bodies.names), len(postures), 3))
        data = bodies.model.createData()
        for i, q in enumerate(postures):
            pin.forwardKinematics(bodies.model, data, q)
            for body, (joint, placement) in enumerate(zip(bodies.joints, bodies.placements)):
                at = data.oMi[joint] * placement
                rotations[body, i], positions[body, i] = at.rotation, at.translation
        return cls(bodies, rotations, positions)

    def to_obstacles(self, obstacles: Sequence[Obstacle], dt: float) -> Approach:
        """Return the nearest approach to obstacles, which move on by their velocities.

        Of the bodies that a joint moves: a base may stand on what it likes.

        Args:
            obstacles: at the first posture.
            dt: between two postures [s].
        """
        nearest = NOTHING
        for obstacle in obstacles:
            shape, place = shape_of(obstacle), _place(obstacle, dt)
            speed = np.linalg.norm(obstacle.velocity) + np.linalg.norm(
                obstacle.half_extents) * np.linalg.norm(obstacle.angular_velocity)
            its_way = speed * dt * np.arange(self._count)
            for body, name in self._moved():
                distance, index = self._nearest(
                    body, shape, place, self._ways[body] + its_way, nearest.distance)
                if distance < nearest.distance:
                    nearest = Approach(distance, name, obstacle.name, index)
        return nearest

    def to_itself(self) -> Approach:
        """Return the nearest approach of the bodies that shall not meet."""
        nearest, bodies = NOTHING, self.bodies
        for first, second in bodies.self_pairs:
            distance, index = self._nearest(
                first, bodies.shapes[second], lambda i, body=second: self._at(body, i),
                self._ways[first] + self._ways[second], nearest.distance)
            if distance < nearest.distance:
                nearest = Approach(distance, bodies.names[first], bodies.names[second], index)
        return nearest

    def to_other(self, other: Motion) -> Approach:
        """Return the nearest approach to another arm, which moves at the same time."""
        nearest = NOTHING
        for second, name in other._moved():
            for first, _ in self._moved():
                distance, index = self._nearest(
                    first, other.bodies.shapes[second],
                    lambda i, body=second: other._at(body, i),
                    self._ways[first] + other._ways[second], nearest.distance)
                if distance < nearest.distance:
                    nearest = Approach(distance, self.bodies.names[first], name, index)
        return nearest

    def _moved(self) -> list[tuple[int, str]]:
        """Return the indices and names of the bodies that a joint moves."""
        return [(body, name) for body, (name, joint) in enumerate(
            zip(self.bodies.names, self.bodies.joints)) if joint > 0]

    def _at(self, body: int, i: int) -> coal.Transform3s:
        return coal.Transform3s(self._rotations[body, i], self._positions[body, i])

    def _way(self, body: int) -> Array:
        """Return how far (k,) any point of a body has come, at most, since the start [m].

        The distance that a point moves is a convex function of where on the body it is, so no
        point moves further than a corner of the box around the body.
        """
        shape = self.bodies.shapes[body]
        shape.computeLocalAABB()
        low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
        corners = np.stack(np.meshgrid(*zip(low, high)), axis=-1).reshape(-1, 3)
        places = (np.einsum('kij,cj->kci', self._rotations[body], corners)
                  + self._positions[body][:, None])
        steps = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1, initial=0.0)
        return np.concatenate(([0.0], np.cumsum(steps)))

    def _nearest(
        self, body: int, other: coal.ShapeBase, at: Callable[[int], coal.Transform3s],
        way: Array, known: float,
    ) -> tuple[float, int]:
        """Return the smallest distance of a body to another shape, if smaller than one known.

        Args:
            body: which.
            other: the shape.
            at: index of a posture → the shape's place.
            way: (k,) how far the two have moved together since the start, at most [m].
            known: [m].

        Returns:
            [m], and the index of the posture.
        """
        shape, request = self.bodies.shapes[body], coal.DistanceRequest()
        i, index = 0, 0
        while i < self._count:
            distance = coal.distance(
                shape, self._at(body, i), other, at(i), request, coal.DistanceResult())
            if distance < known:
                known, index = float(distance), i
            spare = max(distance - known + _RESOLUTION, _RESOLUTION)
            i = max(i + 1, int(np.searchsorted(way, way[i] + spare)))
        return known, index


def _place(obstacle: Obstacle, dt: float) -> Callable[[int], coal.Transform3s]:
    """Return where an obstacle is after a number of ticks."""
    center, rotation = np.array(obstacle.center), np.array(obstacle.rotation)
    velocity, turning = np.array(obstacle.velocity), np.array(obstacle.angular_velocity)
    return lambda i: coal.Transform3s(
        pin.exp3(i * dt * turning) @ rotation, center + i * dt * velocity)
