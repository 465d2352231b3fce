"""Messages on topics of obstacles and `attached`: they wait until a tick's command is out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
import time

import numpy as np

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.recorded_tick import checksum
from redundant_planner.nodes.guard import Guard

# After each tick one message is read, and more while less than this share of the period is used.
_SHARE = 0.1
# Messages that may wait, as many as a subscriber of that depth would keep.
_MOST_WAITING = 100
# For how many ticks messages are put off at most.
_MOST_TIMES = 2
# From when on a topic is useless of which nothing can be used: after this time [s], and after this
# many messages in a row if it was of use before. How often that is said [s].
_USELESS_AFTER, _USELESS_IN_A_ROW = 1.0, 10
_SAID_EVERY = 10.0


@dataclass
class _Refusals:
    """The messages of one topic of which nothing could be used.

    Attributes:
        in_a_row: their number, up to the latest message.
        since: when the first of them was read [s].
        why: what was wrong with the latest one.
        useful: whether anything of an earlier message could be used.
        said_at: when it was said last [s].
    """

    in_a_row: int = 0
    since: float = 0.0
    why: str = ''
    useful: bool = False
    said_at: float = -np.inf


class ObstacleInput:
    """A queue of messages in front of obstacles.

    Attributes:
        tracker: holds the obstacles.
        read_counts: messages so far that were read or dropped, of each topic.
        last_read: checksums of the latest ones, 0 before the first.
        read_at: when the latest message was read [s]; −∞ before the first.
        took: how long the latest ones took, with all that follows from them [s]; the loop says so.
    """

    def __init__(
        self, topics: Sequence[str], tracker: ObstacleSources, period: float, guard: Guard,
        warn: Callable[[str], None],
    ) -> None:
        """Begin with an empty queue.

        Args:
            topics: for what is said of their messages.
            tracker: takes the messages.
            period: of the loop [s].
            guard: counts exceptions.
            warn: takes a sentence about a message.
        """
        self.tracker = tracker
        self._topics = tuple(topics)
        self._refusals = [_Refusals() for _ in topics]
        self.read_counts = [0] * len(topics)
        self.last_read = [0] * len(topics)
        self.read_at = -np.inf
        self.took = 0.0
        self._period, self._budget = period, _SHARE * period
        self._times_put_off = 0
        self._guard = guard
        self._warn = warn
        self._waiting: deque[tuple[int, bytes]] = deque()

    @property
    def scene(self) -> Scene:
        """The obstacles read so far."""
        return self.tracker.scene

    def on_message(self, raw: bytes, topic: int = 0) -> None:
        """Keep a message of a topic until `read`; of too many, drop the oldest of all."""
        if len(self._waiting) == _MOST_WAITING:
            oldest, _ = self._waiting.popleft()
            self.read_counts[oldest] += 1
            self._warn(f'{self._topics[oldest]} come faster than the planner reads them: it '
                       f'dropped the oldest of {_MOST_WAITING} messages')
        self._waiting.append((topic, raw))

    def put_off(self, left: float) -> bool:
        """Return whether messages wait that had better be read after the next tick.

        They would delay it, if they take as long as the last ones did. After a few ticks they wait
        no longer.

        Args:
            left: time until the next tick [s].
        """
        if (not self._waiting or not left < self.took < self._period
                or self._times_put_off == _MOST_TIMES):
            self._times_put_off = 0
            return False
        self._times_put_off += 1
        return True

    def read(self, now: float) -> bool:
        """Read the oldest messages, at least one, as time allows; return whether there were any.

        Args:
            now: of the loop, where lifetimes begin [s].
        """
        if not self._waiting:
            return False
        self.read_at = now
        enough = time.perf_counter() + self._budget
        while self._waiting:
            topic, raw = self._waiting.popleft()
            self.read_counts[topic] += 1
            self.last_read[topic] = checksum(raw)
            name = self._topics[topic]
            try:
                self._note(topic, self.tracker.update(raw, now, topic), now)
            except Exception as error:
                self._guard.caught(f"a message on '{name}'", error)
            if time.perf_counter() > enough:
                break
        return True

    def _note(self, topic: int, problems: Sequence[str], now: float) -> None:
        """Say what was wrong with a message, and remember if nothing of it could be used."""
        name, found = self._topics[topic], self._refusals[topic]
        said = [f'{"" if name == "obstacles" else name + " "}{problem}; ignored'
                for problem in problems]
        if not self.tracker.refused(topic):
            found.in_a_row, found.useful, found.said_at = 0, True, -np.inf
        else:
            found.in_a_row += 1
            found.why = problems[0]
            if found.in_a_row == 1:
                found.since = now
            # A stream of which nothing is of use says the same again and again.
            if found.in_a_row > 1 and now - found.said_at < _SAID_EVERY:
                return
            found.said_at = now
        for sentence in said:
            self._warn(sentence)

    def blind(self, now: float) -> str:
        """Return a sentence about topics of which nothing can be used; empty without such.

        Args:
            now: of the loop [s].
        """
        return '; '.join(
            f'nothing on {name} can be used, and the arm does not keep clear of it: {found.why}'
            for name, found in zip(self._topics, self._refusals)
            if found.in_a_row and now - found.since >= _USELESS_AFTER and (
                not found.useful or found.in_a_row >= _USELESS_IN_A_ROW))
