"""Rotations as quaternions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

Array = npt.NDArray[np.float64]

_NOWHERE = np.zeros(3)


def quaternion_of(rotation: npt.ArrayLike) -> Array:
    """Return a rotation matrix (3, 3) as a quaternion (4,) x y z w.

    A pin.Quaternion that is made from a matrix loses 80 bytes for good (eigenpy 3.13).
    """
    return np.asarray(pin.SE3ToXYZQUAT(pin.SE3(np.asarray(rotation), _NOWHERE))[3:])
