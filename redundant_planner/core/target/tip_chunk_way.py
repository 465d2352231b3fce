"""The way of the tip along a chunk of poses, and how fast it may be there.

Orientations are unit quaternions that a curve through them all is brought back to: any number of
turns, as long as successive poses are less than half a turn apart.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import least_norm_path, PathJoints
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.handover import handover, rested
from redundant_planner.core.target.pace_along import Pace, pace_along
from redundant_planner.core.target.smooth_curve import Motion, SmoothCurve

Array = npt.NDArray[np.float64]

# Share of the acceleration limits that the way may take: the rest is for the null space, and for
# what the postures looked at are wrong by.
_SHARE = 0.8
# The arm looks so far ahead, and by so many times what it takes to stop [s].
_AHEAD, _STOPS = 1.0, 2.0
# Nodes that it looks at: this far apart, unless these would be too few or too many [s].
_SPACING, _FEWEST, _MOST = 0.03, 12, 48
# Squared damping of what the tip's motion asks of the joints.
_DAMPING = 1e-3


class Which(NamedTuple):
    """Which tip follows a way, and what the others do meanwhile.

    Attributes:
        tip: its number.
        coupling: that moves the others along; None where they stay.
    """

    tip: int = 0
    coupling: Coupling | None = None

    def of_all(self, poses: Poses, others: Poses) -> Poses:
        """Return the poses of t tips (N t) where this one has poses (N).

        Args:
            poses: of this tip.
            others: where the tips are due; of them those that stay count.
        """
        if len(others.position) == 1:
            return poses
        found: list[Pose] = []
        for pose in poses.each:
            if self.coupling is not None:
                found += self.coupling.tips(pose).each
            else:
                found += [pose if t == self.tip else at for t, at in enumerate(others.each)]
        return Poses.of(*found)


class TipChunkWay:
    """One chunk's way, begun where the tip was.

    Attributes:
        begin, end: where on the chunk it begins and ends [s].
        share: of the chunk's pace at which it begins.
        pace: how fast time may pass, as far as the arm has looked ahead.
        preview: the twists of this part, in the command frame; times from the look on.
        times: (N + 1,) when its nodes are passed, from the look on [s].
    """

    def __init__(
        self, robot: Robot, limits: Limits, joints: PathJoints, full_speed: Array, chunk: Chunk,
        begin: float, start: Start, twist: Motion, which: Which,
    ) -> None:
        """Find the way.

        Args:
            robot: the arm.
            limits: of its joints.
            joints: how they are weighed and bounded.
            full_speed: highest linear and angular speed of the tip [m/s, rad/s].
            chunk: of poses.
            begin: where on it [s].
            start: where the arm is, and its tips should be.
            twist: how the tip moves (6,) in base axes; its position does not count.
            which: tip.
        """
        arm, tip = start.arm, start.reference_of(which.tip)
        assert isinstance(chunk.points, tuple), 'of poses'
        self._robot, self._limits, self._joints = robot, limits, joints
        self._full_speed, self._which = full_speed, which
        self._curve = SmoothCurve(chunk.times, _coordinates(chunk.points))
        self.begin = min(begin, self._curve.end)
        now, at = self._curve_motion(np.array([self.begin])), self.pose_of_chunk(self.begin)
        apart = se3.pose_error(tip, at, False)
        turn = tip.rotation @ at.rotation.T
        ours = Motion(np.zeros(6), *(
            np.concatenate((part[0, :3], turn @ part[0, 3:])) for part in (now.rate, now.bend)))
        of_tip = slice(6 * which.tip, 6 * which.tip + 6)
        controlled = robot.full_twist(np.ones(robot.m))[of_tip] > 0.0
        self._controlled = controlled
        jacobian = arm.tip_jacobian[of_tip]
        if not robot.in_tool:
            jacobian = jacobian[controlled]
        inverse = np.zeros((robot.n, 6))
        inverse[:, controlled if not robot.in_tool else slice(None)] = np.linalg.solve(
            jacobian @ jacobian.T + _DAMPING * np.eye(len(jacobian)), jacobian).T

        def joints_along(times: Array) -> Motion:
            motion = self._curve_motion(self.begin + times)
            return Motion(*(part @ inverse.T for part in motion))

        self._fading, share = handover(
            twist._replace(position=apart), ours, joints_along, limits,
            self._curve.begin - self.begin, inverse)
        self._curve = rested(self._curve, self.begin, self._fading)
        self.end = max(self._curve.end, self.begin + self._fading.duration)
        self._ahead = max(_AHEAD, _STOPS * float(
            (limits.velocity_max / limits.acceleration_max).max()))
        self.look(self.begin, start)
        self.share = min(share, math.sqrt(self.pace.squared[0]))

    def look(self, s: float, start: Start) -> None:
        """Look ahead from a time of the chunk [s], and the start of a tick."""
        until = min(self.end, s + self._ahead)
        count = int(np.clip((until - s) / _SPACING, _FEWEST, _MOST))
        step = max((until - s) / count, _SPACING / _MOST)
        poses = self.along(np.linspace(s, s + step * count, count + 1))
        # The first step is from where the arm is beside its way.
        first = [0, 0, *range(count + 1)]
        nodes = least_norm_path(self._robot, start.arm.q, self._which.of_all(
            Poses(poses.position[first], poses.rotation[first]), start.reference),
            self._joints)[2:]
        twists = _steps(poses) / step
        speed = np.maximum(np.linalg.norm(twists[:, :3], axis=1) / self._full_speed[0],
                           np.linalg.norm(twists[:, 3:], axis=1) / self._full_speed[1])
        share = 1.0 / np.maximum(speed, 1.0)
        fastest = np.minimum(np.append(share, 1.0), np.insert(share, 0, 1.0))
        self.pace: Pace = pace_along(
            nodes, s, step, fastest, self._limits.velocity_max,
            _SHARE * self._limits.acceleration_max)
        self.times = self.pace.times()
        f = np.sqrt(self.pace.squared)
        said = [self._in_command_axes(f[i] * twists[min(i, count - 1)], poses.rotation[i])
                for i in range(count + 1)]
        self.preview = Preview(self.times, said)

    def along(self, s: Array) -> Poses:
        """Return where the tip should be at times (N,) of the chunk [s]."""
        x, fading = self._curve.at(s).position, self._fading.at(s - self.begin).position
        angle = np.linalg.norm(fading[:, 3:], axis=1, keepdims=True)
        turn = np.hstack((0.5 * np.sinc(0.5 * angle / np.pi) * fading[:, 3:],
                          np.cos(0.5 * angle)))
        return Poses(x[:, :3] + fading[:, :3], rotations(turn) @ rotations(x[:, 3:]))

    def pose_of_chunk(self, s: float) -> Pose:
        """Return where the chunk itself has the tip at a time [s]."""
        x = self._curve.at(np.array([s])).position[0]
        return Pose(x[:3].copy(), rotations(x[None, 3:])[0])

    def off(self, s: float, tip: Pose) -> float:
        """Return how far a tip is from the chunk itself at a time of it [m, rad]."""
        apart = se3.pose_error(self.pose_of_chunk(s), tip, self._robot.in_tool)
        return float(np.abs(apart[self._controlled]).max())

    def _curve_motion(self, times: Array) -> Motion:
        """Return how the chunk itself moves at times (N,): (N, 6) in base axes, positions 0."""
        x, rate, bend = self._curve.at(times)
        squared = np.square(x[:, 3:]).sum(axis=1, keepdims=True)
        turning = _turning(rate[:, 3:], x[:, 3:]) / squared
        growing = (x[:, 3:] * rate[:, 3:]).sum(axis=1, keepdims=True) / squared
        return Motion(
            np.zeros((len(times), 6)), np.hstack((rate[:, :3], turning)),
            np.hstack((bend[:, :3], _turning(bend[:, 3:], x[:, 3:]) / squared
                       - 2.0 * growing * turning)))

    def _in_command_axes(self, twist: Array, rotation: Array) -> Array:
        return se3.turned(twist, rotation.T) if self._robot.in_tool else twist


def _coordinates(poses: tuple[Pose, ...]) -> Array:
    """Return poses as positions and quaternions (K, 7), each the nearer to the one before."""
    quaternions = np.array([quaternion_of(pose.rotation) for pose in poses])
    signs = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
    quaternions[1:] *= np.cumprod(np.where(signs < 0.0, -1.0, 1.0))[:, None]
    return np.hstack((np.array([pose.position for pose in poses]), quaternions))


def _steps(poses: Poses) -> Array:
    """Return the displacements (N, 6) from each of N + 1 poses to the next [m, rad]."""
    turn = poses.rotation[1:] @ poses.rotation[:-1].transpose(0, 2, 1)
    axis = 0.5 * np.column_stack((
        turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
        turn[:, 1, 0] - turn[:, 0, 1]))
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0))
    return np.hstack((np.diff(poses.position, axis=0),
                      axis * (angle / np.maximum(sine, 1e-12))[:, None]))


def _turning(rate: Array, quaternion: Array) -> Array:
    """Return 2 Im(q' q*), (N, 3), of quaternions x y z w (N, 4) and their rates."""
    v, w, dv, dw = quaternion[:, :3], quaternion[:, 3:], rate[:, :3], rate[:, 3:]
    return 2.0 * (w * dv - dw * v + np.cross(v, dv))
