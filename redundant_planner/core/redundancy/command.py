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


def limited_twists(
    twists: Array, controlled: Array, linear_max: float, angular_max: float,
) -> tuple[Array, bool]:
    """Return what `limited_twist` does, of t tips: (6 t,), and whether any is to move.

    Args:
        twists: (t, 6), or (6,) of one tip.
        controlled: (6 t,).
        linear_max, angular_max: of each tip.

    Raises:
        StateError: there are not six finite entries for each tip.
    """
    if len(controlled) == 6:
        return limited_twist(twists, controlled, linear_max, angular_max)
    given = np.asarray(twists, dtype=float)
    if given.shape != (len(controlled) // 6, 6):
        raise StateError(f'twists have shape {given.shape}; an arm with {len(controlled) // 6} '
                         f'tips takes ({len(controlled) // 6}, 6)')
    found = [limited_twist(one, part, linear_max, angular_max)
             for one, part in zip(given, controlled.reshape(-1, 6))]
    return np.concatenate([one for one, _ in found]), any(moves for _, moves in found)


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
