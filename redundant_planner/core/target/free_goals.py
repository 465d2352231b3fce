"""The goals of a search: postures that are free, as they are found."""

from __future__ import annotations

from collections.abc import Generator, Iterable
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.se3 import Poses, stacked
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.core.target.free_space import FreeSpace, Place, stacked_places
from redundant_planner.core.target.goal import Goal
from redundant_planner.core.target.goal_postures import goal_postures, only_posture, posture_at

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Room that a goal has at least [m].
_ROOM = 1e-4
# Guesses at goal postures in one look; how many postures are enough, after how many guesses at
# least, as others lead to other families; and how many may come of one, along its null space.
_GUESSES, _ENOUGH, _FEWEST_GUESSES, _OF_FAMILY = 60, 12, 12, 3
# Guesses that lead this near to a posture lead to it [rad, m].
_SAME = 1e-3
# Guesses without any posture after which a pose counts as out of reach.
_GUESSES_OUT_OF_REACH = 300
# What it costs to see which postures are free, and to choose some of a family [ns].
_COST_OF_JUDGING, _COST_OF_SORTING = 40_000, 50_000


class FreeGoals:
    """Goal postures that are free, as they are found.

    Attributes:
        places: those that are known.
        postures: (g, n) of them [rad, m].
        away: (g,) how far each is from the start [rad, joint weights included].
        price: (g,) what it costs to end there, see `FreeSpace.price_of_end`.
        out_of_reach: whether no posture with the tip at the pose is known after many guesses.
    """

    def __init__(
        self, space: FreeSpace, start: Array, target: Goal | Poses, random: np.random.Generator,
    ) -> None:
        """Prepare.

        Args:
            space: where the arm may be.
            start: (n,) where ways to them begin.
            target: a posture, or poses that the tips shall have.
            random: the numbers.
        """
        self._space, self._start = space, start
        self._poses: Poses | None = None
        if isinstance(target, np.ndarray):
            self._found, self._at_once = only_posture(space, start, target), 1
        else:
            self._poses = stacked(target)
            self._found = goal_postures(space, start, self._poses, random)
            self._at_once = _GUESSES
        self._guesses, self._reached, self.out_of_reach = 0, False, False
        self._tightest: Array | None = None  # room (k,) of the posture that is most nearly free
        self.places: list[Place] = []
        self._measure()

    def look(self) -> Generator[None, None, None]:
        """Look for more of them, unless there are enough; it pauses after each piece of work."""
        until, family = self._guesses + self._at_once, list[Place]()
        while self._guesses < until and (
                len(self.places) < _ENOUGH or self._guesses < _FEWEST_GUESSES):
            found = next(self._found)
            yield
            if found:
                family += self._free(found)
                self._reached = True
            elif found is None:
                self._guesses += 1
                self._add(family)
                family = []
        self.out_of_reach = not self._reached and self._guesses >= _GUESSES_OUT_OF_REACH

    def look_near(self, guesses: Iterable[Array]) -> Generator[None, None, None]:
        """Look for those that guesses (n,) lead to; it pauses likewise."""
        if self._poses is None:
            yield from self.look()
            return
        for guess in guesses:
            found = posture_at(self._space, guess, self._poses)
            if found is not None:
                found = nearest_turn(found, self._start, self._space.joints.position_max)
                if not (np.abs(self.postures - found) < _SAME).all(axis=1).any():
                    self._add(self._free([self._space.place(found)]))
            yield

    def begin_at(self, start: Array) -> None:
        """Take another posture (n,) for the one where ways begin."""
        self._start = start
        self._measure()

    @property
    def lacks(self) -> str:
        """What keeps postures from being goals, as far as it is known; empty where there are."""
        if self.out_of_reach:
            return 'no posture has the tip at the target'
        if self.places:
            return ''
        return 'at the target ' + ('the arm would touch something' if self._tightest is None
                                   else self._space.too_near(self._tightest))

    def _free(self, found: list[Place]) -> list[Place]:
        """Return the places that are free; note the one that is most nearly so."""
        self._space.spend(_COST_OF_JUDGING)
        least = stacked_places(found)[1].min(axis=1)
        free: Flags = np.greater_equal(least, _ROOM)
        best = int(np.where(free, -np.inf, least).argmax())
        if not free[best] and (self._tightest is None or least[best] > self._tightest.min()):
            self._tightest = found[best].room
        return [place for place, is_free in zip(found, free) if is_free]

    def _add(self, family: list[Place]) -> None:
        """Add some of those that one guess led to: the nearest, and a few others."""
        if family:
            self._space.spend(_COST_OF_SORTING)
            away = self._space.distance(self._start, stacked_places(family)[0])
            order = np.argsort(away, kind='stable')[::math.ceil(len(family) / _OF_FAMILY)]
            self.places += [family[i] for i in order]
            self._measure()

    def _measure(self) -> None:
        """Note how far they are, and what they cost."""
        self.postures = np.array([place.q for place in self.places]).reshape(-1, len(self._start))
        self.away = self._space.distance(self._start, self.postures)
        self.price = self._space.price_of_end(self.postures)
