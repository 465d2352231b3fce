"""Obstacles that one marker lists by the thousand: they come and go together, and rest."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from redundant_planner.io.marker_shapes import Things

# A marker's namespace and id.
Key = tuple[str, int]


class _Listed(NamedTuple):
    """What one marker listed.

    Attributes:
        name: of all its obstacles.
        things: they themselves.
        expiry: when they end [s], ∞ for never.
    """

    name: str
    things: Things
    expiry: float


class ObstacleLists:
    """The markers that list many obstacles, by their names."""

    def __init__(self) -> None:
        """Begin without any."""
        self._listed: dict[Key, _Listed] = {}

    def __iter__(self) -> Iterator[tuple[str, Things]]:
        """Go through the markers: the name of all that one lists, and they themselves."""
        return ((one.name, one.things) for one in self._listed.values())

    def __contains__(self, key: Key) -> bool:
        """Return whether a marker is among them."""
        return key in self._listed

    @property
    def count(self) -> int:
        """The number of obstacles in all of them."""
        return sum(len(one.things.shapes) for one in self._listed.values())

    @property
    def next_change(self) -> float:
        """When the next one ends [s], ∞ for never."""
        return min((one.expiry for one in self._listed.values()), default=float('inf'))

    def put(self, key: Key, things: Things, expiry: float) -> None:
        """Take what a marker lists for all that it has, until it ends [s]."""
        namespace, number = key
        self._listed[key] = _Listed(
            f'{namespace}/{number}' if namespace else str(number), things, expiry)

    def remove(self, key: Key) -> bool:
        """Drop what a marker listed; return whether there was any."""
        return self._listed.pop(key, None) is not None

    def clear(self) -> bool:
        """Drop all of it; return whether there was any."""
        had = bool(self._listed)
        self._listed.clear()
        return had

    def expire(self, now: float) -> bool:
        """Drop what has ended by now [s]; return whether anything has."""
        ended = [key for key, one in self._listed.items() if one.expiry <= now]
        for key in ended:
            del self._listed[key]
        return bool(ended)
