"""Which links touched which obstacles, or each other."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

# Two that touch again this soon have bounced: that is still one contact [s].
_BOUNCE = 0.1


class Contact(NamedTuple):
    """All that happened between a link and an obstacle, or another link.

    Attributes:
        link: its capsule's name.
        other: name of the obstacle, or of the other capsule.
        times: how often they began to touch.
        deepest: the deepest that they overlapped [m].
        first, last: when they first and last touched [s].
        touching: whether they touch now.
    """

    link: str
    other: str
    times: int
    deepest: float
    first: float
    last: float
    touching: bool


class ContactLog:
    """Counts contacts by the names of those that touch.

    Attributes:
        contacts: in the order in which they first touched.
    """

    def __init__(self) -> None:
        """Begin without any."""
        self._found: dict[tuple[str, str], Contact] = {}
        self._touching: set[tuple[str, str]] = set()

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """In the order in which they first touched."""
        return tuple(self._found.values())

    @property
    def count(self) -> int:
        """How often any two began to touch."""
        return sum(contact.times for contact in self._found.values())

    def note(self, touches: Iterable[tuple[str, str, float]], time: float) -> None:
        """Note what touches in a step.

        Args:
            touches: names of link and other, and how deep they overlap [m].
            time: of the step [s].
        """
        now = set()
        for link, other, depth in touches:
            key = link, other
            now.add(key)
            before = self._found.get(key, Contact(link, other, 1, 0.0, time, time, False))
            again = key not in self._touching and time - before.last > _BOUNCE
            self._found[key] = before._replace(
                times=before.times + again, deepest=max(before.deepest, depth), last=time,
                touching=True)
        for key in self._touching - now:
            self._found[key] = self._found[key]._replace(touching=False)
        self._touching = now
