"""Decides when simulated time goes on: by a period, once all have answered the last one."""

from __future__ import annotations

import math


class LockStep:
    """Waits in each period for those who have answered before.

    While nobody does, as before a planner has started, time goes on at its real pace: others need
    it to get there.

    Attributes:
        in_step: who will be waited for, as they answered the last period.
        missed: periods in which somebody was waited for in vain.
    """

    def __init__(self, period: float, factor: float, patience: float) -> None:
        """Begin with nobody in step.

        Args:
            period: of simulated time [s].
            factor: how much faster than real time it may be; 0 for no limit.
            patience: how long an answer is waited for, in real time [s].
        """
        self.in_step: set[str] = set()
        self.missed = 0
        self._pause = period / factor if factor > 0.0 else 0.0
        self._pace = period / (factor or 1.0)
        self._patience = patience
        self._answered: set[str] = set()
        self._began = -math.inf

    def answer(self, who: str) -> None:
        """Note that somebody has answered this period."""
        self._answered.add(who)
        self.in_step.add(who)

    def is_due(self, now: float) -> bool:
        """Return whether the next period may begin, in real time [s]."""
        waited = now - self._began
        if not self.in_step:
            return waited >= self._pace
        if self.in_step <= self._answered:
            return waited >= self._pause
        if waited < self._patience:
            return False
        self.in_step &= self._answered
        self.missed += 1
        return True

    def begin(self, now: float) -> None:
        """Note that the next period begins, in real time [s]."""
        self._answered = set()
        pace = self._pause if self.in_step else self._pace
        # Late by less than a period, it catches up.
        late = now - (self._began + pace)
        self._began = now - min(max(late, 0.0), pace) if math.isfinite(late) else now
