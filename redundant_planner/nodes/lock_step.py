"""Decides when simulated time goes on: one period at a time, once the last one was answered."""

from __future__ import annotations


class LockStep:
    """Waits for the command of each period, for as long as somebody commands at all.

    While nobody does, as before a planner has started, time goes on at its real pace: others need
    it to get there.

    Attributes:
        in_step: whether the last period was answered, so that the next one will be waited for.
        missed: periods that were waited for in vain.
    """

    def __init__(self, period: float, factor: float, patience: float) -> None:
        """Begin with nobody in step.

        Args:
            period: of simulated time [s].
            factor: how much faster than real time it may be; 0 for no limit.
            patience: how long an answer is waited for, in real time [s].
        """
        self.in_step = False
        self.missed = 0
        self._pause = period / factor if factor > 0.0 else 0.0
        self._pace = period / (factor or 1.0)
        self._patience = patience
        self._answered = False
        self._began = float('-inf')

    def answer(self) -> None:
        """Note that the command of this period has come."""
        self._answered = self.in_step = True

    def is_due(self, now: float) -> bool:
        """Return whether the next period may begin, in real time [s]."""
        waited = now - self._began
        if not self.in_step:
            return waited >= self._pace
        if self._answered:
            return waited >= self._pause
        if waited < self._patience:
            return False
        self.in_step = False
        self.missed += 1
        return True

    def begin(self, now: float) -> None:
        """Note that the next period begins, in real time [s]."""
        self._answered = False
        pace = self._pause if self.in_step else self._pace
        # Late by less than a period, it catches up.
        self._began = max(self._began + pace, now - pace)
