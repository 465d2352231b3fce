"""Messages on `obstacles` and `attached`: they wait until a tick's command is out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import time

import numpy as np

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.nodes.guard import Guard

# After each tick one message is read, and more while less than this share of the period is used.
_SHARE = 0.1
# Messages that may wait, as many as a subscriber of that depth would keep.
_MOST_WAITING = 100


class ObstacleInput:
    """A queue of messages in front of an obstacle tracker.

    Attributes:
        tracker: holds the obstacles.
        read_count: messages so far that were read or dropped.
        read_at: when the latest message was read [s]; −∞ before the first.
    """

    def __init__(
        self, topic: str, tracker: ObstacleTracker, period: float, guard: Guard,
        warn: Callable[[str], None],
    ) -> None:
        """Begin with an empty queue.

        Args:
            topic: for what is said of its messages.
            tracker: takes the messages.
            period: of the loop [s].
            guard: counts exceptions.
            warn: takes a sentence about a message.
        """
        self.tracker = tracker
        self._topic = topic
        self._prefix = '' if topic == 'obstacles' else f'{topic} '
        self.read_count = 0
        self.read_at = -np.inf
        self._budget = _SHARE * period
        self._guard = guard
        self._warn = warn
        self._waiting: deque[bytes] = deque()

    @property
    def scene(self) -> Scene:
        """The obstacles read so far."""
        return self.tracker.scene

    def on_message(self, raw: bytes) -> None:
        """Keep a message until `read`; of too many, drop the oldest."""
        if len(self._waiting) == _MOST_WAITING:
            self._waiting.popleft()
            self.read_count += 1
            self._warn(f'{self._topic} come faster than the planner reads them: it dropped the '
                       f'oldest of {_MOST_WAITING} messages')
        self._waiting.append(raw)

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
            self.read_count += 1
            try:
                for problem in self.tracker.update(self._waiting.popleft(), now):
                    self._warn(f'{self._prefix}{problem}; ignored')
            except Exception as error:
                self._guard.caught(f"a message on '{self._topic}'", error)
            if time.perf_counter() > enough:
                break
        return True
