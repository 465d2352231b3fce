"""Contains unforeseen exceptions: each costs only the work that it came from."""

from __future__ import annotations

from collections.abc import Callable
import time
import traceback
from typing import ParamSpec, TypeVar

Arguments = ParamSpec('Arguments')
Result = TypeVar('Result')

# Exceptions of one place are logged this often at most [s].
_LOG_PERIOD = 1.0


class Guard:
    """Counts the exceptions of a node's parts and logs them.

    Attributes:
        count: exceptions so far.
        last: the latest one's place and line, empty before the first.
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        """Begin with none.

        Args:
            log: takes a text of several lines.
        """
        self.count = 0
        self.last = ''
        self._log = log
        self._said: dict[str, float] = {}

    def caught(self, place: str, error: Exception) -> None:
        """Count an exception, and log it with its traceback, once a second for each place.

        Args:
            place: the work that was under way, for the reader of the log.
            error: the exception.
        """
        self.count += 1
        self.last = f'{place}: {line_of(error)}'
        now = time.monotonic()
        if now - self._said.get(place, -_LOG_PERIOD) >= _LOG_PERIOD:
            self._said[place] = now
            self._log(f'unforeseen fault {self.count} in {place}; the node goes on\n'
                      + ''.join(traceback.format_exception(error)).rstrip())

    def call(
        self, place: str, function: Callable[Arguments, Result], *arguments: Arguments.args,
        **options: Arguments.kwargs,
    ) -> Result | None:
        """Return what a function returns; None if it raises."""
        try:
            return function(*arguments, **options)
        except Exception as error:
            self.caught(place, error)
            return None


def line_of(error: BaseException) -> str:
    """Return an exception's class and message in one line, as at the end of a traceback."""
    return ' '.join(''.join(traceback.format_exception_only(error)).split())
