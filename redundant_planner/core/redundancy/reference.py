"""The reference poses, and the feedback that leads the tips back to them (docs/derivations.md).

The reference is where the tip would be had every followed twist been integrated exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.kernels import entry, Indices, kernel, Matrix, Vector
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.jacobian import jdot_qdot
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.se3 import one_pose, Pose, Poses

Array = npt.NDArray[np.float64]

# Deadband of the pose feedback without a command [m, rad].
_AT_REST = 1e-5


class Task(NamedTuple):
    """What the tip shall do in a tick, in the controlled axes of the command frame.

    Attributes:
        twists: (3, m) the three below.
        error: (6 t,) reference poses minus the tips'.
    """

    twists: Matrix
    error: Vector

    @property
    def commanded(self) -> Array:
        """The commanded twist, (m,)."""
        return self.twists[0]

    @property
    def feedback(self) -> Array:
        """The twist that leads back to the reference pose, (m,)."""
        return self.twists[1]

    @property
    def turning(self) -> Array:
        """The part that J's own turning within the tick makes, ½ dt J̇ q̇, (m,)."""
        return self.twists[2]


class Start(NamedTuple):
    """Where a tick starts.

    Attributes:
        arm: at the measured posture.
        reference: poses of the tips before the tick.
        command: (6 t,) their twists [m/s, rad/s].
        previous: (n,) velocity of the last tick [rad/s, m/s].
        dt: [s].
    """

    arm: Kinematics
    reference: Poses
    command: Vector
    previous: Vector
    dt: float

    def reference_of(self, tip: int) -> Pose:
        """Return a tip's reference pose."""
        return Pose(self.reference.position[tip], self.reference.rotation[tip])


@kernel
def _apart(a: Vector, b: Vector) -> float:
    """Return the largest difference of two vectors' entries."""
    largest = 0.0
    for i in range(len(a)):
        largest = max(largest, abs(a[i] - b[i]))
    return largest


class Caps(NamedTuple):
    """How far the reference may be from the tip at most [m, rad]."""

    distance: float
    angle: float


@kernel
def _brought_along(
    reference: Poses, tips: Poses, rows: Indices, in_tool: bool, caps: Caps,
) -> tuple[Vector, Poses]:
    """Return the error (6 t,) of the tips, and references, which are brought along if too far.

    Args:
        reference, tips: the poses.
        rows, in_tool: see `RobotConstants`; other axes are brought along at once.
        caps: how far a reference may be.
    """
    count = len(tips.position)
    errors = np.empty(6 * count)
    brought = Poses(reference.position.copy(), reference.rotation.copy())
    for t in range(count):
        tip = one_pose(tips, t)
        apart = se3.pose_error(one_pose(reference, t), tip, in_tool)
        error, controlled = np.zeros(6), 0
        for row in rows:
            if 0 <= row - 6 * t < 6:
                error[row - 6 * t], controlled = apart[row - 6 * t], controlled + 1
        kept = se3.bounded(error, caps.distance, caps.angle)
        if controlled < 6 or _apart(kept, error) > 0.0:
            there = se3.displaced(tip, kept, in_tool)
            brought.position[t], brought.rotation[t] = there.position, there.rotation
        errors[6 * t:6 * t + 6] = kept
    return errors, brought


@kernel
def task_of(start: Start, constants: RobotConstants, gains: Gains) -> tuple[Task, Poses]:
    """Return what the tips shall do in this tick, ẋ, and the reference poses.

    A reference that is out of reach, or has drifted on axes that are not controlled, is brought
    along.
    """
    arm, rows = start.arm, constants.rows
    kept, reference = _brought_along(
        start.reference, Poses(arm.tip_positions, arm.tip_rotations), rows, constants.in_tool,
        Caps(gains.feedback_distance, gains.feedback_angle))
    nothing, correction = np.zeros(6), np.zeros(len(kept))
    for first in range(0, len(kept), 6):
        error = kept[first:first + 6]
        if _apart(start.command[first:first + 6], nothing) > 0.0 or not (
                _apart(error, nothing) < _AT_REST):
            correction[first:first + 6] = se3.feedback(
                error, gains.feedback_gain, gains.feedback_speed, gains.feedback_angular_speed)
    twists = np.zeros((3, len(rows)))
    for i in range(len(rows)):
        twists[0, i], twists[1, i] = start.command[rows[i]], correction[rows[i]]
    if gains.feedback_gain > 0.0:
        # J turns while the arm moves: half of that belongs to the tick ahead.
        twists[2] = 0.5 * start.dt * jdot_qdot(
            arm.tip_jacobian, start.previous, arm.tip_rotations, constants.in_tool, rows)
    return Task(twists, kept), reference


def reference_of(start: Start, constants: RobotConstants, gains: Gains) -> Poses:
    """Return the reference poses of a tick, as `task_of` does, for Python."""
    return _reference(
        start.reference, start.arm.tips, constants.rows, constants.in_tool,
        Caps(gains.feedback_distance, gains.feedback_angle))


@entry
def _reference(
    reference: Poses, tips: Poses, rows: Indices, in_tool: bool, caps: Caps,
) -> Poses:
    return _brought_along(reference, tips, rows, in_tool, caps)[1]


@kernel
def poses_after(
    reference: Poses, followed: Vector, rows: Indices, in_tool: bool, dt: float,
) -> Poses:
    """Return reference poses after the part (m,) of the path that was followed.

    Args:
        reference: before the tick.
        followed: mean twist of the controlled axes [m/s, rad/s].
        rows, in_tool: see `RobotConstants`.
        dt: [s].
    """
    twists, count = np.zeros(6 * len(reference.position)), len(reference.position)
    for i in range(len(rows)):
        twists[rows[i]] = followed[i]
    after = Poses(np.empty((count, 3)), np.empty((count, 3, 3)))
    for t in range(count):
        pose = se3.integrate(one_pose(reference, t), twists[6 * t:6 * t + 6], dt, in_tool)
        after.position[t], after.rotation[t] = pose.position, pose.rotation
    return after


@entry
def followed_poses(
    reference: Poses, followed: Vector, rows: Indices, in_tool: bool, dt: float,
) -> Poses:
    """Do what `poses_after` does, for Python."""
    return poses_after(reference, followed, rows, in_tool, dt)
