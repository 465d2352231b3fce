"""The way of the joints along a chunk of positions, and where on it the arm is."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.handover import handover, rested
from redundant_planner.core.target.pace_along import pace_along
from redundant_planner.core.target.smooth_curve import Motion, SmoothCurve

Array = npt.NDArray[np.float64]

# Share of the acceleration limits that the way may take: what it was sampled at is not exact.
_SHARE = 0.95
# Nodes of the way: this far apart, unless these would be too few or too many [s].
_SPACING, _FEWEST, _MOST = 0.01, 40, 1000


class JointChunkWay:
    """One chunk's way, begun where the arm was.

    Attributes:
        begin, end: where on the chunk it begins and ends [s].
        pace: how fast time may pass on it.
        times: (N + 1,) when the nodes of the pace are passed, from its beginning on [s].
        share: of the chunk's pace at which it begins.
    """

    def __init__(
        self, robot: Robot, limits: Limits, full_speed: Array, chunk: Chunk, begin: float,
        moving: Motion,
    ) -> None:
        """Find the way.

        Args:
            robot: the arm.
            limits: of its joints.
            full_speed: highest linear and angular speed of the tip [m/s, rad/s].
            chunk: of joint positions.
            begin: where on it [s].
            moving: (n,) where the arm is, and how it moves.
        """
        assert isinstance(chunk.points, np.ndarray), 'of the joints'
        self._range = limits.positions[1], limits.positions[0]
        points = chunk.points + (nearest_turn(
            chunk.points[0], moving.position, robot.position_max) - chunk.points[0])
        self._curve = SmoothCurve(chunk.times, points, chunk.velocities)
        self.begin = min(begin, self._curve.end)
        now = Motion(*(part[0] for part in self._curve.at(np.array([self.begin]))))
        self._fading, share = handover(
            moving, now, lambda times: self._curve.at(self.begin + times), limits,
            self._curve.begin - self.begin)
        self._curve = rested(self._curve, self.begin, self._fading)
        self.end = max(self._curve.end, self.begin + self._fading.duration)
        count = int(np.clip((self.end - self.begin) / _SPACING, _FEWEST, _MOST))
        step = (self.end - self.begin) / count
        nodes = self.at(np.linspace(self.begin, self.end, count + 1))
        self.pace = pace_along(
            nodes, self.begin, step, _tip_shares(robot, nodes, step, full_speed),
            limits.velocity_max, _SHARE * limits.acceleration_max)
        self.times = self.pace.times()
        self.share = min(share, math.sqrt(self.pace.squared[0]))

    def at(self, s: Array) -> Array:
        """Return the postures (N, n) at times (N,) of the chunk [rad, m]."""
        return np.clip(self._curve.at(s).position
                       + self._fading.at(s - self.begin).position, *self._range)

    def off(self, s: float, q: Array) -> float:
        """Return how far the joint furthest from the chunk itself is at a time of it [rad, m]."""
        return float(np.abs(self._curve.at(np.array([s])).position[0] - q).max())


def _tip_shares(robot: Robot, nodes: Array, step: float, full_speed: Array) -> Array:
    """Return the share (N + 1,) of the pace at nodes that keeps the tip no faster than it may."""
    moves = np.diff(nodes, axis=0) / step
    twists = np.einsum('kij,kj->ki', robot.kinematics_along(nodes).tip_jacobian[:-1], moves)
    speed = np.maximum(np.linalg.norm(twists[:, :3], axis=1) / full_speed[0],
                       np.linalg.norm(twists[:, 3:], axis=1) / full_speed[1])
    share = 1.0 / np.maximum(speed, 1.0)
    return np.minimum(np.append(share, 1.0), np.insert(share, 0, 1.0))

