"""Says how far compiling has come, on the terminal that waits for it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import sys
import time

_PACKAGE = Path(__file__).resolve().parents[2]
_MARK = re.compile(r'^@(?:compiled|kernel|entry)$|= (?:compiled|kernel|entry)\(', re.MULTILINE)
_ERASE = '\x1b[K'
_WIDTH = 30


def functions_to_compile() -> int:
    """Return how many functions of this package are marked, see `core.kernels`."""
    return sum(len(_MARK.findall(path.read_text(encoding='utf-8')))
               for path in _PACKAGE.rglob('*.py'))


def bar(done: int, total: int, seconds: float) -> str:
    """Return a line about how far it is.

    Args:
        done, total: functions.
        seconds: since it began.
    """
    share = min(done / max(total, 1), 1.0)
    left = f', {seconds * (1.0 - share) / share:.0f} s left' if 0.05 < share < 1.0 else ''
    full = round(_WIDTH * share)
    return f'[{"#" * full}{"." * (_WIDTH - full)}] {min(done, total)} of {total}{left}'


class Announcer:
    """Counts functions that are ready, and says how far it is once one had to be compiled."""

    def __init__(self) -> None:
        """Count from none."""
        self._ready, self._total, self._begin = 0, 0, 0.0

    def __call__(self, name: str, *, compiled: bool) -> None:
        """Take a function that is ready.

        Args:
            name: module and function.
            compiled: whether it was compiled for that, not just loaded.
        """
        self._ready += 1
        if compiled and not self._total:
            self._total, self._begin = functions_to_compile(), time.monotonic()
            print('redundant_planner: compiling its mathematics, once per installation; this '
                  'takes a minute or more (`python -m redundant_planner.compile` does it on two '
                  'cores)', file=sys.stderr, flush=True)
        if self._total and sys.stderr.isatty():
            # Whatever is written next takes the line's place.
            print(_ERASE + bar(self._ready, self._total, time.monotonic() - self._begin),
                  end='\r' if self._ready < self._total else '\n', file=sys.stderr, flush=True)


# Told of each function that is ready.
Listener = Callable[..., None]
