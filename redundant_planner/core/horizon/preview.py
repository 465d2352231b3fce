"""What will be commanded, as a preview announces it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import shown, StateError

Array = npt.NDArray[np.float64]

# Times from now (N + 1,) [s] → mean twists (N, 6) from each to the next.
TwistAhead = Callable[[Array], Array]


@dataclass(frozen=True, init=False)
class Preview:
    """The twists that will be commanded: linear between the points, zero outside.

    Attributes:
        times: (k,) ascending [s]; two equal ones make a step. Read-only.
        twists: (k, 6) tip twists in the command frame [m/s, rad/s]. Read-only.
    """

    times: Array
    twists: Array

    def __init__(self, times: npt.ArrayLike, twists: npt.ArrayLike) -> None:
        """Check the points.

        Args:
            times: (k,) at least one [s].
            twists: (k, 6) [m/s, rad/s].

        Raises:
            StateError: there are no points, lengths differ, a value is not a finite number or
                times go backwards.
        """
        for field, values in (('times', times), ('twists', twists)):
            try:
                array = np.array(values, dtype=float)
            except (TypeError, ValueError):
                raise StateError(f'the {field} of the preview are {shown(values)}; they must be '
                                 'numbers') from None
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        k = self.times.size
        if not k or self.times.ndim != 1 or self.twists.shape != (k, 6):
            raise StateError(f'the preview has {k} times and twists of shape '
                             f'{self.twists.shape}; it takes one or more points with six '
                             'numbers each')
        if not (np.isfinite(self.times).all() and np.isfinite(self.twists).all()):
            raise StateError('the preview has a number that is not finite')
        if (np.diff(self.times) < 0.0).any():
            at = int((np.diff(self.times) < 0.0).argmax())
            raise StateError(f'the times of the preview go backwards, from {self.times[at]} to '
                             f'{self.times[at + 1]} s')

    def at(self, times: Array) -> Array:
        """Return the twists (N, 6) at times (N,)."""
        after = np.searchsorted(self.times, times, side='right')
        inside = (after > 0) & (after < len(self.times))
        after = np.minimum(np.maximum(after, 1), max(len(self.times) - 1, 0))
        before = np.maximum(after - 1, 0)
        span = np.maximum(self.times[after] - self.times[before], np.finfo(float).tiny)
        share = ((times - self.times[before]) / span)[:, None]
        twists = (1.0 - share) * self.twists[before] + share * self.twists[after]
        return np.where(inside[:, None], twists, 0.0)

    def between(self, times: Array) -> Array:
        """Return the mean twists (N, 6) from each of times (N + 1,) to the next.

        Not those of the middle: where the twist makes a step, what lies ahead would make one
        whenever a middle passes it.
        """
        # Who only announces motions loads no compiler.
        from redundant_planner.core.horizon.mean_twists import mean_twists
        return mean_twists(times, self.times, self.twists, self._integrals)

    def ahead(self, now: float) -> PreviewAhead:
        """Return the preview as seen from a time `now` [s]: what `Planner.step` takes then."""
        return PreviewAhead(self, now)

    @cached_property
    def begin(self) -> float:
        """When the first motion begins; infinite if there is none [s]."""
        moving = np.flatnonzero(self.twists.any(axis=1))
        return float(self.times[max(int(moving[0]) - 1, 0)]) if len(moving) else np.inf

    @cached_property
    def end(self) -> float:
        """When the last motion is over [s]."""
        moving = np.flatnonzero(self.twists.any(axis=1))
        after = min(int(moving[-1]) + 1, len(self.times) - 1) if len(moving) else 0
        return float(self.times[after])

    @cached_property
    def _integrals(self) -> Array:
        """The integrals (k, 6) of the twists up to each point."""
        pieces = 0.5 * (self.twists[:-1] + self.twists[1:]) * np.diff(self.times)[:, None]
        return np.vstack((np.zeros(6), pieces.cumsum(axis=0)))


@dataclass(frozen=True)
class PreviewAhead:
    """A preview as seen from a time `now` [s]."""

    preview: Preview
    now: float

    def __call__(self, times: Array) -> Array:
        """Return the mean twists (N, 6) from each of times (N + 1,) from now to the next."""
        return self.preview.between(self.now + times)

    @property
    def begin(self) -> float:
        """Time until the first motion begins [s]; negative after that."""
        return self.preview.begin - self.now

    @property
    def rest(self) -> float:
        """Time until the last motion is over [s]; negative after it."""
        return self.preview.end - self.now
