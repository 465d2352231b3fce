"""Messages on topics of obstacles and `attached`: they wait until a tick's command is out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
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
                for problem in self.tracker.update(raw, now, topic):
                    self._warn(f'{"" if name == "obstacles" else name + " "}{problem}; ignored')
            except Exception as error:
                self._guard.caught(f"a message on '{name}'", error)
            if time.perf_counter() > enough:
                break
        return True
