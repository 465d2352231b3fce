"""Reads serialised targets: a PoseStamped of the tip, or a JointState of the joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import math
import struct

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, StateError
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.goal import checked_target
from redundant_planner.io.cdr import byte_order, ENCAPSULATION, header_of
from redundant_planner.io.joint_layout import joint_layout, STAMP

Array = npt.NDArray[np.float64]

# How far away a target may be [m], and how far from 1 the length of its quaternion.
_FARTHEST = 1e3
_NO_UNIT = 1e-2


def read_target(raw: bytes) -> tuple[float, str, Pose]:
    """Return stamp [s], 0 for none, frame and pose of a serialised geometry_msgs/PoseStamped.

    Raises:
        StateError: the bytes are no PoseStamped, a coordinate is too large or not finite, or the
            quaternion is not one of length 1.
    """
    order = byte_order(raw)
    stamp, frame, end = header_of(raw, order)
    try:
        numbers = struct.unpack_from(f'{order}7d', raw, ENCAPSULATION + -(-end // 8) * 8)
    except struct.error:
        raise StateError(f'the bytes end within the pose: there are {len(raw)}') from None
    return stamp, frame, poses_of_numbers(np.array([numbers]), 'its')[0]


def poses_of_numbers(numbers: Array, whose: str) -> tuple[Pose, ...]:
    """Return poses of seven numbers each: x y z [m], and a quaternion x y z w.

    Args:
        numbers: (K, 7).
        whose: they are, as an error says it, with {} for which of them.

    Raises:
        StateError: a coordinate is too large or not finite, or a quaternion is not one of
            length 1.
    """
    positions, quaternions = numbers[:, :3], numbers[:, 3:]
    far = ~(np.abs(positions) <= _FARTHEST).all(axis=1)
    if far.any():
        i = int(far.argmax())
        raise StateError(f'{whose.format(i)} position is {positions[i].tolist()}; all three '
                         f'numbers must be finite, up to {_FARTHEST:g} m')
    lengths = np.array([math.hypot(*quaternion) for quaternion in quaternions.tolist()])
    odd = ~(np.abs(lengths - 1.0) <= _NO_UNIT)
    if odd.any():
        i = int(odd.argmax())
        raise StateError(f'{whose.format(i)} orientation is the quaternion '
                         f'{quaternions[i].tolist()} of length {lengths[i]:.3g}; it must be 1')
    return tuple(map(Pose, positions, rotations(quaternions / lengths[:, None])))


def read_joint_target(
    raw: bytes, robot: Robot, rest: Array | None = None,
) -> tuple[float, Array]:
    """Return stamp [s], 0 for none, and the positions (n,) that a serialised JointState asks for.

    Args:
        raw: the message.
        robot: the arm.
        rest: (n,) positions of joints that are not named; None if all have to be.

    Raises:
        StateError: the bytes are no JointState, a joint is unknown, named twice or missing, or
            cannot go there.
    """
    layout = joint_layout(raw)
    names = layout.names
    check_names(names, robot)
    missing = [name for name in robot.joint_names if name not in names]
    if missing and rest is None:
        raise StateError(f'joints are missing: {known(missing)}')
    values = struct.unpack_from(f'{layout.order}{len(names)}d', raw, layout.positions)
    # What is not named stays, and is measured a little beyond its limit at times.
    q = np.clip(np.zeros(robot.n) if rest is None else rest,
                robot.position_min, robot.position_max)
    q[[robot.joint_names.index(name) for name in names]] = values
    seconds, nanoseconds = struct.unpack_from(f'{layout.order}iI', raw, STAMP)
    return seconds + 1e-9 * nanoseconds, np.asarray(checked_target(q, robot))


def check_names(names: Sequence[str], robot: Robot) -> None:
    """Make sure that a message names joints of the arm, each once.

    Raises:
        StateError: it does not.
    """
    unknown = [name for name in names if name not in robot.joint_names]
    if unknown or not names:
        raise StateError(f'it names {known(unknown) if unknown else "no joint"}; the joints are '
                         f'{known(robot.joint_names)}')
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise StateError(f'joint names appear twice: {known(twice)}')
