"""What will be commanded where nothing announces it: a guess from the present command."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Vector

Array = npt.NDArray[np.float64]

# A command smaller than this is none, as to how it grows [squared m/s, rad/s].
_NO_SPEED = 1e-24


@compiled
def continued(command: Vector, growth: float, times: Vector) -> Array:
    """Return the twists (N, 6) at times ahead of a command of which nothing else is known.

    Its direction is held and its size goes on growing or fading as it did, until it is nothing
    or twice itself: whoever slows down is about to stop.

    Args:
        command: (6,) now.
        growth: rate of change of its size, as a share of it [1/s].
        times: (N,) from now [s].
    """
    twists = np.empty((len(times), len(command)))
    for i in range(len(times)):
        twists[i] = min(max(1.0 + growth * times[i], 0.0), 2.0) * command
    return twists


@compiled
def growth_of(before: Vector, command: Vector, dt: float) -> float:
    """Return the rate at which a command's size has changed, along itself [1/s].

    NaN for one that is none, or has just begun.

    Args:
        before, command: (6,) the command a while ago, and now.
        dt: that while [s].
    """
    squared, change, any_before = 0.0, 0.0, False
    for i in range(len(command)):
        squared += command[i] * command[i]
        change += (command[i] - before[i]) * command[i]
        any_before = any_before or before[i] != 0.0
    if squared < _NO_SPEED or not any_before:
        return np.nan
    return change / (squared * dt)
