"""Ways that the arm has gone: there again, and back, it need not search."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.target.joint_curve import lengths_along

Array = npt.NDArray[np.float64]

# So many are remembered, the latest; ends of ways that are so near each other are one [rad, m].
_MOST, _SAME = 8, 0.05
# What leads onto a way and off it again may be this share of what it leads along.
_ASIDE = 0.1
# What it costs to compare a way with goals [ns].
COST_OF_WAY = 60_000


class Part(NamedTuple):
    """A part of a way that leads from a posture to a goal, about.

    Attributes:
        postures: (k, n) from its start to its end [rad, m].
        goal: which one it leads to.
        length: with the motions to it and from it, joint weights included [rad].
    """

    postures: Array
    goal: int
    length: float


class PastWays:
    """The latest ways of one arm."""

    def __init__(self) -> None:
        """Begin without any."""
        self._ways: list[Array] = []

    def note(self, postures: Array) -> None:
        """Remember a way (k, n), from its start to its end, unless that is where it began."""
        ends = postures[[0, -1]]
        if np.abs(ends[1] - ends[0]).max() <= _SAME:
            return
        others = [way for way in self._ways
                  if min(np.abs(way[[0, -1]] - ends).max(), np.abs(way[[-1, 0]] - ends).max())
                  > _SAME]
        self._ways = [postures, *others][:_MOST]

    @property
    def ends(self) -> list[Array]:
        """Where ways began and ended, (n,) each, the latest first."""
        return [end for way in self._ways for end in (way[-1], way[0])]

    def parts(self, start: Array, goals: Array, scaling: Array) -> Iterator[Part | None]:
        """Yield for each way the shortest part that leads from a posture to any of some others.

        Args:
            start: (n,) where it begins.
            goals: (g, n) where it may end.
            scaling: (n,) of the joints' lengths, see `PathJoints`.

        Yields:
            None where none leads there.
        """
        for way in self._ways:
            along = lengths_along(way, scaling)
            to_way = np.linalg.norm((way - start) / scaling, axis=1)
            first = int(to_way.argmin())
            if to_way[first] > _ASIDE * along[-1] or not len(goals):
                yield None
                continue
            off_way = np.linalg.norm((way[:, None] - goals) / scaling, axis=2)
            last, every = off_way.argmin(axis=0), np.arange(len(goals))
            led = np.abs(along[last] - along[first])
            aside = to_way[first] + off_way[last, every]
            lengths = np.where(aside <= _ASIDE * led, led + aside, np.inf)
            goal = int(lengths.argmin())
            if not np.isfinite(lengths[goal]):
                yield None
                continue
            step = 1 if last[goal] > first else -1
            yield Part(way[np.arange(first, last[goal] + step, step)], goal,
                       float(lengths[goal]))
