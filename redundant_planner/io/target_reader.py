"""Reads a serialised PoseStamped, a target of the tip."""

from __future__ import annotations

import math
import struct

import numpy as np

from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.io.cdr import byte_order, ENCAPSULATION, header_of

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
    position, quaternion = np.array(numbers[:3]), np.array(numbers[3:])
    if not (np.abs(position) <= _FARTHEST).all():
        raise StateError(f'its position is {position.tolist()}; all three numbers must be finite, '
                         f'up to {_FARTHEST:g} m')
    length = math.hypot(*numbers[3:])
    if not abs(length - 1.0) <= _NO_UNIT:
        raise StateError(f'its orientation is the quaternion {quaternion.tolist()} of length '
                         f'{length:.3g}; it must be 1')
    return stamp, frame, Pose(position, rotations(quaternion[None] / length)[0])
