"""The obstacles a node knows of: those of its parameters and those that markers brought."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ObstacleError, StateError
from redundant_planner.core.obstacles import Obstacle, rotations, Scene
from redundant_planner.nodes.marker_reader import (
    ADD,
    CUBE,
    CYLINDER,
    DELETE,
    DELETEALL,
    Markers,
    read_markers,
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
        self._rebuild()

    def update(self, raw: bytes, now: float) -> list[str]:
        """Apply a serialised MarkerArray at time `now` [s].

        A marker that cannot be used changes nothing: the obstacle of that name stays as it was.

        Returns:
            What was wrong, a sentence per marker.
        """
        try:
            markers = read_markers(raw)
        except StateError as error:
            return [f'obstacles: {error}']
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
        if len(problems) > _SPELT_OUT:
            problems[_SPELT_OUT:] = [f'{len(problems) - _SPELT_OUT} more obstacles like that']
        return problems

    def expire(self, now: float) -> None:
        """Remove the obstacles whose lifetime has ended by `now`, and stop silent ones [s]."""
        ended = self._expiry <= now
        if ended.any():
            self._keep(~ended)
            self._rebuild()
        if self.estimate_velocity and self._velocities.any():
            silent = (now - self._heard > _STILL_AFTER) & self._velocities.any(axis=1)
            if silent.any():
                self._velocities[silent] = 0.0
                self._rebuild()

    def _add(self, markers: Markers, part: slice, now: float) -> list[str]:
        """Take in markers; return what was wrong with those left out."""
        places = np.arange(part.start, part.stop)
        good, problems = self._checked(markers, places)
        places = places[good]
        centers = markers.positions[places]
        norms = np.linalg.norm(markers.quaternions[places], axis=1)[:, None]
        turns = rotations(markers.quaternions[places] / norms)
        factors = np.array([_ENCLOSING[kind] for kind in markers.types[places].tolist()])
        semi_axes = 0.5 * markers.scales[places] * factors.reshape(-1, 3)
        centers, turns, good, unknown = self._in_base(markers, places, centers, turns)
        problems += unknown
        places = places[good]
        if not len(places):
            return problems

        namespaces, ids = markers.namespaces, markers.ids.tolist()
        keys = [(namespaces[i], ids[i]) for i in places.tolist()]
        fresh = list(dict.fromkeys(key for key in keys if key not in self._index))
        self._grow(fresh)
        rows = np.array([self._index[key] for key in keys])
        stamps = markers.stamps[places]
        stamps = np.where(stamps > 0.0, stamps, now)
        if self.estimate_velocity:
            elapsed = (stamps - self._stamps[rows])[:, None]
            with np.errstate(invalid='ignore'):
                velocities = (centers[good] - self._centers[rows]) / np.maximum(elapsed, 1e-9)
                moving = np.linalg.norm(velocities, axis=1, keepdims=True) < _FASTEST
            same = elapsed <= 0.0  # the same measurement once more
            self._velocities[rows] = np.where(
                same, self._velocities[rows], np.where(moving, velocities, 0.0))
        self._centers[rows], self._rotations[rows] = centers[good], turns[good]
        self._semi_axes[rows] = semi_axes[good]
        self._stamps[rows], self._heard[rows] = stamps, now
        lifetimes = markers.lifetimes[places]
        self._expiry[rows] = np.where(lifetimes > 0.0, now + lifetimes, np.inf)
        return problems

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
        keys = [key for key, kept in zip(self._index, keep.tolist()) if kept]
        self._index = {key: i for i, key in enumerate(keys)}
        self._names = tuple(_key_name(*key) for key in keys)
        for field in ('_centers', '_rotations', '_semi_axes', '_velocities', '_stamps', '_heard',
                      '_expiry'):
            setattr(self, field, getattr(self, field)[keep])

    def _rebuild(self) -> None:
        """Make a new scene, unless it would be the same as before."""
        static, before = self._static_scene, self.scene
        names = static.names + self._names
        arrays = [np.concatenate(parts) for parts in (
            (static.centers, self._centers), (static.rotations, self._rotations),
            (static.semi_axes, self._semi_axes), (static.velocities, self._velocities))]
        if names == before.names and all(map(np.array_equal, arrays, (
                before.centers, before.rotations, before.semi_axes, before.velocities))):
            return
        for array in arrays:
            array.setflags(write=False)
        self.scene = Scene(names, *arrays)


def _key_name(namespace: str, number: int) -> str:
    return f'{namespace}/{number}' if namespace else str(number)


def _name(markers: Markers, place: int) -> str:
    """Return a marker's identity as people read it: its namespace and number."""
    return _key_name(markers.namespaces[place], int(markers.ids[place]))
