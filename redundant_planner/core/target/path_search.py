"""The way from a posture to another, or to any with the tip at a pose: two trees, then shortcuts.

Trees grow from both ends towards random postures and each other (RRT-Connect, Kuffner and LaValle
2000). What they find is shortened by straight motions between random points of it, and to other
ends. The random numbers are always the same, and so is the result.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from enum import Enum

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.core.target.free_space import FreeSpace, Place
from redundant_planner.core.target.goal import Goal
from redundant_planner.core.target.goal_postures import goal_postures, only_posture

Array = npt.NDArray[np.float64]
Way = list[Place]

# Room that ways have, in turn, but for their ends: much lets the arm go fast, little finds ways
# through gaps [m]. A way with little counts as longer by this factor.
_ROOMS, _PRICE_OF_GAPS = (0.01, 0.002), 1.3
# An arm that is found closer than its margin may start on a way all the same, within this, and a
# goal keeps so much [m].
_INSIDE, _AT_GOAL = 2e-3, 1e-4
# A place aside counts less by this for each rad of the way there [m/rad].
_PRICE_OF_ASIDE = 0.01
# Branches that a tree without goals grows between guesses.
_LOOKS_AROUND = 10
# Guesses at goal postures before each attempt, and how many postures are enough.
_GUESSES, _GOALS = 60, 24
# Guesses without any posture after which a pose counts as out of reach.
_GUESSES_OUT_OF_REACH = 300
# A straight motion to a goal that is further than the nearest by this share is as good.
_AS_GOOD = 1.05
# Longest branch that is tried at once [rad, joint weights included]: anywhere, and where the tip
# stays in a cone.
_BRANCH, _BRANCH_IN_CONE = 0.8, 0.2
# Nodes after which both trees are given up: at first, and at last.
_FEWEST_NODES, _MOST_NODES = 500, 4000
# Attempts at a shortcut and how many in vain end them, of any way and of one that may become the
# best: one that costs less than this factor of it by then.
_ROUGHLY, _THOROUGHLY, _PROMISES = (60, 20), (300, 60), 1.1
# A shortcut must save this share of the way, and the least one about a corner takes this power of
# a half of it.
_LEAST_GAIN, _FINEST_CUT = 1e-3, 5.0


class _Cut(Enum):
    """What a shortcut leads to, in the order in which they are tried."""

    TO_GOAL = 0
    FROM_START = 1
    TO_END = 2
    CORNER = 3


_CUTS = tuple(_Cut)


class PathSearch:
    """A search that goes on for ever, one attempt after the other.

    Attributes:
        way: the shortest way that is known, None if none is.
        room: that it has [m].
        straight: whether it is one straight motion to the nearest goal that is known.
        rounds: how many attempts have ended since the first way was found.
        out_of_reach: whether no posture with the tip at the pose is known after many guesses.
        aside: whether the way leads out of the way of others, and not to a goal.
    """

    def __init__(
        self, space: FreeSpace, start: Array, target: Goal, *, gives_way: bool,
    ) -> None:
        """Prepare.

        Args:
            space: where the arm may be.
            start: (n,) where the way begins.
            target: where it ends.
            gives_way: whether it looks around for `step_aside` while there is no goal.
        """
        self.way: Way | None = None
        self.room = self._price = np.inf
        self.straight, self.rounds, self.out_of_reach, self.aside = False, 0, False, False
        self._tree: _Tree | None = None  # the latest one that begins at the start
        self._space, self._start, self._gives_way = space, space.begin_at(start), gives_way
        self._goals: list[Place] = []
        self._tightest: Array | None = None  # room (k,) of the goal that is nearly free
        self._random = np.random.default_rng(0)
        self._postures = (
            goal_postures(space, start, target, self._random) if isinstance(target, Pose) else
            only_posture(space, start, target))
        self._guesses, self._reached = 0, False
        self._ranges = space.joint_ranges(start)

    def work(self) -> Generator[None, None, None]:
        """Search, and pause after each piece of work."""
        attempt = 0
        while True:
            yield from self._guess()
            room = _ROOMS[attempt % len(_ROOMS)]
            most_nodes = min(_FEWEST_NODES * (1 + attempt), _MOST_NODES)
            attempt += 1
            if not self._goals or (self._start.room < -_INSIDE).any():
                yield from self._explored()
                continue
            way = yield from self._connected(room, most_nodes)
            if way is not None:
                way = yield from self._shortened(way, room, *_ROUGHLY)
                if self._price_of(way, room) < _PROMISES * self._price:
                    yield from self._shortened(way, room, *_THOROUGHLY)
            self.rounds += self.way is not None

    @property
    def lacks(self) -> str:
        """What keeps it from finding a way, as far as it knows."""
        if self.out_of_reach:
            return 'no posture has the tip at the target'
        if not self._goals:
            return 'at the target ' + (
                'the arm would touch something' if self._tightest is None
                else self._space.too_near(self._tightest))
        return 'no way to the target is found'

    def step_aside(self) -> None:
        """Have the way lead to where obstacles are furthest, as far as that is known."""
        if self._tree is None:
            return
        postures, space = np.array([place.q for place in self._tree.places]), self._space
        best = int(np.argmax(
            space.away(postures) - _PRICE_OF_ASIDE * space.distance(self._start.q, postures)))
        if best > 0:
            self.way, self.room, self.aside = self._tree.to_root(best)[::-1], _ROOMS[-1], True

    def length(self, way: Way) -> float:
        """Return how long a way is, joint weights included [rad]."""
        return float(self._along(way)[-1])

    def _along(self, way: Way) -> Array:
        """Return the length of a way up to each of its places (k,)."""
        nodes = np.array([place.q for place in way])
        return np.concatenate((np.zeros(1), np.cumsum(
            self._space.distance(nodes[:-1], nodes[1:]))))

    def _guess(self) -> Generator[None, None, None]:
        """Look for goal postures."""
        until = self._guesses + _GUESSES
        while len(self._goals) < _GOALS and self._guesses < until:
            found = next(self._postures)
            yield
            for goal in found or ():
                if (goal.room >= _AT_GOAL).all():
                    self._goals.append(goal)
                elif self._tightest is None or goal.room.min() > self._tightest.min():
                    self._tightest = goal.room
            self._guesses += found is None
            self._reached = self._reached or bool(found)
        self.out_of_reach = not self._reached and self._guesses >= _GUESSES_OUT_OF_REACH

    def _explored(self) -> Generator[None, None, None]:
        """Look around where there is no goal yet, if the arm gives way."""
        yield
        if not self._gives_way:
            return
        if self._tree is None:
            self._tree = _Tree(self._space, [self._start])
        for _ in range(_LOOKS_AROUND if len(self._tree.places) < _FEWEST_NODES else 0):
            yield from self._tree.grow(
                self._random.uniform(*self._ranges), self._space.asked(_ROOMS[-1]))

    def _price_of(self, way: Way, room: float) -> float:
        """Return what a way with some room costs: its length, if nothing else counts."""
        joints, end = self._space.joints, way[-1].q
        off = np.nan_to_num(nearest_turn(end, joints.preferred, joints.position_max)
                            - joints.preferred)
        return self.length(way) * (1.0 if room == _ROOMS[0] else _PRICE_OF_GAPS) + (
            joints.preference * float(np.linalg.norm(off)))

    def _note(self, way: Way, room: float) -> None:
        """Keep a way with some room if it is the best."""
        price = self._price_of(way, room)
        if price < self._price:
            self._price, self.room = price, room
            nearest = min(self._space.distance(self._start.q, goal.q) for goal in self._goals)
            self.straight = len(way) == 2 and bool(self.length(way) <= _AS_GOOD * nearest)
            self.way, self.aside = way, False

    def _connected(
        self, room: float, most_nodes: int,
    ) -> Generator[None, None, Way | None]:
        """Return a way with some room to any goal, None where the trees have grown too large."""
        space, start, goals = self._space, self._start, self._goals
        needed = space.asked(room)
        for goal in sorted(goals, key=lambda goal: float(space.distance(start.q, goal.q))):
            yield
            if (yield from space.is_free_between(start, goal, needed)):
                return [start, goal]
        trees = _Tree(space, [start]), _Tree(space, goals)
        self._tree = trees[0]
        forward = True
        while len(trees[0].places) + len(trees[1].places) < most_nodes:
            growing, other = trees if forward else trees[::-1]
            grown = yield from growing.grow(
                self._random.uniform(*self._ranges), needed)
            while grown is not None:
                goal = growing.places[grown]
                met = yield from other.grow(goal.q, needed)
                if met is None:
                    break
                if other.places[met].q is goal.q:
                    way = growing.to_root(grown)[::-1] + other.to_root(met)[1:]
                    return way if forward else way[::-1]
            forward = not forward
        return None

    def _shortened(
        self, way: Way, room: float, attempts: int, most_in_vain: int,
    ) -> Generator[None, None, Way]:
        """Return a way that is shorter by straight motions with as much room.

        They lead to another goal, from the start, to the end, or around a corner, however near.
        """
        self._note(way, room)
        needed, in_vain, along = self._space.asked(room), 0, self._along(way)
        for attempt in range(attempts):
            if in_vain > most_in_vain or (
                    len(way) == 2 and attempt > len(_CUTS) * len(self._goals)):
                break
            in_vain += 1
            shorter = yield from self._cut(way, along, _CUTS[attempt % len(_CUTS)], needed)
            if shorter is not None:
                way, along, in_vain = shorter, self._along(shorter), 0
                self._note(way, room)
            yield
        return way

    def _cut(
        self, way: Way, along: Array, cut: _Cut, needed: Array,
    ) -> Generator[None, None, Way | None]:
        """Return a way after a random shortcut; None if this one saves nothing or is not free.

        Args:
            way: as it is.
            along: its length up to each of its places.
            cut: what the shortcut leads to.
            needed: (k,) the room that it shall have.
        """
        random, space, whole = self._random, self._space, float(along[-1])
        begin, end = sorted(random.uniform(0.0, whole, 2).tolist())
        if cut is _Cut.CORNER:
            corner = float(along[int(random.integers(len(way)))])
            size = whole * 2.0 ** -random.uniform(0.0, _FINEST_CUT)
            begin, end = max(corner - size * random.uniform(), 0.0), min(
                corner + size * random.uniform(), whole)
        begin, end = (0.0 if cut is _Cut.FROM_START else begin,
                      whole if cut in (_Cut.TO_GOAL, _Cut.TO_END) else end)
        goal = (self._goals[int(random.integers(len(self._goals)))] if cut is _Cut.TO_GOAL else
                way[-1])
        before, from_q = self._point(way, along, begin)
        after, to_q = self._point(way, along, end)
        to_q = goal.q if end == whole else to_q
        saved = (end - begin) - float(space.distance(from_q, to_q))
        if saved < _LEAST_GAIN * whole:
            return None
        one = way[0] if begin == 0.0 else space.place(from_q)
        other = goal if end == whole else space.place(to_q)
        # The ends of the way may have less room.
        roomy = (begin == 0.0 or (one.room >= needed).all()) and (
            end == whole or (other.room >= needed).all())
        if not roomy or not (yield from space.is_free_between(one, other, needed)):
            return None
        return [*(way[:before + 1] if begin > 0.0 else ()), one, other,
                *(way[after + 1:] if end < whole else ())]

    @staticmethod
    def _point(way: Way, along: Array, at: float) -> tuple[int, Array]:
        """Return the posture (n,) at a length of a way, and the number of the node before it."""
        i = min(int(np.searchsorted(along, at, side='right')) - 1, len(way) - 2)
        share = (at - along[i]) / max(along[i + 1] - along[i], np.finfo(float).tiny)
        return i, way[i].q + share * (way[i + 1].q - way[i].q)


class _Tree:
    """Places, each with the one that it grew from."""

    def __init__(self, space: FreeSpace, roots: Sequence[Place]) -> None:
        self._space, self.places = space, list(roots)
        self._parents = [-1] * len(roots)
        self._postures = np.empty((64 + len(roots), len(roots[0].q)))
        for i, root in enumerate(roots):
            self._postures[i] = root.q

    def grow(self, target: Array, needed: Array) -> Generator[None, None, int | None]:
        """Grow one branch with room (k,) towards a posture (n,); return the new place's number."""
        space = self._space
        at = int(space.distance(self._postures[:len(self.places)], target).argmin())
        root = self.places[at]
        size, longest = float(space.distance(root.q, target)), (
            _BRANCH_IN_CONE if space.narrow else _BRANCH)
        q = target
        if size > longest:
            q = space.into_cone(root.q + longest / size * (target - root.q))
        place = space.place(q)
        yield
        if (place.room < needed).any() or not (
                yield from space.is_free_between(root, place, needed)):
            return None
        return self._add(place, at)

    def to_root(self, index: int) -> Way:
        """Return the places from one back to its root."""
        found = []
        while index >= 0:
            found.append(self.places[index])
            index = self._parents[index]
        return found

    def _add(self, place: Place, parent: int) -> int:
        """Add a place and return its number."""
        index = len(self.places)
        if index == len(self._postures):
            self._postures = np.vstack((self._postures, np.empty_like(self._postures)))
        self._postures[index] = place.q
        self.places.append(place)
        self._parents.append(parent)
        return index
