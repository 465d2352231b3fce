"""When commands go out: at even moments, although ticks begin and end when they can."""

from __future__ import annotations

from pathlib import Path
import time

# A tick begins this share of the period before its command is due, and not longer before [s]: time
# enough to plan a joint path around something, too.
_SHARE = 0.35
_LONGEST = 1e-3
# The last bit of a wait is not slept: the system wakes nobody up to the microsecond [s].
_AWAKE = 20e-6
# What the beat falls back by per period, so that it is found again after it was put too early.
_CREEP = 1e-4
_TIMER_SLACK = Path('/proc/self/timerslack_ns')


class CommandPacer:
    """Moments one period apart, as early as the ticks allow.

    What delays a tick now and then (another callback, a QP to solve) would shift its command, and
    so lengthen one period and shorten the next. Therefore a tick begins a little before its
    command is due, and a command that is ready waits.

    Attributes:
        waited: how long the command of the last tick has waited [s].
    """

    def __init__(self, period: float) -> None:
        """Begin with the first tick.

        Args:
            period: between commands [s].
        """
        self.waited = 0.0
        self._period = period
        self._lead = min(_SHARE * period, _LONGEST)
        self._due = float('inf')

    def begin(self, now: float) -> float:
        """Return when the command of a tick that begins now is due [s].

        No timer is early, so the earliest ticks tell where the beat is; one that begins late
        leaves it alone, and its command may be overdue already.
        """
        self.waited = 0.0
        latest = now + self._lead
        if self._due < latest:
            periods = max(int((latest - self._due) / self._period + _CREEP), 1)
            self._due += (1.0 + _CREEP) * periods * self._period
        self._due = min(self._due, latest)
        return self._due

    def is_due(self, now: float) -> bool:
        """Return whether the next tick may begin [s]; not before the first has."""
        return now + self._lead >= self._due + self._period

    def wait(self) -> None:
        """Wait until the command is due, if it is not yet and a tick has ever begun."""
        begin = time.monotonic()
        early = self._due - begin
        if not 0.0 < early <= self._lead:
            return
        if early > _AWAKE:
            time.sleep(early - _AWAKE)
        while time.monotonic() < self._due:
            pass
        self.waited = early


def wake_up_in_time() -> None:
    """Have Linux wake the main thread when it asked for it, not up to 50 µs later, if it may."""
    try:
        _TIMER_SLACK.write_text('1')
    except OSError:
        return
