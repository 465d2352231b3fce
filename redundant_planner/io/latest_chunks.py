"""The latest chunks of a planner's ticks: a chunk is recorded once, and not in each tick."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Goal, Target, TipGoals, TipTargets
from redundant_planner.io.recorded_target import RecordedTarget


class LatestChunks:
    """The latest chunk of the arm, and that of each tip."""

    def __init__(self) -> None:
        """Begin without one."""
        self._chunk: Chunk | None = None
        self._of_tips: dict[str, Chunk] = {}
        self._targets: dict[str, Pose | Chunk | None] | None = None  # of tips, a tick ago

    def to_record(self, target: Target | TipTargets | None) -> RecordedTarget:
        """Return what to record of a tick's target."""
        assert not isinstance(target, TipGoals), 'tips are recorded by name'
        if isinstance(target, Chunk):
            goes_on, self._chunk = target is self._chunk, target
            return RecordedTarget(None if goes_on else target, goes_on)
        if not isinstance(target, Mapping):
            return RecordedTarget(target)
        go_on = tuple(tip for tip, at in target.items()
                      if isinstance(at, Chunk) and at is self._of_tips.get(tip))
        self._of_tips.update({tip: at for tip, at in target.items() if isinstance(at, Chunk)})
        return RecordedTarget({tip: None if tip in go_on else at for tip, at in target.items()},
                              tips_go_on=go_on)

    def recorded(self, aimed: RecordedTarget) -> Goal | Chunk | TipTargets | None:
        """Return a tick's target of what was recorded.

        Of tips it is the same object as a tick ago while nothing has changed, as in the planner.
        """
        target = self._chunk if aimed.goes_on else aimed.target
        if isinstance(target, Chunk):
            self._chunk = target
        if not isinstance(target, Mapping):
            self._targets = None
            return target
        self._of_tips.update({tip: at for tip, at in target.items() if isinstance(at, Chunk)})
        found = {tip: self._of_tips.get(tip) if tip in aimed.tips_go_on else at
                 for tip, at in target.items()}
        if self._targets is None or aimed.news or not all(
                _same(at, self._targets.get(tip)) for tip, at in found.items()):
            self._targets = found
        return self._targets


def _same(one: Pose | Chunk | None, other: Pose | Chunk | None) -> bool:
    """Return whether two targets of a tip are alike."""
    if isinstance(one, Pose) and isinstance(other, Pose):
        return all(map(np.array_equal, one, other))
    return one is other
