"""The QP about a guess of the joint path ahead: cost, rows and clearances, linearised.

About a guess q̄ of the nodes, pose(q_i) = pose_i is solved by q_i = q̄_i + J_i⁺e_i + Z_i w_i, where
e_i is the pose error of q̄_i and Z_i spans the null space of J_i. What remains of the problem in
`path_qp.py` is a QP in the null-space coordinates w_i alone, n − m per node, with a
block-tridiagonal Hessian. docs/horizon.md has the derivation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import (
    PathJoints,
    SQUARED_DAMPING,
    step_to_pose,
)
from redundant_planner.core.horizon.least_squares import smallest_of
from redundant_planner.core.horizon.poses_ahead import error_to, poses_at
from redundant_planner.core.kernels import compiled, entry, Indices, kernel, Matrix, Stack, Vector
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.near_pairs import near_pairs_along
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.cone import cone_room
from redundant_planner.core.robot.kinematics import along_in, Chain, KinematicsAlong
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.robot.turns import short_way

Array = npt.NDArray[np.float64]

# How far one step may move a node in its null space [rad, m].
LARGEST_STEP = 0.2
# How near a link is to an obstacle when the pair enters the QP [m].
_PAIRS_WITHIN = 0.15
# What a plan keeps beyond the margin: the filter slows down for what arrives right at it [m].
CLEARANCE_RESERVE = 0.0005


class Measures(NamedTuple):
    """How long a plan is, and what it violates.

    Attributes:
        cost: Σ ‖Δq‖² / Δt, joint weights included.
        error: how far it is off the poses [m, rad].
        intrusion: how far links are inside their clearance [m]; negative outside.
        beyond: how far joints are beyond their limits [rad, m]; negative within.
    """

    cost: float = np.inf
    error: float = np.inf
    intrusion: float = np.inf
    beyond: float = np.inf


class LocalProblem(NamedTuple):
    """The QP about a plan: q_i = base_i + w_i directions_i follows the poses to first order.

    Attributes:
        base: (N, n).
        directions: (N, n − m, n) the null space of every node.
        linear, hessian: of the cost in w, (N (n − m),) and square.
        gradients: (p, n) ∂ρ/∂q of the pairs of links and obstacles near any node, then those of
            the tip's cone at each of them, if there is one.
        bounds: (p,) what a step must add to ρ, or to the room in the cone, at least.
        at: (p,) their nodes.
        smallest: (N, n) the nodes of least cost, as if nothing bounded them.
        unbounded: whether these break none of the bounds: then they are the solution.
    """

    base: Matrix
    directions: Stack
    linear: Vector
    hessian: Matrix
    gradients: Matrix
    bounds: Vector
    at: Indices
    smallest: Matrix
    unbounded: bool


class Linearised(NamedTuple):
    """What a plan's nodes measure, and the QP about them."""

    measures: Measures
    local: LocalProblem


class _Followed(NamedTuple):
    """Nodes that follow their poses to first order.

    Attributes:
        base: (N, n) the nodes, each a step to its pose further.
        steps: (N, n) these steps.
        basis: (N, n − m, n) of the null spaces, orthonormal in the scaled joints.
        error: the largest pose error before [m, rad].
    """

    base: Matrix
    steps: Matrix
    basis: Stack
    error: float


@kernel
def _followed(
    arms: KinematicsAlong, poses: Poses, chain: Chain, scaling: Vector,
) -> _Followed:
    """Take a damped least-norm step from every node to its pose, see `linearised`."""
    count, n = arms.q.shape
    free, tips = n - len(chain.rows), len(chain.tip_joints)
    base, steps, basis = np.empty((count, n)), np.empty((count, n)), np.empty((count, free, n))
    largest = 0.0
    for i in range(count):
        error = error_to(
            poses_at(poses, i, tips),
            poses_at(Poses(arms.tip_positions, arms.tip_rotations), i, tips), chain.rows,
            chain.in_tool)
        largest = max(largest, np.abs(error).max())
        orthogonal, upper = null_space.orthogonal_factors(arms.jacobian[i] * scaling)
        steps[i] = scaling * step_to_pose(orthogonal, upper, error, SQUARED_DAMPING)
        base[i] = arms.q[i] + steps[i]
        for w in range(free):
            basis[i, w] = orthogonal[:, len(chain.rows) + w]
    return _Followed(base, steps, basis, largest)


@kernel
def _path_cost(
    q: Vector, base: Matrix, basis: Stack, times: Vector, joints: PathJoints,
) -> tuple[float, Array, Array]:
    """Return Σ ‖Δq‖² / Δt + k_p Σ ‖q − q_p‖² Δt; half its gradient and Hessian in w."""
    scaling = joints.scaling
    count, free, n = basis.shape
    size = count * free
    cost, linear, hessian = 0.0, np.zeros(size), np.zeros((size, size))
    for i in range(count):
        stiffness = 1.0 / (times[i + 1] - times[i])
        for j in range(n):
            before = q[j] if i == 0 else base[i - 1, j]
            stretch = (base[i, j] - before) / scaling[j]
            cost += stiffness * stretch * stretch
            for w in range(free):
                linear[i * free + w] += stiffness * stretch * basis[i, w, j]
                if i > 0:
                    linear[(i - 1) * free + w] -= stiffness * stretch * basis[i - 1, w, j]
        for w in range(free):
            here = i * free + w
            hessian[here, here] += stiffness
            if i > 0:
                hessian[here - free, here - free] += stiffness
                for other in range(free):
                    there, along = (i - 1) * free + other, 0.0
                    for j in range(n):
                        along += basis[i, w, j] * basis[i - 1, other, j]
                    hessian[here, there] = hessian[there, here] = -stiffness * along
        for j in range(n):
            preference = joints.preference * (times[i + 1] - times[i])
            off = short_way(base[i, j] - joints.preferred[j], joints.position_max[j])
            if preference == 0.0 or math.isnan(off):
                continue
            cost += preference * off * off
            for w in range(free):
                slope = preference * scaling[j] * basis[i, w, j]
                linear[i * free + w] += slope * off
                for other in range(free):
                    hessian[i * free + w, i * free + other] += (
                        slope * scaling[j] * basis[i, other, j])
    return cost, linear, hessian


@compiled
def stepped(base: Matrix, directions: Stack, w: Vector) -> Array:
    """Return the nodes (N, n) that a step w (N (n − m),) leads to, see `LocalProblem`."""
    count, free, n = directions.shape
    nodes = base.copy()
    for i in range(count):
        for k in range(free):
            for j in range(n):
                nodes[i, j] += w[i * free + k] * directions[i, k, j]
    return nodes


@kernel
def _breaks_no_bound(
    w: Vector, smallest: Matrix, local: LocalProblem, joints: PathJoints,
) -> bool:
    """Return whether a step w, which leads to nodes (N, n), breaks none of the constraints."""
    count, n = smallest.shape
    for step in w:
        if abs(step) > LARGEST_STEP:
            return False
    for i in range(count):
        for j in range(n):
            if not joints.position_min[j] <= smallest[i, j] <= joints.position_max[j]:
                return False
    for row in range(len(local.bounds)):
        at, change = local.at[row], 0.0
        for j in range(n):
            change += local.gradients[row, j] * (smallest[at, j] - local.base[at, j])
        if change < local.bounds[row]:
            return False
    return True


@entry
def linearised(
    q: Vector, nodes: Matrix, poses: Poses, obstacles: InflatedObstacles, times: Vector,
    chain: Chain, joints: PathJoints,
) -> Linearised:
    """Return what a plan's nodes measure, and the QP about them.

    Args:
        q: (n,) where the arm is.
        nodes: (N, n) the plan's.
        poses, obstacles: the problem.
        times: (N + 1,) of the nodes [s].
        chain: the arm.
        joints: see there.
    """
    count, n = nodes.shape
    beyond = -np.inf
    for i in range(count):
        for j in range(n):
            beyond = max(beyond, nodes[i, j] - joints.position_max[j],
                         joints.position_min[j] - nodes[i, j])
    arms = along_in(nodes, chain)
    followed = _followed(arms, poses, chain, joints.scaling)
    cost, linear, hessian = _path_cost(
        q, followed.base, followed.basis, times, joints)
    near = near_pairs_along(obstacles, arms, chain, times[1:], _PAIRS_WITHIN)
    pairs = len(near.postures)
    tips = len(chain.tip_joints)
    rows = pairs + (count * tips if joints.cone.angle < math.pi else 0)
    gradients, bounds, at = np.empty((rows, n)), np.empty(rows), np.empty(rows, np.intp)
    for i in range(rows):
        if i < pairs:
            at[i], gradients[i] = near.postures[i], near.gradient[i]
            bounds[i] = CLEARANCE_RESERVE / near.smallest[i] - near.normalized_distance[i]
        else:
            at[i], tip = (i - pairs) // tips, (i - pairs) % tips
            room, gradients[i] = cone_room(
                joints.cone, arms.tip_rotations[i - pairs],
                arms.tip_jacobian[at[i], 6 * tip:6 * tip + 6])
            bounds[i] = -room
        for j in range(n):
            bounds[i] -= gradients[i, j] * followed.steps[at[i], j]
    directions, base = followed.basis * joints.scaling, followed.base
    w = smallest_of(hessian, linear, 2 * directions.shape[1] - 1)
    smallest = stepped(base, directions, w)
    local = LocalProblem(base, directions, linear, hessian, gradients, bounds, at, smallest, True)
    return Linearised(
        Measures(cost, followed.error, -near.nearest, beyond),
        LocalProblem(base, directions, linear, hessian, gradients, bounds, at, smallest,
                     _breaks_no_bound(w, smallest, local, joints)))
