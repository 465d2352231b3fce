"""How much room links have at a posture, and whether a straight motion of the joints is free.

No point of a link moves further in a motion Δq than Σ_j b_j |Δq_j|, with the lever arm bounds b.
A motion is therefore free where every link has, at both ends together, more room than that.
Otherwise the posture half way is looked at, and so on (Schwarzer, Saha and Latombe 2005).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import PathJoints
from redundant_planner.core.kernels import (
    entry,
    IndexPairs,
    Indices,
    kernel,
    Matrix,
    OutMatrix,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.obstacles.clearance import (
    bound_by_balls,
    is_contact,
    measure_until,
    Pairs,
)
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.self_collision import write_link_distances
from redundant_planner.core.obstacles.shapes import ELLIPSOID
from redundant_planner.core.robot.kinematics import (
    Chain,
    fill,
    fill_links,
    JointPlaces,
    Kinematics,
    new_kinematics_compiled,
    new_places,
    place_joints,
)

Array = npt.NDArray[np.float64]

# What has more room than this need not be measured exactly [m].
_AMPLE = 0.3
# What memory for numbers costs and the call from Python that needs it, and at a posture a joint,
# the tips and two links [ns].
COST_OF_CALL, _COST_OF_JOINT, _COST_OF_TIPS, _COST_OF_LINKS = 10_000, 250, 800, 10
# What a link and the ball around an obstacle cost, or an ellipsoid; and a distance from anything
# else that its ball does not settle, be it a bound or exact, on average [ns].
_COST_OF_BALL, _COST_OF_DISTANCE = 6, 42
# Pieces of a motion shorter than this are not halved any more, and one that is longer than a
# hundred turns counts as blocked, as nobody has the memory to look at it [rad, m].
_FINEST, _LONGEST = 0.02, 630.0
# What is known of a motion: that it is looked at, that it is free, or that it is not.
PENDING, FREE, BLOCKED = range(3)


class Arena(NamedTuple):
    """An arm, and what keeps its links from being anywhere.

    Attributes:
        chain: the arm.
        joints: how they are weighed and bounded.
        reach: (k, n) how far a point of what has room may come for each rad or m of a joint.
        obstacles: for links with their margin.
        radii: (c,) with half the margin between links [m].
        links: (p, 2) which of them can collide.
        supports: (p, n) see `SelfPairs`.
        in_cone: whether the tip has to stay in the cone of `joints`.
        forgiven: (k,) what is added to the room, infinite for links that cannot move.
    """

    chain: Chain
    joints: PathJoints
    reach: Matrix
    obstacles: InflatedObstacles
    radii: Vector
    links: IndexPairs
    supports: Matrix
    in_cone: bool
    forgiven: Vector


class Motion(NamedTuple):
    """A straight motion that is halved until it is known to be free.

    Attributes:
        start: (n,) where it begins [rad, m].
        step: (n,) the way to its end.
        far: (k,) how far links may come on it [m].
        least: (k,) room that it has to have.
        at: (s,) shares of the motion that have been looked at; its ends come first.
        rooms: (s, k) there.
        pieces: (t, 2) which of them are ends of a piece, in the order in which they are halved.
        counts: (3,) how many have been looked at, have been halved, and there are.
    """

    start: OutVector
    step: OutVector
    far: OutVector
    least: OutVector
    at: OutVector
    rooms: OutMatrix
    pieces: IndexPairs
    counts: Indices


def new_motion(n: int, rooms: int, longest: float) -> Motion:
    """Return room for motions of n joints whose joints move no further than the longest does.

    Args:
        n: joints.
        rooms: how many entries room has.
        longest: [rad, m]; further than a hundred turns is no further.
    """
    # A little more than there are, whatever round-off does.
    pieces = 2 ** math.ceil(math.log2(max(1.001 * min(longest, _LONGEST) / _FINEST, 1.0)))
    return Motion(
        np.empty(n), np.empty(n), np.empty(rooms), np.empty(rooms), np.empty(pieces + 2),
        np.empty((pieces + 2, rooms)), np.empty((2 * pieces + 1, 2), dtype=np.intp),
        np.zeros(3, dtype=np.intp))


class Scratch(NamedTuple):
    """Room for the numbers of one posture.

    Attributes:
        enough: (k,) room that need not be measured any further.
        least: (k,) where something has less room, nothing else need be known.
        work: (1,) how much has been done, see `FreeSpace` [ns].
    """

    arm: Kinematics
    places: JointPlaces
    pairs: Pairs
    points: Stack
    enough: Vector
    least: Vector
    work: Indices


def usual_work(arena: Arena) -> int:
    """Return how much work a posture is where a quarter of the obstacles are near."""
    return (_COST_OF_JOINT * arena.reach.shape[1] + _COST_OF_LINKS * len(arena.links)
            + (_COST_OF_BALL + _COST_OF_DISTANCE // 4) * arena.obstacles.smallest.size)


@kernel
def new_scratch(arena: Arena) -> Scratch:
    """Return arrays for `write_room`."""
    chain, shape = arena.chain, arena.obstacles.smallest.shape
    rooms, n = arena.reach.shape
    return Scratch(
        new_kinematics_compiled(
            np.empty(n), len(chain.rows), len(chain.tip_joints), len(chain.capsule_joint)),
        new_places(n),
        Pairs(np.empty(shape), np.empty(shape), np.empty(shape)),
        np.empty((len(arena.links), 2, 3)), np.full(rooms, _AMPLE), np.full(rooms, -np.inf),
        np.full(1, COST_OF_CALL, np.intp))


@kernel
def write_room(arena: Arena, scratch: Scratch, room: OutVector) -> bool:
    """Write the room (k,) at the posture that is in the scratch's arm.

    What has more room to obstacles than `scratch.enough` may be given a bound from below. Where
    something has less than `scratch.least` False is returned, and the room is not complete.
    """
    arm, pairs, obstacles, enough = scratch.arm, scratch.pairs, arena.obstacles, scratch.enough
    chain, cone = arena.chain, arena.joints.cone
    if arena.in_cone:
        fill(chain, scratch.places, arm)
        scratch.work[0] += _COST_OF_TIPS
    else:
        place_joints(arm.q, chain, scratch.places, arm.joint_screws)
        fill_links(scratch.places, chain, arm.segment_start, arm.segment_end)
    links, forgiven = len(chain.capsule_joint), arena.forgiven
    ends = links + len(arena.links)
    scratch.work[0] += _COST_OF_JOINT * len(arm.q) + _COST_OF_LINKS * len(arena.links)
    room[:] = np.inf
    write_link_distances(arm.segment_start, arm.segment_end, arena.radii, arena.links,
                         room[links:ends], scratch.points)
    if arena.in_cone:
        for t in range(len(arm.tip_rotations)):
            cosine, rotation = 0.0, arm.tip_rotations[t]
            for i in range(3):
                for j in range(3):
                    cosine += cone.direction[i] * rotation[i, j] * cone.axis[j]
            room[ends] = min(
                room[ends], cone.angle - math.acos(min(max(cosine, -1.0), 1.0)))
    for k in range(links, len(room)):
        if room[k] + forgiven[k] < scratch.least[k]:
            return False
    scratch.work[0] += _COST_OF_BALL * pairs.distance.size
    bound_by_balls(obstacles, arm.segment_start, arm.segment_end, 0.0, pairs.distance)
    for link in range(links):
        for obstacle in range(pairs.distance.shape[1]):
            bound = pairs.distance[link, obstacle]
            if obstacles.shapes[obstacle] != ELLIPSOID and bound > enough[link]:
                if not is_contact(obstacles, link, obstacle):
                    room[link] = min(room[link], bound)
                pairs.distance[link, obstacle] = np.inf
    scratch.work[0] += _COST_OF_DISTANCE * measure_until(
        obstacles, arm.segment_start, arm.segment_end, enough, scratch.least, forgiven, pairs)
    for link in range(links):
        for obstacle in range(pairs.distance.shape[1]):
            if not is_contact(obstacles, link, obstacle):
                room[link] = min(room[link], pairs.distance[link, obstacle])
    for k in range(len(room)):
        room[k] += forgiven[k]
        if room[k] < scratch.least[k]:
            return False
    return True


@entry
def rooms_at(postures: Matrix, arena: Arena) -> tuple[Matrix, int]:
    """Return the room (N, k) of links at N postures (N, n), and how much work that was."""
    rooms = np.empty((len(postures), len(arena.forgiven)))
    scratch = new_scratch(arena)
    for i in range(len(postures)):
        scratch.arm.q[:] = postures[i]
        write_room(arena, scratch, rooms[i])
    return rooms, scratch.work[0]


@kernel
def begin_motion(
    motion: Motion, start: Vector, room: Vector, end: Vector, end_room: Vector, needed: Vector,
    arena: Arena,
) -> bool:
    """Begin to look at a motion; return whether there is memory for one as long.

    Args:
        motion: which is filled.
        start, end: (n,) its ends.
        room, end_room: (k,) there.
        needed: (k,) room; where an end has less, the motion may have as little [m].
        arena: where it leads.
    """
    size = 0.0
    for j in range(len(start)):
        motion.start[j], motion.step[j] = start[j], end[j] - start[j]
        size = max(size, abs(motion.step[j]))
    if not size <= _FINEST * (len(motion.at) - 2):
        return False
    for k in range(len(needed)):
        motion.least[k] = min(needed[k], min(room[k], end_room[k]))
        motion.far[k] = 0.0
        for j in range(len(start)):
            motion.far[k] += arena.reach[k, j] * abs(motion.step[j])
    motion.at[0], motion.at[1] = 0.0, 1.0
    motion.rooms[0], motion.rooms[1] = room, end_room
    motion.pieces[0, 0], motion.pieces[0, 1] = 0, 1
    motion.counts[0], motion.counts[1], motion.counts[2] = 2, 0, 1
    return True


@kernel
def go_on_with(motion: Motion, most: int, arena: Arena, scratch: Scratch) -> int:
    """Go on halving a motion; return whether it is free, blocked, or still looked at.

    Args:
        motion: which is changed.
        most: no other posture is begun once `scratch.work` has reached this [ns].
        arena: where it leads.
        scratch: for numbers.
    """
    at, rooms, pieces, counts = motion.at, motion.rooms, motion.pieces, motion.counts
    size = 0.0
    for j in range(len(motion.step)):
        size = max(size, abs(motion.step[j]))
    while counts[1] < counts[2]:
        one, other = pieces[counts[1]]
        span = at[other] - at[one]
        narrow = False
        for k in range(len(motion.far)):
            narrow = narrow or span * motion.far[k] > rooms[one, k] + rooms[other, k]
        if narrow and span * size > _FINEST:
            if scratch.work[0] >= most:
                return PENDING
            middle = counts[0]
            at[middle] = 0.5 * (at[one] + at[other])
            for j in range(len(motion.step)):
                scratch.arm.q[j] = motion.start[j] + at[middle] * motion.step[j]
            for k in range(len(motion.far)):
                # More than that keeps either half free, and so much is known.
                half = 0.5 * span * motion.far[k]
                known = max(rooms[one, k], rooms[other, k]) - half
                scratch.enough[k] = max(half, motion.least[k]) - arena.forgiven[k]
                scratch.least[k] = motion.least[k]
                if known >= motion.least[k]:
                    scratch.least[k] = -np.inf
                    if 2.0 * half <= rooms[one, k] + rooms[other, k]:
                        scratch.enough[k] = -np.inf
            free = write_room(arena, scratch, rooms[middle])
            scratch.enough[:], scratch.least[:] = _AMPLE, -np.inf
            counts[0] = middle + 1
            if not free:
                return BLOCKED
            for k in range(len(motion.far)):
                half = 0.5 * span * motion.far[k]
                rooms[middle, k] = max(
                    rooms[middle, k], max(rooms[one, k], rooms[other, k]) - half)
                if rooms[middle, k] < motion.least[k]:
                    return BLOCKED
            last = counts[2]
            pieces[last, 0], pieces[last, 1] = one, middle
            pieces[last + 1, 0], pieces[last + 1, 1] = middle, other
            counts[2] = last + 2
        counts[1] += 1
    return FREE


@entry
def begin_looking(
    motion: Motion, start: Vector, room: Vector, end: Vector, end_room: Vector, needed: Vector,
    arena: Arena,
) -> bool:
    """Begin to look at a motion, see `begin_motion`."""
    return begin_motion(motion, start, room, end, end_room, needed, arena)


@entry
def go_on_looking(motion: Motion, most: int, arena: Arena) -> tuple[int, int]:
    """Go on looking at a motion, see `go_on_with`; return its state, and how much work it was."""
    scratch = new_scratch(arena)
    return go_on_with(motion, most, arena, scratch), scratch.work[0]
