"""Performance indices: each function returns a value and its gradient.

Sign convention of the whole package: ∇H points where the arm should go. `clearance_index` and
`manipulability_index` are to be maximised; `joint_limit_index` and `shortest_path_index` are to
be minimised and enter the sum of Eq. 18 with a minus sign, in `total_gradient` and nowhere else.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.null_space import Decomposition
from redundant_planner.core.obstacles import pseudo_distance

Array = npt.NDArray[np.float64]

def joint_limit_index(q: Array, position_min: Array, position_max: Array) -> tuple[float, Array]:
    """Return H_s of Eq. 3 and its gradient; joints without limits do not count.

    H_s = Σ [(q_i − m_i) / (q_i,max − q_i,min)]², m_i the middle of the range.

    Args:
        q, position_min, position_max: (n,) [rad, m].
    """
    limited = np.isfinite(position_min) & np.isfinite(position_max)
    low, high = np.where(limited, position_min, q), np.where(limited, position_max, q)
    span = np.where(limited, high - low, 1.0)
    offset = (q - 0.5 * (low + high)) / span
    return float(offset @ offset), 2.0 * offset / span


def clearance_index(
    clearance: Array, distance: Array, *, smoothing: float = 0.0,
    influence_distance: float = np.inf,
) -> tuple[float, Array]:
    """Return H_w of Eq. 7, the smallest S over all links and obstacles, and ∂H_w/∂ρ per pair.

    The gradient in q is the sum of ∂H_w/∂ρ · ∂ρ/∂q over the pairs (`clearance_gradients`), of
    which few count. The minimum is smoothed to −w ln Σ exp(−S_i/w), so that the gradient turns
    over gradually where the nearest pair changes; w = 0 is Eq. 7 to the letter.

    S grows with distance squared and so does ∇S. A pair therefore counts in proportion to a
    fade, from nothing at the influence distance to everything at contact, and the whole sum by
    the largest fade. An infinite influence distance is Eq. 7 to the letter.

    Args:
        clearance: ρ of every pair, any shape.
        distance: of the same shape, not more than the pairs' true distances [m].
        smoothing: w [unit of S].
        influence_distance: [m].

    Returns:
        H_w (infinite without obstacles) and its slopes, zero for pairs that do not count.
    """
    if not clearance.size:
        return np.inf, np.zeros(clearance.shape)
    levels = pseudo_distance(clearance)
    lowest = float(levels.min())
    if np.isfinite(influence_distance):
        share = fade(distance / influence_distance)
        activation = float(share.max())
        if activation == 0.0:
            return lowest, np.zeros(clearance.shape)
    else:
        share, activation = np.ones(clearance.shape), 1.0
    if smoothing > 0.0:
        weights = share * np.exp((lowest - levels) / smoothing)
        total = float(weights.sum())
        if total > 0.0:
            value = lowest - smoothing * math.log(total)
            return value, weights * (2.0 * activation / total * (clearance + 1.0))
    nearest = int(np.where(share > 0.0, levels, np.inf).argmin())
    slopes = np.zeros(clearance.shape)
    slopes.flat[nearest] = 2.0 * activation * (clearance.flat[nearest] + 1.0)  # ∂S/∂ρ
    return lowest, slopes


def manipulability_index(parts: Decomposition, changes: Array) -> tuple[float, Array]:
    """Return Yoshikawa's manipulability w = √det(JJᵀ) = Π σ_i and its gradient.

    With σ_i's directions u_i and v_i, ∂σ_i/∂q_k = u_iᵀ (∂J/∂q_k) v_i, so
    ∂w/∂q_k = Σ_i Π_{j≠i} σ_j · u_iᵀ (∂J/∂q_k) v_i: finite in a singularity, too.

    Args:
        parts: of the (m, n) Jacobian.
        changes: (m, n) ∂σ_i/∂q_k.
    """
    values = parts.singular_values
    others = np.array([np.prod(np.delete(values, i)) for i in range(len(values))])
    return parts.manipulability, others @ changes


def shortest_path_index(
    least_norm: Array, dual: Array, derivative_columns: Array,
) -> tuple[float, Array]:
    """Return ½‖J⁺ẋ‖², the integrand of Eq. 11 along the least-norm motion, and its gradient.

    With y = (JJᵀ)⁻¹ẋ, ∂(J⁺ẋ)/∂q_k = −J⁺ (∂J/∂q_k) J⁺ẋ + P (∂J/∂q_k)ᵀ y. The second term is
    orthogonal to J⁺ẋ, so the gradient is −yᵀ (∂J/∂q_k) J⁺ẋ: exact, with no inverse of its own
    (docs/derivations.md).

    Args:
        least_norm: (n,) J⁺ẋ.
        dual: (m,) y.
        derivative_columns: (m, n) columns (∂J/∂q_k) J⁺ẋ.
    """
    return 0.5 * float(least_norm @ least_norm), -(dual @ derivative_columns)


def total_gradient(
    clearance: Array, joint_limit: Array, shortest_path: Array, manipulability: Array, *,
    k_w: float, k_s: float, k_f: float, k_m: float,
) -> Array:
    """Return ∇H of Eq. 18, (n,), pointing where the arm should go.

    Eq. 18 writes k_w ∇H_w + k_s ∇H_s + k_f ∇H_f and leaves the signs to the coefficients; here
    all coefficients are positive and the minimised indices are subtracted. k_m is not the
    paper's.
    """
    return (k_w * clearance - k_s * joint_limit - k_f * shortest_path
            + k_m * manipulability)


def fade(ratio: npt.ArrayLike) -> Array:
    """Return 1 at 0 and below, 0 at 1 and beyond, with level tangents at both ends."""
    x = 1.0 - np.minimum(np.maximum(ratio, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)
