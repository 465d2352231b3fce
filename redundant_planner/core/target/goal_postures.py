"""Postures with the tips at their poses: from random ones, and on along the null space."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.robot.turns import nearest_turn, TURN
from redundant_planner.core.target.free_space import FreeSpace, Place, places_of
from redundant_planner.core.target.inverse_kinematics import are_apart, AT_POSE, self_motion, solve

Array = npt.NDArray[np.float64]

# Steps along the null space to either side, and their size [rad, m].
_ASIDE, _ASIDE_SIZE = 6, 0.25
# A posture is another one than those known if a joint is this far from each of them [rad, m].
_APART = 0.07
# What looking for postures costs, each step to the poses, and two postures that may be one [ns].
_COST_OF_GUESS, _COST_OF_STEP, _COST_OF_KNOWN = 30_000, 2500, 4
# Steps towards another posture, so many before the next look. They become smaller where they leave
# more than this share of the distance, from the first to the last [rad, m].
_AT_ONCE, _WORTH_IT, _NEARER, _NEAREST = 4, 0.99, 0.3, 0.02
# Every other guess is this far from where the arm is, about [rad, m].
_SPREAD = 0.5


def goal_postures(
    space: FreeSpace, q: Array, poses: Poses, random: np.random.Generator,
) -> Generator[list[Place] | None, None, None]:
    """Yield postures, some after each piece of work and often none; None after each guess.

    They need not be free. Joints that turn without end take the short way round to them.

    The first guess is where the arm is, then near it and anywhere in turn.

    Args:
        space: where the arm may be.
        q: (n,) where it is.
        poses: that the tips shall have.
        random: the numbers.
    """
    low, high = space.joint_ranges(q)
    guess, guesses, known = q, 0, _Known(len(q))
    # Ways aside are random: few of them spare those joints that cost more than others.
    spares = space.robot.n > space.robot.m and bool(np.ptp(space.joints.scaling) > 0.0)
    while True:
        found = posture_at(space, guess, poses)
        yield []
        if found is not None:
            found = nearest_turn(found, q, space.joints.position_max)
            yield _places(space, [found])
            for aside in _asides(space, random):
                beside = _beside(space, found, poses, aside, _ASIDE_SIZE, _ASIDE)
                postures = known.others_of(nearest_turn(beside, q, space.joints.position_max))
                space.spend(_COST_OF_KNOWN * len(beside) * known.count)
                yield []
                for some in space.slices(len(postures)):
                    yield _places(space, postures[some])
            if spares:
                known.others_of(found[None])
                nearest = found
                for beside in nearer(space, found, poses, q):
                    nearest = beside
                    yield []
                for other in known.others_of(nearest[None]):
                    yield _places(space, [other])
        guesses += 1
        guess = (random.uniform(low, high) if guesses % 2 else
                 np.minimum(np.maximum(random.normal(q, _SPREAD), low), high))
        yield None


def only_posture(
    space: FreeSpace, q: Array, wanted: Array,
) -> Generator[list[Place] | None, None, None]:
    """Yield one posture, and then None for ever, as there is no other.

    A joint that turns without end takes the short way round, and the long one if it must.

    Args:
        space: where the arm may be.
        q: (n,) where it is.
        wanted: (n,) where it shall be.
    """
    wanted = nearest_turn(wanted, q, space.joints.position_max)
    room = space.place(wanted).room
    found = [Place(wanted, room)]
    for j in np.flatnonzero(np.isinf(space.joints.position_max)):
        other = wanted.copy()
        other[j] += TURN if wanted[j] < q[j] else -TURN
        found.append(Place(other, room))
    yield found
    while True:
        yield None


def posture_at(space: FreeSpace, guess: Array, poses: Poses) -> Array | None:
    """Return a posture (n,) with the tips at their poses; None where a guess leads elsewhere."""
    found = solve(guess, poses, space.robot.chain, space.joints)
    space.spend(_COST_OF_GUESS + _COST_OF_STEP * found.steps)
    return found.q if found.error < AT_POSE else None


def _beside(
    space: FreeSpace, q: Array, poses: Poses, aside: Array, size: float, count: int,
) -> Array:
    """Return postures (k, n) along the null space, see `self_motion`."""
    beside, steps = self_motion(q, poses, aside, size, count, space.robot.chain, space.joints)
    space.spend(_COST_OF_GUESS + _COST_OF_STEP * (steps + count))
    return beside


def nearer(space: FreeSpace, q: Array, poses: Poses, to: Array) -> Iterator[Array]:
    """Yield postures (n,) with tips at poses, each nearer to another one than those before.

    The null space leads there. The last one is as near as it gets.

    Args:
        space: where the arm may be.
        q: (n,) with the tips at the poses, where it begins.
        poses: of the tips.
        to: (n,) the other posture.
    """
    size, nearest = _NEARER, float(space.distance(q, to))
    while size >= _NEAREST:
        beside = _beside(space, q, poses, to - q, size, _AT_ONCE)
        apart = space.distance(beside, to)
        best = float(apart.min(initial=np.inf))
        if best > _WORTH_IT * nearest:
            size *= 0.5
        if best < nearest:
            q, nearest = beside[int(apart.argmin())], best
        yield q


def _asides(space: FreeSpace, random: np.random.Generator) -> tuple[Array, ...]:
    """Return a way along the null space and its opposite (n,); none without a null space."""
    robot = space.robot
    if robot.n <= robot.m:
        return ()
    aside = random.normal(size=robot.n)
    return aside, -aside


class _Known:
    """Postures that have been looked at: those of a null space are met again and again."""

    def __init__(self, n: int) -> None:
        self._postures = np.empty((0, n))

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self._postures)

    def others_of(self, postures: Array) -> Array:
        """Return those of some postures (k, n) that are not known, and know them from now on."""
        others = postures[are_apart(postures, self._postures, _APART)]
        self._postures = np.vstack((self._postures, others))
        return others


def _places(space: FreeSpace, postures: Sequence[Array] | Array) -> list[Place]:
    """Return postures (n,) with their room."""
    return places_of(np.array(postures), space.rooms(np.array(postures)))


def off_poses(robot: Robot, q: Array, poses: Poses) -> float:
    """Return how far tips are from their poses at a posture (n,), on controlled axes [m, rad]."""
    off = se3.poses_error(poses, robot.kinematics(q).tips, robot.in_tool)
    return float(np.abs(robot.task_rows(off)).max())
