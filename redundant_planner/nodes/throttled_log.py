"""Log entries that a stream of bad messages would repeat: once in a while at most."""

from __future__ import annotations

from collections.abc import Callable
import time

# The same entry appears this often at most, if nothing else is said [s].
_PERIOD = 1.0
# Kinds of entries that are remembered.
_MOST_KINDS = 100


class ThrottledLog:
    """Passes sentences on, each kind once in a period; what is before the colon is the kind."""

    def __init__(
        self, log: Callable[[str], object], period: float = _PERIOD,
        most_kinds: int = _MOST_KINDS,
    ) -> None:
        """Pass sentences on to `log`.

        Args:
            log: takes them.
            period: how long a kind that was just said is not said again [s].
            most_kinds: that are remembered.
        """
        self._log = log
        self._period, self._most_kinds = period, most_kinds
        self._said_at: dict[str, float] = {}

    def __call__(self, sentence: str) -> None:
        """Pass a sentence on, unless one of its kind was just said."""
        kind, now = sentence.partition(':')[0], time.monotonic()
        if kind not in self._said_at or now - self._said_at[kind] > self._period:
            if len(self._said_at) > self._most_kinds:
                self._said_at.clear()
            self._said_at[kind] = now
            self._log(sentence)
