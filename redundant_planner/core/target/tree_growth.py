"""Two trees of postures that grow towards random ones and each other (RRT-Connect).

Kuffner and LaValle 2000. After each attempt the smaller tree is the next to grow: one in a corner
would else keep a few postures while the other one fills its space.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import (
    entry,
    IndexPairs,
    Indices,
    kernel,
    Matrix,
    OutStack,
    OutVector,
    Vector,
)
from redundant_planner.core.robot.cone import cone_room
from redundant_planner.core.robot.kinematics import fill
from redundant_planner.core.target.straight_motion import (
    Arena,
    begin_motion,
    BLOCKED,
    FREE,
    go_on_with,
    Motion,
    new_scratch,
    PENDING,
    Scratch,
    write_room,
)

Array = npt.NDArray[np.float64]

# Postures that trees have memory for at first, as the first touch of much takes milliseconds, and
# most of them: both together.
_FEW_NODES, _MOST_NODES = 512, 4096
# What a posture costs among which the nearest is looked for, one that is kept where some are cut
# off, and a step into the cone [ns].
_COST_OF_NODE, _COST_OF_KEPT, _COST_OF_TILT = 10, 35, 1500
# Steps that lead a posture into the tip's cone, to this share of its angle inside, and by which
# share of the longest branch one that was led there has to come nearer to what it grows towards.
_STEPS_INTO_CONE, _ROOM_IN_CONE, _PROGRESS = 6, 0.1, 0.1
_TINY = 1e-12
# How a piece of work ended: it goes on, the trees have met, more random postures are wanted, or
# the trees have become too large.
GROWING, MET, WANTING, TOO_LARGE = range(4)
# The entries of `Trees.numbers`: postures of either tree, which tree grows, whether it grows
# towards the other one's new posture, that posture, the root of the branch, whether the branch
# ends at what it leads to, how many random postures have been used, and whether a branch is
# looked at.
(_COUNT, _OTHER_COUNT, _TREE, _CONNECTS, _AIM, _ROOT, _ARRIVES, USED, _LOOKS) = range(9)


class Trees(NamedTuple):
    """Two trees: the first one from the start, the other from all goals, if there are any.

    Attributes:
        postures: (2, M, n) [rad, m].
        rooms: (2, M, k) there.
        parents: (2, M) which posture each grew from, −1 for roots.
        numbers: (9,) see above.
        branch: (n,) where a branch ends that is looked at.
        room: (k,) there.
    """

    postures: OutStack
    rooms: OutStack
    parents: IndexPairs
    numbers: Indices
    branch: OutVector
    room: OutVector


def new_trees(starts: tuple[Array, Array], goals: tuple[Array, Array]) -> Trees:
    """Return trees that have roots only.

    Args:
        starts, goals: postures (r, n) and their room (r, k); of goals, r may be 0.
    """
    most = max(_FEW_NODES, 2 * len(starts[0]), 2 * len(goals[0]))
    n, k = starts[0].shape[1], starts[1].shape[1]
    trees = Trees(
        np.empty((2, most, n)), np.empty((2, most, k)), np.empty((2, most), dtype=np.intp),
        np.zeros(9, dtype=np.intp), np.empty(n), np.empty(k))
    for tree, (postures, rooms) in enumerate((starts, goals)):
        trees.postures[tree, :len(postures)] = postures
        trees.rooms[tree, :len(postures)] = rooms
        trees.parents[tree, :len(postures)] = -1
        trees.numbers[tree] = len(postures)
    return trees


def enlarged(trees: Trees) -> Trees | None:
    """Return the same trees with memory for twice as many postures; None if they have most."""
    wide = min(2 * trees.postures.shape[1], _MOST_NODES)
    if wide <= trees.postures.shape[1]:
        return None
    postures, rooms, parents = (
        np.empty((2, wide, *part.shape[2:]), dtype=part.dtype)
        for part in (trees.postures, trees.rooms, trees.parents))
    for tree, count in enumerate(trees.numbers[:2]):
        postures[tree, :count] = trees.postures[tree, :count]
        rooms[tree, :count] = trees.rooms[tree, :count]
        parents[tree, :count] = trees.parents[tree, :count]
    return trees._replace(postures=postures, rooms=rooms, parents=parents)


def with_goals(trees: Trees, postures: Array, rooms: Array) -> Trees:
    """Return trees with more goals (r, n) with room (r, k), as far as there is memory for them."""
    first = int(trees.numbers[_OTHER_COUNT])
    while first + len(postures) >= trees.postures.shape[1]:
        larger = enlarged(trees)
        if larger is None:
            break
        trees = larger
    # A branch may always be added without asking.
    last = max(first, min(first + len(postures), trees.postures.shape[1] - 1))
    trees.postures[1, first:last] = postures[:last - first]
    trees.rooms[1, first:last] = rooms[:last - first]
    trees.parents[1, first:last] = -1
    trees.numbers[_OTHER_COUNT] = last
    return trees


def with_start(trees: Trees, posture: Array, room: Array) -> Trees:
    """Return trees of which the first one begins anew, at a posture (n,) with room (k,)."""
    trees.postures[0, 0], trees.rooms[0, 0], trees.parents[0, 0] = posture, room, -1
    others = trees.numbers[_OTHER_COUNT]
    trees.numbers[:] = 0
    trees.numbers[[_COUNT, _OTHER_COUNT]] = 1, others
    return trees


def way_between(trees: Trees) -> tuple[Array, Array]:
    """Return postures (w, n) and rooms (w, k) from start to goal where the trees have met."""
    forth, back = _branches(trees)
    return (np.concatenate((trees.postures[0, forth], trees.postures[1, back[1:]])),
            np.concatenate((trees.rooms[0, forth], trees.rooms[1, back[1:]])))


def cut_off(trees: Trees, edge: int) -> int:
    """Cut an edge of the way between trees that have met, and what hangs on it, off its tree.

    Returns:
        How much work it was [ns].
    """
    forth, back = _branches(trees)
    tree, node = ((0, forth[edge + 1]) if edge + 1 < len(forth) else
                  (1, back[edge + 1 - len(forth)]))
    before = int(trees.numbers[tree])
    _remove(trees, tree, node)
    return _COST_OF_KEPT * before


def _branches(trees: Trees) -> tuple[list[int], list[int]]:
    """Return the numbers of the postures from the start on, and on to a goal, in either tree.

    The last of the first tree is the first of the other one, where they have met.
    """
    numbers = trees.numbers
    tree = int(numbers[_TREE])
    ends = {tree: int(numbers[_AIM]), 1 - tree: int(numbers[1 - tree]) - 1}
    return to_root(trees, 0, ends[0])[::-1], to_root(trees, 1, ends[1])


def to_root(trees: Trees, tree: int, index: int) -> list[int]:
    """Return the numbers of the postures from one back to its root."""
    found = []
    while index >= 0:
        found.append(index)
        index = int(trees.parents[tree, index])
    return found


@entry
def _remove(trees: Trees, tree: int, node: int) -> None:
    """Remove a posture of a tree, and those that grew from it."""
    count, parents, kept = trees.numbers[tree], trees.parents[tree], 0
    moved = np.empty(count, np.intp)  # their new numbers, −1 for those that are gone
    for i in range(count):
        parent = parents[i]
        if i == node or (parent >= 0 and moved[parent] < 0):
            moved[i] = -1
            continue
        moved[i], parents[kept] = kept, parent if parent < 0 else moved[parent]
        for j in range(trees.postures.shape[2]):
            trees.postures[tree, kept, j] = trees.postures[tree, i, j]
        for k in range(trees.rooms.shape[2]):
            trees.rooms[tree, kept, k] = trees.rooms[tree, i, k]
        kept += 1
    trees.numbers[tree], trees.numbers[_CONNECTS], trees.numbers[_LOOKS] = kept, 0, 0


@kernel
def _into_cone(arena: Arena, scratch: Scratch, q: OutVector) -> None:
    """Lead a posture (n,) into the tips' cones, or nearer to that: the worst one first."""
    cone, low, high = arena.joints.cone, arena.joints.position_min, arena.joints.position_max
    for _ in range(_STEPS_INTO_CONE):
        scratch.arm.q[:] = q
        fill(arena.chain, scratch.places, scratch.arm)
        scratch.work[0] += _COST_OF_TILT
        arm = scratch.arm
        room, gradient = cone_room(cone, arm.tip_rotations[0], arm.tip_jacobian[:6])
        for t in range(1, len(arm.tip_rotations)):
            other, slope = cone_room(
                cone, arm.tip_rotations[t], arm.tip_jacobian[6 * t:6 * t + 6])
            if other < room:
                room, gradient = other, slope
        if room > _ROOM_IN_CONE * cone.angle:
            return
        missing = 2.0 * _ROOM_IN_CONE * cone.angle - room
        squared = _TINY
        for j in range(len(q)):
            squared = squared + gradient[j] * gradient[j]
        for j in range(len(q)):
            q[j] = min(max(q[j] + missing / squared * gradient[j], low[j]), high[j])


@kernel
def _squared(one: Vector, other: Vector, scaling: Vector) -> float:
    """Return the square of how far postures (n,) are apart, joint weights included."""
    squared = 0.0
    for j in range(len(one)):
        apart = (one[j] - other[j]) / scaling[j]
        squared = squared + apart * apart
    return squared


@kernel
def _nearest(trees: Trees, tree: int, aim: Vector, scaling: Vector) -> tuple[int, float]:
    """Return the number of a tree's posture that is nearest to another one (n,), and how near."""
    best, least = 0, np.inf
    for i in range(trees.numbers[tree]):
        squared = _squared(aim, trees.postures[tree, i], scaling)
        if squared < least:
            best, least = i, squared
    return best, math.sqrt(least)


@kernel
def _begin_branch(
    trees: Trees, tree: int, aim: Vector, motion: Motion, needed: Vector, longest: float,
    arena: Arena, scratch: Scratch,
) -> bool:
    """Begin to look at a branch towards a posture (n,); return whether it may be free."""
    scaling = arena.joints.scaling
    numbers = trees.numbers
    root, size = _nearest(trees, tree, aim, scaling)
    numbers[_ROOT], numbers[_ARRIVES] = root, 1 if size <= longest else 0
    share = 1.0 if size <= longest else longest / size
    for j in range(len(aim)):
        near = trees.postures[tree, root, j]
        trees.branch[j] = aim[j] if share == 1.0 else near + share * (aim[j] - near)
    if share < 1.0 and arena.in_cone:
        _into_cone(arena, scratch, trees.branch)
        # Back where it came from, it would grow from there again and again.
        if _squared(aim, trees.branch, scaling) > (size - _PROGRESS * longest) ** 2:
            return False
    scratch.arm.q[:], scratch.least[:] = trees.branch, needed
    free = write_room(arena, scratch, trees.room)
    scratch.least[:] = -np.inf
    return free and begin_motion(
        motion, trees.postures[tree, root], trees.rooms[tree, root], trees.branch, trees.room,
        needed, arena)


@kernel
def _add_branch(trees: Trees, tree: int) -> None:
    """Add the branch that is free to a tree."""
    numbers, at = trees.numbers, trees.numbers[tree]
    trees.postures[tree, at], trees.rooms[tree, at] = trees.branch, trees.room
    trees.parents[tree, at] = numbers[_ROOT]
    numbers[tree] = at + 1


@kernel
def _smaller_tree(numbers: Indices) -> int:
    """Return which tree is to grow."""
    return 0 if numbers[_COUNT] <= numbers[_OTHER_COUNT] else 1


@entry
def grow(
    trees: Trees, motion: Motion, aims: Matrix, needed: Vector, longest: float, most: int,
    arena: Arena,
) -> tuple[int, int]:
    """Grow trees a little further; return how it ended, and how much work it was.

    Args:
        trees: which grow.
        motion: the branch that is looked at.
        aims: (r, n) random postures.
        needed: (k,) room.
        longest: of a branch [rad, joint weights included].
        most: how much work it may be, about [ns].
        arena: where they grow.
    """
    numbers, scratch = trees.numbers, new_scratch(arena)
    room_for, work = trees.postures.shape[1] - 1, scratch.work
    while work[0] < most:
        tree = 1 - numbers[_TREE] if numbers[_CONNECTS] == 1 else numbers[_TREE]
        state = BLOCKED
        if numbers[_LOOKS] == 1:
            state = go_on_with(motion, most, arena, scratch)
            if state == PENDING:
                break
            numbers[_LOOKS] = 0
        else:
            if numbers[_CONNECTS] == 0:
                if numbers[_COUNT] + numbers[_OTHER_COUNT] >= room_for:
                    return TOO_LARGE, work[0]
                if numbers[USED] == len(aims):
                    return WANTING, work[0]
            work[0] += _COST_OF_NODE * numbers[tree]
            if numbers[_CONNECTS] == 1:
                aim = trees.postures[numbers[_TREE], numbers[_AIM]]
            else:
                aim = aims[numbers[USED]]
                numbers[USED] += 1
            if _begin_branch(trees, tree, aim, motion, needed, longest, arena, scratch):
                numbers[_LOOKS] = 1
                continue
        free = state == FREE
        if free:
            _add_branch(trees, tree)
        alone = numbers[_OTHER_COUNT] == 0
        if numbers[_CONNECTS] == 1:
            if free and numbers[_ARRIVES] == 1:
                return MET, work[0]
            if not free or numbers[tree] >= room_for:
                numbers[_CONNECTS], numbers[_TREE] = 0, _smaller_tree(numbers)
        elif not alone:
            if free:
                numbers[_CONNECTS], numbers[_AIM] = 1, numbers[tree] - 1
            else:
                numbers[_TREE] = _smaller_tree(numbers)
    return GROWING, work[0]
