"""What an attack found: the counts, and the first account of every kind of finding."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
import contextlib
from dataclasses import dataclass, field
import signal
import traceback
from types import FrameType
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import PlannerError

Result = TypeVar('Result')

# An input that takes more processor time than this stalls its user [s].
PATIENCE = 20.0

FINDINGS = ('deaths', 'unforeseen_exceptions', 'limit_violations', 'non_finite')
COUNTS = ('inputs', 'refusals', *FINDINGS)


class StalledError(Exception):
    """An input was not done with within `PATIENCE`."""


@dataclass
class Tally:
    """Counts of attacks.

    Attributes:
        attack: which one is under way, for `--at`.
        inputs: tried.
        refusals: answered with a PlannerError, or with a sentence about what was wrong.
        deaths: processes that an attack ended, by a signal, an exit or by hanging.
        unforeseen_exceptions: answered with any other exception, or not in time.
        limit_violations: outputs beyond a limit of position, velocity, acceleration or jerk.
        non_finite: outputs that are not finite.
        kinds: exception class → how often.
        first: a kind of finding, and its place → an account of the first of them.
    """

    attack: int = 0
    inputs: int = 0
    refusals: int = 0
    deaths: int = 0
    unforeseen_exceptions: int = 0
    limit_violations: int = 0
    non_finite: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def attempt(self, action: Callable[[], Result]) -> Result | None:
        """Try one input: return what the action returns, None where it was refused or failed."""
        self.inputs += 1
        try:
            with _in_time():
                return action()
        except PlannerError as error:
            self.refusals += 1
            self.kinds[type(error).__name__] += 1
        except Exception as error:  # what this benchmark looks for
            self.unforeseen_exceptions += 1
            self.kinds[type(error).__name__] += 1
            place = traceback.extract_tb(error.__traceback__)[-1]
            self._tell(f'{type(error).__name__} at {place.filename}:{place.lineno}',
                       traceback.format_exc())
        return None

    def check_finite(self, *arrays: npt.ArrayLike) -> bool:
        """Count an output that is not finite; return whether all of it is."""
        finite = all(bool(np.isfinite(np.asarray(array, dtype=float)).all()) for array in arrays)
        self.non_finite += not finite
        if not finite:
            self._tell('an output is not finite', ''.join(traceback.format_stack(limit=3)))
        return finite

    def exceeded(self, limit: str, how: str) -> None:
        """Count an output beyond a limit: of which kind, and a sentence about it."""
        self.limit_violations += 1
        self._tell(f'{limit} beyond its limit', how)

    def died(self, how: str, last_words: str) -> None:
        """Count a death: by which signal or exit status, and what the process wrote at last."""
        self.deaths += 1
        self._tell(f'death by {how}', last_words)

    def _tell(self, what: str, account: str) -> None:
        self.first.setdefault(what, f'attack {self.attack}\n{account}')

    def add(self, other: Tally) -> None:
        """Add what another tally counts."""
        for name in COUNTS:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.kinds += other.kinds
        self.first = {**other.first, **self.first}

    @property
    def clean(self) -> bool:
        """Whether nothing was found."""
        return not any(getattr(self, name) for name in FINDINGS)


@contextlib.contextmanager
def _in_time() -> Iterator[None]:
    def stall(number: int, frame: FrameType | None) -> None:
        raise StalledError(f'no answer within {PATIENCE:g} s')

    before = signal.signal(signal.SIGPROF, stall)
    signal.setitimer(signal.ITIMER_PROF, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
