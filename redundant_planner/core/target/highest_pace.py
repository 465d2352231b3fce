"""The highest pace along a way at its nodes, backwards from rest at its end (`pace_along`)."""

from __future__ import annotations

from redundant_planner.core.kernels import compiled, Matrix, OutMatrix, OutVector, Vector

# Halvings until the largest x is known, to a millionth.
_HALVINGS = 20
# A joint slower than this at the given pace does not bound df/dt [rad/s, m/s].
_STILL = 1e-9


@compiled
def fill_pace(
    nodes: Matrix, step: float, fastest: Vector, velocity_max: Vector, acceleration_max: Vector,
    squared: OutVector, rates: OutMatrix, bends: OutMatrix,
) -> None:
    """Write the arrays of a `Pace`, see `pace_along`."""
    last, n = len(nodes) - 1, nodes.shape[1]
    for i in range(last + 1):
        middle = min(max(i, 1), last - 1)
        for j in range(n):
            bends[i, j] = (nodes[middle + 1, j] - 2.0 * nodes[middle, j]
                           + nodes[middle - 1, j]) / step**2
            rates[i, j] = (nodes[middle + 1, j] - nodes[middle - 1, j]) / (2.0 * step) + (
                i - middle) * step * bends[i, j]
    squared[last] = 0.0
    for i in range(last - 1, -1, -1):
        high = min(fastest[i], 1.0) ** 2
        for j in range(n):
            rate = abs(rates[i, j])
            if rate > velocity_max[j]:
                high = min(high, (velocity_max[j] / rate) ** 2)
        low = 0.0
        for halving in range(_HALVINGS + 1):
            x = high if halving == 0 else 0.5 * (low + high)
            # The range of u that leads to an x of the next node, within all limits here.
            least, most = -0.5 * x / step, 0.5 * (squared[i + 1] - x) / step
            for j in range(n):
                rate, bend, limit = rates[i, j], bends[i, j] * x, acceleration_max[j]
                if abs(rate) > _STILL:
                    a, b = (-limit - bend) / rate, (limit - bend) / rate
                    least, most = max(least, min(a, b)), min(most, max(a, b))
                elif abs(bend) > limit:
                    most = least - 1.0
            if least <= most:
                low = x
                if halving == 0:
                    break
            else:
                high = x
        squared[i] = low
