"""Log entries that a stream of bad messages would repeat, once a second at most."""

from __future__ import annotations

from collections.abc import Callable
import time

import numpy as np

# The same entry appears this often at most [s].
_PERIOD = 1.0
# Kinds of entries that are remembered.
_MOST_KINDS = 100


class ThrottledLog:
    """Passes sentences on, each kind once a second; the words before the colon are the kind."""

    def __init__(self, log: Callable[[str], object]) -> None:
        """Pass sentences on to `log`."""
        self._log = log
        self._said_at: dict[str, float] = {}

    def __call__(self, sentence: str) -> None:
        """Pass a sentence on, unless one of its kind was just said."""
        kind, now = sentence.partition(':')[0], time.monotonic()
        if now - self._said_at.get(kind, -np.inf) > _PERIOD:
            if len(self._said_at) > _MOST_KINDS:
                self._said_at.clear()
            self._said_at[kind] = now
            self._log(sentence)
