"""Tracks obstacles by the names that markers give them, beside those of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import compress, count, islice, repeat
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ObstacleError, StateError
from redundant_planner.core.obstacles import motion_estimate
from redundant_planner.core.obstacles.motion_estimate import Sightings, unseen
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import rotations, Scene
from redundant_planner.io.marker_reader import (
    ADD,
    DELETE,
    DELETEALL,
    Listing,
    MarkerReader,
    Markers,
    SPHERE,
)
from redundant_planner.io.marker_shapes import lists_many, shaped, single, sizes, things_of
from redundant_planner.io.obstacle_bounds import (
    BAD_TWIST,
    checked,
    faults,
    GOOD,
    problem_of,
    problem_of_list,
)
from redundant_planner.io.obstacle_lists import ObstacleLists
from redundant_planner.io.plausible import FASTEST

Array = npt.NDArray[np.float64]
# A frame's origin (3,) and axes (3, 3) in the base frame.
Transform = tuple[Array, Array]

# Obstacles from markers that are kept at any time.
MOST_OBSTACLES = 20_000
# Frames besides the base's that the markers of one message may use.
MOST_FRAMES = 20

_NO_TWISTS: Array = np.empty((0, 6))
# Problems of one message that are spelt out.
_SPELT_OUT = 3


class _KnownListing(NamedTuple):
    """The rows of a message in which each marker had one.

    They hold for later messages with the same listing, until an obstacle comes or goes.

    Attributes:
        listing: of the message.
        first: the first marker after the last DELETEALL.
        rows: (k,) of the markers from there on, all of them ADD.
        types: (k,) theirs, none of which lists many obstacles.
    """

    listing: Listing
    first: int
    rows: npt.NDArray[np.intp]
    types: npt.NDArray[np.intp]


class ObstacleTracker:
    """Static obstacles and markers with their lifetimes, as one scene.

    Attributes:
        scene: stays the same object while nothing changes.
        refused: whether nothing of the latest message could be used.
    """

    def __init__(
        self, static: Iterable[Obstacle], frames: Sequence[str], *,
        transform: Callable[[str], Transform] | None = None, estimate_velocity: bool = False,
    ) -> None:
        """Begin with the static obstacles.

        Args:
            static: obstacles that no marker removes.
            frames: names of the base frame in markers.
            transform: returns where another frame is, or raises ObstacleError with the reason;
                None refuses other frames.
            estimate_velocity: whether velocities come from successive positions.

        Raises:
            ObstacleError: as `checked`.
        """
        self._frames = tuple(frames)
        self._transform = transform
        self.estimate_velocity = estimate_velocity
        # A marker's namespace and id → its row in the tracks; in the order of the rows.
        self._index: dict[tuple[str, int], int] = {}
        self._names: tuple[str, ...] = ()
        self._tracks = unseen(0)
        self._lists = ObstacleLists()
        self._reader = MarkerReader()
        self._known: _KnownListing | None = None
        self._changed = False
        self.refused = False
        self._next_change = np.inf
        self._hidden: frozenset[str] = frozenset()
        self._static = checked(static)
        self.scene = self._static_scene = Scene.of(self._static)

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

    @property
    def hidden(self) -> frozenset[str]:
        """Names of obstacles from markers that are none for the time being."""
        return self._hidden

    @hidden.setter
    def hidden(self, names: frozenset[str]) -> None:
        if names != self._hidden:
            self._hidden = names
            self._changed = True
            self._rebuild()

    def update(self, raw: bytes, now: float) -> list[str]:
        """Apply a serialised MarkerArray at time `now` [s].

        A bad marker changes nothing: the obstacle of that name stays as it was.

        Returns:
            A sentence per problem.
        """
        try:
            markers = self._reader.read(raw)
        except StateError as error:
            self.refused = True
            return [f'obstacles: {error}']
        known_one = self._known
        if known_one is None or markers.twists is not None or (
                markers.listing is not known_one.listing) or faults(
                markers.positions, markers.quaternions, markers.scales, markers.lifetimes,
                known_one.first).any():
            problems = self._apply(markers, now)
        else:
            self._move_known(known_one, markers, now)
            self.refused, problems = False, []
        self._rebuild()
        return problems

    def expire(self, now: float) -> None:
        """Remove the obstacles whose lifetime has ended by `now`, and stop silent ones [s]."""
        if now < self._next_change:
            return
        self._keep(self._tracks.expiry > now)
        self._changed = self._lists.expire(now) or self._changed
        self._changed = motion_estimate.stop_silent(self._tracks, now) or self._changed
        self._rebuild()
        self._next_change = min(
            motion_estimate.next_change(self._tracks), self._lists.next_change)

    def _move_known(self, same: _KnownListing, markers: Markers, now: float) -> None:
        """Apply a message with the same obstacles as before, somewhere else."""
        if same.first:
            motion_estimate.forget(self._tracks)
            self._changed = True
        part = slice(same.first, None)
        self._take_in(Sightings(
            same.rows, np.zeros(len(same.rows), np.intp),
            np.ascontiguousarray(markers.positions[part]), rotations(markers.quaternions[part]),
            *shaped(same.types, markers.scales[part]), markers.stamps[part],
            markers.lifetimes[part], _NO_TWISTS), now)

    def _apply(self, markers: Markers, now: float) -> list[str]:
        """Apply markers that may do anything to any obstacle; return a sentence per problem."""
        listing = markers.listing
        actions, types = listing.actions, listing.types
        centers, axes = markers.positions.copy(), rotations(markers.quaternions)
        twists = markers.twists
        no_twist = None if twists is None else (np.abs(twists) > FASTEST).any(axis=1)
        reasons = self._into_base(listing, centers, axes, twists)
        full = sizes(types, markers.scales)
        found = faults(centers, markers.quaternions, full, markers.lifetimes, 0)
        if no_twist is not None:
            found[no_twist] = BAD_TWIST
        good = (actions == ADD) & (single(types) | lists_many(types)) & (found == GOOD)
        if reasons:
            good &= np.array([frame not in reasons for frame in listing.frames])
        bad = np.flatnonzero(~good & (actions != DELETE) & (actions != DELETEALL))
        problems = [problem_of(markers, place, found[place], reasons)
                    for place in bad[:_SPELT_OUT].tolist()]
        if len(bad) > _SPELT_OUT:
            problems.append(f'{len(bad) - _SPELT_OUT} more obstacles like that')

        # Markers before the last DELETEALL leave no trace.
        first = int(np.flatnonzero(actions == DELETEALL).max(initial=-1)) + 1
        if first:
            self._keep(np.zeros(len(self._index), dtype=bool))
            self._changed = self._lists.clear() or self._changed
        adds = good & single(types)
        acting = adds | (actions == DELETE)
        acting[:first] = False
        places = np.flatnonzero(acting)
        rows, lost = self._rows_of(listing, places, adds[places])
        if lost:
            problems.append(f'{lost} obstacles are too many: up to {MOST_OBSTACLES} are kept')
        places, rows = places[rows >= 0], rows[rows >= 0]
        taken = int(adds[places].sum())
        self._take_in(Sightings(
            rows, (actions[places] == DELETE).astype(np.intp), centers[places], axes[places],
            # A marker that deletes may be of any type.
            *shaped(np.where(adds, types, SPHERE)[places], full[places]), markers.stamps[places],
            markers.lifetimes[places], _NO_TWISTS if twists is None else twists[places]), now)
        lists = good & lists_many(types)
        lists[:first] = False
        if lists.any() or self._lists.count:
            more, lists_taken = self._take_lists(markers, lists | acting, centers, axes, now)
            taken += lists_taken
            problems += more
        self.refused = bool(problems) and not taken
        kept = self._tracks.expiry > -np.inf
        self._keep(kept)
        # What stands before a DELETEALL may be wrong next time, and that has to be said.
        if first <= 1 and kept.all() and adds[first:].all() and (
                len(rows) == len(actions) - first) and all(
                frame in self._frames for frame in set(listing.frames)):
            self._known = _KnownListing(listing, first, rows, types[places])
        return problems

    def _take_lists(
        self, markers: Markers, acting: npt.NDArray[np.bool_], centers: Array, axes: Array,
        now: float,
    ) -> tuple[list[str], int]:
        """Take markers that list many obstacles, and drop lists whose names stand for others now.

        Args:
            markers: of the message.
            acting: (k,) which of them are good.
            centers, axes: (k, 3), (k, 3, 3) their poses in the base frame.
            now: [s].

        Returns:
            A sentence per problem, and how many lists were taken.
        """
        listing, problems, taken = markers.listing, [], 0
        last = {(listing.namespaces[i], int(listing.ids[i])): i
                for i in np.flatnonzero(acting).tolist()}
        for key, place in last.items():
            if listing.actions[place] == DELETE or not lists_many(listing.types[place]):
                self._changed = self._lists.remove(key) or self._changed
                continue
            room = MOST_OBSTACLES - len(self._index) - self._lists.count_without(key)
            problem = problem_of_list(markers, place, centers[place], axes[place], room)
            if problem:
                problems.append(problem)
                continue
            life = float(markers.lifetimes[place])
            twist = None if markers.twists is None else markers.twists[place]
            self._lists.put(key, things_of(markers, place, centers[place], axes[place]),
                            now + life if life > 0.0 else np.inf,
                            None if twist is None or np.isnan(twist[0]) else twist,
                            centers[place], now)
            taken += 1
            if key in self._index:
                self._tracks.expiry[self._index[key]] = -np.inf
            self._changed = True
        self._next_change = min(self._next_change, self._lists.next_change)
        return problems, taken

    def _take_in(self, sightings: Sightings, now: float) -> None:
        """Write sightings into the tracks."""
        changed, soonest = motion_estimate.take_in(
            self._tracks, sightings, now, self.estimate_velocity)
        self._changed = self._changed or changed
        self._next_change = min(self._next_change, soonest)

    def _into_base(
        self, listing: Listing, centers: Array, axes: Array, twists: Array | None,
    ) -> dict[str, str]:
        """Turn centres (k, 3), axes (k, 3, 3) and twists (k, 6) into the base frame, in place.

        Returns:
            Frame → why its markers cannot be used.
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
                origin, frame_axes = self._transform(frame)
            except ObstacleError as error:
                reasons[frame] = str(error)
                continue
            chosen = numbers == number[frame]
            with np.errstate(invalid='ignore', over='ignore'):  # `faults` looks at the result
                centers[chosen] = centers[chosen] @ frame_axes.T + origin
                axes[chosen] = frame_axes @ axes[chosen]
                if twists is not None:
                    for part in (slice(0, 3), slice(3, 6)):
                        twists[chosen, part] = twists[chosen, part] @ frame_axes.T
        return reasons

    def _rows_of(
        self, listing: Listing, places: npt.NDArray[np.intp], adds: npt.NDArray[np.bool_],
    ) -> tuple[npt.NDArray[np.intp], int]:
        """Return the rows of some markers' obstacles, making room for new ones.

        Args:
            listing: of the message.
            places: (k,) the markers.
            adds: (k,) whether a marker adds an obstacle that has no row yet.

        Returns:
            (k,) rows, −1 for no obstacle, and the number of obstacles without room.
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
        """Append tracks for obstacles that the index has already."""
        self._changed, self._known = True, None
        self._names += tuple([f'{name}/{number}' if name else str(number)
                              for name, number in islice(self._index, len(self._names), None)])
        self._tracks = motion_estimate.appended(self._tracks, more)

    def _keep(self, keep: npt.NDArray[np.bool_]) -> None:
        """Drop the obstacles that are not marked (k,)."""
        if keep.all():
            return
        self._changed, self._known = True, None
        marks = keep.tolist()
        self._index = dict(zip(compress(self._index, marks), count()))
        self._names = tuple(compress(self._names, marks))
        self._tracks = motion_estimate.kept(self._tracks, keep)

    def _rebuild(self) -> None:
        """Make a new scene, if anything has changed since the last one."""
        if not self._changed:
            return
        self._changed = False
        static, tracks, shown = self._static_scene, self._tracks, self._names
        if self._hidden:
            keep = np.array([name not in self._hidden for name in shown], dtype=bool)
            tracks, shown = motion_estimate.kept(tracks, keep), tuple(compress(shown, keep))
        names = static.names + shown
        parts = [
            (static.shapes, static.centers, static.rotations, static.half_extents,
             static.velocities, static.angular_velocities),
            (tracks.shapes, tracks.centers, tracks.rotations, tracks.half_extents,
             tracks.velocities, tracks.angular_velocities)]
        for name, things, velocities, angular in self._lists:
            if name in self._hidden:
                continue
            names += (name,) * len(things.shapes)
            parts.append((*things, velocities, angular))
        arrays = [np.concatenate(part) for part in zip(*parts)]
        for array in arrays:
            array.setflags(write=False)
        self.scene = Scene(names, *arrays)
