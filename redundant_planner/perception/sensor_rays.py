"""How far a sensor sees in every direction, from nothing but the points of a cloud.

Directions are sorted into bins: the six faces of a cube around the sensor, a grid on each. So the
sensor may be of any kind, and the cloud need not be organised. Each bin knows its nearest point
and how many points it has.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, kernel, Matrix, OutMatrix

Array = npt.NDArray[np.float64]

# Bins along the edge of a face: a third of a degree each.
_BINS = 256
BIN_COUNT = 6 * _BINS * _BINS
# A cell nearer to the sensor than so many of its own radii fills too much of the view.
_NEAREST = 2.0


def no_rays() -> Array:
    """Return bins to fill, for one cloud after another (BIN_COUNT, 2).

    Each has the squared distance of its nearest point [m²], infinite for none, and beside it how
    many points it has.
    """
    return np.tile([np.inf, 0.0], (BIN_COUNT, 1))


@kernel
def _on_cube(x: float, y: float, z: float) -> tuple[int, float, float, float]:
    """Return the face of a direction, and where on it: both coordinates, and how far away."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        return (0 if x > 0.0 else 1), y, z, ax
    if ay >= az:
        return (2 if y > 0.0 else 3), x, z, ay
    return (4 if z > 0.0 else 5), x, y, az


@kernel
def _bin(share: float) -> int:
    """Return the bin of a coordinate on a face, −1 to 1."""
    return min(max(int((share + 1.0) * (0.5 * _BINS)), 0), _BINS - 1)


@compiled
def fill_rays(points: Matrix, rays: OutMatrix) -> None:
    """Write the bins of a cloud.

    Args:
        points: (3, n) in the sensor's frame, NaN and infinite ones among them [m].
        rays: of `no_rays`.
    """
    for i in range(len(rays)):
        rays[i, 0], rays[i, 1] = np.inf, 0.0
    for i in range(points.shape[1]):
        x, y, z = points[0, i], points[1, i], points[2, i]
        squared = x * x + y * y + z * z
        if not 0.0 < squared < np.inf:
            continue
        face, a, b, away = _on_cube(x, y, z)
        scale = 1.0 / away
        at = (face * _BINS + _bin(a * scale)) * _BINS + _bin(b * scale)
        rays[at, 0] = min(rays[at, 0], squared)
        rays[at, 1] += 1.0


@compiled
def seen_through(centers: Matrix, size: float, needed: float, rays: Matrix) -> Array:
    """Return 1 for the cubes that the sensor sees through, else 0, (k,).

    As many rays must pass through a cube as points would make an obstacle of it, and all rays
    around it must end behind it.

    Args:
        centers: (k, 3) of the cubes in the sensor's frame [m].
        size: of the cubes [m].
        needed: rays that must pass through one.
        rays: of the cloud.
    """
    radius = 0.5 * math.sqrt(3.0) * size  # of the ball around a cube
    through = np.zeros(len(centers))
    for i in range(len(centers)):
        x, y, z = centers[i, 0], centers[i, 1], centers[i, 2]
        behind = (math.sqrt(x * x + y * y + z * z) + radius) ** 2
        face, a, b, away = _on_cube(x, y, z)
        if away < _NEAREST * radius:
            continue
        # The ball's shadow on the face. Beyond the face's edge nobody looks: the cube stays.
        reach_a, reach_b = (abs(a) + radius) / (away - radius), (abs(b) + radius) / (away - radius)
        if reach_a > 1.0 or reach_b > 1.0:
            continue
        spread_a, spread_b = reach_a - abs(a) / away, reach_b - abs(b) / away
        inner = 0.5 * size / away
        passing, free = 0.0, True
        inner_low_a, inner_high_a = _bin(a / away - inner), _bin(a / away + inner)
        inner_low_b, inner_high_b = _bin(b / away - inner), _bin(b / away + inner)
        for row in range(_bin(a / away - spread_a), _bin(a / away + spread_a) + 1):
            for column in range(_bin(b / away - spread_b), _bin(b / away + spread_b) + 1):
                at = (face * _BINS + row) * _BINS + column
                if rays[at, 0] < behind:
                    free = False
                    break
                if (inner_low_a <= row <= inner_high_a
                        and inner_low_b <= column <= inner_high_b):
                    passing += rays[at, 1]
            if not free:
                break
        if free and passing >= needed:
            through[i] = 1.0
    return through
