"""Makes a way of the joints shorter by straight motions between its points, or to other ends."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import (
    entry,
    Indices,
    kernel,
    Matrix,
    OutMatrix,
    OutVector,
    Vector,
)
from redundant_planner.core.target.straight_motion import (
    Arena,
    begin_motion,
    FREE,
    go_on_with,
    Motion,
    new_scratch,
    PENDING,
    write_room,
)

Array = npt.NDArray[np.float64]

# A shortcut must save this share of the way, and the least one about a corner takes this power of
# a half of it.
_LEAST_GAIN, _FINEST_CUT = 1e-3, 5.0
# What a shortcut leads to, in the order in which they are tried.
_TO_GOAL, _FROM_START, _TO_END, _CORNER = range(4)
_CUTS = 4
# Random numbers of an attempt.
NUMBERS = 6
# What the choice of a shortcut costs [ns].
_COST_OF_ATTEMPT = 150
# More corners than before a shortcut takes away.
_ADDED = 2
# The entries of `Shortening.numbers`: corners of the way, attempts, those in vain one after the
# other, the corners after which a shortcut begins and before which it ends, whether it leads from
# the way's start and to its end, its goal or −1, and whether it is looked at.
(COUNT, _ATTEMPT, _IN_VAIN, _BEFORE, _AFTER, _AT_START, _AT_END, _GOAL, _LOOKS) = range(9)


class Shortening(NamedTuple):
    """A way that becomes shorter.

    Attributes:
        postures: (W, n) its corners, and room for more [rad, m].
        rooms: (W, k) there.
        along: (W,) its length up to each of them [rad].
        ends: (2, n) where a shortcut begins and ends.
        end_rooms: (2, k) there.
        numbers: (9,) see above.
    """

    postures: OutMatrix
    rooms: OutMatrix
    along: OutVector
    ends: OutMatrix
    end_rooms: OutMatrix
    numbers: Indices


def new_shortening(postures: Array, rooms: Array, scaling: Array) -> Shortening:
    """Return a way, postures (w, n) with room (w, k), that is to become shorter."""
    count, n = postures.shape
    most = 2 * count + 8
    way = Shortening(
        np.empty((most, n)), np.empty((most, rooms.shape[1])), np.zeros(most), np.empty((2, n)),
        np.empty((2, rooms.shape[1])), np.zeros(9, dtype=np.intp))
    way.postures[:count], way.rooms[:count], way.numbers[COUNT] = postures, rooms, count
    steps = np.diff(postures, axis=0) / scaling
    way.along[1:count] = np.cumsum(np.sqrt((steps * steps).sum(axis=1)))
    return way


@kernel
def _put_point(way: Shortening, at: float, end: int) -> int:
    """Write the posture at a length of a way to a shortcut's end; return the corner before."""
    along, last, i = way.along, way.numbers[COUNT] - 2, 0
    while i < last and along[i + 1] <= at:
        i += 1
    piece = along[i + 1] - along[i]
    share = (at - along[i]) / piece if piece > 0.0 else 0.0
    for j in range(way.ends.shape[1]):
        one, other = way.postures[i, j], way.postures[i + 1, j]
        way.ends[end, j] = one + share * (other - one)
    return i


@kernel
def _distance(one: Vector, other: Vector, scaling: Vector) -> float:
    squared = 0.0
    for j in range(len(one)):
        apart = (other[j] - one[j]) / scaling[j]
        squared = squared + apart * apart
    return math.sqrt(squared)


@kernel
def _choose(
    way: Shortening, goals: Matrix, numbers: Vector, scaling: Vector,
) -> bool:
    """Choose a shortcut by random numbers; return whether it is one."""
    state = way.numbers
    count, kind = state[COUNT], state[_ATTEMPT] % _CUTS
    whole = way.along[count - 1]
    begin, end = whole * min(numbers[0], numbers[1]), whole * max(numbers[0], numbers[1])
    if kind == _CORNER:
        corner = way.along[min(int(numbers[2] * count), count - 1)]
        size = whole * 2.0 ** (-_FINEST_CUT * numbers[3])
        begin = max(corner - size * numbers[0], 0.0)
        end = min(corner + size * numbers[1], whole)
    if kind == _FROM_START:
        begin = 0.0
    if kind in (_TO_GOAL, _TO_END):
        end = whole
    state[_AT_START], state[_AT_END] = 1 if begin == 0.0 else 0, 1 if end == whole else 0
    state[_GOAL] = min(int(numbers[4] * len(goals)), len(goals) - 1) if kind == _TO_GOAL else -1
    state[_BEFORE] = _put_point(way, begin, 0)
    state[_AFTER] = _put_point(way, end, 1)
    if state[_AT_END] == 1:
        way.ends[1] = way.postures[count - 1]
    if state[_GOAL] >= 0:
        way.ends[1] = goals[state[_GOAL]]
    saved = (end - begin) - _distance(way.ends[0], way.ends[1], scaling)
    return saved >= _LEAST_GAIN * whole


@kernel
def _take(way: Shortening, scaling: Vector) -> bool:
    """Put the shortcut into the way; return whether there was room for its corners."""
    state = way.numbers
    count = state[COUNT]
    head = 0 if state[_AT_START] == 1 else state[_BEFORE] + 1
    tail = count if state[_AT_END] == 1 else state[_AFTER] + 1
    left, first = count - tail, head + _ADDED
    if first + left > len(way.postures):
        return False
    # Corners after the shortcut move up or down.
    for step in range(left):
        i = step if first <= tail else left - 1 - step
        way.postures[first + i], way.rooms[first + i] = (
            way.postures[tail + i].copy(), way.rooms[tail + i].copy())
    for end in range(2):
        way.postures[head + end] = way.ends[end]
        way.rooms[head + end] = way.end_rooms[end]
    state[COUNT] = first + left
    way.along[0] = 0.0
    for i in range(max(head, 1), state[COUNT]):
        way.along[i] = way.along[i - 1] + _distance(
            way.postures[i - 1], way.postures[i], scaling)
    return True


@entry
def shorten(
    way: Shortening, motion: Motion, goals: Matrix, goal_rooms: Matrix, random: Matrix,
    needed: Vector, most_in_vain: int, most: int, arena: Arena,
) -> tuple[bool, int]:
    """Make a way a little shorter; return whether that is over, and how much work it was.

    Args:
        way: which is changed.
        motion: the shortcut that is looked at.
        goals, goal_rooms: (g, n) and (g, k) other ends.
        random: (a, `NUMBERS`) from 0 to 1, for each attempt.
        needed: (k,) room of shortcuts; the ends of the way may have less.
        most_in_vain: after so many attempts in vain it is over.
        most: how much work it may be, about [ns].
        arena: where it leads.
    """
    state, scratch, scaling = way.numbers, new_scratch(arena), arena.joints.scaling
    while scratch.work[0] < most:
        if state[_LOOKS] == 1:
            found = go_on_with(motion, most, arena, scratch)
            if found == PENDING:
                break
            state[_LOOKS] = 0
            if found == FREE and _take(way, scaling):
                state[_IN_VAIN] = 0
            continue
        if state[_ATTEMPT] == len(random) or state[_IN_VAIN] > most_in_vain or (
                state[COUNT] == 2 and state[_ATTEMPT] > _CUTS * len(goals)):
            return True, scratch.work[0]
        scratch.work[0] += _COST_OF_ATTEMPT
        chosen = _choose(way, goals, random[state[_ATTEMPT]], scaling)
        state[_ATTEMPT] += 1
        state[_IN_VAIN] += 1
        if not chosen:
            continue
        roomy, scratch.least[:] = True, needed
        for end in range(2):
            if end == 0 and state[_AT_START] == 1:
                way.end_rooms[0] = way.rooms[0]
            elif end == 1 and state[_GOAL] >= 0:
                way.end_rooms[1] = goal_rooms[state[_GOAL]]
            elif end == 1 and state[_AT_END] == 1:
                way.end_rooms[1] = way.rooms[state[COUNT] - 1]
            elif roomy:
                scratch.arm.q[:] = way.ends[end]
                roomy = write_room(arena, scratch, way.end_rooms[end])
        scratch.least[:] = -np.inf
        if roomy and begin_motion(motion, way.ends[0], way.end_rooms[0], way.ends[1],
                                  way.end_rooms[1], needed, arena):
            state[_LOOKS] = 1
    return False, scratch.work[0]
