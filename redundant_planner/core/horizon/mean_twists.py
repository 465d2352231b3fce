"""The mean of a preview's twists over stretches of time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Matrix, Vector

Array = npt.NDArray[np.float64]


@compiled
def mean_twists(times: Vector, points: Vector, twists: Matrix, integrals: Matrix) -> Array:
    """Return the mean twists (N, 6) from each of ascending times (N + 1,) to the next [s].

    Args:
        times: [s].
        points, twists: (k,) and (k, 6), see `Preview`.
        integrals: (k, 6) of the twists up to each point.
    """
    means, reached, now = np.empty((len(times) - 1, 6)), np.zeros(6), np.empty(6)
    last = len(points) - 2
    before = 0
    for i in range(len(times)):
        now[:] = 0.0
        if last >= 0:
            while before < last and points[before + 1] <= times[i]:
                before += 1
            span = points[before + 1] - points[before]
            elapsed = min(max(times[i] - points[before], 0.0), span)
            share = elapsed / span if span > 0.0 else 0.0
            for j in range(6):
                step = twists[before + 1, j] - twists[before, j]
                now[j] = integrals[before, j] + elapsed * (
                    twists[before, j] + 0.5 * share * step)
        if i > 0:
            means[i - 1] = (now - reached) / (times[i] - times[i - 1])
        reached[:] = now
    return means
