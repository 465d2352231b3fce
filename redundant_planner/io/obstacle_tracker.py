"""The obstacles a node knows of: those of its parameters and those that markers brought."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import compress, count, islice, repeat
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ObstacleError, StateError
from redundant_planner.core.kernels import (
    compiled,
    Indices,
    Matrix,
    OutMatrix,
    OutStack,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import rotations, Scene
from redundant_planner.io.marker_reader import (
    ADD,
    CUBE,
    CYLINDER,
    DELETE,
    DELETEALL,
    Listing,
    MarkerReader,
    Markers,
    SPHERE,
)

Array = npt.NDArray[np.float64]
# A frame's origin (3,) and axes (3, 3) in the base frame.
Transform = tuple[Array, Array]

# Obstacles that markers may have brought at any time.
MOST_OBSTACLES = 20_000
# Frames besides the base's that the markers of one message may be given in.
MOST_FRAMES = 20
# Coordinates and full extents of an obstacle [m]. Beyond them it was not meant, and the squares
# that clearances are made of would leave the range of numbers.
FARTHEST = 1e6
SMALLEST, LARGEST = 1e-6, 1e6

# Half extents → semi-axes of the smallest ellipsoid around the shape, by the marker's type.
_ENCLOSING = np.full((4, 3), np.nan)
_ENCLOSING[SPHERE] = 1.0
_ENCLOSING[CUBE] = math.sqrt(3.0)
_ENCLOSING[CYLINDER] = math.sqrt(1.5), math.sqrt(1.5), math.sqrt(3.0)
_QUATERNION_TOLERANCE = 0.01
# An obstacle that seems faster than this was moved, not moving [m/s].
_FASTEST = 3.0
# Stamps that are closer than this belong to one measurement: noise divided by less is any
# velocity [s].
_CLOSEST = 1e-3
# An obstacle that nothing was heard of for this long stands still; a stamp that is older than the
# last one by more is of a clock that was set back [s].
_STILL_AFTER = 0.3
# Problems of one message that are spelt out.
_SPELT_OUT = 3
# What may be wrong with an obstacle's numbers, see `_faults`.
_GOOD, _BAD_SCALE, _BAD_PLACE, _BAD_TURN, _BAD_LIFETIME = range(5)


class _Known(NamedTuple):
    """Where in the book the obstacles of a message stand that gave all of them a place.

    It holds for later messages with the same listing, until an obstacle comes or goes.

    Attributes:
        listing: of the message.
        first: the first marker after the last DELETEALL.
        rows: (k,) of the markers from there on, all of them ADD.
        factors: (k, 3) half extents → semi-axes.
    """

    listing: Listing
    first: int
    rows: npt.NDArray[np.intp]
    factors: Array


class ObstacleTracker:
    """Static obstacles and markers with their lifetimes, as one scene.

    `scene` stays the same object while nothing changes.
    """

    def __init__(
        self, static: Iterable[Obstacle], frames: Sequence[str], *,
        transform: Callable[[str], Transform] | None = None, estimate_velocity: bool = False,
    ) -> None:
        """Begin with the static obstacles.

        Args:
            static: obstacles that no marker removes.
            frames: names the base frame goes by in markers.
            transform: returns where another frame is, or raises ObstacleError with the reason;
                None where other frames are refused.
            estimate_velocity: whether obstacles that are seen at one place after another are
                taken to move on.
        """
        self._frames = tuple(frames)
        self._transform = transform
        self.estimate_velocity = estimate_velocity
        self._index: dict[tuple[str, int], int] = {}
        self._names: tuple[str, ...] = ()
        self._centers: Array = np.empty((0, 3))
        self._rotations: Array = np.empty((0, 3, 3))
        self._semi_axes: Array = np.empty((0, 3))
        self._velocities: Array = np.empty((0, 3))
        self._stamps: Array = np.empty(0)
        self._heard: Array = np.empty(0)
        self._expiry: Array = np.empty(0)
        self._reader = MarkerReader()
        self._known: _Known | None = None
        self._changed = False
        self._next_change = np.inf
        self.scene = Scene.of()
        self.static = tuple(static)

    @property
    def static(self) -> tuple[Obstacle, ...]:
        """The obstacles that no marker removes; assigning replaces them.

        Raises:
            ObstacleError: as `checked`; nothing has changed then.
        """
        return self._static

    @static.setter
    def static(self, obstacles: Iterable[Obstacle]) -> None:
        self._static = checked(obstacles)
        self._static_scene = Scene.of(self._static)
        self._changed = True
        self._rebuild()

    def update(self, raw: bytes, now: float) -> list[str]:
        """Apply a serialised MarkerArray at time `now` [s].

        A marker that cannot be used changes nothing: the obstacle of that name stays as it was.

        Returns:
            What was wrong, a sentence per marker.
        """
        try:
            markers = self._reader.read(raw)
        except StateError as error:
            return [f'obstacles: {error}']
        if self._known is None or markers.listing is not self._known.listing or _faults(
                markers.positions, markers.quaternions, markers.scales, markers.lifetimes,
                self._known.first).any():
            problems = self._apply(markers, now)
        else:
            # The same obstacles as before, somewhere else.
            known, problems = self._known, []
            if known.first:
                self._forget(slice(None))
            part = slice(known.first, None)
            self._take_over(
                np.zeros(len(known.rows), np.intp), markers.positions[part],
                rotations(markers.quaternions[part]), 0.5 * markers.scales[part] * known.factors,
                markers.stamps[part], markers.lifetimes[part], known.rows, now)
        self._rebuild()
        return problems

    def _apply(self, markers: Markers, now: float) -> list[str]:
        """Apply markers that may do anything to any obstacle; return what was wrong."""
        listing = markers.listing
        actions = listing.actions
        centers, turns = markers.positions.copy(), rotations(markers.quaternions)
        reasons = self._into_base(listing, centers, turns)
        shaped = (listing.types >= CUBE) & (listing.types <= CYLINDER)
        faults = _faults(centers, markers.quaternions, markers.scales, markers.lifetimes, 0)
        good = (actions == ADD) & shaped & (faults == _GOOD)
        if reasons:
            good &= np.array([frame not in reasons for frame in listing.frames])
        bad = np.flatnonzero(~good & (actions != DELETE) & (actions != DELETEALL))
        problems = [_problem(markers, place, faults[place], reasons)
                    for place in bad[:_SPELT_OUT].tolist()]
        if len(bad) > _SPELT_OUT:
            problems.append(f'{len(bad) - _SPELT_OUT} more obstacles like that')

        # What comes before the last DELETEALL leaves no trace.
        first = int(np.flatnonzero(actions == DELETEALL).max(initial=-1)) + 1
        if first:
            self._keep(np.zeros(len(self._index), dtype=bool))
        acting = good | (actions == DELETE)
        acting[:first] = False
        places = np.flatnonzero(acting)
        rows, lost = self._rows_of(listing, places, good[places])
        if lost:
            problems.append(f'{lost} obstacles are too many: up to {MOST_OBSTACLES} are kept in '
                            'mind')
        places, rows = places[rows >= 0], rows[rows >= 0]
        factors = _ENCLOSING[np.where(shaped, listing.types, 0)[places]]
        self._take_over(
            actions[places], centers[places], turns[places],
            0.5 * markers.scales[places] * factors, markers.stamps[places],
            markers.lifetimes[places], rows, now)
        self._keep(self._expiry > -np.inf)
        if good[first:].all() and len(rows) == len(actions) - first and all(
                frame in self._frames for frame in set(listing.frames)):
            self._known = _Known(listing, first, rows, factors)
        return problems

    def expire(self, now: float) -> None:
        """Remove the obstacles whose lifetime has ended by `now`, and stop silent ones [s]."""
        if now < self._next_change:
            return
        ended = self._expiry <= now
        if ended.any():
            self._keep(~ended)
        silent = (now - self._heard > _STILL_AFTER) & self._velocities.any(axis=1)
        if silent.any():
            self._velocities[silent] = 0.0
            self._changed = True
        self._rebuild()
        still_moving = self._heard[self._velocities.any(axis=1)]
        self._next_change = min(float(self._expiry.min(initial=np.inf)),
                                float(still_moving.min(initial=np.inf)) + _STILL_AFTER + 1e-6)

    def _take_over(
        self, actions: npt.NDArray[np.intp], centers: Array, turns: Array, semi_axes: Array,
        stamps: Array, lifetimes: Array, rows: npt.NDArray[np.intp], now: float,
    ) -> None:
        """Write what was seen into the rows it belongs to."""
        changed, soonest = _take_over(
            actions, centers, turns, semi_axes, stamps, lifetimes, rows, now,
            self.estimate_velocity, self._centers, self._rotations, self._semi_axes,
            self._velocities, self._stamps, self._heard, self._expiry)
        self._changed = self._changed or changed
        self._next_change = min(self._next_change, soonest)

    def _into_base(self, listing: Listing, centers: Array, turns: Array) -> dict[str, str]:
        """Turn places (k, 3) and axes (k, 3, 3) into those in the base frame.

        Returns:
            Frame → why nothing can be turned from there.
        """
        number = {frame: i for i, frame in enumerate(dict.fromkeys(listing.frames))}
        foreign = [frame for frame in number if frame not in self._frames]
        reasons = dict.fromkeys(foreign[MOST_FRAMES:], 'the markers of one message may be given '
                                f'in up to {MOST_FRAMES} frames besides the base')
        numbers = np.array([number[frame] for frame in listing.frames]) if foreign else None
        for frame in foreign[:MOST_FRAMES]:
            try:
                if self._transform is None:
                    raise ObstacleError(f'it must be in {known(self._frames)}')
                origin, axes = self._transform(frame)
            except ObstacleError as error:
                reasons[frame] = str(error)
                continue
            chosen = numbers == number[frame]
            with np.errstate(invalid='ignore', over='ignore'):  # what it leads to is checked
                centers[chosen] = centers[chosen] @ axes.T + origin
                turns[chosen] = axes @ turns[chosen]
        return reasons

    def _rows_of(
        self, listing: Listing, places: npt.NDArray[np.intp], adds: npt.NDArray[np.bool_],
    ) -> tuple[npt.NDArray[np.intp], int]:
        """Return the rows of some markers' obstacles, making room for new ones that are added.

        Returns:
            (k,) rows, −1 for no obstacle, and for how many there was no room.
        """
        # Loops in C: a message may list thousands.
        index, acts = self._index, np.zeros(len(listing.ids), dtype=bool)
        acts[places] = True
        keys = list(zip(compress(listing.namespaces, acts.tolist()), listing.ids[places].tolist()))
        rows = list(map(index.get, keys, repeat(-1)))
        lost = 0
        if -1 in rows:
            unknown = (np.array(rows) < 0) & adds
            new = [*dict.fromkeys(compress(keys, unknown.tolist()))]
            lost = max(len(index) + len(new) - MOST_OBSTACLES, 0)
            if new[:len(new) - lost]:
                index.update(zip(new[:len(new) - lost], count(len(index))))
                self._grow(len(new) - lost)
                rows = list(map(index.get, keys, repeat(-1)))
        return np.array(rows, dtype=np.intp), lost

    def _grow(self, more: int) -> None:
        """Make room for obstacles that the index has already."""
        old = len(self._centers)
        self._known = None
        self._names += tuple([f'{name}/{number}' if name else str(number)
                              for name, number in islice(self._index, old, None)])
        self._centers = np.vstack((self._centers, np.empty((more, 3))))
        self._rotations = np.concatenate((self._rotations, np.zeros((more, 3, 3))))
        self._semi_axes = np.vstack((self._semi_axes, np.ones((more, 3))))
        self._velocities = np.vstack((self._velocities, np.empty((more, 3))))
        self._stamps = np.concatenate((self._stamps, np.empty(more)))
        self._heard = np.concatenate((self._heard, np.zeros(more)))
        self._expiry = np.concatenate((self._expiry, np.full(more, np.inf)))
        self._forget(slice(old, None))

    def _forget(self, rows: slice) -> None:
        """Make obstacles look as if they had never been seen."""
        self._centers[rows], self._velocities[rows], self._stamps[rows] = np.nan, 0.0, -np.inf
        self._changed = True

    def _keep(self, keep: npt.NDArray[np.bool_]) -> None:
        """Forget the obstacles that are not marked."""
        if keep.all():
            return
        self._changed, self._known = True, None
        kept = keep.tolist()
        self._index = dict(zip(compress(self._index, kept), count()))
        self._names = tuple(compress(self._names, kept))
        for field in ('_centers', '_rotations', '_semi_axes', '_velocities', '_stamps', '_heard',
                      '_expiry'):
            setattr(self, field, getattr(self, field)[keep])

    def _rebuild(self) -> None:
        """Make a new scene, if anything has changed since the last one."""
        if not self._changed:
            return
        self._changed = False
        static = self._static_scene
        arrays = [np.concatenate(parts) for parts in (
            (static.centers, self._centers), (static.rotations, self._rotations),
            (static.semi_axes, self._semi_axes), (static.velocities, self._velocities))]
        for array in arrays:
            array.setflags(write=False)
        self.scene = Scene(static.names + self._names, *arrays)


def checked(obstacles: Iterable[Obstacle]) -> tuple[Obstacle, ...]:
    """Return obstacles that are within the bounds which hold for markers, too.

    Raises:
        ObstacleError: naming one that is too far away, too small or too large.
    """
    obstacles = tuple(obstacles)
    scene = Scene.of(obstacles)
    ahead = np.tile((0.0, 0.0, 0.0, 1.0), (len(obstacles), 1))
    faults = _faults(scene.centers, ahead, 2.0 * scene.semi_axes, np.zeros(len(obstacles)), 0)
    for i in np.flatnonzero(faults)[:1]:
        raise ObstacleError(f'obstacle {scene.names[i]!r} ' + _fault_text(
            int(faults[i]), scene.centers[i], ahead[i], 2.0 * scene.semi_axes[i], 0.0))
    return obstacles


@compiled
def _faults(
    positions: Matrix, quaternions: Matrix, scales: Matrix, lifetimes: Vector, first: int,
) -> Indices:
    """Return what is wrong with the numbers of obstacles, from the first one on that counts.

    This is where all bounds on obstacles are: `FARTHEST`, `SMALLEST` and `LARGEST`.
    """
    faults = np.zeros(len(positions), np.intp)
    for i in range(first, len(positions)):
        x, y, z, w = quaternions[i]
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if not abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
            faults[i] = _BAD_TURN
        if not lifetimes[i] >= 0.0:
            faults[i] = _BAD_LIFETIME
        for axis in range(3):
            if not abs(positions[i, axis]) <= FARTHEST:
                faults[i] = _BAD_PLACE
        for axis in range(3):
            if not SMALLEST <= scales[i, axis] <= LARGEST:
                faults[i] = _BAD_SCALE
    return faults


def _fault_text(fault: int, center: Array, quaternion: Array, scale: Array, life: float) -> str:
    """Return what follows an obstacle's name in the sentence about a fault."""
    return {
        _BAD_SCALE: f'has the scale (full axes) {scale.tolist()}; all three must be positive, '
                    f'from {SMALLEST:g} to {LARGEST:g} m',
        _BAD_PLACE: f'is at {center.tolist()}; it takes finite numbers up to {FARTHEST:g} m',
        _BAD_TURN: f'has the orientation quaternion {quaternion.tolist()} of length '
                   f'{math.hypot(*quaternion.tolist()):.3g}; it must be 1',
        _BAD_LIFETIME: f'has a lifetime of {life:g} s; it must be positive, or 0 for unlimited',
    }[fault]


def _problem(markers: Markers, place: int, fault: int, reasons: dict[str, str]) -> str:
    """Return the sentence about a marker that cannot be used."""
    listing = markers.listing
    kind, action, frame = listing.types[place], listing.actions[place], listing.frames[place]
    namespace, number = listing.namespaces[place], listing.ids[place]
    name = f'{namespace}/{number}' if namespace else str(number)
    if action != ADD:
        what = f'has action {action}; it must be ADD, DELETE or DELETEALL'
    elif kind not in (SPHERE, CUBE, CYLINDER):
        what = (f'is a marker of type {kind}; it must be SPHERE ({SPHERE}), CUBE ({CUBE}) or '
                f'CYLINDER ({CYLINDER})')
    elif frame in reasons:
        what = f'is given in frame {frame!r}; {reasons[frame]}'
    else:
        what = _fault_text(fault, markers.positions[place], markers.quaternions[place],
                           markers.scales[place], markers.lifetimes[place])
    return f'obstacle {name!r} {what}'


@compiled
def _take_over(
    actions: Indices, centers: Matrix, turns: Stack, semi_axes: Matrix, stamps: Vector,
    lifetimes: Vector, rows: Indices, now: float, estimate_velocity: bool,
    known_centers: OutMatrix, known_turns: OutStack, known_semi_axes: OutMatrix,
    velocities: OutMatrix, known_stamps: OutVector, heard: OutVector, expiry: OutVector,
) -> tuple[bool, float]:
    """Write what was seen of obstacles into their rows, one after another.

    Those that are deleted expire at −∞, and look as if they had never been seen.

    Returns:
        Whether anything is new, and when an obstacle ends or falls silent at the earliest [s].
    """
    changed, soonest = False, np.inf
    for i in range(len(rows)):
        row = rows[i]
        if actions[i] == DELETE:
            for axis in range(3):
                known_centers[row, axis], velocities[row, axis] = np.nan, 0.0
            known_stamps[row], expiry[row] = -np.inf, -np.inf
            changed = True
            continue
        stamp = stamps[i] if stamps[i] > 0.0 else now
        elapsed = stamp - known_stamps[row]
        restarted = elapsed < -_STILL_AFTER
        measured = elapsed >= _CLOSEST or restarted  # else it is the same measurement once more
        if estimate_velocity and measured:
            velocity, squared = np.zeros(3), 0.0
            for axis in range(3):
                velocity[axis] = (centers[i, axis] - known_centers[row, axis]) / elapsed
                squared += velocity[axis] ** 2
            # Not so where it was never seen before: NaN.
            moving = squared < _FASTEST ** 2 and not restarted
            for axis in range(3):
                speed = velocity[axis] if moving else 0.0
                changed = changed or speed != velocities[row, axis]
                velocities[row, axis] = speed
        for axis in range(3):
            changed = (changed or centers[i, axis] != known_centers[row, axis]
                       or semi_axes[i, axis] != known_semi_axes[row, axis])
            known_centers[row, axis] = centers[i, axis]
            known_semi_axes[row, axis] = semi_axes[i, axis]
            for other in range(3):
                changed = changed or turns[i, axis, other] != known_turns[row, axis, other]
                known_turns[row, axis, other] = turns[i, axis, other]
        if measured:
            known_stamps[row] = stamp
        heard[row] = now
        expiry[row] = now + lifetimes[i] if lifetimes[i] > 0.0 else np.inf
        soonest = min(soonest, expiry[row])
        if velocities[row].any():
            soonest = min(soonest, now + _STILL_AFTER + 1e-6)
    return changed, soonest
