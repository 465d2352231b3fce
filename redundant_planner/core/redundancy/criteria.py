"""Performance indices: each function returns a value and its gradient.

Sign convention of the whole package: ∇H points where the arm should go. `clearance_index` and
`manipulability_index` are to be maximised; `joint_limit_index` and `shortest_path_index` are to
be minimised and enter the sum of Eq. 18 with a minus sign, in `total_gradient` and nowhere else.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, kernel, Matrix, Vector
from redundant_planner.core.redundancy.null_space import Decomposition, manipulability
from redundant_planner.core.robot.turns import short_way

Array = npt.NDArray[np.float64]


@compiled
def joint_limit_index(
    q: Vector, position_min: Vector, position_max: Vector,
) -> tuple[float, Array]:
    """Return H_s of Eq. 3 and its gradient; joints without limits do not count.

    H_s = Σ [(q_i − m_i) / (q_i,max − q_i,min)]², m_i the middle of the range.

    Args:
        q, position_min, position_max: (n,) [rad, m].
    """
    value, gradient = 0.0, np.zeros(len(q))
    for i in range(len(q)):
        span = position_max[i] - position_min[i]
        if np.isfinite(span):
            offset = (q[i] - 0.5 * (position_min[i] + position_max[i])) / span
            value += offset * offset
            gradient[i] = 2.0 * offset / span
    return value, gradient


@kernel
def fade(ratio: float) -> float:
    """Return 1 at 0 and below, 0 at 1 and beyond, with level tangents at both ends."""
    x = 1.0 - min(max(ratio, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


@compiled
def clearance_index(
    normalized_distance: Vector, distance: Vector, gradient: Matrix, smoothing: float,
    influence_distance: float,
) -> tuple[float, Array]:
    """Return H_w of Eq. 7, the smallest S over all links and obstacles, and its gradient.

    That is the sum of ∂H_w/∂ρ · ∂ρ/∂q over the pairs, of which few count. The minimum is
    smoothed to −w ln Σ exp(−S_i/w), so that the gradient turns over gradually where the nearest
    pair changes; w = 0 is Eq. 7 to the letter.

    S grows with distance squared and so does ∇S. A pair therefore counts in proportion to a
    fade, from nothing at the influence distance to everything at contact, and the whole sum by
    the largest fade. An infinite influence distance is Eq. 7 to the letter.

    Args:
        normalized_distance: (p,) ρ of every pair.
        distance: (p,) not more than the pairs' true distances [m].
        gradient: (p, n) ∂ρ/∂q, from `clearance_gradients`.
        smoothing: w [unit of S].
        influence_distance: [m].

    Returns:
        H_w (infinite without obstacles) and ∇H_w (n,), zero where no pair counts.
    """
    n = gradient.shape[1]
    total_gradient = np.zeros(n)
    shares = np.empty(len(normalized_distance))
    lowest, lowest_counting, nearest, activation = np.inf, np.inf, -1, 0.0
    for i in range(len(normalized_distance)):
        level = normalized_distance[i] * (normalized_distance[i] + 2.0)  # S of Eq. 6
        lowest = min(lowest, level)
        shares[i] = fade(distance[i] / influence_distance)
        activation = max(activation, shares[i])
        if shares[i] > 0.0 and level < lowest_counting:
            lowest_counting, nearest = level, i
    if nearest < 0:
        return lowest, total_gradient
    total = 0.0
    if smoothing > 0.0:
        for i in range(len(normalized_distance)):
            level = normalized_distance[i] * (normalized_distance[i] + 2.0)
            shares[i] *= math.exp((lowest - level) / smoothing)
            total += shares[i]
    if total > 0.0:
        value = lowest - smoothing * math.log(total)
    else:
        value, total = lowest, 1.0
        shares[:] = 0.0
        shares[nearest] = 1.0
    for i in range(len(normalized_distance)):
        # ∂S/∂ρ = 2 (ρ + 1)
        slope = shares[i] * (2.0 * activation / total * (normalized_distance[i] + 1.0))
        for j in range(n):
            total_gradient[j] += slope * gradient[i, j]
    return value, total_gradient


@compiled
def manipulability_index(parts: Decomposition, changes: Matrix) -> tuple[float, Array]:
    """Return Yoshikawa's manipulability w = √det(JJᵀ) = Π σ_i and its gradient.

    With σ_i's directions u_i and v_i, ∂σ_i/∂q_k = u_iᵀ (∂J/∂q_k) v_i, so
    ∂w/∂q_k = Σ_i Π_{j≠i} σ_j · u_iᵀ (∂J/∂q_k) v_i: finite in a singularity, too.

    Args:
        parts: of the (m, n) Jacobian.
        changes: (m, n) ∂σ_i/∂q_k.
    """
    gradient = np.zeros(changes.shape[1])
    for i in range(len(changes)):
        others = 1.0
        for j in range(len(changes)):
            if j != i:
                others *= parts.singular_values[j]
        for k in range(len(gradient)):
            gradient[k] += others * changes[i, k]
    return manipulability(parts), gradient


@compiled
def shortest_path_index(least_norm: Vector, change: Vector) -> tuple[float, Array]:
    """Return ½‖J⁺ẋ‖², the integrand of Eq. 11 along the least-norm motion, and its gradient.

    With y = (JJᵀ)⁻¹ẋ, ∂(J⁺ẋ)/∂q_k = −J⁺ (∂J/∂q_k) J⁺ẋ + P (∂J/∂q_k)ᵀ y. The second term is
    orthogonal to J⁺ẋ, so the gradient is −yᵀ (∂J/∂q_k) J⁺ẋ: exact, with no inverse of its own.

    Args:
        least_norm: (n,) J⁺ẋ.
        change: (n,) yᵀ (∂J/∂q_k) J⁺ẋ, from `derivative_between`.
    """
    value = 0.0
    for j in range(len(least_norm)):
        value += 0.5 * least_norm[j] * least_norm[j]
    return value, -change


@compiled
def posture_index(
    q: Vector, preferred: Vector, position_max: Vector,
) -> tuple[float, Array]:
    """Return ½‖q − q_p‖² over the joints that have a preferred position, and its gradient.

    A joint that turns without end takes the short way round to its q_p.

    Args:
        q: (n,) the posture.
        preferred: (n,) q_p, NaN for joints that may be anywhere.
        position_max: (n,) infinite for joints that turn without end.
    """
    value, gradient = 0.0, np.zeros(len(q))
    for j in range(len(q)):
        if not math.isnan(preferred[j]):
            gradient[j] = short_way(q[j] - preferred[j], position_max[j])
            value += 0.5 * gradient[j] * gradient[j]
    return value, gradient


class IndexWeights(NamedTuple):
    """What each index counts in Eq. 18, all of them 0 or more; k_m and k_p are not the paper's."""

    k_w: float
    k_s: float
    k_f: float
    k_m: float
    k_p: float


@compiled
def total_gradient(
    clearance: Vector, joint_limit: Vector, shortest_path: Vector, manipulability: Vector,
    posture: Vector, weights: IndexWeights,
) -> Array:
    """Return ∇H of Eq. 18, (n,), pointing where the arm should go.

    Eq. 18 writes k_w ∇H_w + k_s ∇H_s + k_f ∇H_f and leaves the signs to the coefficients. Here
    all coefficients are positive, and the minimised indices are subtracted.

    Args:
        clearance, joint_limit, shortest_path, manipulability, posture: (n,) the indices'
            gradients.
        weights: what they count.
    """
    return (weights.k_w * clearance - weights.k_s * joint_limit - weights.k_f * shortest_path
            + weights.k_m * manipulability - weights.k_p * posture)
