"""The commanded twist as a tick takes it: checked, its controlled part, as fast as it may be."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.kernels import compiled, OutVector, Vector

Array = npt.NDArray[np.float64]

# Entries of a twist beyond this are cut back before anything is computed with them.
_ABSURD = 1e100
# A speed limit of 0 counts as this, for the sake of a division [m/s, rad/s].
SLOWEST = 1e-12


def limited_twist(
    twist: Array, controlled: Array, linear_max: float, angular_max: float,
) -> tuple[Array, bool]:
    """Return the controlled part of a twist (6,), no faster than the limits; whether there is any.

    Args:
        twist: (6,) in the command frame [m/s, rad/s].
        controlled: (6,) 1 for controlled axes, else 0.
        linear_max, angular_max: the limits [m/s, rad/s].

    Raises:
        StateError: it does not have six finite entries.
    """
    command, largest = np.array(twist, dtype=float), math.nan
    if command.shape == (6,):
        largest = _limit_speed(command, controlled, linear_max, angular_max)
    if math.isnan(largest):
        raise StateError(f'twist is {np.asarray(twist).tolist()}; it takes six finite '
                         'numbers [m/s, rad/s]')
    return command, largest > 0.0


@compiled
def _limit_speed(
    command: OutVector, controlled: Vector, linear_max: float, angular_max: float,
) -> float:
    """Take a twist's uncontrolled part away and slow it down to the limits.

    Returns:
        The largest entry of its controlled part before; NaN if any entry is not finite.
    """
    largest = 0.0
    for i in range(6):
        if not math.isfinite(command[i]):
            return np.nan
        command[i] *= controlled[i]
        largest = max(largest, abs(command[i]))
    if largest == 0.0:
        return largest
    # The norm of an absurd twist would overflow.
    scale = largest if largest > _ABSURD else 1.0
    excess = 1.0 / scale
    for part in range(2):
        first = 3 * part
        x, y, z = command[first] / scale, command[first + 1] / scale, command[first + 2] / scale
        # A limit of 0 lets nothing pass.
        limit = max(angular_max if part else linear_max, SLOWEST)
        excess = max(excess, math.sqrt(x * x + y * y + z * z) / limit)
    for i in range(6):
        command[i] = command[i] / scale / excess
    return largest
