"""Joint paths of the least motion from each pose to the next: where every search starts from."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.horizon.poses_ahead import error_to, poses_at
from redundant_planner.core.kernels import compiled, entry, kernel, Matrix, Vector
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.cone import Cone
from redundant_planner.core.robot.kinematics import (
    Chain,
    fill_tip,
    new_kinematics_compiled,
    new_places,
)
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.safety.limits import Limits

Array = npt.NDArray[np.float64]

# Squared damping of the way to a pose: near a singularity it takes some more steps [m²].
SQUARED_DAMPING = 1e-4


class PathJoints(NamedTuple):
    """How the joints of a path are weighed and bounded.

    Attributes:
        scaling: (n,) 1 / square root of the joint weights.
        position_min, position_max: (n,) margins taken off [rad, m].
        preferred: (n,) where they should rather be, NaN for anywhere [rad, m].
        preference: what that counts [1/s²].
        cone: that an axis of the tip stays in.
    """

    scaling: Vector
    position_min: Vector
    position_max: Vector
    preferred: Vector
    preference: float
    cone: Cone


def path_joints(constants: RobotConstants, gains: Gains, limits: Limits) -> PathJoints:
    """Return what a path of the joints goes by."""
    return PathJoints(
        constants.scaling, limits.positions[1], limits.positions[0], constants.preferred,
        gains.posture_weight, constants.cone)


def least_norm_path(robot: Robot, q: Array, poses: Poses, joints: PathJoints) -> Array:
    """Return the postures (N, n) that follow poses from a posture (n,) with the least motion each.

    One step is taken towards each pose, which need not reach it to the last digit.
    """
    return _least_norm_path(q, poses, robot.chain, joints)


@compiled
def step_to_pose(orthogonal: Matrix, upper: Matrix, error: Vector, damping: float) -> Array:
    """Return the damped least-norm step Jᵀ (J Jᵀ + damping)⁻¹ e, (n,), of Jᵀ = Q [R; 0].

    With J Jᵀ = Rᵀ R: a Cholesky decomposition of Rᵀ R + damping, and two substitutions.
    """
    m = len(error)
    lower, dual = np.zeros((m, m)), np.empty(m)
    for i in range(m):
        for j in range(i + 1):
            total = damping if i == j else 0.0
            for k in range(j + 1):
                total += upper[k, i] * upper[k, j] - (
                    lower[i, k] * lower[j, k] if k < j else 0.0)
            lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
    for i in range(m):
        total = error[i]
        for k in range(i):
            total -= lower[i, k] * dual[k]
        dual[i] = total / lower[i, i]
    for i in range(m - 1, -1, -1):
        total = dual[i]
        for k in range(i + 1, m):
            total -= lower[k, i] * dual[k]
        dual[i] = total / lower[i, i]
    step = np.zeros(len(orthogonal))
    for i in range(min(m, len(step))):
        along = 0.0
        for k in range(i, m):
            along += upper[i, k] * dual[k]
        for j in range(len(step)):
            step[j] += orthogonal[j, i] * along
    return step


@kernel
def least_norm_nodes(q: Vector, poses: Poses, chain: Chain, joints: PathJoints) -> Array:
    """Return what `least_norm_path` does, of an arm's chain."""
    tips = len(chain.tip_joints)
    count = len(poses.position) // tips
    nodes = np.empty((count, len(q)))
    arm, places = new_kinematics_compiled(q, len(chain.rows), tips, 0), new_places(len(q))
    for i in range(count):
        fill_tip(chain, places, arm)
        error = error_to(poses_at(poses, i, tips), Poses(arm.tip_positions, arm.tip_rotations),
                         chain.rows, chain.in_tool)
        orthogonal, upper = null_space.orthogonal_factors(arm.jacobian * joints.scaling)
        step = step_to_pose(orthogonal, upper, error, SQUARED_DAMPING)
        for j in range(len(q)):
            there = arm.q[j] + joints.scaling[j] * step[j]
            arm.q[j] = min(max(there, joints.position_min[j]), joints.position_max[j])
        nodes[i] = arm.q
    return nodes


@entry
def _least_norm_path(q: Vector, poses: Poses, chain: Chain, joints: PathJoints) -> Array:
    """Do what `least_norm_nodes` does, for Python."""
    return least_norm_nodes(q, poses, chain, joints)
