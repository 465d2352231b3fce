"""Points to voxels: cubes of one size on a grid that stands still in the base frame.

A voxel is one whole number, 21 bits for its place along each axis. A hash table counts the points
of each; it grows with the number of different voxels, so that it stays in the processor's cache.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, kernel, Matrix, OutMatrix, Vector

Array = npt.NDArray[np.float64]
Keys = npt.NDArray[np.intp]

_BITS = 21
# Places along an axis are counted from the base, both ways.
_MIDDLE = 2 ** (_BITS - 1)
_MASK = 2**_BITS - 1
# Slots of the table at first, a power of two; half of them may be taken.
_SLOTS = 2**14
# Spreads neighbouring voxels over the table (Knuth's multiplicative hashing).
_FACTOR = 0x9E3779B97F4A7C15 - 2**64
# Of the product, only high digits depend on all digits of the voxel.
_SHIFT = 43


def centers_of(keys: Keys, size: float) -> Array:
    """Return the centres (k, 3) of voxels (k,) of a size [m]."""
    places = np.stack([keys >> 2 * _BITS, (keys >> _BITS) & _MASK, keys & _MASK], axis=1)
    return (places - _MIDDLE + 0.5) * size


def key_of(point: npt.ArrayLike, size: float) -> int:
    """Return the voxel of a size [m] that a point (3,) lies in [m]."""
    i, j, k = np.floor(np.asarray(point, float) / size).astype(int).tolist()
    return ((i + _MIDDLE) << 2 * _BITS) | ((j + _MIDDLE) << _BITS) | (k + _MIDDLE)


@compiled
def cropped(
    points: Matrix, origin: Vector, axes: Matrix, ball: Vector, box: Matrix, kept: OutMatrix,
) -> int:
    """Write the points (3, n) that lie within a ball and a box; return how many there are.

    NaN and infinite ones lie in neither.

    Args:
        points: in the sensor's frame [m].
        origin: (3,) of that frame in the base frame [m].
        axes: (3, 3) of that frame in the base frame.
        ball: (4,) centre and radius [m].
        box: (2, 3) lowest and highest corner [m].
        kept: (3, n or more) what is written, in the base frame [m].
    """
    m, squared = 0, ball[3] * ball[3]
    r00, r01, r02 = axes[0, 0], axes[0, 1], axes[0, 2]
    r10, r11, r12 = axes[1, 0], axes[1, 1], axes[1, 2]
    r20, r21, r22 = axes[2, 0], axes[2, 1], axes[2, 2]
    for i in range(points.shape[1]):
        a, b, c = points[0, i], points[1, i], points[2, i]
        x = r00 * a + r01 * b + r02 * c + origin[0]
        y = r10 * a + r11 * b + r12 * c + origin[1]
        z = r20 * a + r21 * b + r22 * c + origin[2]
        dx, dy, dz = x - ball[0], y - ball[1], z - ball[2]
        # No jumps: in a cloud without order, nobody could foretell them.
        kept[0, m], kept[1, m], kept[2, m] = x, y, z
        m += ((dx * dx + dy * dy + dz * dz <= squared) & (box[0, 0] <= x) & (x <= box[1, 0])
              & (box[0, 1] <= y) & (y <= box[1, 1]) & (box[0, 2] <= z) & (z <= box[1, 2]))
    return m


@kernel
def _slot(key: int, table: Indices, keys: Indices) -> int:
    """Return the slot of a table in which a voxel is, or would be."""
    mask = len(table) - 1
    at = ((key * _FACTOR) >> _SHIFT) & mask
    while table[at] >= 0 and keys[table[at]] != key:
        at = (at + 1) & mask
    return at


@compiled
def counted(points: Matrix, size: float) -> tuple[Keys, Keys]:
    """Return the voxels of a size [m] that points (3, n) lie in [m].

    Returns:
        The k voxels, in no order, and how many points each has.
    """
    table = np.full(_SLOTS, -1)
    keys, counts = np.empty(_SLOTS // 2, np.intp), np.empty(_SLOTS // 2, np.intp)
    found, last = 0, -1
    for i in range(points.shape[1]):
        key = ((math.floor(points[0, i] / size) + _MIDDLE << 2 * _BITS)
               | (math.floor(points[1, i] / size) + _MIDDLE << _BITS)
               | (math.floor(points[2, i] / size) + _MIDDLE))
        if last >= 0 and keys[last] == key:  # as for most neighbours in an image
            counts[last] += 1
            continue
        at = _slot(key, table, keys)
        last = table[at]
        if last >= 0:
            counts[last] += 1
            continue
        if found == len(keys):
            table = np.full(2 * len(table), -1)
            keys = np.append(keys, np.empty(found, np.intp))
            counts = np.append(counts, np.empty(found, np.intp))
            for j in range(found):
                table[_slot(keys[j], table, keys)] = j
            at = _slot(key, table, keys)
        keys[found], counts[found], table[at] = key, 1, found
        last = found
        found += 1
    return keys[:found], counts[:found]
