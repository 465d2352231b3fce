"""A smooth curve through points at given times, and a difference that fades away.

Without given rates it is a cubic spline, whose acceleration makes no jump; with them it is of
cubic pieces (Hermite), as a joint_trajectory_controller takes them.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.target.spline_rates import spline_rates

Array = npt.NDArray[np.float64]

# How long before its first point the curve begins to move, if that is passed in motion [s].
_RUN_UP = 0.4


class Motion(NamedTuple):
    """Where something is, and how it moves: (…, c) each.

    Attributes:
        position: [rad, m].
        rate: [per s].
        bend: rate of the rate [per s²].
    """

    position: Array
    rate: Array
    bend: Array


class SmoothCurve:
    """A curve through K points of c coordinates: at rest before the first and after the last.

    Attributes:
        begin, end: when its first and last point are due [s].
    """

    def __init__(self, times: Array, points: Array, rates: Array | None = None) -> None:
        """Take points (K, c) at ascending times (K,) [s].

        Args:
            times, points: one at least.
            rates: (K, c) [per s]; None to take those of the smoothest curve.
        """
        self.begin, self.end = float(times[0]), float(times[-1])
        self._braking = 0.0  # see `coming_to_rest`
        if rates is None:
            rates = spline_rates(times, points)
        span = np.diff(times)[:, None]
        mean = np.diff(points, axis=0) / span
        pieces = np.stack((
            points[:-1], rates[:-1], (3.0 * mean - 2.0 * rates[:-1] - rates[1:]) / span,
            (rates[:-1] + rates[1:] - 2.0 * mean) / span**2), axis=1)
        rest, first = np.zeros((1, 4, points.shape[1])), np.zeros((1, 4, points.shape[1]))
        first[0, 0], first[0, 2] = (
            points[0] - 0.5 * _RUN_UP * rates[0], 0.5 / _RUN_UP * rates[0])
        before, after = rest.copy(), rest
        before[0, 0], after[0, 0] = first[0, 0], points[-1]
        # Of all pieces: when they begin, and their polynomials (pieces, 4, c).
        self._starts = np.concatenate(((-np.inf, self.begin - _RUN_UP), times))
        self._powers = np.concatenate((before, first, pieces, after))

    def coming_to_rest(self, braking: float) -> SmoothCurve:
        """Return this curve with a time that slows down to a stop at its end.

        Args:
            braking: how long before the end that begins, and by how much later it ends [s].
        """
        other = copy.copy(self)
        other._braking, other.end = braking, self.end + braking
        return other

    def at(self, times: Array) -> Motion:
        """Return the motions (N, c) at times (N,)."""
        if not self._braking:
            return self._at(times)
        b = self._braking
        x = np.clip(times - (self.end - 2.0 * b), 0.0, 2.0 * b)
        speed, brakes = 1.0 - 0.5 * x / b, (x > 0.0) & (x < 2.0 * b)
        found = self._at(np.minimum(times, self.end - 2.0 * b) + x - 0.25 * x**2 / b)
        speed = speed[:, None]
        return Motion(found.position, speed * found.rate,
                      speed**2 * found.bend - np.where(brakes[:, None], 0.5 / b, 0.0) * found.rate)

    def _at(self, times: Array) -> Motion:
        piece = np.searchsorted(self._starts, times, side='right') - 1
        x = np.where(piece > 0, times - self._starts[piece], 0.0)[:, None]
        a, b, c, d = self._powers[piece].transpose(1, 0, 2)
        return Motion(a + x * (b + x * (c + x * d)), b + x * (2.0 * c + 3.0 * x * d),
                      2.0 * c + 6.0 * x * d)


class Fading(NamedTuple):
    """A difference that fades away smoothly: the quintic in time that ends at rest at 0.

    (1 − x)³ (a + b x + c x²), x from 0 to 1.

    Attributes:
        duration: positive [s].
        powers: a, b and c, (3, c).
    """

    duration: float
    powers: Array

    @classmethod
    def of(cls, difference: Motion, duration: float) -> Fading:
        """Return the one that begins as a difference (c,) does."""
        d, rate, bend = difference
        return cls(duration, np.array((
            d, 3.0 * d + duration * rate,
            6.0 * d + 3.0 * duration * rate + 0.5 * duration**2 * bend)))

    def at(self, times: Array) -> Motion:
        """Return the motions (N, c) at times (N,) since its beginning."""
        x = np.minimum(times / self.duration, 1.0)[:, None]
        a, b, c = self.powers
        y, g, dg = 1.0 - x, a + x * (b + x * c), b + 2.0 * x * c
        return Motion(
            y**3 * g, y**2 * (y * dg - 3.0 * g) / self.duration,
            y * (y**2 * 2.0 * c - 6.0 * y * dg + 6.0 * g) / self.duration**2)
