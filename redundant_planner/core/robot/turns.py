"""Joints that turn without end: a whole turn further they are where they were."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import kernel

Array = npt.NDArray[np.float64]

TURN = 2.0 * math.pi  # [rad]


@kernel
def short_way(way: float, position_max: float) -> float:
    """Return the way of one joint without its whole turns, if it has no limits [rad, m].

    Args:
        way: from one position to another.
        position_max: of the joint, infinite for one that turns without end.
    """
    if math.isinf(position_max):
        way -= TURN * math.floor(way / TURN + 0.5)
    return way


def nearest_turn(q: Array, near: Array, position_max: Array) -> Array:
    """Return postures (…, n) whose joints without limits are turned to within π of another one.

    Args:
        q: the postures; a joint that is near enough keeps its position to the last bit [rad, m].
        near: (n,) the other one.
        position_max: (n,) infinite for joints that turn without end.
    """
    turns = np.where(np.isinf(position_max), np.rint((near - q) / TURN), 0.0)
    return np.asarray(q + TURN * turns)
