"""Links' clearances as CasADi writes them down, for optimisation."""

from __future__ import annotations

import casadi as ca
import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.core.obstacles.scene import Scene

Array = npt.NDArray[np.float64]

# Points of a link that are looked at lie no further apart [m].
_SPACING = 0.05
# A distance counts as this share of a level, so that IPOPT sees numbers around 1 [m].
_UNIT = 0.1
_TINY = 1e-12


def clearance(
    obstacle: Obstacle, start: ca.SX, end: ca.SX, length: float, radius: float,
) -> ca.SX:
    """Return what is 0 or more where a link keeps clear of an obstacle at rest.

    Of an ellipsoid it is exact over the whole link, as the planner has it. Other shapes look at
    points along the link only: whoever needs certainty measures what comes out.

    Args:
        obstacle: any shape but a half-space.
        start, end: (3,) of the link's segment [m].
        length: of the segment [m].
        radius: of the link, with the margin [m].
    """
    if obstacle.shape == ELLIPSOID:
        return _level(obstacle, start, end, radius) - 1.0
    shares = np.linspace(0.0, 1.0, int(np.ceil(length / _SPACING)) + 1)
    distances = [_distance(obstacle, ca.mtimes(
        obstacle.rotation.T, start + share * (end - start) - obstacle.center))
        for share in shares]
    least = distances[0]
    for distance in distances[1:]:
        least = ca.fmin(least, distance)
    return (least - radius) / _UNIT


def _level(obstacle: Obstacle, start: ca.SX, end: ca.SX, radius: float) -> ca.SX:
    """Return S + 1 of Eq. 6, the least over the link."""
    maps = inflated_obstacles(Scene.of([obstacle]), [radius])
    matrix = maps.inverse[0] * maps.rotations[:, :, 0].T
    first, way = ca.mtimes(matrix, start - obstacle.center), ca.mtimes(matrix, end - start)
    t = ca.fmin(ca.fmax(-ca.dot(first, way) / (ca.dot(way, way) + _TINY), 0.0), 1.0)
    return ca.sumsqr(first + t * way)


def _distance(obstacle: Obstacle, at: ca.SX) -> ca.SX:
    """Return how far a point (3,), in the obstacle's axes, is from its surface [m]."""
    half = obstacle.half_extents
    if obstacle.shape == CAPSULE:
        reach = half[2] - half[0]
        along = ca.fmin(ca.fmax(at[2], -reach), reach)
        return ca.sqrt(at[0] ** 2 + at[1] ** 2 + (at[2] - along) ** 2 + _TINY) - half[0]
    if obstacle.shape == CYLINDER:
        beyond = [ca.sqrt(at[0] ** 2 + at[1] ** 2 + _TINY) - half[0], ca.fabs(at[2]) - half[2]]
    elif obstacle.shape == BOX:
        beyond = [ca.fabs(at[axis]) - half[axis] for axis in range(3)]
    else:
        raise ValueError(f"obstacle '{obstacle.name}' is a {obstacle.shape}; the optimum knows "
                         f'{ELLIPSOID}, {BOX}, {CYLINDER} and {CAPSULE}')
    furthest = beyond[0]
    for one in beyond[1:]:
        furthest = ca.fmax(furthest, one)
    outside = ca.sqrt(sum(ca.fmax(one, 0.0) ** 2 for one in beyond) + _TINY)
    return outside + ca.fmin(furthest, 0.0)
