"""Obstacles made larger by the links' radii, so that a link can be treated as a bare segment.

A link is every point within its radius r of a segment. It is as far from an obstacle as its
segment is from obstacle ⊕ ball of radius r. The trace-minimal outer ellipsoid of that sum has the
obstacle's axes and the semi-axes √((1+β) a² + (1+1/β) r²), β = √(3 r² / tr A²).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, entry, Indices, kernel, Matrix, Stack, Vector
from redundant_planner.core.obstacles.scene import Scene

Array = npt.NDArray[np.float64]


@kernel
def inflated_square(semi_axis: float, radius: float, trace: float) -> float:
    """Return the squared semi-axis of the trace-minimal ellipsoid around ellipsoid ⊕ ball [m²].

    With A² = diag(a²): (1+β) A² + (1+1/β) r² I, β = √(3 r² / tr A²). Adding r to the semi-axes
    instead would not contain the sum.

    Args:
        semi_axis: a of the ellipsoid [m].
        radius: r of the ball, 0 or more [m].
        trace: tr A², the sum of the three squared semi-axes [m²].
    """
    r2 = radius * radius
    # r² / β without the division, as β is 0 for a bare segment.
    beta, beyond = math.sqrt(3.0 * r2 / trace), math.sqrt(r2 * trace / 3.0)
    return (1.0 + beta) * (semi_axis * semi_axis) + r2 + beyond


@compiled
def inflated_semi_axes(semi_axes: Matrix, radii: Matrix) -> Array:
    """Return the semi-axes of the trace-minimal ellipsoids around ellipsoid ⊕ ball, (c, k, 3).

    Args:
        semi_axes: (k, 3) [m].
        radii: (c, k) of the balls, 0 or more [m].
    """
    inflated = np.empty((*radii.shape, 3))
    for ball in range(len(radii)):
        for ellipsoid in range(len(semi_axes)):
            a, b, c = semi_axes[ellipsoid]
            trace = a * a + b * b + c * c
            for axis in range(3):
                inflated[ball, ellipsoid, axis] = math.sqrt(inflated_square(
                    semi_axes[ellipsoid, axis], radii[ball, ellipsoid], trace))
    return inflated


class InflatedEllipsoids(NamedTuple):
    """The obstacles, larger by the links' radii, and what turns each into the unit ball.

    That is y = diag(1/a) Rᵀ (x − c). Links differ in radius, and so every obstacle has one
    inflated ellipsoid per link.

    Attributes:
        centers: (k, 3) c [m].
        rotations: (k, 3, 3) R.
        inverse: (c, k, 3) 1 / inflated semi-axes a [1/m].
        smallest: (c, k) smallest inflated semi-axis [m].
        velocities: (k, 3) obstacle velocities in the base frame [m/s].
        speeds: (k,) their size [m/s].
    """

    centers: Matrix
    rotations: Stack
    inverse: Stack
    smallest: Matrix
    velocities: Matrix
    speeds: Vector


def inflated_ellipsoids(
    scene: Scene, radii: npt.ArrayLike, lead: float = 0.0, chosen: Indices | None = None,
) -> InflatedEllipsoids:
    """Inflate a scene's obstacles by the radii of links.

    Args:
        scene: the obstacles.
        radii: (c,) of the links [m].
        lead: obstacles that move are larger all round by their way within this time [s].
        chosen: (k,) indices of the obstacles to take; all if None.
    """
    every = np.arange(len(scene.names)) if chosen is None else chosen
    return _inflated_ellipsoids(
        scene.centers, scene.rotations, scene.semi_axes, scene.velocities,
        np.array(radii, dtype=float), lead, every)


@entry
def _inflated_ellipsoids(
    centers: Matrix, rotations: Stack, semi_axes: Matrix, velocities: Matrix, radii: Vector,
    lead: float, chosen: Indices,
) -> InflatedEllipsoids:
    centers, rotations, velocities = centers[chosen], rotations[chosen], velocities[chosen]
    speeds = np.empty(len(chosen))
    for obstacle in range(len(chosen)):
        a, b, c = velocities[obstacle]
        speeds[obstacle] = math.sqrt(a * a + b * b + c * c)
    inverse = inflated_semi_axes(semi_axes[chosen], radii[:, None] + lead * speeds)
    smallest = np.empty(inverse.shape[:2])
    for obstacle in range(len(chosen)):
        for link in range(len(radii)):
            a, b, c = inverse[link, obstacle]
            smallest[link, obstacle] = min(a, b, c)
            for axis in range(3):
                inverse[link, obstacle, axis] = 1.0 / inverse[link, obstacle, axis]
    return InflatedEllipsoids(centers, rotations, inverse, smallest, velocities, speeds)
