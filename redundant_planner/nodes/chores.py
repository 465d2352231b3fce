"""Work that can wait: at most one piece of it is done after each tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from redundant_planner.nodes.guard import Guard

# How long a chore waits at most for a tick with nothing else to do [s].
_PATIENCE = 0.02


class Chore(NamedTuple):
    """Something to do again and again.

    Attributes:
        period: how often [s].
        work: does it.
    """

    period: float
    work: Callable[[], None]


class Chores:
    """Gives each chore its turn when it is due."""

    def __init__(self, guard: Guard) -> None:
        """Begin without chores; the guard counts their exceptions."""
        self._guard = guard
        self._chores: list[Chore] = []
        self._due: list[float] = []

    def add(self, period: float, work: Callable[[], None]) -> None:
        """Add a chore that is due at once, then every `period` [s]."""
        self._chores.append(Chore(period, work))
        self._due.append(0.0)

    def do_one(self, now: float, busy: bool = False) -> None:
        """Do the first chore that is due [s].

        Args:
            now: [s]; if the clock was set back, all chores are due.
            busy: whether this tick had other work already: a chore then waits, though not for
                long.
        """
        for i, (period, work) in enumerate(self._chores):
            patience = min(period, _PATIENCE) if busy else 0.0
            if now >= self._due[i] + patience or self._due[i] > now + period:
                self._due[i] = now + period
                self._guard.call('the work after a tick', work)
                return
