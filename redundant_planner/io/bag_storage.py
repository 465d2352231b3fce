"""What every kind of file offers that a bag may consist of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from typing import Protocol

from redundant_planner.core.errors import PlannerError

# A message: its channel, when it was recorded [ns], and its bytes.
Message = tuple[int, int, bytes]

# ROS counts the seconds of a stamp in 32 bits: no message is recorded later [ns].
LATEST = 2**31 * 10**9


class RecordingError(PlannerError):
    """A bag cannot be read, or lacks what was asked of it."""


class BagFile(Protocol):
    """A file with messages.

    Attributes:
        topics: channel → topic and type.
        counts: channel → messages.
        begin_ns, end_ns: of the first and the last message; begin_ns > end_ns without any.
        problems: what was left out.
    """

    topics: dict[int, tuple[str, str]]
    counts: Counter[int]
    begin_ns: int
    end_ns: int
    problems: list[str]

    def messages(self, chosen: Collection[int], first: int, last: int) -> Iterator[Message]:
        """Yield the messages of some channels with first ≤ time < last [ns], in order of time."""
