"""The way from a posture to another, or to any with the tip at a pose: two trees, then shortcuts.

Trees grow from both ends towards random postures and each other (RRT-Connect, Kuffner and LaValle
2000). What they find is shortened by straight motions between random points of it, and to other
ends, and pulled tight. From then on they grow where a way could be shorter. With the same seed the
random numbers are the same, and so is the result.
"""

from __future__ import annotations

from collections.abc import Generator
from itertools import pairwise
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.target.elastic_band import pulled_tight
from redundant_planner.core.target.free_goals import FreeGoals
from redundant_planner.core.target.free_space import FreeSpace, Place, places_of, stacked_places
from redundant_planner.core.target.goal import Goal
from redundant_planner.core.target.joint_curve import lengths_along
from redundant_planner.core.target.past_ways import COST_OF_WAY, Part, PastWays
from redundant_planner.core.target.random_postures import informed_samples, near_trees
from redundant_planner.core.target.shortcuts import COUNT, new_shortening, NUMBERS, shorten
from redundant_planner.core.target.straight_motion import COST_OF_CALL, Motion, new_motion
from redundant_planner.core.target.tree_growth import (
    cut_off,
    enlarged,
    grow,
    GROWING,
    MET,
    new_trees,
    to_root,
    TOO_LARGE,
    Trees,
    USED,
    way_between,
    with_goals,
    with_start,
)

Array = npt.NDArray[np.float64]
Way = list[Place]

# Room that ways have, in turn, but for their ends: much lets the arm go fast, little finds ways
# through gaps [m]. A way with little counts as longer by a factor.
_ROOMS, _PRICES = (0.01, 0.002), {0.01: 1.0, 0.002: 1.3}
# An arm that is found closer than its margin may start on a way all the same, within this [m].
_INSIDE = 2e-3
# A place aside counts less by this for each rad of the way there [m/rad], and so many are looked
# at: that is done in one tick.
_PRICE_OF_ASIDE, _MOST_ASIDE = 0.01, 32
# Branches that a tree without goals grows between guesses.
_LOOKS_AROUND = 10
# A way is better at this share of the best one's price. At these factors of what the cheapest
# straight motion would cost, a straight one is as good, and any way is good.
_BETTER, _AS_GOOD, _GOOD = 0.98, 1.05, 1.1
# Longest branch that is tried at once [rad, joint weights included]: anywhere, where the way may
# have little room, and where the tip stays in a cone.
_BRANCH, _BRANCH_IN_GAPS, _BRANCH_IN_CONE = 0.8, 0.5, 0.2
# Random postures that trees grow towards, drawn at once, and what drawing costs and each of them;
# trees, a way that is to become shorter, and a price or a look at all goals [ns].
_AIMS, _COST_OF_DRAWING, _COST_OF_AIM = 128, 60_000, 1000
_COST_OF_TREES, _COST_OF_WAY, _COST_OF_PRICE = 100_000, 200_000, 50_000
# Work at trees in one attempt [ns]: then those with other room have their turn.
_WORK = 35_000_000
# Attempts at a shortcut and how many in vain end them, of any way and of one that may become the
# best: one that costs less than this factor of it by then.
_ROUGHLY, _THOROUGHLY, _PROMISES = (60, 20), (300, 60), 1.1
# So many of them at once where the user has barriers.
_CUTS_AT_ONCE = 5


class PathSearch:
    """A search that goes on for ever, one attempt after the other.

    Attributes:
        way: the shortest way that is known, None if none is.
        room: that it has [m].
        straight: whether it is one straight motion, and costs hardly more than any way might.
        good: whether it costs little more than any way might, a straight one to the best goal.
        shortened: whether it has been made shorter, roughly at least.
        rounds: how many attempts have ended since the first way was found.
        goals: that are known so far, see `FreeGoals`.
        went_before: whether a way that the arm has gone before led to a goal.
        aside: whether the way leads out of the way of others, and not to a goal.
    """

    def __init__(
        self, space: FreeSpace, start: Array, target: Goal | Poses, *, gives_way: bool,
        seed: int = 0, past: PastWays | None = None,
    ) -> None:
        """Prepare.

        Args:
            space: where the arm may be.
            start: (n,) where the way begins.
            target: where it ends.
            gives_way: whether it looks around for `step_aside` while there is no goal.
            seed: of its random numbers.
            past: ways that the arm has gone.
        """
        self.way: Way | None = None
        self.room = self._price = np.inf
        self.straight, self.good, self.shortened, self.rounds = False, False, False, 0
        self.aside = self.went_before = False
        self._trees: Trees | None = None  # the latest, of which the first begins at the start
        self._space, self._start, self._gives_way = space, space.begin_at(start), gives_way
        self._random, self._past = np.random.default_rng(seed), past
        self.goals = FreeGoals(space, start, target, self._random)
        self._ranges = space.joint_ranges(start)
        self._memory: Motion | None = None
        self._blocked: set[tuple[float, int]] = set()  # straight motions to goals, by room
        # Trees that have not met, by room, and how many goals they have.
        self._unmet: dict[float, tuple[Trees, int]] = {}

    def work(self) -> Generator[None, None, None]:
        """Search, and pause after each piece of work."""
        attempt = 0
        if self.way is not None:
            yield from self._improved(self.way, self.room)
            self.rounds += 1
        elif self._past is not None and self._past.ends:
            yield from self.goals.look()
            yield from self._gone_before(self._past)
        while True:
            yield from self.goals.look()
            room = _ROOMS[attempt % len(_ROOMS)]
            attempt += 1
            if not self.goals.places or (self._start.room < -_INSIDE).any():
                yield from self._explore()
                continue
            if (self._most(room) <= self.goals.away).all():
                self._space.spend(_COST_OF_PRICE)
                yield
                # Where those with little room could not be better, others still may.
                self.rounds += room == _ROOMS[0]
                continue
            way = yield from self._connected(room)
            if way is not None:
                way = yield from self._cut_short(way, room, *_ROUGHLY)
                way = yield from self._tight(way, room)
                self.shortened = True
                if self._price_of(way, room) < _PROMISES * self._price:
                    yield from self._improved(way, room)
            self.rounds += self.way is not None

    @property
    def price(self) -> float:
        """What the way costs: its length, if nothing else counts; infinite where there is none."""
        return self._price

    def go_on_from(self, rest: Array) -> None:
        """Search from another start, where postures (k, n) are a way that is known.

        They end at a goal. `work` begins anew.
        """
        forgiven = self._space.arena.forgiven.copy()
        self._start = self._space.begin_at(rest[0])
        self.goals.begin_at(rest[0])
        self._blocked.clear()
        if not np.array_equal(forgiven, self._space.arena.forgiven):
            self._unmet.clear()  # what their postures' room is, is not known any more
        self._unmet = {room: (with_start(trees, *self._start), rooted)
                       for room, (trees, rooted) in self._unmet.items()}
        last = min(self.goals.places, key=lambda goal: float(np.abs(goal.q - rest[-1]).max()))
        between = rest[1:-1]
        self.way = [self._start, *places_of(between, self._space.rooms(between)), last]
        self.straight = False
        self._price = self._price_of(self.way, self.room)

    @property
    def lacks(self) -> str:
        """What keeps it from finding a way, as far as it knows."""
        return self.goals.lacks or 'no way to the target is found'

    def step_aside(self) -> None:
        """Have the way lead to where obstacles are furthest, as far as that is known."""
        if self._trees is None:
            return
        trees, space = self._trees, self._space
        count = int(trees.numbers[0])
        looked_at = range(0, count, math.ceil(count / _MOST_ASIDE))
        postures = trees.postures[0, looked_at]
        best = looked_at[int(np.argmax(
            space.away(postures) - _PRICE_OF_ASIDE * space.distance(self._start.q, postures)))]
        if best > 0:
            nodes = to_root(trees, 0, best)[::-1]
            self.way = places_of(trees.postures[0, nodes], trees.rooms[0, nodes])
            self.room, self.aside = _ROOMS[-1], True

    def length(self, way: Way) -> float:
        """Return how long a way is, joint weights included [rad]."""
        return float(lengths_along(stacked_places(way)[0], self._space.joints.scaling)[-1])

    def _explore(self) -> Generator[None, None, None]:
        """Look around where there is no goal yet, if the arm gives way."""
        yield
        if not self._gives_way:
            return
        if self._trees is None:
            (q, room) = stacked_places([self._start])
            self._trees = new_trees((q, room), (q[:0], room[:0]))
        yield from self._grow(self._trees, _LOOKS_AROUND, _ROOMS[-1])

    def _gone_before(self, past: PastWays) -> Generator[None, None, None]:
        """Take a way that the arm has gone before, if one leads to a goal and is still free."""
        space = self._space
        if (self._start.room < -_INSIDE).any():
            return
        yield from self.goals.look_near(past.ends)
        parts: list[Part] = []
        for part in past.parts(self._start.q, self.goals.postures, space.joints.scaling):
            parts += [part] if part is not None else []
            space.spend(COST_OF_WAY)
            yield
        if not parts:
            return
        part, places = min(parts, key=lambda part: part.length), list[Place]()
        for some in space.slices(len(part.postures)):
            places += places_of(part.postures[some], space.rooms(part.postures[some]))
            yield
        end = self.goals.places[part.goal]
        ways = [([self._start, *places, end], room) for room in _ROOMS]
        if part.length > _AS_GOOD * self.goals.away[part.goal]:
            # What was in the way then may be gone.
            ways.insert(0, ([self._start, end], _ROOMS[0]))
        for way, room in ways:
            if (yield from self._is_free(way, room)):
                self._note(way, room)
                self.shortened = self.went_before = True
                return

    def _is_free(self, way: Way, room: float) -> Generator[None, None, bool]:
        """Return whether straight motions from place to place are free."""
        needed, motion = self._space.asked(room), self._motion()
        for one, other in pairwise(way):
            if not (yield from self._space.is_free_between(one, other, needed, motion)):
                return False
            self._space.spend(COST_OF_CALL)  # what it takes to begin to look at one
            yield
        return True

    def _price_of(self, way: Way, room: float) -> float:
        """Return what a way with some room costs: its length, if nothing else counts."""
        self._space.spend(_COST_OF_PRICE)
        return self.length(way) * _PRICES[room] + float(self._space.price_of_end(way[-1].q))

    def _note(self, way: Way, room: float) -> None:
        """Keep a way with some room if it is the best."""
        price = self._price_of(way, room)
        if price < self._price:
            self._price, self.room = price, room
            least = float((self.goals.away + self.goals.price).min())
            self.straight = len(way) == 2 and price <= _AS_GOOD * least
            self.good, self.way, self.aside = price <= _GOOD * least, way, False

    def _most(self, room: float) -> Array:
        """Return how long a way to each goal may be to be the best [rad, weights included]."""
        return (_BETTER * self._price - self.goals.price) / _PRICES[room]

    def _connected(self, room: float) -> Generator[None, None, Way | None]:
        """Return a way with some room to any goal, None where trees have not met so far."""
        space, start, goals = self._space, self._start, self.goals.places
        needed, away, most = space.asked(room), self.goals.away, self._most(room)
        for i in np.argsort(away - most if np.isfinite(self._price) else away):
            if (room, int(i)) in self._blocked or away[i] >= most[i]:
                continue
            yield
            if (yield from space.is_free_between(start, goals[i], needed, self._motion())):
                return [start, goals[i]]
            self._blocked.add((room, int(i)))
        trees, rooted = self._unmet.pop(room, (None, 0))
        if trees is None:
            trees = new_trees(stacked_places([start]), stacked_places(
                [goals[i] for i in np.flatnonzero(away < most)]))
            space.spend(_COST_OF_TREES)
            yield
        elif rooted < len(goals):
            trees = with_goals(trees, *stacked_places(goals[rooted:]))
        self._trees, until = trees, space.spent + _WORK
        while space.spent < until:
            ended, trees = yield from self._grow(trees, _AIMS, room)
            if ended == TOO_LARGE:
                return None
            if ended == MET:
                way = places_of(*way_between(trees))
                broken = yield from self._rule_broken(way)
                if broken is None:
                    return way
                space.spend(cut_off(trees, broken))
            yield
        # Between two branches: the memory of the motion that is looked at is none of the trees'.
        self._unmet[room] = trees, len(goals)
        return None

    def _rule_broken(self, way: Way) -> Generator[None, None, int | None]:
        """Return the first motion of a way that does not keep the user's barriers, if any."""
        for i, motion in enumerate(pairwise(way)):
            if not (yield from self._space.keeps_rules(motion)):
                return i
        return None

    def _grow(
        self, trees: Trees, aims: int, room: float,
    ) -> Generator[None, None, tuple[int, Trees]]:
        """Grow trees to so many random postures with some room; return how it ended, and them."""
        space, (low, high) = self._space, self._ranges
        towards = self._random.uniform(low, high, (aims, len(low)))
        most = self._most(room)
        within = np.flatnonzero(self.goals.away < most)
        if np.isfinite(self._price) and len(within):
            aimed = informed_samples(
                self._random, aims, self._start.q, self.goals.postures[within], most[within],
                space.joints.scaling)
            inside = ((low <= aimed) & (aimed <= high)).all(axis=1)
            towards[inside] = aimed[inside]
        if trees.numbers[:2].all():
            towards[::2] = near_trees(self._random, len(towards[::2]), trees, low, high)
        trees.numbers[USED] = 0
        space.spend(_COST_OF_DRAWING + _COST_OF_AIM * aims)
        yield
        motion, needed = self._motion(), space.asked(room)
        longest = (_BRANCH_IN_CONE if space.narrow else
                   _BRANCH if room == _ROOMS[0] else _BRANCH_IN_GAPS)
        while True:
            ended, work = grow(
                trees, motion, towards, needed, longest, space.piece, space.arena)
            space.spend(work)
            if ended == TOO_LARGE and (larger := enlarged(trees)) is not None:
                trees = self._trees = larger
                space.spend(_COST_OF_TREES)
            elif ended != GROWING:
                return ended, trees
            yield

    def _improved(self, way: Way, room: float) -> Generator[None, None, None]:
        """Make a way shorter that may be the best."""
        way = yield from self._cut_short(way, room, *_THOROUGHLY)
        yield from self._tight(way, room)

    def _tight(self, way: Way, room: float) -> Generator[None, None, Way]:
        """Return a way pulled tight, if it then has as much room."""
        if len(way) == 2:
            return way
        tight = yield from pulled_tight(self._space, way, room)
        if tight is None:
            return way
        self._note(tight, room)
        return tight

    def _cut_short(
        self, way: Way, room: float, attempts: int, most_in_vain: int,
    ) -> Generator[None, None, Way]:
        """Return a way that is shorter by straight motions with as much room.

        They lead to another goal, from the start, to the end, or around a corner, however near.
        """
        self._note(way, room)
        random = self._random.random((attempts, NUMBERS))
        if not self._space.has_rules:
            way = yield from self._cut(way, room, random, most_in_vain)
        else:
            # Few at a time: those that do not keep the user's barriers are taken back together.
            for first in range(0, attempts, _CUTS_AT_ONCE):
                shorter = yield from self._cut(
                    way, room, random[first:first + _CUTS_AT_ONCE], most_in_vain)
                if (yield from self._space.keeps_rules(shorter)):
                    way = shorter
        self._note(way, room)
        return way

    def _cut(
        self, way: Way, room: float, random: Array, most_in_vain: int,
    ) -> Generator[None, None, Way]:
        """Return a way with as much room after attempts (a, ...) to make it shorter."""
        space, goals = self._space, stacked_places(self.goals.places)
        motion, needed = self._motion(), space.asked(room)
        shorter = new_shortening(*stacked_places(way), space.joints.scaling)
        space.spend(_COST_OF_WAY)
        yield
        over = False
        while not over:
            over, work = shorten(
                shorter, motion, *goals, random, needed, most_in_vain, space.piece, space.arena)
            space.spend(work)
            yield
        count = shorter.numbers[COUNT]
        return places_of(shorter.postures[:count], shorter.rooms[:count])

    def _motion(self) -> Motion:
        """Return memory for a motion between any two postures of the search."""
        if self._memory is None:
            ends = np.array([self._start.q, *self._ranges, *self.goals.postures])
            self._memory = new_motion(
                len(self._start.q), len(self._start.room),
                float((ends.max(axis=0) - ends.min(axis=0)).max(initial=0.0)))
        return self._memory
