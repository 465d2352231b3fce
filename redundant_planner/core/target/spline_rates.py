"""The rates at which the smoothest curve passes points at given times."""

from __future__ import annotations

import numpy as np

from redundant_planner.core.kernels import compiled, Matrix, Vector


@compiled
def spline_rates(times: Vector, points: Matrix) -> Matrix:
    """Return the rates (K, c) at which a cubic spline passes points (K, c) at times (K,) [s].

    At its ends those of the parabola through the three points there.
    """
    count, width = points.shape
    rates = np.zeros((count, width))
    if count < 2:
        return rates
    last = count - 1
    if count == 2:
        for j in range(width):
            rates[0, j] = rates[1, j] = (points[1, j] - points[0, j]) / (times[1] - times[0])
        return rates
    for end in range(2):
        i, k = (0, 0) if end == 0 else (last, last - 2)
        near, far = times[k + 1] - times[k], times[k + 2] - times[k + 1]
        for j in range(width):
            first = (points[k + 1, j] - points[k, j]) / near
            second = (points[k + 2, j] - points[k + 1, j]) / far
            bend = (second - first) / (near + far)
            rates[i, j] = first - bend * near if end == 0 else second + bend * far
    # Continuous acceleration: a tridiagonal system, eliminated forwards and backwards.
    above = np.zeros(count)
    for i in range(1, last):
        before, after = 1.0 / (times[i] - times[i - 1]), 1.0 / (times[i + 1] - times[i])
        pivot = 2.0 * (before + after) - before * above[i - 1]
        above[i] = after / pivot
        for j in range(width):
            right = 3.0 * (before**2 * (points[i, j] - points[i - 1, j])
                           + after**2 * (points[i + 1, j] - points[i, j]))
            rates[i, j] = (right - before * rates[i - 1, j]) / pivot
    for i in range(last - 1, 0, -1):
        for j in range(width):
            rates[i, j] -= above[i] * rates[i + 1, j]
    return rates
