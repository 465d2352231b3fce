"""Looks for a smooth way to a target, a little in each tick, and for a better rest of one."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.target.free_space import FreeSpace
from redundant_planner.core.target.goal import Goal
from redundant_planner.core.target.joint_curve import JointCurve, lengths_along, resampled
from redundant_planner.core.target.past_ways import PastWays
from redundant_planner.core.target.path_search import PathSearch
from redundant_planner.core.target.straight_motion import COST_OF_CALL

Array = npt.NDArray[np.float64]

# What a piece of work costs besides, the least one, and a curve that is looked at [ns].
_COST_OF_PIECE, _LEAST_PIECE, _COST_OF_CURVE = 5000, 3 * COST_OF_CALL, 250_000
# Distances between control points of the curve, in turn until it is free [rad].
_SPACINGS = (0.2, 0.1, 0.05, 0.025)
# Postures of a curve's span that are looked at.
_LOOKS_PER_SPAN = 4
# Share of its room that a way keeps in its corners, and what it may have less than its ends [m].
_CORNERS, _SLACK = 0.5, 1e-4
# The rest of a way is another one if it costs no more than this share of it.
_BETTER = 0.98
# Corners of a polygon that are so close are the same [rad].
_SAME = 1e-6
# A point of the curve depends on so many control points before and after it.
OVERLAP = 2


class CurveSearch:
    """A search for one curve after the other, each better than the last.

    Attributes:
        search: for the way.
        space: in which it looks.
        found: control points (k, n) of a curve; None until there is one.
    """

    def __init__(
        self, space: FreeSpace, start: Array, target: Goal | Poses, scaling: Array, *,
        gives_way: bool, seed: int = 0, past: PastWays | None = None,
    ) -> None:
        """Begin.

        Args:
            space: where the arm may be.
            start: (n,) where the way begins.
            target: where it ends.
            scaling: (n,) see `PathJoints`.
            gives_way, seed, past: see `PathSearch`.
        """
        self.space = space
        self.found: Array | None = None
        self.search = PathSearch(
            space, start, target, gives_way=gives_way, seed=seed, past=past)
        self._scaling, self._any_way = scaling, False
        self._polygon = np.empty((0, len(start)))  # corners of the curve found last
        self._work = self._curves()

    def think(self, work: int, *, any_way: bool = False) -> None:
        """Go on looking for a curve.

        Args:
            work: how much that may be, see `FreeSpace` [ns].
            any_way: whether one that is not good will do.
        """
        self._any_way = any_way
        space = self.space
        until = space.spent + work
        while self.found is None and space.spent < until:
            space.piece = max(until - space.spent, _LEAST_PIECE)
            self.found = next(self._work)
            space.spend(_COST_OF_PIECE)

    def improve(self, before: Array, share: float) -> None:
        """Look for a better rest of the curve found last from now on.

        Args:
            before: (`OVERLAP` + 1, n) control points, of which the last one is the first of the
                rest.
            share: of the curve's polygon that comes before that.
        """
        along = lengths_along(self._polygon, self._scaling)
        rest = self._polygon[along > share * along[-1] + _SAME]
        self.found = None
        self.search.go_on_from(np.vstack((before[-1:], rest)))
        self._work = self._rests(before[:-1], _BETTER * self.search.price)

    def _curves(self) -> Generator[Array | None, None, None]:
        """Yield None while looking for a way, and then the control points (k, n) of a curve."""
        search = self.search
        for _ in search.work():
            yield None
            if search.way is not None and (
                    search.straight or self._any_way or (search.shortened and search.good)):
                break
        assert search.way is not None
        polygon = self._corners
        points = resampled(polygon, self._scaling, _SPACINGS[0])
        if len(polygon) > 2:
            smooth = yield from self._smooth(polygon, polygon[:0])
            points = resampled(
                polygon, self._scaling, _SPACINGS[-1]) if smooth is None else smooth
        self._polygon = polygon
        yield points

    def _rests(self, before: Array, price: float) -> Generator[Array | None, None, None]:
        """Likewise, but a curve that costs less, and goes on from control points (k, n)."""
        search = self.search
        rounds = search.rounds
        for _ in search.work():
            yield None
            if search.rounds > rounds and search.price < price:
                polygon, price, rounds = self._corners, search.price, search.rounds
                points = yield from self._smooth(polygon, before)
                if points is not None:
                    self._polygon = polygon
                    yield points

    @property
    def _corners(self) -> Array:
        """The corners (k, n) of the way."""
        assert self.search.way is not None
        return np.array([place.q for place in self.search.way])

    def _smooth(
        self, polygon: Array, before: Array,
    ) -> Generator[None, None, Array | None]:
        """Return the control points (k, n) of a curve along a polygon, None if none is free.

        Args:
            polygon: its corners, those of the search's way.
            before: control points that come before.
        """
        space, found = self.space, self.search
        assert found.way is not None
        # The curve cuts corners.
        least = np.minimum(_CORNERS * space.asked(found.room), np.minimum(
            found.way[0].room, found.way[-1].room) - _SLACK)
        for spacing in _SPACINGS:
            points = resampled(polygon, self._scaling, spacing)
            curve = JointCurve(np.vstack((before, points)))
            # Where there is something before, the curve's first span is another one.
            at = np.linspace(float(len(before) > 0), curve.spans,
                             _LOOKS_PER_SPAN * curve.spans + 1)
            space.spend(_COST_OF_CURVE)
            yield
            free = True
            for some in space.slices(len(at)):
                free = not (space.rooms(curve.at(at[some])) < least).any()
                yield
                if not free:
                    break
            if free:
                return points
        return None
