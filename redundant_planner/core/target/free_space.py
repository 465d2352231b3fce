"""Where the arm may be: how much room its links have at postures, and on the way between two.

No point of a link moves further in a motion Δq than Σ_j b_j |Δq_j|, with the lever arm bounds b.
A motion is therefore free where every link has, at both ends together, more room than that.
Otherwise the posture half way is looked at, and so on (Schwarzer, Saha and Latombe 2005).
"""

from __future__ import annotations

from collections.abc import Generator
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import RobotConstants
from redundant_planner.core.horizon.least_norm_path import PathJoints
from redundant_planner.core.kernels import (
    entry,
    IndexPairs,
    Indices,
    kernel,
    Matrix,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.obstacles.clearance import is_contact, measure, Pairs
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.self_collision import write_link_distances
from redundant_planner.core.obstacles.shapes import HALF_SPACE
from redundant_planner.core.robot.cone import Cone, cone_room
from redundant_planner.core.robot.kinematics import (
    Chain,
    fill,
    JointPlaces,
    Kinematics,
    new_kinematics_compiled,
    new_places,
)
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# What has more room than this need not be measured exactly [m].
_AMPLE = 0.3
# Pieces of a motion shorter than this are not halved any more, and one that is longer than a
# hundred turns counts as blocked, as nobody has the memory to look at it [rad, m].
_FINEST, _LONGEST = 0.02, 630.0
# Steps that lead a posture into the tip's cone, to this share of its angle inside.
_STEPS_INTO_CONE, _ROOM_IN_CONE = 6, 0.1
_TINY = 1e-12
# Most room that is asked of pairs of links [m]: a Panda's hand is close to its link5 in most ways.
_ROOM_OF_PAIRS = 2e-3
# What postures cost to look at besides their distances, each and together, and what a piece of
# work costs at most, in distances: each takes about 0.1 µs.
_COST_OF_POSTURE, _COST_OF_CALL, _PIECE = 40, 100, 1500


class Place(NamedTuple):
    """A posture, and the room there.

    Attributes:
        q: (n,) [rad, m].
        room: (k,) see `FreeSpace`.
    """

    q: Array
    room: Array


class _Around(NamedTuple):
    """What keeps links from being anywhere.

    Attributes:
        obstacles: for links with their margin.
        radii: (c,) with half the margin between links [m].
        links: (p, 2) which of them can collide.
        cone: that the tip stays in.
        in_cone: whether it has to.
        forgiven: (k,) what is added to the room, infinite for links that cannot move.
    """

    obstacles: InflatedObstacles
    radii: Vector
    links: IndexPairs
    cone: Cone
    in_cone: bool
    forgiven: Vector


class _Motion(NamedTuple):
    """A straight motion of the joints, and what it asks for.

    Attributes:
        start: (n,) where it begins [rad, m].
        step: (n,) the way to its end.
        size: of the joint that moves furthest [rad, m].
        way: (k,) how far links may come on it [m].
        least: (k,) room that it has to have.
    """

    start: Vector
    step: Vector
    size: float
    way: Vector
    least: Vector


class _Halving(NamedTuple):
    """A motion that is halved until it is known to be free.

    Attributes:
        at: (s,) shares of the motion that have been looked at; its ends come first.
        rooms: (s, k) there.
        pieces: (t, 2) which of them are ends of a piece, in the order in which they are halved.
        counts: (3,) how many have been looked at, have been halved, and there are.
    """

    at: Vector
    rooms: Matrix
    pieces: IndexPairs
    counts: Indices


class FreeSpace:
    """The postures at which one arm is free, among obstacles as they are at one moment.

    Room is what a link has to the nearest obstacle, and what pairs of links have to each other,
    margins taken off [m], and how much further the tip may lean in its cone [rad]: k entries, in
    this order.

    Attributes:
        robot: the arm.
        joints: how they are weighed and bounded.
        spent: the work done so far, in distances.
        at_once: how many postures are looked at in one piece of work.
    """

    def __init__(
        self, robot: Robot, constants: RobotConstants, joints: PathJoints,
        obstacles: InflatedObstacles,
    ) -> None:
        """Take a look at obstacles that are inflated for links with their margin."""
        self.robot, self.joints, self.spent = robot, joints, 0
        self._constants = constants
        reach = [constants.lever_arm_bounds, constants.self_lever_arm_bounds]
        in_cone = constants.cone.angle < math.pi
        if in_cone:
            # What turns, turns the tip's axis no faster.
            screws = robot.kinematics(np.zeros(robot.n)).joint_screws
            reach.append(np.linalg.norm(screws[3:], axis=0)[None])
        self._reach = np.vstack(reach)
        self._around = _Around(
            obstacles, constants.radii, constants.self_pairs, constants.cone, in_cone,
            np.where(self._reach.any(axis=1), 0.0, np.inf))
        self._cost = obstacles.smallest.size + len(constants.self_pairs) + _COST_OF_POSTURE
        self.at_once = max(_PIECE // self._cost, 1)

    def spend(self, distances: int) -> None:
        """Note work that was done besides measuring, in distances."""
        self.spent += distances

    def rooms(self, postures: Array) -> Array:
        """Return the room (N, k) at postures (N, n); infinite for links that cannot move."""
        self.spend(_COST_OF_CALL + len(postures) * self._cost)
        return _rooms(postures, self.robot.chain, self._around)

    @property
    def narrow(self) -> bool:
        """Whether the tip has to stay in a cone: few postures do, and random ones do not."""
        return self._around.in_cone

    def into_cone(self, q: Array) -> Array:
        """Return a posture (n,) near another one with the tip in its cone, or nearer to that."""
        cone = self._around.cone
        for _ in range(_STEPS_INTO_CONE if self.narrow else 0):
            arm = self.robot.kinematics(q)
            room, gradient = cone_room(cone, arm.tip_rotation, arm.joint_screws)
            if room > _ROOM_IN_CONE * cone.angle:
                break
            missing = 2.0 * _ROOM_IN_CONE * cone.angle - room
            q = np.clip(q + missing / max(float(gradient @ gradient), _TINY) * gradient,
                        self.joints.position_min, self.joints.position_max)
        return q

    def asked(self, room: float) -> Array:
        """Return the room (k,) to ask of a way that shall have so much [m].

        Pairs of links get less: two that are close by the arm's design would forbid most ways.
        """
        links, pairs = len(self._constants.lever_arm_bounds), len(self._constants.self_pairs)
        asked = np.full(len(self._reach), room)
        asked[links:links + pairs] = min(room, _ROOM_OF_PAIRS)
        return asked

    def begin_at(self, q: Array) -> Place:
        """Return a posture (n,) with its room, to start from.

        Links found closer to each other than their margin may stay so, only not get closer: that
        counts as no room from here on.
        """
        forgiven = self._around.forgiven
        forgiven[np.isfinite(forgiven)] = 0.0
        room = self.rooms(q[None])[0]
        pairs = slice(len(self._constants.lever_arm_bounds), None)
        forgiven[pairs] = np.where(
            np.isfinite(forgiven[pairs]), np.maximum(-room[pairs], 0.0), np.inf)
        return Place(q, room + forgiven)

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
        return f'the tip would lean {-math.degrees(room[least]):.1f}° out of its cone'

    def nearest_obstacle(self, postures: Array) -> float:
        """Return the least room that any link has to an obstacle at postures (N, n) [m]."""
        links = len(self._constants.lever_arm_bounds)
        return float(self.rooms(postures)[:, :links].min(initial=np.inf))

    def away(self, postures: Array) -> Array:
        """Return how far (N,) the links are from any obstacle's middle, on average [m].

        Walls do not count.
        """
        obstacles = self._around.obstacles
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
        self, one: Place, other: Place, needed: Array,
    ) -> Generator[None, None, bool]:
        """Return whether a straight motion of the joints is free whose ends are.

        It pauses after each piece of work.

        Args:
            one, other: its ends.
            needed: (k,) room; where an end has less, the motion may have as little [m].
        """
        least = np.minimum(needed, np.minimum(one.room, other.room))
        step = other.q - one.q
        size = float(np.abs(step).max(initial=0.0))
        if size > _LONGEST:
            return False
        motion = _Motion(one.q, step, size, self._reach @ np.abs(step), least)
        halving = _halving(one.room, other.room, size)
        while True:
            before = halving.counts[0]
            blocked = _halve(motion, halving, self.at_once, self.robot.chain, self._around)
            self.spend(self._cost * int(halving.counts[0] - before))
            if blocked or halving.counts[1] == halving.counts[2]:
                return not blocked
            yield

    def joint_ranges(self, q: Array) -> tuple[Array, Array]:
        """Return the (low, high) positions (n,) to look in; joints without limits about q (n,)."""
        low, high = self.joints.position_min, self.joints.position_max
        return (np.where(np.isfinite(low), low, q - math.pi),
                np.where(np.isfinite(high), high, q + math.pi))

    def distance(self, one: Array, other: Array) -> Array:
        """Return how far postures (…, n) are apart, joint weights included."""
        apart = (other - one) / self.joints.scaling
        return np.asarray(np.sqrt((apart * apart).sum(axis=-1)))


def _halving(one: Array, other: Array, size: float) -> _Halving:
    """Return a motion that has not been halved yet, from the rooms (k,) at its ends.

    Args:
        one, other: the rooms.
        size: of the motion, of the joint that moves furthest [rad, m].
    """
    # A little more than there are, whatever round-off does.
    pieces = 2 ** math.ceil(math.log2(max(1.001 * size / _FINEST, 1.0)))
    found = _Halving(np.empty(pieces + 2), np.empty((pieces + 2, len(one))),
                     np.empty((2 * pieces + 1, 2), dtype=np.intp), np.array((2, 0, 1)))
    found.at[0], found.at[1] = 0.0, 1.0
    found.rooms[0], found.rooms[1] = one, other
    found.pieces[0] = 0, 1
    return found


class _Scratch(NamedTuple):
    """Room for the numbers of one posture."""

    arm: Kinematics
    places: JointPlaces
    pairs: Pairs
    points: Stack


@kernel
def _new_scratch(q: Vector, chain: Chain, around: _Around) -> _Scratch:
    """Return arrays for `_write_room`."""
    shape = around.obstacles.smallest.shape
    return _Scratch(
        new_kinematics_compiled(q, len(chain.rows), len(chain.capsule_joint)), new_places(len(q)),
        Pairs(np.empty(shape), np.empty(shape), np.empty(shape)),
        np.empty((len(around.links), 2, 3)))


@kernel
def _write_room(chain: Chain, around: _Around, scratch: _Scratch, room: OutVector) -> None:
    """Write the room (k,) at the posture that is in the scratch's arm."""
    arm, pairs, obstacles = scratch.arm, scratch.pairs, around.obstacles
    fill(chain, scratch.places, arm)
    measure(obstacles, arm.segment_start, arm.segment_end, 0.0, _AMPLE, pairs)
    links = len(chain.capsule_joint)
    room[:] = np.inf
    for link in range(links):
        for obstacle in range(pairs.distance.shape[1]):
            if not is_contact(obstacles, link, obstacle):
                room[link] = min(room[link], pairs.distance[link, obstacle])
    ends = links + len(around.links)
    write_link_distances(arm.segment_start, arm.segment_end, around.radii, around.links,
                         room[links:ends], scratch.points)
    if around.in_cone:
        cosine = 0.0
        for i in range(3):
            for j in range(3):
                cosine += around.cone.direction[i] * arm.tip_rotation[i, j] * around.cone.axis[j]
        room[ends] = around.cone.angle - math.acos(min(max(cosine, -1.0), 1.0))
    for i in range(len(room)):
        room[i] += around.forgiven[i]


@entry
def _rooms(postures: Matrix, chain: Chain, around: _Around) -> Matrix:
    """Return the room (N, k) of links at N postures (N, n).

    Args:
        postures: where the joints are.
        chain: the arm.
        around: what is in its way.
    """
    rooms = np.empty((len(postures), len(around.forgiven)))
    scratch = _new_scratch(np.empty(postures.shape[1]), chain, around)
    for i in range(len(postures)):
        scratch.arm.q[:] = postures[i]
        _write_room(chain, around, scratch, rooms[i])
    return rooms


@entry
def _halve(
    motion: _Motion, halving: _Halving, most: int, chain: Chain, around: _Around,
) -> bool:
    """Go on halving a motion; return whether it is blocked.

    Args:
        motion: what is halved.
        halving: the state, which is changed.
        most: how many postures are looked at.
        chain, around: as of `_rooms`.
    """
    at, rooms, pieces, counts = halving.at, halving.rooms, halving.pieces, halving.counts
    start, step, size, way, least = motion
    scratch, end = _new_scratch(start, chain, around), counts[0] + most
    while counts[1] < counts[2]:
        one, other = pieces[counts[1]]
        span = at[other] - at[one]
        narrow = False
        for k in range(len(way)):
            narrow = narrow or span * way[k] > rooms[one, k] + rooms[other, k]
        if narrow and span * size > _FINEST:
            middle = counts[0]
            if middle == end:
                return False
            at[middle] = 0.5 * (at[one] + at[other])
            for j in range(len(step)):
                scratch.arm.q[j] = start[j] + at[middle] * step[j]
            _write_room(chain, around, scratch, rooms[middle])
            for k in range(len(way)):
                if rooms[middle, k] < least[k]:
                    return True
            last = counts[2]
            pieces[last, 0], pieces[last, 1] = one, middle
            pieces[last + 1, 0], pieces[last + 1, 1] = middle, other
            counts[0], counts[2] = middle + 1, last + 2
        counts[1] += 1
    return False
