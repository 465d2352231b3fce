"""Where the arm may be: how much room its links have at postures, and on the way between two."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
import itertools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import RobotConstants
from redundant_planner.core.horizon.least_norm_path import PathJoints
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.shapes import HALF_SPACE
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.core.safety.own_barriers import OwnBarriers
from redundant_planner.core.target.straight_motion import (
    Arena,
    begin_looking,
    FREE,
    go_on_looking,
    Motion,
    new_motion,
    PENDING,
    rooms_at,
    usual_work,
)

Array = npt.NDArray[np.float64]

# Most room that is asked of pairs of links [m]: a Panda's hand is close to its link5 in most ways.
_ROOM_OF_PAIRS = 2e-3
# A piece of work, if nobody says another one [ns].
_PIECE = 100_000
# What a barrier of the user's own costs at a posture [ns], how much of it is asked of a way, more
# than the filter keeps, and how far apart postures are looked at [rad, m].
_COST_OF_RULE, _ROOM_OF_RULES, _KEPT_OF_RULES, _STEP = 14_000, 0.01, 2e-3, 0.05
_ROUND_OFF = 1e-9


class Place(NamedTuple):
    """A posture, and the room there.

    Attributes:
        q: (n,) [rad, m].
        room: (k,) see `FreeSpace`.
    """

    q: Array
    room: Array


def stacked_places(places: Sequence[Place]) -> tuple[Array, Array]:
    """Return the postures (w, n) of places, and their rooms (w, k)."""
    return np.array([place.q for place in places]), np.array([place.room for place in places])


def places_of(postures: Array, rooms: Array) -> list[Place]:
    """Return places with postures (w, n) and rooms (w, k)."""
    return [Place(q.copy(), room.copy()) for q, room in zip(postures, rooms)]


class FreeSpace:
    """The postures at which one arm is free, among obstacles as they are at one moment.

    Room is what a link has to the nearest obstacle, and what pairs of links have to each other,
    margins taken off [m], how much further the tip may lean in its cone, and what the joints may
    use up of the user's barriers [rad]: k entries, in this order. The compiled search knows
    nothing of the last ones: they are infinite there, and `keeps_rules` looks at its ways.

    Attributes:
        robot: the arm.
        joints: how they are weighed and bounded.
        arena: it and what keeps its links from being anywhere, for compiled functions.
        spent: the work done so far, counted and not timed, so that replays are exact: in what
            it takes on one machine [ns].
        piece: a piece of work at most, about, likewise; more than `COST_OF_CALL`.
    """

    def __init__(
        self, robot: Robot, constants: RobotConstants, joints: PathJoints,
        obstacles: InflatedObstacles, own: OwnBarriers | None = None,
    ) -> None:
        """Take a look at obstacles that are inflated for links with their margin."""
        self.robot, self.joints, self.spent = robot, joints, 0
        self._own = own if own is not None and own.barriers else None
        self._rules = 0 if self._own is None else len(self._own.barriers)
        self._forgiven_rules = np.zeros(self._rules)
        self._constants = constants
        reach = [constants.lever_arm_bounds, constants.self_lever_arm_bounds]
        in_cone = constants.cone.angle < math.pi
        if in_cone:
            # What turns, turns the tip's axis no faster.
            screws = robot.kinematics(np.zeros(robot.n)).joint_screws
            reach.append(np.linalg.norm(screws[3:], axis=0)[None])
        reach.append(np.zeros((self._rules, robot.n)))
        levers = np.vstack(reach)
        self.arena = Arena(
            robot.chain, joints, levers, obstacles, constants.radii, constants.self_pairs,
            constants.self_supports, in_cone, np.where(levers.any(axis=1), 0.0, np.inf))
        self.piece = _PIECE
        # What a posture costs, about: at first, and as measured.
        self._usual = self._posture = usual_work(self.arena)

    def spend(self, work: int) -> None:
        """Note work that was done [ns]."""
        self.spent += work

    def slices(self, count: int) -> Iterator[slice]:
        """Yield which of so many postures to look at in one piece of work, and in the next."""
        first = 0
        while first < count:
            posture = self._posture + _COST_OF_RULE * self._rules
            last = min(first + max(self.piece // posture, 1), count)
            yield slice(first, last)
            first = last

    def rooms(self, postures: Array) -> Array:
        """Return the room (N, k) at postures (N, n); infinite for links that cannot move."""
        rooms, work = rooms_at(postures, self.arena)
        self.spend(work)
        if len(postures) > 1:
            self._posture = work // len(postures)
        if self._rules:
            rooms[:, -self._rules:] = self._rooms_of_rules(postures)
        return rooms

    def _rooms_of_rules(self, postures: Array) -> Array:
        """Return what is left of the user's barriers (N, b) at postures (N, n)."""
        assert self._own is not None
        self.spend(_COST_OF_RULE * self._rules * len(postures))
        return self._own.rooms(postures) - _KEPT_OF_RULES + self._forgiven_rules

    def keeps_rules(self, way: Sequence[Place]) -> Generator[None, None, bool]:
        """Return whether straight motions from place to place keep the user's barriers.

        They may have as little room as their ends. It pauses after each piece of work.
        """
        if not self._rules:
            return True
        looked = 0
        for one, other in itertools.pairwise(way):
            least = np.minimum(np.minimum(one.room, other.room)[-self._rules:], _ROOM_OF_RULES)
            steps = math.ceil(float(np.abs(other.q - one.q).max(initial=0.0)) / _STEP)
            for step in range(1, steps + 1):
                between = one.q + step / steps * (other.q - one.q)
                if (self._rooms_of_rules(between[None])[0] < least - _ROUND_OFF).any():
                    return False
                looked += 1
                if looked % 4 == 0:
                    yield
        yield
        return True

    @property
    def has_rules(self) -> bool:
        """Whether there are barriers of the user's own."""
        return self._rules > 0

    @property
    def narrow(self) -> bool:
        """Whether the tip has to stay in a cone: few postures do, and random ones do not."""
        return self.arena.in_cone

    def asked(self, room: float) -> Array:
        """Return the room (k,) to ask of a way that shall have so much [m].

        Pairs of links get less: two that are close by the arm's design would forbid most ways.
        """
        links, pairs = len(self._constants.lever_arm_bounds), len(self._constants.self_pairs)
        asked = np.full(len(self.arena.reach), room)
        asked[links:links + pairs] = min(room, _ROOM_OF_PAIRS)
        asked[len(asked) - self._rules:] = min(room, _ROOM_OF_RULES)
        return asked

    def begin_at(self, q: Array) -> Place:
        """Return a posture (n,) with its room, to start from.

        Links found closer to each other than their margin may stay so, only not get closer: that
        counts as no room from here on. So may what is found outside a barrier of the user's.
        """
        self._posture = self._usual  # an earlier search leaves nothing to this one
        forgiven = self.arena.forgiven
        forgiven[np.isfinite(forgiven)] = 0.0
        self._forgiven_rules[:] = 0.0
        room = self.rooms(q[None])[0]
        if self._rules:
            self._forgiven_rules = np.maximum(-room[-self._rules:], 0.0)
            own = room[-self._rules:] + self._forgiven_rules
        pairs = slice(len(self._constants.lever_arm_bounds), None)
        forgiven[pairs] = np.where(
            np.isfinite(forgiven[pairs]), np.maximum(-room[pairs], 0.0), np.inf)
        room = room + forgiven
        if self._rules:
            room[-self._rules:] = own
        return Place(q, room)

    def too_near(self, room: Array) -> str:
        """Say which link has the least room (k,), and what is missing of its margin."""
        links, pairs = len(self._constants.lever_arm_bounds), self._constants.self_pairs
        names, least = [capsule.name for capsule in self.robot.capsules], int(room.argmin())
        missing = f'{-1e3 * room[least]:.1f} mm too near to'
        if least < links:
            return f"'{names[least]}' would be {missing} an obstacle"
        if least < links + len(pairs):
            one, other = pairs[least - links]
            return f"'{names[one]}' would be {missing} '{names[other]}'"
        if self._own is not None and least >= len(room) - self._rules:
            return f"'{self._own.names[least - len(room)]}' would not be kept"
        return f'the tip would lean {-math.degrees(room[least]):.1f}° out of its cone'

    def nearest_obstacle(self, postures: Array) -> float:
        """Return the least room that any link has to an obstacle at postures (N, n) [m]."""
        links = len(self._constants.lever_arm_bounds)
        return float(self.rooms(postures)[:, :links].min(initial=np.inf))

    def away(self, postures: Array) -> Array:
        """Return how far (N,) the links are from any obstacle's middle, on average [m].

        Walls do not count.
        """
        obstacles = self.arena.obstacles
        centers = obstacles.centers.T[obstacles.shapes != HALF_SPACE]
        if not len(centers):
            return np.zeros(len(postures))
        arms = self.robot.kinematics_along(postures)
        middles = 0.5 * (arms.segment_start + arms.segment_end)
        apart = np.linalg.norm(middles[:, :, None] - centers, axis=3)
        return np.asarray(apart.min(axis=2).mean(axis=1))

    def place(self, q: Array) -> Place:
        """Return a posture (n,) with its room."""
        return Place(q, self.rooms(q[None])[0])

    def is_free_between(
        self, one: Place, other: Place, needed: Array, memory: Motion | None = None,
    ) -> Generator[None, None, bool]:
        """Return whether a straight motion of the joints is free whose ends are.

        It pauses after each piece of work.

        Args:
            one, other: its ends.
            needed: (k,) room; where an end has less, the motion may have as little [m].
            memory: for the motion, which is changed; new memory if None.
        """
        motion = memory or new_motion(
            len(one.q), len(needed), float(np.abs(other.q - one.q).max(initial=0.0)))
        if not begin_looking(motion, one.q, one.room, other.q, other.room, needed, self.arena):
            return False
        while True:
            state, work = go_on_looking(motion, self.piece, self.arena)
            self.spend(work)
            if state != PENDING:
                return state == FREE and (yield from self.keeps_rules((one, other)))
            yield

    def joint_ranges(self, q: Array) -> tuple[Array, Array]:
        """Return the (low, high) positions (n,) to look in; joints without limits about q (n,)."""
        low, high = self.joints.position_min, self.joints.position_max
        return (np.where(np.isfinite(low), low, q - math.pi),
                np.where(np.isfinite(high), high, q + math.pi))

    def price_of_end(self, postures: Array) -> Array:
        """Return what it costs to end at postures (…, n) that are not the preferred one."""
        joints = self.joints
        off = nearest_turn(postures, joints.preferred, joints.position_max) - joints.preferred
        return np.asarray(joints.preference * np.linalg.norm(np.nan_to_num(off), axis=-1))

    def distance(self, one: Array, other: Array) -> Array:
        """Return how far postures (…, n) are apart, joint weights included."""
        apart = (other - one) / self.joints.scaling
        return np.asarray(np.sqrt((apart * apart).sum(axis=-1)))
