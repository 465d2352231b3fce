"""The way out of a singularity: which joints to move, and where the tip goes with them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.constants import RobotConstants
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.robot.kinematics import KinematicsAlong
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import Limits

Array = npt.NDArray[np.float64]

# How far a joint is moved [rad, m], and how many joints at most: an arm that is stretched out
# with its wrist in line needs two.
_STEP, _MOST_JOINTS = 0.4, 2
# J counts as regular with this multiple of the margin as its smallest singular value, or of this
# value without a margin [unit of J].
_REGULAR, _LEAST = 2.0, 0.02
# ε below, as a share of that; a joint is worth moving that makes the product this much larger.
_SMALL, _WORTHWHILE = 0.05, 1.1
# No further than this from where it was found, the same way still leads out [rad, m].
_SAME_PLACE = 0.2


class WayOut(NamedTuple):
    """A small motion that ends further from singularities.

    Attributes:
        joints: names of the joints that move, and whether their positions grow.
        position: (3,) of the tip then, from where it is, in its own axes [m].
        rpy: (3,) its turn in these axes: roll, pitch, yaw [rad].
    """

    joints: tuple[tuple[str, bool], ...]
    position: Array
    rpy: Array

    def __str__(self) -> str:
        """Say it to somebody who may type the command of this package that goes there."""
        moves = ' and '.join(
            f"{'increase' if grows else 'decrease'} joint '{name}'" for name, grows in self.joints)
        numbers = [' '.join(f'{number + 0.0:.2f}' for number in np.round(values, 2))
                   for values in (self.position, self.rpy)]
        return (f'{moves} to get out: go_to --relative --position {numbers[0]} '
                f'--rpy {numbers[1]}')


def way_out(
    robot: Robot, q: Array, constants: RobotConstants, limits: Limits, margin: float,
) -> WayOut | None:
    """Return the way out of a singularity; None if one or two joints make little difference.

    Each joint is tried in both directions. The best one makes Π (σ_i + ε) largest, where ε keeps
    J's other singular values in the comparison while one is 0. It brings no links closer to each
    other than their margin.

    Args:
        robot: the arm.
        q: (n,) its posture.
        constants, limits: of the arm.
        margin: smallest singular value that the planner lets it go down to [unit of J].
    """
    high, low = limits.positions
    regular = _REGULAR * max(margin, _LEAST)
    arms = robot.kinematics_along(q[None])
    here, values, room = arms, _singular_values(arms)[0], _room(arms, 0, constants)
    moves = np.zeros(robot.n)
    for _ in range(min(_MOST_JOINTS, robot.n)):
        if values[-1] > regular:
            break
        free = np.flatnonzero(moves == 0.0)
        steps = np.zeros((2 * len(free), robot.n))
        steps[np.arange(len(steps)), np.tile(free, 2)] = np.repeat((_STEP, -_STEP), len(free))
        tried = robot.kinematics_along(np.clip(arms.q[0] + steps, low, high))
        found = _singular_values(tried)
        able, before = (found + _SMALL * regular).prod(axis=1), (values + _SMALL * regular).prod()
        best = next((i for i in np.argsort(-able, kind='stable').tolist()
                     if able[i] < _WORTHWHILE * before
                     or _room(tried, i, constants) >= min(room, 0.0)), 0)
        if able[best] < _WORTHWHILE * before:
            break
        arms, values = KinematicsAlong(*(field[best:best + 1] for field in tried)), found[best]
        moves += steps[best]
    if not moves.any():
        return None
    axes = here.tip_rotations[0].T
    return WayOut(
        tuple((robot.joint_names[j], bool(moves[j] > 0.0)) for j in np.flatnonzero(moves)),
        axes @ (arms.tip_positions[0] - here.tip_positions[0]),
        np.asarray(pin.rpy.matrixToRpy(axes @ arms.tip_rotations[0])))


def _singular_values(arms: KinematicsAlong) -> Array:
    """Return J's singular values (N, m) at N postures, descending."""
    return np.asarray(np.linalg.svd(arms.jacobian, compute_uv=False))


def _room(arms: KinematicsAlong, i: int, constants: RobotConstants) -> float:
    """Return the least room between links at one of N postures, their margin taken off [m]."""
    return float(link_distances(
        arms.segment_start[i], arms.segment_end[i], constants.radii,
        constants.self_pairs).distance.min(initial=np.inf))


class LastWayOut:
    """The way out that was found last: a message may stand for seconds, and costs nothing then."""

    def __init__(
        self, robot: Robot, constants: RobotConstants, limits: Limits, margin: float,
    ) -> None:
        """Prepare for an arm; arguments as for `way_out`."""
        self._robot, self._constants, self._limits = robot, constants, limits
        self._margin = margin
        self._at, self._words = [math.inf] * robot.n, ''

    def words(self, q: Array) -> str:
        """Return the way out in words at a posture (n,), in brackets; empty if there is none."""
        at = q.tolist()
        if not math.dist(at, self._at) < _SAME_PLACE:  # every tick of such an arm asks for this
            found = way_out(self._robot, q, self._constants, self._limits, self._margin)
            self._at, self._words = at, '' if found is None else f' ({found})'
        return self._words

    def forget(self) -> None:
        """Look anew next time."""
        self._at = [math.inf] * self._robot.n
