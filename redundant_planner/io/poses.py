"""Poses as people write them: x y z, and after them nothing, roll pitch yaw or a quaternion."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ParameterError

Array = npt.NDArray[np.float64]

# How many numbers one has.
POSE_SIZES = (3, 6, 7)


def pose_of(what: str, numbers: Sequence[float] | Array) -> tuple[Array, Array]:
    """Return position (3,) [m] and quaternion (4,) x y z w, of the length it was written with.

    Args:
        what: it is the pose of, as an error says it.
        numbers: x y z [m], and after them nothing, roll pitch yaw [rad] or a quaternion x y z w.

    Raises:
        ParameterError: there are not as many numbers, or one is not finite.
    """
    found = np.asarray(numbers, dtype=float)
    if len(found) not in POSE_SIZES or not np.isfinite(found).all():
        raise ParameterError(
            f'{what} is {found.tolist()}; it takes x y z [m], and after them nothing, '
            'roll pitch yaw [rad] or a quaternion x y z w')
    if len(found) == 7:
        return found[:3], found[3:]
    # Nodes that only read obstacles mostly do without Pinocchio.
    import pinocchio as pin

    from redundant_planner.core.robot.quaternions import quaternion_of
    roll, pitch, yaw = found[3:].tolist() if len(found) == 6 else (0.0, 0.0, 0.0)
    return found[:3], quaternion_of(pin.rpy.rpyToMatrix(*(
        math.remainder(angle, 2.0 * math.pi) for angle in (roll, pitch, yaw))))
