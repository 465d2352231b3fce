"""Where a velocity command leads: its integral for position drives, and a simulated arm."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Vector

Array = npt.NDArray[np.float64]


class PositionCommand:
    """The integral of the velocity commands, for arms that take positions.

    It starts at the measured posture and then follows the commands alone: adding q̇ dt to every
    measurement instead would leave a position-controlled arm standing behind its own lag.
    """

    def __init__(self, position_min: Array, position_max: Array, tolerance: float) -> None:
        """Stay inside the position limits (n,), and within `tolerance` [rad, m] of the arm."""
        self._min, self._max, self._tolerance = position_min, position_max, tolerance
        self._no_speed = np.zeros(len(position_min))
        self._q: Array | None = None

    def reset(self) -> None:
        """Start from the measured posture at the next advance."""
        self._q = None

    def advance(
        self, measured: Array, dq: Array, dt: float, *, known: bool = True,
    ) -> Array:
        """Return the positions (n,) to command for velocities `dq` held for `dt`.

        Args:
            measured: (n,) where the arm is [rad, m],
            known: or where it was when it was last heard of.
            dq: (n,) [rad/s, m/s].
            dt: [s].
        """
        if self._q is None or (
                known and _far_apart(self._q, measured, self._no_speed, 0.0, self._tolerance)):
            self._q = measured
        self._q = _advanced(self._q, dq, dt, self._min, self._max)
        return self._q.copy()


@compiled
def _advanced(q: Vector, dq: Vector, dt: float, low: Vector, high: Vector) -> Array:
    advanced = q.copy()
    for i in range(len(q)):
        # An arm found outside its range is not pulled: only its velocity command moves it.
        if dq[i] != 0.0:
            advanced[i] = min(max(q[i] + dq[i] * dt, low[i]), high[i])
    return advanced


def has_jumped(
    before: Array, after: Array, velocity_max: Array, elapsed: float, tolerance: float,
) -> bool:
    """Return whether an arm was moved, or restarted elsewhere, rather than having moved.

    Args:
        before, after: (n,) successive measurements [rad, m].
        velocity_max: (n,) [rad/s, m/s].
        elapsed: time between them [s].
        tolerance: [rad, m], for noise and late messages.
    """
    return _far_apart(before, after, velocity_max, elapsed, tolerance)


@compiled
def _far_apart(
    before: Vector, after: Vector, velocity_max: Vector, elapsed: float, tolerance: float,
) -> bool:
    for i in range(len(before)):
        if abs(after[i] - before[i]) > velocity_max[i] * elapsed + tolerance:
            return True
    return False
