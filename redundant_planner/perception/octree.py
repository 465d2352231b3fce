"""Reads the occupied cubes out of an octomap_msgs/Octomap.

OctoMap itself has no Python in apt, and all that is needed is one walk through the bytes. An
octree halves a cube of 2¹⁶ cells into eight again and again; depth first, each node says which of
its children there are. Of the binary form each node has two bits for each child: 00 is unknown, 10
free, 01 occupied, 11 divided on. Of the full form each node has its log-odds as a float32, and one
bit for each child; those without children are occupied if the log-odds are not negative.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError, shown
from redundant_planner.core.kernels import compiled, Indices, kernel, OutMatrix, Vector

Array = npt.NDArray[np.float64]

# The levels of OctoMap's trees.
_DEPTH = 16
_FINEST, _COARSEST = 1e-4, 10.0
# What `_walk` returns instead of a number of cubes.
_ENDS_EARLY, _TOO_DEEP = -1, -2


class Cubes(NamedTuple):
    """Occupied cubes, in the frame of their map.

    Attributes:
        centers: (k, 3) [m].
        edges: (k,) [m].
    """

    centers: Array
    edges: Array


def occupied(message: Any, center: Array, radius: float) -> Cubes:
    """Return the occupied cubes of an octomap_msgs/Octomap near a point.

    Args:
        message: of the id 'OcTree', binary or full.
        center: (3,) of a ball, in the frame of the map [m].
        radius: of the ball: cubes beyond it are left out [m].

    Raises:
        ObstacleError: it is of another id, its resolution is none, or its bytes are no octree.
    """
    if message.id != 'OcTree':
        raise ObstacleError(f"the octomap has the id {shown(message.id)}; it must be 'OcTree'")
    resolution = float(message.resolution)
    if not _FINEST <= resolution <= _COARSEST:
        raise ObstacleError(f'the octomap has a resolution of {resolution} m; it must be from '
                            f'{_FINEST:g} to {_COARSEST:g} m')
    given = message.data
    data = np.frombuffer(given, np.uint8) if isinstance(given, bytes) else np.asarray(given)
    data = data.astype(np.intp) & 255
    if not len(data):
        return Cubes(np.empty((0, 3)), np.empty(0))
    # In cells, counted from the corner of the tree; its middle is the map's origin.
    ball = np.append(np.asarray(center) / resolution + 2.0**(_DEPTH - 1), radius / resolution)
    full = not message.binary
    count = _walk(data, full, ball, np.empty((0, 4)))
    if count < 0:
        raise ObstacleError('the bytes of the octomap are no octree: they ' + {
            _ENDS_EARLY: f'end within a node, after {len(data)} of them',
            _TOO_DEEP: f'go deeper than {_DEPTH} levels'}[count])
    found = np.empty((count, 4))
    _walk(data, full, ball, found)
    edges = found[:, 3] * resolution
    centers = (found[:, :3] - 2**(_DEPTH - 1)) * resolution + 0.5 * edges[:, None]
    return Cubes(centers, edges)


@kernel
def _note(
    x: int, y: int, z: int, edge: int, ball: Vector, found: OutMatrix, count: int,
) -> int:
    """Write a cube if it is near the ball and there is room; return how many are near by now."""
    squared = 0.0
    for axis, low in enumerate((x, y, z)):
        away = max(low - ball[axis], ball[axis] - low - edge, 0.0)
        squared += away * away
    if squared > ball[3] * ball[3]:
        return count
    if count < len(found):
        found[count, 0], found[count, 1], found[count, 2], found[count, 3] = x, y, z, edge
    return count + 1


@compiled
def _walk(data: Indices, full: bool, ball: Vector, found: OutMatrix) -> int:
    """Write the occupied cubes near a ball, as far as there is room; return how many there are.

    Args:
        data: the bytes.
        full: of which form they are.
        ball: (4,) centre and radius [cells].
        found: (k, 4) lowest corner and edge of each [cells].
    """
    # Nodes yet to be read: lowest corner and edge.
    waiting = np.empty((8 * (_DEPTH + 1), 4), np.intp)
    waiting[0, 0] = waiting[0, 1] = waiting[0, 2] = 0
    waiting[0, 3] = 2**_DEPTH
    left, count, at = 1, 0, 0
    needed = 5 if full else 2
    while left:
        left -= 1
        x, y, z, edge = waiting[left, 0], waiting[left, 1], waiting[left, 2], waiting[left, 3]
        if at + needed > len(data):
            return _ENDS_EARLY
        if full:
            children, occupied_itself = data[at + 4], data[at + 3] < 128
        else:
            children, occupied_itself = data[at] + 256 * data[at + 1], False
        at += needed
        half = edge // 2
        if full and children == 0:
            count = _note(x, y, z, edge, ball, found, count) if occupied_itself else count
            continue
        if half == 0:
            return _TOO_DEEP
        # The last child first, as the first one is read next.
        for back in range(8):
            i = 7 - back
            u, v, w = x + half * (i & 1), y + half * (i >> 1 & 1), z + half * (i >> 2)
            divided = children >> i & 1 if full else children >> 2 * i & 3
            if divided == (1 if full else 3):
                waiting[left, 0], waiting[left, 1], waiting[left, 2] = u, v, w
                waiting[left, 3] = half
                left += 1
            elif not full and divided == 2:
                count = _note(u, v, w, half, ball, found, count)
    return count
