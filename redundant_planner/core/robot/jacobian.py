"""∂J/∂q, exactly, from the columns of J alone.

With base-axes columns J_j = [v_j; w_j] of the tip point (w = 0 for a prismatic joint),

    ∂J_j/∂q_k = [w_k × v_j; w_k × w_j]   for k ≤ j   (joint k turns the axis of joint j)
    ∂J_j/∂q_k = [w_j × v_k; 0]           for k > j   (joint k moves the tip, not the axis of j)

The planner needs only products with a joint velocity, in O(n); Eq. 17 needs the tensor itself.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import (
    compiled,
    Indices,
    kernel,
    Matrix,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.robot.se3 import Place

Array = npt.NDArray[np.float64]


@kernel
def joint_shares(
    joint_screws: Matrix, point: Place, force: Place, supports: Vector, shares: OutVector,
) -> None:
    """Write the joints' shares in f · ẋ of a point x, (n,): f · v_j + (x × f) · w_j.

    Args:
        joint_screws: (6, n) [v_j; w_j] at the base origin.
        point: x in the base frame [m].
        force: f, of any unit.
        supports: (n,) factors: 1 where a joint moves the point, else 0.
        shares: (n,) what is written [unit of f times m/rad, or of f].
    """
    x = point.y * force.z - point.z * force.y
    y = point.z * force.x - point.x * force.z
    z = point.x * force.y - point.y * force.x
    for j in range(len(shares)):
        shares[j] = supports[j] * (
            force.x * joint_screws[0, j] + force.y * joint_screws[1, j]
            + force.z * joint_screws[2, j] + x * joint_screws[3, j] + y * joint_screws[4, j]
            + z * joint_screws[5, j])


def jacobian_derivative(jacobian: Array) -> Array:
    """Return the tensor D[k] = ∂J/∂q_k, (n, 6 t, n), in base axes.

    Args:
        jacobian: (6 t, n) of t tips in base axes (LOCAL_WORLD_ALIGNED).
    """
    if len(jacobian) > 6:
        return np.concatenate([jacobian_derivative(part) for part in np.split(
            jacobian, len(jacobian) // 6)], axis=1)
    v, w = jacobian[:3].T, jacobian[3:].T
    n = len(v)
    derivative = np.zeros((n, 6, n))
    turned_v = np.cross(w[:, None], v[None])  # [k, j] = w_k × v_j
    turned_w = np.cross(w[:, None], w[None])
    moved = np.cross(w[None], v[:, None])  # [k, j] = w_j × v_k
    before = (np.arange(n)[:, None] <= np.arange(n)[None])[:, :, None]  # k ≤ j
    derivative[:, :3] = np.where(before, turned_v, moved).transpose(0, 2, 1)
    derivative[:, 3:] = np.where(before, turned_w, 0.0).transpose(0, 2, 1)
    return derivative


@compiled
def derivative_times(
    jacobian: Matrix, dq: Vector, rotations: Stack, in_tool: bool, rows: Indices,
) -> Array:
    """Return the columns (∂J/∂q_k) q̇ of the controlled axes, (m, n).

    Of the sum over j that the tensor makes with q̇, column k takes w_k × [v_j; w_j] for j ≥ k and
    [w_j × v_k; 0] for j < k. In tool axes, J_tool = Rᵀ J and joint k turns R as well:
    Rᵀ ((∂J/∂q_k) q̇ − w_k × J q̇).

    Args:
        jacobian: (6 t, n) Jacobian of t tips in base axes; a joint that does not move a tip has a
            column of 0 there, and so no part in its derivative.
        dq: (n,) q̇.
        rotations: (t, 3, 3) R, tool axes in the base frame.
        in_tool: whether the columns are wanted in tool axes.
        rows: (m,) the controlled ones of the six axes of each tip.
    """
    n = len(dq)
    columns = np.empty((len(rows), n))
    for tip in range(len(rotations)):
        own, rotation = jacobian[6 * tip:6 * tip + 6], rotations[tip]
        # Σ [v_j; w_j] q̇_j over j ≥ k and over j < k; what is taken off; a whole column.
        after, before, total, full = np.zeros((4, 6))
        for j in range(n):
            for row in range(6):
                after[row] += own[row, j] * dq[j]
        # In tool axes w_k × J q̇ is taken off.
        if in_tool:
            total[:] = after
        for k in range(n):
            v1, v2, v3, w1, w2, w3 = own[:, k]
            for part in range(0, 6, 3):
                x = after[part] - total[part]
                y = after[part + 1] - total[part + 1]
                z = after[part + 2] - total[part + 2]
                full[part], full[part + 1], full[part + 2] = (
                    w2 * z - w3 * y, w3 * x - w1 * z, w1 * y - w2 * x)
            full[0] += before[4] * v3 - before[5] * v2
            full[1] += before[5] * v1 - before[3] * v3
            full[2] += before[3] * v2 - before[4] * v1
            for i in range(len(rows)):
                row = rows[i] - 6 * tip
                if not 0 <= row < 6:
                    continue
                if in_tool:
                    axes, part = rotation[:, row % 3], 3 * (row // 3)
                    columns[i, k] = (axes[0] * full[part] + axes[1] * full[part + 1]
                                     + axes[2] * full[part + 2])
                else:
                    columns[i, k] = full[row]
            for row in range(6):
                after[row] -= own[row, k] * dq[k]
                before[row] += own[row, k] * dq[k]
    return columns


@compiled
def jdot_qdot(
    jacobian: Matrix, dq: Vector, rotations: Stack, in_tool: bool, rows: Indices,
) -> Array:
    """Return J̇ q̇ = Σ_k (∂J/∂q_k) q̇ · q̇_k of the controlled axes, (m,).

    Args:
        jacobian, dq, rotations, in_tool, rows: as for `derivative_times`.
    """
    columns = derivative_times(jacobian, dq, rotations, in_tool, rows)
    rate = np.zeros(len(rows))
    for i in range(len(rows)):
        for k in range(len(dq)):
            rate[i] += columns[i, k] * dq[k]
    return rate


@compiled
def derivative_between(
    left: Vector, jacobian: Matrix, dq: Vector, rotations: Stack, in_tool: bool,
    rows: Indices,
) -> Array:
    """Return uᵀ (∂J/∂q_k) q̇ for every k, (n,).

    Args:
        left: (m,) u.
        jacobian, dq, rotations, in_tool, rows: as for `derivative_times`.
    """
    columns = derivative_times(jacobian, dq, rotations, in_tool, rows)
    result = np.zeros(len(dq))
    for i in range(len(rows)):
        for k in range(len(dq)):
            result[k] += left[i] * columns[i, k]
    return result
