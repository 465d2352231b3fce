"""Sends commands at even moments, although ticks begin and end at uneven ones."""

from __future__ import annotations

from pathlib import Path
import time

# A tick begins this share of the period before its command is due, but at most this long [s]. On
# a slow machine, and after a sleep, it takes 0.2 ms, and 0.4 ms where it filters or evades.
_SHARE = 0.5
_LONGEST = 7e-4
# The last part of a wait is not slept, as the system wakes a process late: so much that one of 20
# wakings is later, within bounds. By how much that part shrinks each time [s].
_LEAST_AWAKE, _MOST_AWAKE = 20e-6, 150e-6
_LATER_WAKINGS, _SHRINKS = 0.05, 0.5e-6
# The due times fall back by this share per period, so that they recover from being too early.
_CREEP = 1e-4
_TIMER_SLACK = Path('/proc/self/timerslack_ns')


class CommandPacer:
    """Moments one period apart, as early as the ticks allow.

    Another callback or a QP to solve may delay a tick. Its command would come late, one period
    would be longer and the next one shorter. Therefore a tick begins a little before its command
    is due, and a command that is ready waits.

    Attributes:
        waited: how long the command of the last tick has waited [s].
        missed: how many moments have passed without a tick before the latest one.
    """

    def __init__(self, period: float) -> None:
        """Begin with the first tick.

        Args:
            period: between commands [s].
        """
        self.waited, self.missed = 0.0, 0
        self._period = period
        self._lead = min(_SHARE * period, _LONGEST)
        self._due = float('inf')
        self._awake = _LEAST_AWAKE

    def begin(self, now: float) -> float:
        """Return when the command of a tick that begins now is due [s].

        No timer is early, so the earliest ticks tell when commands are due. A late tick changes
        nothing, and its command may be overdue already.
        """
        self.waited, self.missed = 0.0, 0
        latest = now + self._lead
        if self._due < latest:
            periods = max(int((latest - self._due) / self._period + _CREEP), 1)
            self._due += (1.0 + _CREEP) * periods * self._period
            self.missed = periods - 1
        self._due = min(self._due, latest)
        return self._due

    def is_due(self, now: float) -> bool:
        """Return whether the next tick may begin [s]; not before the first has."""
        return now + self._lead >= self._due + self._period

    @property
    def left(self) -> float:
        """Time until the next tick may begin [s]; infinite before the first has."""
        return self._due + self._period - self._lead - time.monotonic()

    @property
    def due(self) -> float:
        """When the command of the latest tick was due [s]; infinite before the first has begun."""
        return self._due

    def move(self, delay: float) -> None:
        """Have commands come later by a delay, less than a period; begin ticks anew right after.

        Args:
            delay: [s].
        """
        begin = self._due + delay - self._lead
        while begin < time.monotonic():
            begin += self._period
        time.sleep(max(begin - time.monotonic(), 0.0))
        self._due = float('inf')

    def wait(self) -> None:
        """Wait until the command is due; not before the first tick has begun."""
        begin = time.monotonic()
        early = self._due - begin
        if not 0.0 < early <= self._lead:
            return
        if early > self._awake:
            time.sleep(early - self._awake)
            is_late = time.monotonic() > self._due
            self._awake += _SHRINKS / _LATER_WAKINGS * is_late - _SHRINKS
            self._awake = min(max(self._awake, _LEAST_AWAKE), _MOST_AWAKE)
        while time.monotonic() < self._due:
            pass
        self.waited = early


def wake_up_in_time() -> None:
    """Have Linux wake the main thread on time, not up to 50 µs later, if it permits that."""
    try:
        _TIMER_SLACK.write_text('1')
    except OSError:
        return
