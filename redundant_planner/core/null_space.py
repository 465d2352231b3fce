"""Least-norm and homogeneous solutions of J q̇ = ẋ (Eqs. 1 and 2).

Everything follows from one singular value decomposition J = U Σ Vᵀ. The null-space projector
I − V Vᵀ uses the directions themselves, not their damped gains, so J P = 0 holds to round-off
also where the least-norm solution is damped: damping slows the arm down, it never leaks
null-space motion into the end effector.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# A direction with a smaller share of the largest singular value is not controllable at all; its
# joint motion belongs to the null space. Round-off of J is some 1e-16 of the same.
_RANK_TOLERANCE = 1e-9


class Decomposition(NamedTuple):
    """J = U Σ Vᵀ with the directions that J does not control taken out.

    Attributes:
        left: (m, m) U.
        singular_values: (m,) Σ, descending.
        right: (m, n) Vᵀ; rows of uncontrollable directions are zero.
    """

    left: Array
    singular_values: Array
    right: Array

    @property
    def manipulability(self) -> float:
        """Yoshikawa's √det(JJᵀ), as the product of the singular values."""
        return float(np.prod(self.singular_values))


def decompose(jacobian: Array) -> Decomposition:
    """Decompose an (m, n) Jacobian, m ≤ n."""
    left, values, right = np.linalg.svd(jacobian, full_matrices=False)
    if values[-1] <= _RANK_TOLERANCE * values[0]:
        right = np.where((values > _RANK_TOLERANCE * values[0])[:, None], right, 0.0)
    return Decomposition(left, values, right)


def inverse_gains(singular_values: Array, threshold: float, damping: float) -> Array:
    """Return σ / (σ² + λ²), with damping only where a singular value falls below a threshold.

    λ² = damping² (1 − (σ_min/threshold)²) for σ_min < threshold, else 0 (Nakamura and Hanafusa
    1986): J⁺ is the exact pseudo-inverse away from singularities and bounded at them. A
    threshold of 0 never damps; directions of exactly no gain then get none.

    Args:
        singular_values: (m,) or (N, m), descending.
        threshold: where damping begins [unit of J].
        damping: λ at σ = 0 [unit of J].
    """
    squared: Array | float = 0.0
    if threshold > 0.0:
        if singular_values.ndim == 1 and singular_values[-1] >= threshold:
            return 1.0 / singular_values  # the usual case: neither damped nor without gain
        share = np.minimum(singular_values[..., -1:] / threshold, 1.0)
        squared = damping * damping * (1.0 - share * share)
    denominator = singular_values * singular_values + squared
    floor = (_RANK_TOLERANCE * singular_values[..., :1]) ** 2
    return np.divide(singular_values, denominator, out=np.zeros_like(singular_values),
                     where=denominator > floor)


def least_norm(parts: Decomposition, gains: Array, twist: Array) -> Array:
    """Return J⁺ẋ, the first term of Eq. 1, (n,).

    Args:
        parts: of the (m, n) Jacobian.
        gains: (m,) from `inverse_gains`.
        twist: (m,) ẋ.
    """
    return parts.right.T @ (gains * (parts.left.T @ twist))


def project(parts: Decomposition, vector: Array) -> Array:
    """Return P g = (I − J⁺J) g, (n,), without forming P."""
    return vector - parts.right.T @ (parts.right @ vector)


def pseudo_inverse(parts: Decomposition, gains: Array) -> Array:
    """Return J⁺, (n, m)."""
    return (parts.right.T * gains) @ parts.left.T


def null_space_projector(parts: Decomposition) -> Array:
    """Return P = I − J⁺J, (n, n)."""
    return np.eye(parts.right.shape[1]) - parts.right.T @ parts.right


def dynamic_factor(k_alpha: float, least_norm_size: float, projected_size: float) -> float:
    """Return k of Eq. 2: kα ‖J⁺ẋ‖ / (‖J⁺ẋ‖ + ‖P∇H‖), and 0 where both norms are 0.

    Args:
        k_alpha: kα, the adjustment coefficient.
        least_norm_size: ‖J⁺ẋ‖.
        projected_size: ‖P∇H‖.
    """
    total = least_norm_size + projected_size
    return k_alpha * least_norm_size / total if total > 0.0 else 0.0
