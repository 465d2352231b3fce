"""Pulls a way of the joints tight, as an elastic band (Quinlan and Khatib 1993).

Nodes q_1 … q_N between two ends that stay where they are minimise

    ½ (N + 1) Σ ‖q_{i+1} − q_i‖² + ½ p (N + 1) Σ max(0, asked_i − room(q_i))²

with joint weights: nodes spread evenly, and the first sum is half the squared length then. Room
is that of every link, pair of links and cone near a node. A step solves that with rooms linearised
about the nodes. Which of them act is found by solving it again until they stay the same, a few
times at most.
Straight motions from node to node are looked at in the end, and where one is not free its nodes
are asked for more room. Shortcuts only ever lead through the inside of a way; a band also slides
along what is in its way.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_squares import (
    add_of_rate,
    add_row,
    smallest_of,
    Squares,
    Stencil,
)
from redundant_planner.core.kernels import (
    entry,
    Flags,
    Indices,
    kernel,
    Matrix,
    OutMatrix,
    OutStack,
    Vector,
)
from redundant_planner.core.obstacles.clearance import is_contact
from redundant_planner.core.obstacles.clearance_gradients import clearance_gradient
from redundant_planner.core.obstacles.self_collision import distance_gradients
from redundant_planner.core.robot.cone import cone_room
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.target.free_space import FreeSpace, Place
from redundant_planner.core.target.joint_curve import evenly, lengths_along
from redundant_planner.core.target.straight_motion import (
    Arena,
    begin_motion,
    BLOCKED,
    go_on_with,
    Motion,
    new_motion,
    new_scratch,
    PENDING,
    write_room,
)

Array = npt.NDArray[np.float64]

# Distance of nodes [rad], and how many pieces they divide a way into at most.
_SPACING, _MOST_PIECES = 0.12, 40
# The square of a lack of room counts so much beside the square of the length [rad²/m²].
_PRICE = 1e3
# Nodes are asked for so much more room than motions: in between, links move in arcs [m].
_RESERVE = 2e-3
# A step leaves out what has this much more room than is asked; the next one looks again [m].
_WITHIN = 0.1
# Rows of a node, the least room first.
_MOST_ROWS = 32
# How far a step moves a joint of a node at most. It is the last one if it moves none by the other
# [rad, m].
_LARGEST_STEP, _SETTLED = 0.2, 0.05
# Steps of every other node, and then of all of them, at most.
_STEPS, _STEPS_AGAIN = 6, 4
# A step solves its problem so many times at most. For each node that costs n³ times this with n
# joints, and a row of the problem this [ns].
_SOLUTIONS, _COST_OF_SOLUTION, _COST_OF_ROW = 6, 4, 150
# What a new band costs [ns].
_COST_OF_BAND = 200_000
# How often nodes beside a motion that is not free are asked for more room, and how much [m].
_TRIES, _MORE = 6, 4e-3
_ROUND_OFF = 1e-9


class Band(NamedTuple):
    """A band and its problem.

    Attributes:
        nodes: (N, n) [rad, m].
        ends: (2, n) likewise.
        asked: (N, k) room at the nodes, see `FreeSpace`.
        gradients: (N, R, n) of rooms near the nodes [m/rad].
        spare: (N, R) what these rooms have more than is asked [m].
        acts: (N, R) 1 where they count in the step, 0 where not, −1 where that is not known.
        rows: (N,) how many of the R there are.
        squares: of the problem.
        step: (N, n) its solution.
    """

    nodes: OutMatrix
    ends: Matrix
    asked: OutMatrix
    gradients: OutStack
    spare: OutMatrix
    acts: OutMatrix
    rows: Indices
    squares: Squares
    step: OutMatrix


def new_band(postures: Array, asked: Array) -> Band:
    """Return the band of postures (N + 2, n) that is asked for room (N, k) between its ends."""
    count, n = len(postures) - 2, postures.shape[1]
    rows = (count, _MOST_ROWS)
    return Band(
        postures[1:-1].copy(), postures[[0, -1]], asked.copy(), np.empty((*rows, n)),
        np.empty(rows), np.empty(rows), np.zeros(count, dtype=np.intp),
        Squares(np.zeros((count * n, count * n)), np.empty(count * n)), np.zeros((count, n)))


@kernel
def _row_for(band: Band, node: int, spare: float) -> int:
    """Return the row for what has so much to spare at a node; −1 where others are more urgent."""
    row, most = band.rows[node], band.spare.shape[1]
    if row < most:
        band.rows[node] = row + 1
    else:
        row = 0
        for other in range(1, most):
            if band.spare[node, other] > band.spare[node, row]:
                row = other
        if band.spare[node, row] <= spare:
            return -1
    band.spare[node, row], band.acts[node, row] = spare, -1.0
    return row


@entry
def look_at_nodes(band: Band, first: int, last: int, arena: Arena) -> int:
    """Linearise the rooms near some nodes of a band, and have its step begin anew.

    Returns how much work it was [ns].

    Args:
        band: which is changed.
        first, last: which nodes, the last one not among them.
        arena: where it leads.
    """
    scratch, chain = new_scratch(arena), arena.chain
    arm, obstacles, n = scratch.arm, arena.obstacles, band.nodes.shape[1]
    (links, count), pairs = obstacles.smallest.shape, len(arena.links)
    room, near = np.empty(len(arena.forgiven)), np.empty(pairs, np.intp)
    for node in range(first, min(last, len(band.nodes))):
        asked = band.asked[node]
        band.rows[node] = 0
        band.step[node] = 0.0
        arm.q[:] = band.nodes[node]
        for k in range(len(asked)):
            scratch.enough[k] = asked[k] + _WITHIN
        write_room(arena, scratch, room)
        moved = Links(arm.segment_start, arm.segment_end, arm.joint_screws, chain.supports,
                      chain.parents)
        for link in range(links):
            for obstacle in range(count if room[link] < asked[link] + _WITHIN else 0):
                spare = scratch.pairs.distance[link, obstacle] - asked[link]
                if spare >= _WITHIN or is_contact(obstacles, link, obstacle):
                    continue
                row = _row_for(band, node, spare)
                if row >= 0:
                    gradient = band.gradients[node, row]
                    clearance_gradient(
                        obstacles, link, obstacle, scratch.pairs.parameter[link, obstacle], 0.0,
                        moved, gradient)
                    for j in range(n):
                        gradient[j] *= obstacles.smallest[link, obstacle]
        found = 0
        for pair in range(pairs):
            if room[links + pair] < asked[links + pair] + _WITHIN:
                near[found] = pair
                found += 1
        slopes = distance_gradients(
            scratch.points, near[:found], arm.joint_screws, arena.supports)
        for i in range(found):
            row = _row_for(band, node, room[links + near[i]] - asked[links + near[i]])
            if row >= 0:
                band.gradients[node, row] = slopes[i]
        for t in range(len(arm.tip_rotations) if arena.in_cone else 0):
            left, slope = cone_room(
                arena.joints.cone, arm.tip_rotations[t], arm.tip_jacobian[6 * t:6 * t + 6])
            row = _row_for(band, node, left - asked[links + pairs])
            if row >= 0:
                band.gradients[node, row] = slope
        scratch.work[0] += _COST_OF_ROW * band.rows[node]
    return scratch.work[0]


@kernel
def _choose_acting(band: Band) -> bool:
    """Choose the rooms that act, given the step so far; return whether others did before."""
    changed = False
    for node in range(len(band.nodes)):
        for row in range(band.rows[node]):
            then = band.spare[node, row]
            for j in range(band.nodes.shape[1]):
                then += band.gradients[node, row, j] * band.step[node, j]
            acts = 1.0 if then < 0.0 else 0.0
            changed = changed or acts != band.acts[node, row]
            band.acts[node, row] = acts
    return changed


@entry
def solve_step(band: Band, scaling: Vector) -> bool:
    """Solve a band's problem for the rooms that act; return whether others did before."""
    if not _choose_acting(band):
        return False
    nodes, (count, n) = band.nodes, band.nodes.shape
    hessian, linear = band.squares
    size, last = len(linear), 2 * n - 1
    for i in range(size):
        linear[i] = 0.0
        for j in range(max(i - last, 0), min(i + last + 1, size)):
            hessian[i, j] = 0.0
    for i in range(count + 1):
        for j in range(n):
            before = band.ends[0, j] if i == 0 else nodes[i - 1, j]
            weight = (count + 1) / (scaling[j] * scaling[j])
            if i < count:
                add_of_rate(band.squares, i * n + j, n, Stencil(1.0, -1.0, 0.0),
                            nodes[i, j] - before, weight)
            else:
                add_of_rate(band.squares, (i - 1) * n + j, n, Stencil(-1.0, 0.0, 0.0),
                            band.ends[1, j] - before, weight)
    for i in range(count):
        for row in range(band.rows[i]):
            if band.acts[i, row] == 1.0:
                add_row(band.squares, i * n, band.gradients[i, row], band.spare[i, row],
                        _PRICE * (count + 1))
    x = smallest_of(hessian, linear, last)
    for i in range(count):
        band.step[i] = x[i * n:i * n + n]
    return True


class Look(NamedTuple):
    """A look at the straight motions from posture to posture.

    Attributes:
        postures, rooms: (N + 2, n) and (N + 2, k) there.
        blocked: (N + 1,) which motions are not free; those known not to be are not looked at.
        at: (2,) the next one, and 1 if it is being looked at.
    """

    postures: Matrix
    rooms: Matrix
    blocked: Flags
    at: Indices


@entry
def go_on_looking_at(
    look: Look, motion: Motion, needed: Vector, most: int, arena: Arena,
) -> int:
    """Look at a few more motions; return how much work it was [ns].

    Args:
        look: which is changed.
        motion: the one that is looked at.
        needed: (k,) room; where an end has less, a motion may have as little [m].
        most: how much work it may be, about.
        arena: where they lead.
    """
    blocked, at = look.blocked, look.at
    scratch = new_scratch(arena)
    while at[0] < len(blocked) and scratch.work[0] < most:
        i = at[0]
        if at[1] == 0 and (blocked[i] or not begin_motion(
                motion, look.postures[i], look.rooms[i], look.postures[i + 1],
                look.rooms[i + 1], needed, arena)):
            blocked[i] = True
            at[0] = i + 1
            continue
        at[1] = 1
        found = go_on_with(motion, most, arena, scratch)
        if found == PENDING:
            break
        blocked[i] = found == BLOCKED
        at[0], at[1] = i + 1, 0
    return scratch.work[0]


def pulled_tight(
    space: FreeSpace, way: Sequence[Place], room: float,
) -> Generator[None, None, list[Place] | None]:
    """Return a way pulled tight; None where it then has less room than before, or is longer.

    It pauses after each piece of work.

    Args:
        space: where the arm may be.
        way: places with free motions between them.
        room: that it has, and shall have [m]; where it has less it may have as little.
    """
    polygon, scaling = np.array([place.q for place in way]), space.joints.scaling
    size, needed = float(lengths_along(polygon, scaling)[-1]), space.asked(room)
    pieces = 2 * min(max(math.ceil(0.5 * size / _SPACING), 4), _MOST_PIECES // 2)
    postures = evenly(polygon, scaling, pieces)
    space.spend(_COST_OF_BAND)
    yield
    rooms = yield from _rooms(space, postures)
    least = np.minimum(needed, rooms)
    asked = least + _RESERVE
    # Every other node first: most of the way to go is theirs.
    coarse = new_band(postures[::2], asked[2:-1:2])
    yield from _relaxed(space, coarse, _STEPS)
    postures[2:-1:2] = coarse.nodes
    postures[1::2] = 0.5 * (postures[:-1:2] + postures[2::2])
    band = new_band(postures, asked[1:-1])
    for _ in range(_TRIES):
        yield from _relaxed(space, band, _STEPS_AGAIN)
        postures[1:-1] = band.nodes
        rooms[1:-1] = yield from _rooms(space, band.nodes)
        blocked = yield from _blocked(space, postures, rooms, least, needed)
        if not blocked.any():
            tight = [way[0], *map(Place, postures[1:-1], rooms[1:-1]), way[-1]]
            shorter = float(lengths_along(postures, scaling)[-1]) < size
            return tight if shorter and (yield from space.keeps_rules(tight)) else None
        band.asked[blocked[:-1] | blocked[1:]] += _MORE
    return None


def _relaxed(space: FreeSpace, band: Band, steps: int) -> Generator[None, None, None]:
    """Let a band go where it is shorter."""
    (count, n), joints = band.nodes.shape, space.joints
    for _ in range(steps):
        for some in space.slices(count):
            space.spend(look_at_nodes(band, some.start, some.stop, space.arena))
            yield
        for _ in range(_SOLUTIONS):
            changed = solve_step(band, joints.scaling)
            space.spend(_COST_OF_SOLUTION * count * n**3)
            yield
            if not changed:
                break
        step = np.clip(band.step, -_LARGEST_STEP, _LARGEST_STEP)
        band.nodes[:] = np.clip(band.nodes + step, joints.position_min, joints.position_max)
        if np.abs(step).max() < _SETTLED:
            break


def _rooms(space: FreeSpace, postures: Array) -> Generator[None, None, Array]:
    """Return the room (N, k) at postures (N, n)."""
    rooms = []
    for some in space.slices(len(postures)):
        rooms.append(space.rooms(postures[some]))
        yield
    return np.concatenate(rooms)


def _blocked(
    space: FreeSpace, postures: Array, rooms: Array, least: Array, needed: Array,
) -> Generator[None, None, Flags]:
    """Return which straight motions (N + 1,) from posture to posture are not free.

    Args:
        space: where the arm may be.
        postures, rooms: (N + 2, n) and (N + 2, k) there.
        least: (N + 2, k) room that is asked there.
        needed: (k,) see `go_on_looking_at`.
    """
    short: Flags = np.any(rooms < least - _ROUND_OFF, axis=1)
    look = Look(postures, rooms, short[:-1] | short[1:], np.zeros(2, dtype=np.intp))
    motion = new_motion(
        postures.shape[1], len(needed), float(np.abs(np.diff(postures, axis=0)).max()))
    while look.at[0] < len(look.blocked):
        space.spend(go_on_looking_at(look, motion, needed, space.piece, space.arena))
        yield
    return look.blocked
