"""∂J/∂q of a serial chain, exactly, from the columns of J alone.

With base-axes columns J_j = [v_j; w_j] of the tip point (w = 0 for a prismatic joint),

    ∂J_j/∂q_k = [w_k × v_j; w_k × w_j]   for k ≤ j   (joint k turns the axis of joint j)
    ∂J_j/∂q_k = [w_j × v_k; 0]           for k > j   (joint k moves the tip, not the axis of j)

A Jacobian in tool axes is J_tool = Rᵀ J, so ∂J_tool/∂q_k = Rᵀ (∂J/∂q_k − w_k × J), and the
w_k × cancels against k ≤ j.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def jacobian_derivative(jacobian: Array) -> Array:
    """Return the tensor D[k] = ∂J/∂q_k, (n, 6, n), in base axes.

    Args:
        jacobian: (6, n) tip Jacobian in base axes (LOCAL_WORLD_ALIGNED).
    """
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


def jacobian_derivative_times(jacobian: Array, dq: Array) -> Array:
    """Return the columns (∂J/∂q_k) q̇, (6, n), in base axes, without forming the tensor.

    Column k is [w_k × V_k + W_k × v_k; w_k × Ω_k] with V_k = Σ_{j≥k} v_j q̇_j,
    Ω_k = Σ_{j≥k} w_j q̇_j and W_k = Σ_{j<k} w_j q̇_j.

    Args:
        jacobian: (6, n) tip Jacobian in base axes.
        dq: (n,) joint velocities.
    """
    terms = jacobian * dq
    following = terms[:, ::-1].cumsum(axis=1)[:, ::-1]
    v, w = jacobian[:3], jacobian[3:]
    preceding = following[3:, :1] - following[3:]
    return np.concatenate(
        (_cross(w, following[:3]) + _cross(preceding, v), _cross(w, following[3:])))


def tool_derivative_times(jacobian: Array, rotation: Array, dq: Array) -> Array:
    """Return the columns (∂(RᵀJ)/∂q_k) q̇, (6, n), in tool axes.

    Args:
        jacobian: (6, n) tip Jacobian in base axes.
        rotation: (3, 3) tip axes in the base frame, R.
        dq: (n,) joint velocities.
    """
    twist = (jacobian @ dq)[:, None]
    w = jacobian[3:]
    columns = jacobian_derivative_times(jacobian, dq)
    columns[:3] -= _cross(w, np.broadcast_to(twist[:3], w.shape))
    columns[3:] -= _cross(w, np.broadcast_to(twist[3:], w.shape))
    return (rotation.T @ columns.reshape(2, 3, -1)).reshape(6, -1)


def _cross(a: Array, b: Array) -> Array:
    """Column-wise cross product of two (3, n) arrays."""
    result = np.empty(a.shape)
    result[0] = a[1] * b[2] - a[2] * b[1]
    result[1] = a[2] * b[0] - a[0] * b[2]
    result[2] = a[0] * b[1] - a[1] * b[0]
    return result
