"""Jerk: what is commanded is the mean of the velocities planned last (docs/safety.md).

With planned accelerations within ±a, the mean over a window W has a jerk of 2a/W at most, and it
keeps every limit of position, velocity and acceleration that the planned motion keeps.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Matrix, OutMatrix, OutVector, Vector
from redundant_planner.core.safety.limits import braked

Array = npt.NDArray[np.float64]

# A window of so many ticks, and round-off: no tick more for that.
_ROUND_OFF = 1e-6


def reversal_time(acceleration_max: Array, jerk_max: Array) -> float:
    """Return how long the slowest joint takes to turn its acceleration round: max 2 a/j [s].

    Args:
        acceleration_max, jerk_max: (n,) [rad/s², rad/s³; m], the latter may be infinite.
    """
    return float((2.0 * acceleration_max / jerk_max).max())


def window_of(reversal: float, dt: float) -> int:
    """Return the smallest number of ticks of dt [s] whose mean keeps the jerk limits."""
    return max(math.ceil(reversal / dt - _ROUND_OFF), 1)


class MeanVelocity:
    """The mean of the joint velocities that were planned last."""

    def __init__(self, n: int) -> None:
        """Stand still, with a window of one tick."""
        self.start(1, np.zeros(n))

    def start(self, ticks: int, velocity: Array, change: Array | None = None) -> None:
        """Begin anew, with a mean that is `velocity` and has been changing steadily.

        Args:
            ticks: of the window.
            velocity: (n,) the mean.
            change: (n,) what it changed by in the last tick; None for not at all.
        """
        since = np.arange(ticks) - 0.5 * (ticks - 1)
        steady = np.zeros(len(velocity)) if change is None else change
        self._planned = velocity + np.outer(since, steady)
        self._next = 0
        self._latest = self._planned[-1].copy()

    @property
    def ticks(self) -> int:
        """Length of the window."""
        return len(self._planned)

    @property
    def latest(self) -> Array:
        """The velocity (n,) that was planned last."""
        return self._latest

    def take(self, planned: Array) -> Array:
        """Take a planned velocity (n,); return the mean, which is the caller's to keep."""
        self._latest = planned
        if len(self._planned) == 1:
            return planned.copy()
        mean, at = np.empty(len(planned)), self._next
        self._next = (at + 1) % len(self._planned)
        _take(self._planned, at, planned, mean)
        return mean

    def stops_at(self, posture: Array, dt: float) -> Array:
        """Return where joints at a posture (n,) get to if 0 is planned from now on [rad, m]."""
        if len(self._planned) == 1:
            return posture
        stop = np.empty(len(posture))
        _stop(self._planned, self._next, posture, dt, stop)
        return stop


@compiled
def _take(planned: OutMatrix, at: int, velocity: Vector, mean: OutVector) -> None:
    """Put a velocity (n,) into a window (k, n), and write the mean of that."""
    ticks, n = planned.shape
    for i in range(n):
        planned[at, i], mean[i] = velocity[i], 0.0
    for tick in range(ticks):
        for i in range(n):
            mean[i] += planned[tick, i]
    for i in range(n):
        mean[i] /= ticks


@compiled
def _stop(planned: Matrix, first: int, posture: Vector, dt: float, stop: OutVector) -> None:
    """Write the posture plus Σ over the window of each velocity's share not in the mean yet."""
    ticks, n = planned.shape
    stop[:] = 0.0
    for age in range(ticks):
        row = (first + age) % ticks
        for i in range(n):
            stop[i] += planned[row, i] * age
    for i in range(n):
        stop[i] = posture[i] + stop[i] * (dt / ticks)


class SmoothStop:
    """Brings joints to rest from whatever was commanded last, as an S-curve."""

    def __init__(self, acceleration_max: Array, jerk_max: Array, dt: float) -> None:
        """Prepare for joints with these limits (n,) [rad/s², rad/s³; m], and ticks of dt [s]."""
        self._acceleration_max, self._dt = acceleration_max, dt
        self._ticks = window_of(reversal_time(acceleration_max, jerk_max), dt)
        self._last = self._before = np.zeros(len(acceleration_max))
        self._mean: MeanVelocity | None = None

    def moving(self, dq: Array) -> None:
        """Note what (n,) was commanded; the stop begins from there."""
        self._before, self._last, self._mean = self._last, dq, None

    def next(self) -> Array:
        """Return the next command (n,) of the stop; exactly 0 at its end."""
        if self._mean is None:
            self._mean = MeanVelocity(len(self._last))
            self._mean.start(self._ticks, self._last, self._last - self._before)
        self._before = self._last
        self._last = self._mean.take(
            braked(self._mean.latest, self._acceleration_max, self._dt))
        return self._last
