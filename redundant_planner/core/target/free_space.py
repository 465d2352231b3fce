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
from redundant_planner.core.kernels import entry, IndexPairs, Stack, Vector
from redundant_planner.core.obstacles.clearance import is_contact, measure, Pairs
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.self_collision import write_link_distances
from redundant_planner.core.obstacles.shapes import HALF_SPACE
from redundant_planner.core.robot.cone import cone_room
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# What has more room than this need not be measured exactly [m].
_AMPLE = 0.3
# Pieces of a motion shorter than this are not halved any more [rad, m].
_FINEST = 0.02
# Steps that lead a posture into the tip's cone, to this share of its angle inside.
_STEPS_INTO_CONE, _ROOM_IN_CONE = 6, 0.1
_TINY = 1e-12
# Most room that is asked of pairs of links [m]: a Panda's hand is close to its link5 in most ways.
_ROOM_OF_PAIRS = 2e-3
# How many postures are looked at in one piece of work.
AT_ONCE = 5
# What a posture costs to look at besides its distances, in distances.
_COST_OF_POSTURE = 60


class Place(NamedTuple):
    """A posture, and the room there.

    Attributes:
        q: (n,) [rad, m].
        room: (k,) see `FreeSpace`.
    """

    q: Array
    room: Array


class FreeSpace:
    """The postures at which one arm is free, among obstacles as they are at one moment.

    Room is what a link has to the nearest obstacle, and what pairs of links have to each other,
    margins taken off [m], and how much further the tip may lean in its cone [rad]: k entries, in
    this order.

    Attributes:
        robot: the arm.
        joints: how they are weighed and bounded.
        spent: the work done so far, in distances.
    """

    def __init__(
        self, robot: Robot, constants: RobotConstants, joints: PathJoints,
        obstacles: InflatedObstacles,
    ) -> None:
        """Take a look at obstacles that are inflated for links with their margin."""
        self.robot, self.joints, self.spent = robot, joints, 0
        self._constants, self._obstacles = constants, obstacles
        reach = [constants.lever_arm_bounds, constants.self_lever_arm_bounds]
        self._cone = constants.cone if constants.cone.angle < math.pi else None
        if self._cone is not None:
            # What turns, turns the tip's axis no faster.
            screws = robot.kinematics(np.zeros(robot.n)).joint_screws
            reach.append(np.linalg.norm(screws[3:], axis=0)[None])
        self._reach = np.vstack(reach)
        self._fixed = ~self._reach.any(axis=1)
        self._forgiven = np.zeros(len(self._reach))
        self._cost = obstacles.smallest.size + len(constants.self_pairs) + _COST_OF_POSTURE

    def spend(self, postures: int) -> None:
        """Note work that was done on postures besides measuring them."""
        self.spent += postures * _COST_OF_POSTURE // 2

    def rooms(self, postures: Array) -> Array:
        """Return the room (N, k) at postures (N, n); infinite for links that cannot move."""
        arms = self.robot.kinematics_along(postures)
        self.spent += len(postures) * self._cost
        found = _rooms(
            arms.segment_start, arms.segment_end, self._obstacles, self._constants.radii,
            self._constants.self_pairs, _AMPLE)
        if self._cone is not None:
            cosines = np.clip((arms.tip_rotation @ self._cone.axis) @ self._cone.direction, -1, 1)
            found = np.column_stack((found, self._cone.angle - np.arccos(cosines)))
        found[:, self._fixed] = np.inf
        return np.asarray(found + self._forgiven)

    @property
    def narrow(self) -> bool:
        """Whether the tip has to stay in a cone: few postures do, and random ones do not."""
        return self._cone is not None

    def into_cone(self, q: Array) -> Array:
        """Return a posture (n,) near another one with the tip in its cone, or nearer to that."""
        for _ in range(_STEPS_INTO_CONE if self._cone is not None else 0):
            assert self._cone is not None
            arm = self.robot.kinematics(q)
            room, gradient = cone_room(self._cone, arm.tip_rotation, arm.joint_screws)
            if room > _ROOM_IN_CONE * self._cone.angle:
                break
            missing = 2.0 * _ROOM_IN_CONE * self._cone.angle - room
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
        self._forgiven[:] = 0.0
        room = self.rooms(q[None])[0]
        pairs = slice(len(self._constants.lever_arm_bounds), None)
        self._forgiven[pairs] = np.maximum(-room[pairs], 0.0)
        return Place(q, room + self._forgiven)

    def nearest_obstacle(self, postures: Array) -> float:
        """Return the least room that any link has to an obstacle at postures (N, n) [m]."""
        links = len(self._constants.lever_arm_bounds)
        return float(self.rooms(postures)[:, :links].min(initial=np.inf))

    def away(self, postures: Array) -> Array:
        """Return how far (N,) the links are from any obstacle's middle, on average [m].

        Walls do not count.
        """
        centers = self._obstacles.centers.T[self._obstacles.shapes != HALF_SPACE]
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
        way, size = self._reach @ np.abs(step), float(np.abs(step).max(initial=0.0))
        begin, end = np.zeros(1), np.ones(1)
        before, after = one.room[None], other.room[None]
        while True:
            span = end - begin
            narrow = (span[:, None] * way > before + after).any(axis=1) & (
                span * size > _FINEST)
            if not narrow.any():
                return True
            begin, end, before, after = (
                begin[narrow], end[narrow], before[narrow], after[narrow])
            middle = 0.5 * (begin + end)
            rooms = np.empty_like(before)
            for first in range(0, len(middle), AT_ONCE):
                part = slice(first, first + AT_ONCE)
                rooms[part] = self.rooms(one.q + middle[part, None] * step)
                if (rooms[part] < least).any():
                    return False
                yield
            begin, end = np.concatenate((begin, middle)), np.concatenate((middle, end))
            before, after = np.vstack((before, rooms)), np.vstack((rooms, after))

    def joint_ranges(self, q: Array) -> tuple[Array, Array]:
        """Return the (low, high) positions (n,) to look in; joints without limits about q (n,)."""
        low, high = self.joints.position_min, self.joints.position_max
        return (np.where(np.isfinite(low), low, q - math.pi),
                np.where(np.isfinite(high), high, q + math.pi))

    def distance(self, one: Array, other: Array) -> Array:
        """Return how far postures (…, n) are apart, joint weights included."""
        apart = (other - one) / self.joints.scaling
        return np.asarray(np.sqrt((apart * apart).sum(axis=-1)))


@entry
def _rooms(
    start: Stack, end: Stack, obstacles: InflatedObstacles, radii: Vector, links: IndexPairs,
    ample: float,
) -> Array:
    """Return the room (N, c + p) of links at N postures.

    Args:
        start, end: (N, c, 3) their segments [m].
        obstacles: for links with their margin.
        radii: (c,) with half the margin between links [m].
        links: (p, 2) which of them can collide.
        ample: more than this need not be measured exactly [m].
    """
    count, capsules = start.shape[0], start.shape[1]
    rooms = np.full((count, capsules + len(links)), np.inf)
    shape = obstacles.smallest.shape
    pairs = Pairs(np.empty(shape), np.empty(shape), np.empty(shape))
    points = np.empty((len(links), 2, 3))
    for i in range(count):
        measure(obstacles, start[i], end[i], 0.0, ample, pairs)
        for link in range(capsules):
            for obstacle in range(shape[1]):
                if not is_contact(obstacles, link, obstacle):
                    rooms[i, link] = min(rooms[i, link], pairs.distance[link, obstacle])
        write_link_distances(start[i], end[i], radii, links, rooms[i, capsules:], points)
    return rooms
