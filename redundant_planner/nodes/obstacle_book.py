"""The obstacles a node knows of: those of its parameters and those that markers brought."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.compiled import (
    compiled,
    Indices,
    Matrix,
    OutMatrix,
    OutStack,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.errors import known, ObstacleError, StateError
from redundant_planner.core.obstacles import Obstacle, rotations, Scene
from redundant_planner.nodes.marker_reader import (
    ADD,
    CUBE,
    CYLINDER,
    DELETE,
    DELETEALL,
    MarkerReader,
    Markers,
    SPHERE,
)

Array = npt.NDArray[np.float64]
# A frame's origin (3,) and axes (3, 3) in the base frame.
Transform = tuple[Array, Array]

# Half extents → semi-axes of the smallest ellipsoid around the shape.
_ENCLOSING = {
    SPHERE: (1.0, 1.0, 1.0),
    CUBE: (math.sqrt(3.0),) * 3,
    CYLINDER: (math.sqrt(1.5), math.sqrt(1.5), math.sqrt(3.0)),
}
_QUATERNION_TOLERANCE = 0.01
# An obstacle that seems faster than this was moved, not moving [m/s].
_FASTEST = 3.0
# An obstacle that nothing was heard of for this long stands still [s].
_STILL_AFTER = 0.3
# Problems of one message that are spelt out.
_SPELT_OUT = 3


class ObstacleBook:
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
        self._centers: Array = np.empty((0, 3))
        self._rotations: Array = np.empty((0, 3, 3))
        self._semi_axes: Array = np.empty((0, 3))
        self._velocities: Array = np.empty((0, 3))
        self._stamps: Array = np.empty(0)
        self._heard: Array = np.empty(0)
        self._expiry: Array = np.empty(0)
        self._names: tuple[str, ...] = ()
        self._reader = MarkerReader()
        # The ids of a message that only gave places to known obstacles, see `MarkerReader`.
        self._same_ids: npt.NDArray[np.intp] | None = None
        self._rows: npt.NDArray[np.intp] = np.empty(0, dtype=np.intp)
        self._factors: Array = np.empty((0, 3))
        self._changed = False
        self._next_change = np.inf
        self.scene = Scene.of()
        self.static = tuple(static)

    @property
    def static(self) -> tuple[Obstacle, ...]:
        """The obstacles that no marker removes; assigning replaces them."""
        return self._static

    @static.setter
    def static(self, obstacles: Iterable[Obstacle]) -> None:
        self._static = tuple(obstacles)
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
        if markers.ids is self._same_ids and _usable(
                markers.positions, markers.quaternions, markers.scales):
            # The same obstacles as last time, somewhere else.
            self._take_over(
                markers.positions, rotations(markers.quaternions),
                0.5 * markers.scales * self._factors, markers.stamps, markers.lifetimes,
                self._rows, now)
            self._rebuild()
            return []
        self._same_ids, self._rows = None, np.empty(0, dtype=np.intp)
        problems: list[str] = []
        # Markers of one action after another, in the message's order.
        edges = np.flatnonzero(np.diff(markers.actions)) + 1
        for begin, end in zip((0, *edges), (*edges, len(markers.ids))):
            if begin == end:
                continue
            action, part = int(markers.actions[begin]), slice(begin, end)
            if action == DELETEALL:
                self._keep(np.zeros(len(self._index), dtype=bool))
            elif action == DELETE:
                self._delete(markers, part)
            elif action == ADD:
                problems += self._add(markers, part, now)
            else:
                problems.append(f"obstacle '{_name(markers, begin)}' has action {action}; it "
                                'must be ADD, DELETE or DELETEALL')
        self._rebuild()
        if not problems and len(edges) == 0 and len(self._rows) == len(markers.ids) and all(
                frame in self._frames for frame in set(markers.frames)):
            self._same_ids = markers.ids
        if len(problems) > _SPELT_OUT:
            problems[_SPELT_OUT:] = [f'{len(problems) - _SPELT_OUT} more obstacles like that']
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

    def _add(self, markers: Markers, part: slice, now: float) -> list[str]:
        """Take in markers; return what was wrong with those left out."""
        places = np.arange(part.start, part.stop)
        good, problems = self._checked(markers, places)
        places = places[good]
        centers, turns = markers.positions[places], rotations(markers.quaternions[places])
        factors = np.array([_ENCLOSING[kind] for kind in markers.types[places].tolist()])
        centers, turns, good, unknown = self._in_base(markers, places, centers, turns)
        problems += unknown
        places, self._factors = places[good], factors.reshape(-1, 3)[good]
        if not len(places):
            return problems

        namespaces, ids = markers.namespaces, markers.ids.tolist()
        keys = [(namespaces[i], ids[i]) for i in places.tolist()]
        fresh = list(dict.fromkeys(key for key in keys if key not in self._index))
        self._grow(fresh)
        self._rows = np.array([self._index[key] for key in keys])
        self._take_over(
            centers[good], turns[good], 0.5 * markers.scales[places] * self._factors,
            markers.stamps[places], markers.lifetimes[places], self._rows, now)
        return problems

    def _take_over(
        self, centers: Array, turns: Array, semi_axes: Array, stamps: Array, lifetimes: Array,
        rows: npt.NDArray[np.intp], now: float,
    ) -> None:
        """Write what was seen into the rows it belongs to."""
        changed, soonest = _take_over(
            centers, turns, semi_axes, stamps, lifetimes, rows, now, self.estimate_velocity,
            self._centers, self._rotations, self._semi_axes, self._velocities, self._stamps,
            self._heard, self._expiry)
        self._changed = self._changed or changed
        self._next_change = min(self._next_change, soonest)

    def _checked(
        self, markers: Markers, places: npt.NDArray[np.intp],
    ) -> tuple[npt.NDArray[np.bool_], list[str]]:
        """Return which markers are ellipsoids, and a sentence about each of the others."""
        types = markers.types[places]
        shaped = np.isin(types, list(_ENCLOSING))
        scales = markers.scales[places]
        sized = np.asarray((np.isfinite(scales) & (scales > 0.0)).all(axis=1))
        placed = np.asarray(np.isfinite(markers.positions[places]).all(axis=1))
        norms = np.linalg.norm(markers.quaternions[places], axis=1)
        turned = np.abs(norms - 1.0) <= _QUATERNION_TOLERANCE
        good = shaped & sized & placed & turned
        problems = []
        for i in np.flatnonzero(~good).tolist():
            place = int(places[i])
            if not shaped[i]:
                what = (f'is a marker of type {types[i]}; it must be SPHERE ({SPHERE}), '
                        f'CUBE ({CUBE}) or CYLINDER ({CYLINDER})')
            elif not sized[i]:
                what = f'has scale {scales[i].tolist()}; all three must be positive [m]'
            elif not placed[i]:
                what = f'is at {markers.positions[place].tolist()}; it takes finite numbers'
            else:
                what = (f'has the orientation quaternion {markers.quaternions[place].tolist()} of '
                        f'length {norms[i]:.3g}; it must be 1')
            problems.append(f"obstacle '{_name(markers, place)}' {what}")
        return good, problems

    def _in_base(
        self, markers: Markers, places: npt.NDArray[np.intp], centers: Array, turns: Array,
    ) -> tuple[Array, Array, npt.NDArray[np.bool_], list[str]]:
        """Return the markers' places in the base frame, which of them have one, and why not."""
        good = np.ones(len(places), dtype=bool)
        problems: list[str] = []
        frames = [markers.frames[i] for i in places.tolist()]
        for frame in dict.fromkeys(frames):
            if frame in self._frames:
                continue
            chosen = np.array([name == frame for name in frames])
            try:
                if self._transform is None:
                    raise ObstacleError(f'it must be in {known(self._frames)}')
                origin, axes = self._transform(frame)
                centers[chosen] = centers[chosen] @ axes.T + origin
                turns[chosen] = axes @ turns[chosen]
            except ObstacleError as error:
                good &= ~chosen
                problems += [f"obstacle '{_name(markers, i)}' is given in frame '{frame}'; {error}"
                             for i in places[chosen].tolist()]
        return centers, turns, good, problems

    def _grow(self, keys: list[tuple[str, int]]) -> None:
        """Make room for obstacles not known so far."""
        if not keys:
            return
        count = len(keys)
        self._changed = True
        self._index.update({key: len(self._index) + i for i, key in enumerate(keys)})
        self._names = tuple(_key_name(*key) for key in self._index)
        self._centers = np.vstack((self._centers, np.full((count, 3), np.nan)))
        self._rotations = np.concatenate((self._rotations, np.zeros((count, 3, 3))))
        self._semi_axes = np.vstack((self._semi_axes, np.ones((count, 3))))
        self._velocities = np.vstack((self._velocities, np.zeros((count, 3))))
        self._stamps = np.concatenate((self._stamps, np.full(count, -np.inf)))
        self._heard = np.concatenate((self._heard, np.zeros(count)))
        self._expiry = np.concatenate((self._expiry, np.full(count, np.inf)))

    def _delete(self, markers: Markers, part: slice) -> None:
        keep = np.ones(len(self._index), dtype=bool)
        for i in range(part.start, part.stop):
            row = self._index.get((markers.namespaces[i], int(markers.ids[i])))
            if row is not None:
                keep[row] = False
        self._keep(keep)

    def _keep(self, keep: npt.NDArray[np.bool_]) -> None:
        """Forget the obstacles that are not marked."""
        if keep.all():
            return
        self._changed, self._same_ids = True, None
        keys = [key for key, kept in zip(self._index, keep.tolist()) if kept]
        self._index = {key: i for i, key in enumerate(keys)}
        self._names = tuple(_key_name(*key) for key in keys)
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


@compiled
def _usable(positions: Matrix, quaternions: Matrix, scales: Matrix) -> bool:
    """Return whether all markers are at finite places, turned by unit quaternions, and sized."""
    for i in range(len(positions)):
        x, y, z, w = quaternions[i]
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if not abs(norm - 1.0) <= _QUATERNION_TOLERANCE:
            return False
        for axis in range(3):
            if not (np.isfinite(positions[i, axis]) and 0.0 < scales[i, axis] < np.inf):
                return False
    return True


@compiled
def _take_over(
    centers: Matrix, turns: Stack, semi_axes: Matrix, stamps: Vector, lifetimes: Vector,
    rows: Indices, now: float, estimate_velocity: bool, known_centers: OutMatrix,
    known_turns: OutStack, known_semi_axes: OutMatrix, velocities: OutMatrix,
    known_stamps: OutVector, heard: OutVector, expiry: OutVector,
) -> tuple[bool, float]:
    """Write what was seen of obstacles into their rows.

    Returns:
        Whether anything is new, and when an obstacle ends or falls silent at the earliest [s].
    """
    changed, soonest = False, np.inf
    for i in range(len(rows)):
        row = rows[i]
        stamp = stamps[i] if stamps[i] > 0.0 else now
        elapsed = stamp - known_stamps[row]
        if estimate_velocity and elapsed > 0.0:  # else it is the same measurement once more
            velocity, squared = np.zeros(3), 0.0
            for axis in range(3):
                velocity[axis] = (
                    centers[i, axis] - known_centers[row, axis]) / max(elapsed, 1e-9)
                squared += velocity[axis] ** 2
            moving = squared < _FASTEST ** 2  # not so where it was never seen before: NaN
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
        known_stamps[row], heard[row] = stamp, now
        expiry[row] = now + lifetimes[i] if lifetimes[i] > 0.0 else np.inf
        soonest = min(soonest, expiry[row])
        if velocities[row].any():
            soonest = min(soonest, now + _STILL_AFTER + 1e-6)
    return changed, soonest


def _key_name(namespace: str, number: int) -> str:
    return f'{namespace}/{number}' if namespace else str(number)


def _name(markers: Markers, place: int) -> str:
    """Return a marker's identity as people read it: its namespace and number."""
    return _key_name(markers.namespaces[place], int(markers.ids[place]))
