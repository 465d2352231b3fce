"""The reference pose, and the feedback that leads the tip back to it (docs/derivations.md).

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
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# Deadband of the pose feedback without a command [m, rad].
_AT_REST = 1e-5


class Task(NamedTuple):
    """What the tip shall do in a tick, in the controlled axes of the command frame.

    Attributes:
        twists: (3, m) the three below.
        error: (6,) reference pose minus the tip's.
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
        reference: pose before the tick.
        command: (6,) the twist [m/s, rad/s].
        previous: (n,) velocity of the last tick [rad/s, m/s].
        dt: [s].
    """

    arm: Kinematics
    reference: Pose
    command: Vector
    previous: Vector
    dt: float


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
    reference: Pose, tip: Pose, rows: Indices, in_tool: bool, caps: Caps,
) -> tuple[Vector, Pose]:
    """Return the error (6,) of the tip, and the reference, which is brought along if too far.

    Args:
        reference, tip: the poses.
        rows, in_tool: see `RobotConstants`; other axes are brought along at once.
        caps: how far the reference may be.
    """
    apart = se3.pose_error(reference, tip, in_tool)
    error = np.zeros(6)
    for row in rows:
        error[row] = apart[row]
    kept = se3.bounded(error, caps.distance, caps.angle)
    if len(rows) < 6 or _apart(kept, error) > 0.0:
        reference = se3.displaced(tip, kept, in_tool)
    return kept, reference


@kernel
def task_of(start: Start, constants: RobotConstants, gains: Gains) -> tuple[Task, Pose]:
    """Return what the tip shall do in this tick, ẋ, and the reference pose.

    A reference that is out of reach, or has drifted on axes that are not controlled, is brought
    along.
    """
    arm, rows = start.arm, constants.rows
    kept, reference = _brought_along(
        start.reference, Pose(arm.tip_position, arm.tip_rotation), rows, constants.in_tool,
        Caps(gains.feedback_distance, gains.feedback_angle))
    correction = se3.feedback(
        kept, gains.feedback_gain, gains.feedback_speed, gains.feedback_angular_speed)
    nothing = np.zeros(6)
    if _apart(start.command, nothing) == 0.0 and _apart(kept, nothing) < _AT_REST:
        correction[:] = 0.0
    twists = np.zeros((3, len(rows)))
    for i in range(len(rows)):
        twists[0, i], twists[1, i] = start.command[rows[i]], correction[rows[i]]
    if gains.feedback_gain > 0.0:
        # J turns while the arm moves: half of that belongs to the tick ahead.
        twists[2] = 0.5 * start.dt * jdot_qdot(
            arm.tip_jacobian, start.previous, arm.tip_rotation, constants.in_tool, rows)
    return Task(twists, kept), reference


def reference_of(start: Start, constants: RobotConstants, gains: Gains) -> Pose:
    """Return the reference pose of a tick, as `task_of` does, for Python."""
    return _reference(
        start.reference, Pose(start.arm.tip_position, start.arm.tip_rotation), constants.rows,
        constants.in_tool, Caps(gains.feedback_distance, gains.feedback_angle))


@entry
def _reference(
    reference: Pose, tip: Pose, rows: Indices, in_tool: bool, caps: Caps,
) -> Pose:
    return _brought_along(reference, tip, rows, in_tool, caps)[1]


@kernel
def pose_after(
    reference: Pose, followed: Vector, rows: Indices, in_tool: bool, dt: float,
) -> Pose:
    """Return a reference pose after the part (m,) of the path that was followed.

    Args:
        reference: before the tick.
        followed: mean twist of the controlled axes [m/s, rad/s].
        rows, in_tool: see `RobotConstants`.
        dt: [s].
    """
    twist = np.zeros(6)
    for i in range(len(rows)):
        twist[rows[i]] = followed[i]
    return se3.integrate(reference, twist, dt, in_tool)


@entry
def followed_pose(
    reference: Pose, followed: Vector, rows: Indices, in_tool: bool, dt: float,
) -> Pose:
    """Do what `pose_after` does, for Python."""
    return pose_after(reference, followed, rows, in_tool, dt)
