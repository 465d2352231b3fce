"""What an attack found: the counts, and the first traceback of every unforeseen exception."""

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


class StalledError(Exception):
    """An input was not done with within `PATIENCE`."""


@dataclass
class Tally:
    """Counts of one kind of attack.

    Attributes:
        inputs: tried.
        refusals: answered with a PlannerError, or with a sentence about what was wrong.
        unforeseen_exceptions: answered with any other exception, or not in time.
        limit_violations: outputs beyond a position, velocity or acceleration limit.
        non_finite: outputs that are not finite.
        kinds: exception class → how often.
        first: exception class and place → traceback of the first of them.
        attack: which attack is under way, for `--at`.
    """

    inputs: int = 0
    refusals: int = 0
    unforeseen_exceptions: int = 0
    limit_violations: int = 0
    non_finite: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)
    attack: int = 0

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
            self.first.setdefault(
                f'{type(error).__name__} at {place.filename}:{place.lineno}',
                f'attack {self.attack}\n{traceback.format_exc()}')
        return None

    def check_finite(self, *arrays: npt.ArrayLike) -> bool:
        """Count an output that is not finite; return whether all of it is."""
        finite = all(bool(np.isfinite(np.asarray(array, dtype=float)).all()) for array in arrays)
        self.non_finite += not finite
        return finite

    @property
    def clean(self) -> bool:
        """Whether nothing was found."""
        return not (self.unforeseen_exceptions or self.limit_violations or self.non_finite)


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
