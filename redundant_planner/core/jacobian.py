"""∂J/∂q of a serial chain, exactly, from the columns of J alone.

With base-axes columns J_j = [v_j; w_j] of the tip point (w = 0 for a prismatic joint),

    ∂J_j/∂q_k = [w_k × v_j; w_k × w_j]   for k ≤ j   (joint k turns the axis of joint j)
    ∂J_j/∂q_k = [w_j × v_k; 0]           for k > j   (joint k moves the tip, not the axis of j)

The planner needs only products with a joint velocity, which Pinocchio gives
(`Robot.jacobian_derivative_times`); Eq. 17 needs the tensor itself.
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
