"""Postures with the tips at their poses, and others on from each along the null space.

The steps are Levenberg's and Marquardt's, damped by a share of the squared error that is left:
they converge quadratically near a singularity, too (Yamashita and Fukushima 2001; Sugihara 2011).
A joint at its limit takes no part in a step that would lead it beyond: the others make up for it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import PathJoints, step_to_pose
from redundant_planner.core.horizon.poses_ahead import error_to
from redundant_planner.core.kernels import entry, Flags, kernel, Matrix, Vector
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.kinematics import (
    Chain,
    fill_tip,
    JointPlaces,
    Kinematics,
    new_kinematics_compiled,
    new_places,
)
from redundant_planner.core.robot.se3 import Poses

Array = npt.NDArray[np.float64]

# A posture is at a pose within this [m, rad].
AT_POSE = 1e-5
# Squared damping, as a share of the squared error, and the least of it [m²].
_DAMPING, _LEAST_DAMPING = 0.01, 1e-12
# Most steps; and a guess is given up where so many have not halved the squared error.
_MOST_STEPS, _PATIENCE = 40, 5
# A step along the null space that has become shorter than this share leads nowhere.
_LEAST_SHARE = 1e-6


class Solution(NamedTuple):
    """What a guess has led to.

    Attributes:
        q: (n,) the posture [rad, m].
        error: of the tip at its worst controlled axis [m, rad].
        steps: that were computed; those that would lead joints beyond their limits count, too.
    """

    q: Vector
    error: float
    steps: int


@kernel
def _leads_beyond(q: float, move: float, low: float, high: float) -> bool:
    """Return whether a joint is at a limit and moves outwards."""
    return (q <= low and move < 0.0) or (q >= high and move > 0.0)


@kernel
def _solve(
    arm: Kinematics, places: JointPlaces, poses: Poses, chain: Chain, joints: PathJoints,
) -> tuple[float, int]:
    """Lead an arm's posture to its tips' poses; return the worst axis' error and the steps."""
    squares, computed = np.empty(_MOST_STEPS + 1), 0
    for step in range(_MOST_STEPS + 1):
        fill_tip(chain, places, arm)
        error = error_to(poses, Poses(arm.tip_positions, arm.tip_rotations), chain.rows,
                         chain.in_tool)
        worst, squares[step] = 0.0, 0.0
        for value in error:
            worst = max(worst, abs(value))
            squares[step] += value * value
        if worst < AT_POSE or step == _MOST_STEPS or (
                step >= _PATIENCE and squares[step] > 0.5 * squares[step - _PATIENCE]):
            break
        # 0 for joints that stay at their limits, at first those that the gradient leads beyond.
        scaling, within = joints.scaling.copy(), False
        for j in range(len(scaling)):
            along = 0.0
            for row in range(len(error)):
                along += arm.jacobian[row, j] * error[row]
            if _leads_beyond(arm.q[j], along, joints.position_min[j], joints.position_max[j]):
                scaling[j] = 0.0
        while not within:
            orthogonal, upper = null_space.orthogonal_factors(arm.jacobian * scaling)
            move = scaling * step_to_pose(
                orthogonal, upper, error, max(_DAMPING * squares[step], _LEAST_DAMPING))
            within, computed = True, computed + 1
            for j in range(len(move)):
                if _leads_beyond(
                        arm.q[j], move[j], joints.position_min[j], joints.position_max[j]):
                    scaling[j], within = 0.0, False
        for j in range(len(move)):
            arm.q[j] = min(max(arm.q[j] + move[j], joints.position_min[j]),
                           joints.position_max[j])
    return worst, computed


@entry
def solve(guess: Vector, poses: Poses, chain: Chain, joints: PathJoints) -> Solution:
    """Return the posture that a guess (n,) leads to.

    Its error is above `AT_POSE` where it leads elsewhere than to the tips' poses.
    """
    arm = new_kinematics_compiled(guess, len(chain.rows), len(chain.tip_joints), 0)
    error, steps = _solve(arm, new_places(len(guess)), poses, chain, joints)
    return Solution(arm.q, error, steps)


@entry
def self_motion(
    q: Vector, poses: Poses, aside: Vector, size: float, count: int, chain: Chain,
    joints: PathJoints,
) -> tuple[Matrix, int]:
    """Return the postures (k, n) at poses of the tips on from another one (n,) at these.

    And how many steps to the poses that took.

    Args:
        q: the first posture.
        poses: of the tips.
        aside: (n,) which way; its part in the null space counts.
        size: of a step [rad, m].
        count: how many postures at most. They end where a step does not lead back to the poses.
        chain, joints: of the arm.
    """
    found, way = np.empty((count, len(q))), aside.copy()
    arm = new_kinematics_compiled(q, len(chain.rows), len(chain.tip_joints), 0)
    places = new_places(len(q))
    fill_tip(chain, places, arm)
    steps = 0
    for k in range(count):
        parts = null_space.decompose(arm.jacobian * joints.scaling)
        way = joints.scaling * null_space.project(parts, way / joints.scaling)
        length = 0.0
        for value in way:
            length += value * value
        length = math.sqrt(length)
        if length < _LEAST_SHARE:
            return found[:k].copy(), steps
        for j in range(len(way)):
            way[j] /= length
            there = arm.q[j] + size * way[j]
            arm.q[j] = min(max(there, joints.position_min[j]), joints.position_max[j])
        error, more = _solve(arm, places, poses, chain, joints)
        steps += more
        if error >= AT_POSE:
            return found[:k].copy(), steps
        found[k] = arm.q
    return found, steps


@entry
def are_apart(postures: Matrix, others: Matrix, least: float) -> Flags:
    """Return which postures (k, n) are so far from all others (m, n), in one joint at least."""
    apart = np.ones(len(postures), np.bool_)
    for i in range(len(postures)):
        for other in range(len(others)):
            alike = True
            for j in range(postures.shape[1]):
                if abs(postures[i, j] - others[other, j]) > least:
                    alike = False
                    break
            if alike:
                apart[i] = False
                break
    return apart
