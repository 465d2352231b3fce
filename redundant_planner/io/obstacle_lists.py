"""Obstacles that one marker lists by the thousand: they come, move and go together."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.motion_estimate import STATIC_AFTER
from redundant_planner.io.marker_shapes import Things

Array = npt.NDArray[np.float64]

# A marker's namespace and id.
Key = tuple[str, int]


class _Listed(NamedTuple):
    """What one marker listed.

    Attributes:
        name: of all its obstacles.
        things: they themselves.
        velocities, angular_velocities: (k, 3) theirs [m/s, rad/s].
        expiry: when they end [s], ∞ for never.
        silent: when they count as static [s], ∞ if they are.
    """

    name: str
    things: Things
    velocities: Array
    angular_velocities: Array
    expiry: float
    silent: float


class ObstacleLists:
    """The markers that list many obstacles, by their names."""

    def __init__(self) -> None:
        """Begin without any."""
        self._listed: dict[Key, _Listed] = {}

    def __iter__(self) -> Iterator[tuple[str, Things, Array, Array]]:
        """Go through the markers: name, things, velocities and angular velocities of each."""
        return ((one.name, one.things, one.velocities, one.angular_velocities)
                for one in self._listed.values())

    def __contains__(self, key: Key) -> bool:
        """Return whether a marker is among them."""
        return key in self._listed

    @property
    def count(self) -> int:
        """The number of obstacles in all of them."""
        return sum(len(one.things.shapes) for one in self._listed.values())

    def count_without(self, key: Key) -> int:
        """Return how many obstacles all other markers list."""
        listed = self._listed.get(key)
        return self.count - (len(listed.things.shapes) if listed else 0)

    @property
    def next_change(self) -> float:
        """When the next one ends or counts as static [s], ∞ for never."""
        return min((min(one.expiry, one.silent) for one in self._listed.values()),
                   default=float('inf'))

    def put(
        self, key: Key, things: Things, expiry: float, twist: Array | None, origin: Array,
        now: float,
    ) -> None:
        """Take what a marker lists for all that it has.

        Args:
            key: the marker's.
            things: what it lists.
            expiry: when that ends [s].
            twist: (6,) they move like one body: the velocity of its origin and its angular
                velocity [m/s, rad/s]; None if it rests.
            origin: (3,) of the body [m].
            now: [s].
        """
        namespace, number = key
        resting = np.zeros_like(things.centers)
        velocities = angular = resting
        if twist is not None:
            angular = resting + twist[3:]
            velocities = twist[:3] + np.cross(angular, things.centers - origin)
        self._listed[key] = _Listed(
            f'{namespace}/{number}' if namespace else str(number), things, velocities, angular,
            expiry, now + STATIC_AFTER if velocities.any() or angular.any() else np.inf)

    def remove(self, key: Key) -> bool:
        """Drop what a marker listed; return whether there was any."""
        return self._listed.pop(key, None) is not None

    def clear(self) -> bool:
        """Drop all of it; return whether there was any."""
        had = bool(self._listed)
        self._listed.clear()
        return had

    def expire(self, now: float) -> bool:
        """Drop what has ended by now [s], stop what is silent; return whether anything changed."""
        changed = False
        for key, one in list(self._listed.items()):
            if one.expiry <= now:
                del self._listed[key]
                changed = True
            elif one.silent <= now:
                resting = np.zeros_like(one.velocities)
                self._listed[key] = one._replace(
                    velocities=resting, angular_velocities=resting, silent=np.inf)
                changed = True
        return changed
