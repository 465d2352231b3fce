"""Which obstacles can be meant: bounds on their numbers, and the sentence about a bad one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.kernels import compiled, Indices, Matrix, Vector
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.io.marker_reader import ADD, Listing, Markers
from redundant_planner.io.marker_shapes import count_of, LISTS, SINGLE
from redundant_planner.io.plausible import FASTEST

Array = npt.NDArray[np.float64]

# Coordinates and full extents of an obstacle [m]. Nobody means one beyond them, and the squares in
# a clearance would overflow.
FARTHEST = 1e6
SMALLEST, LARGEST = 1e-6, 1e6
_QUATERNION_TOLERANCE = 0.01
_TYPES = {**SINGLE, **LISTS}
_MESH_RESOURCE = 10
# What `faults` returns.
GOOD, _BAD_SCALE, _BAD_PLACE, _BAD_TURN, _BAD_LIFETIME, BAD_TWIST = range(6)


def checked(obstacles: Iterable[Obstacle]) -> tuple[Obstacle, ...]:
    """Return obstacles that keep the bounds on markers.

    Raises:
        ObstacleError: naming one that is too far away, too small or too large.
    """
    obstacles = tuple(obstacles)
    scene = Scene.of(obstacles)
    ahead = np.tile((0.0, 0.0, 0.0, 1.0), (len(obstacles), 1))
    found = faults(scene.centers, ahead, 2.0 * scene.half_extents, np.zeros(len(obstacles)), 0)
    for i in np.flatnonzero(found)[:1]:
        raise ObstacleError(f'obstacle {scene.names[i]!r} ' + _fault_text(
            int(found[i]), scene.centers[i], ahead[i], 2.0 * scene.half_extents[i], 0.0))
    return obstacles


@compiled
def faults(
    positions: Matrix, quaternions: Matrix, scales: Matrix, lifetimes: Vector, first: int,
) -> Indices:
    """Return what is wrong with the numbers of obstacles (k,), `GOOD` for nothing.

    Args:
        positions: (k, 3) centres in the base frame [m].
        quaternions: (k, 4) x y z w.
        scales: (k, 3) full extents [m].
        lifetimes: (k,) [s].
        first: those before this one are not looked at.
    """
    found = np.zeros(len(positions), np.intp)
    for i in range(first, len(positions)):
        x, y, z, w = quaternions[i]
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if not abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
            found[i] = _BAD_TURN
        if not lifetimes[i] >= 0.0:
            found[i] = _BAD_LIFETIME
        for axis in range(3):
            if not abs(positions[i, axis]) <= FARTHEST:
                found[i] = _BAD_PLACE
        for axis in range(3):
            if not SMALLEST <= scales[i, axis] <= LARGEST:
                found[i] = _BAD_SCALE
    return found


def _fault_text(fault: int, center: Array, quaternion: Array, scale: Array, life: float) -> str:
    """Return what follows an obstacle's name in the sentence about a fault."""
    return {
        _BAD_SCALE: f'has the scale (full axes) {scale.tolist()}; all three must be positive, '
                    f'from {SMALLEST:g} to {LARGEST:g} m',
        _BAD_PLACE: f'is at {center.tolist()}; it takes finite numbers up to {FARTHEST:g} m',
        _BAD_TURN: f'has the orientation quaternion {quaternion.tolist()} of length '
                   f'{math.hypot(*quaternion.tolist()):.3g}; it must be 1',
        _BAD_LIFETIME: f'has a lifetime of {life:g} s; it must be positive, or 0 for unlimited',
        BAD_TWIST: "has a text that begins with 'twist', but no six numbers follow, up to "
                   f'{FASTEST:g} m/s and rad/s',
    }[fault]


def problem_of(markers: Markers, place: int, fault: int, reasons: Mapping[str, str]) -> str:
    """Return the sentence about a marker that cannot be used.

    Args:
        markers: of the message.
        place: the marker's in the message.
        fault: of its numbers, as `faults` returns it.
        reasons: frame → why its markers cannot be used.
    """
    listing = markers.listing
    kind, action, frame = int(listing.types[place]), listing.actions[place], listing.frames[place]
    if action != ADD:
        what = f'has action {action}; it must be ADD, DELETE or DELETEALL'
    elif kind == _MESH_RESOURCE:
        what = ('is a mesh, MESH_RESOURCE (10), which is not read; send boxes, cylinders or '
                'capsules around it')
    elif kind not in _TYPES.values():
        what = (f'is a marker of type {kind}; it must be '
                + ', '.join(f'{name} ({number})' for name, number in _TYPES.items()))
    elif frame in reasons:
        what = f'is given in frame {frame!r}; {reasons[frame]}'
    else:
        what = _fault_text(fault, markers.positions[place], markers.quaternions[place],
                           markers.scales[place], markers.lifetimes[place])
    return f'obstacle {_name(listing, place)!r} {what}'


def problem_of_list(
    markers: Markers, place: int, center: Array, axes: Array, room: int,
) -> str:
    """Return the sentence about a marker whose list of obstacles cannot be used, '' if it can.

    Args:
        markers: of the message.
        place: the marker's in the message.
        center, axes: (3,), (3, 3) its pose in the base frame.
        room: how many obstacles more can be kept.
    """
    points, what = markers.points[place], ''
    count = count_of(markers, place)
    with np.errstate(invalid='ignore', over='ignore'):
        good = np.abs(points @ axes.T + center) <= FARTHEST
    if not good.all():
        bad = int(np.flatnonzero(~good.all(axis=1))[0])
        what = (f'has its point {bad} at {points[bad].tolist()}; it takes finite numbers up to '
                f'{FARTHEST:g} m')
    elif count > room:
        what = f'lists {count} things; there is room for {max(room, 0)} more'
    return f'obstacle {_name(markers.listing, place)!r} {what}' if what else ''


def _name(listing: Listing, place: int) -> str:
    """Return what a marker's obstacle is called."""
    namespace, number = listing.namespaces[place], listing.ids[place]
    return f'{namespace}/{number}' if namespace else str(number)
