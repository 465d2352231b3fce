"""Which shape each type of marker is, and what markers that list many things are made of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Matrix
from redundant_planner.core.obstacles import shapes
from redundant_planner.io.marker_reader import (
    CUBE,
    CUBE_LIST,
    CYLINDER,
    LINE_LIST,
    LINE_STRIP,
    Markers,
    POINTS,
    SPHERE,
    SPHERE_LIST,
)

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

# Every type of marker that is an obstacle, or lists many.
SINGLE = {'SPHERE': SPHERE, 'CUBE': CUBE, 'CYLINDER': CYLINDER}
LISTS = {'LINE_STRIP': LINE_STRIP, 'LINE_LIST': LINE_LIST, 'CUBE_LIST': CUBE_LIST,
         'SPHERE_LIST': SPHERE_LIST, 'POINTS': POINTS}
# Type of marker → shape; −1 where it is none.
_SHAPE_OF = np.full(max(LISTS.values()) + 1, -1)
_SHAPE_OF[[SPHERE, SPHERE_LIST]] = shapes.ELLIPSOID
_SHAPE_OF[[CUBE, CUBE_LIST, POINTS]] = shapes.BOX
_SHAPE_OF[CYLINDER] = shapes.CYLINDER
_SHAPE_OF[[LINE_STRIP, LINE_LIST]] = shapes.CAPSULE
# A cylinder is round if its two widths differ by no more than this share.
_ROUND = 0.01


class Things(NamedTuple):
    """The k obstacles that one marker lists.

    Attributes:
        shapes: (k,) as in `Scene`.
        centers: (k, 3) in the base frame [m].
        rotations: (k, 3, 3).
        half_extents: (k, 3) [m].
    """

    shapes: Indices
    centers: Array
    rotations: Array
    half_extents: Array


def single(types: Indices) -> npt.NDArray[np.bool_]:
    """Return which types of markers are one obstacle (k,)."""
    return np.asarray((types >= CUBE) & (types <= CYLINDER))


def lists_many(types: Indices) -> npt.NDArray[np.bool_]:
    """Return which types of markers list many obstacles (k,)."""
    return np.asarray((types >= LINE_STRIP) & (types <= POINTS))


def sizes(types: Indices, scales: Array) -> Array:
    """Return the full extents (k, 3) of markers, as their scales (k, 3) say [m].

    Lines have a width alone, and points a width and a height: the larger counts.
    """
    if not lists_many(types).any():
        return scales
    full = scales.copy()
    lines = (types == LINE_STRIP) | (types == LINE_LIST)
    full[lines] = scales[lines, :1]
    full[types == POINTS] = scales[types == POINTS, :2].max(axis=1, keepdims=True)
    return full


def shaped(types: Indices, full: Array) -> tuple[Indices, Array]:
    """Return shapes (k,) and half extents (k, 3) of markers that are one obstacle each.

    A cylinder that is not round is the box around it.

    Args:
        types: (k,) of the markers.
        full: (k, 3) full extents [m].
    """
    half, kind = 0.5 * full, _SHAPE_OF[types]
    cylinders = types == CYLINDER
    if cylinders.any():
        wide = half[:, :2].max(axis=1)
        flat = cylinders & ~(half[:, :2].min(axis=1) >= (1.0 - _ROUND) * wide)
        kind[flat] = shapes.BOX
        half[cylinders & ~flat, :2] = wide[cylinders & ~flat, None]
    return kind, half


def count_of(markers: Markers, place: int) -> int:
    """Return how many obstacles a marker lists."""
    kind, count = int(markers.listing.types[place]), len(markers.points[place])
    if kind == LINE_STRIP:
        return max(count - 1, 0)
    return count // 2 if kind == LINE_LIST else count


def things_of(markers: Markers, place: int, center: Array, axes: Array) -> Things:
    """Return the obstacles that one marker lists.

    Args:
        markers: of the message.
        place: the marker's in the message.
        center, axes: (3,) and (3, 3) its pose in the base frame.
    """
    kind, points = int(markers.listing.types[place]), markers.points[place]
    points = points @ axes.T + center
    full = sizes(np.array([kind]), markers.scales[place, None])[0]
    if kind in (LINE_STRIP, LINE_LIST):
        pairs = (points[:-1], points[1:]) if kind == LINE_STRIP else (
            points[:len(points) // 2 * 2:2], points[1::2])
        return _lines(*pairs, 0.5 * float(full[0]))
    return Things(
        np.full(len(points), _SHAPE_OF[kind]), points,
        np.ascontiguousarray(np.broadcast_to(axes, (len(points), 3, 3))),
        np.tile(0.5 * full, (len(points), 1)))


def _lines(start: Array, end: Array, radius: float) -> Things:
    """Return the capsules around segments (k, 3), (k, 3)."""
    way = end - start
    half = np.empty_like(way)
    half[:, :2] = radius
    half[:, 2] = 0.5 * np.sqrt(np.square(way).sum(axis=1)) + radius
    return Things(np.full(len(way), shapes.CAPSULE), 0.5 * (start + end), upright_to(way), half)


@compiled
def upright_to(ways: Matrix) -> Array:
    """Return rotations (k, 3, 3) whose z axes lie along vectors (k, 3), any for a zero."""
    turned = np.empty((len(ways), 3, 3))
    for i in range(len(ways)):
        x, y, z = ways[i]
        size = np.sqrt(x * x + y * y + z * z)
        x, y, z = (x / size, y / size, z / size) if size > 0.0 else (0.0, 0.0, 1.0)
        # Sound for every direction, the one against z included (Duff et al., 2017).
        sign = 1.0 if z >= 0.0 else -1.0
        a = -1.0 / (sign + z)
        b = x * y * a
        r = turned[i]
        r[0, 0], r[1, 0], r[2, 0] = 1.0 + sign * x * x * a, sign * b, -sign * x
        r[0, 1], r[1, 1], r[2, 1] = b, sign + y * y * a, -y
        r[0, 2], r[1, 2], r[2, 2] = x, y, z
    return turned
