"""Least-norm and homogeneous solutions of J q̇ = ẋ (Eqs. 1 and 2).

Everything follows from one singular value decomposition J = U Σ Vᵀ. The null-space projector
I − V Vᵀ uses the directions themselves, not their damped gains, so J P = 0 holds to round-off
also where the least-norm solution is damped: damping slows the arm down, it never leaks
null-space motion into the end effector.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, kernel, Matrix, Vector

Array = npt.NDArray[np.float64]

# A direction with a smaller share of the largest singular value is not controllable at all; its
# joint motion belongs to the null space. Round-off of J is some 1e-16 of the same.
_RANK_TOLERANCE = 1e-9
# Rows count as orthogonal when their cosine is below this, which takes four or five sweeps.
_ORTHOGONAL = 1e-15
_MOST_SWEEPS = 30


class Decomposition(NamedTuple):
    """J = U Σ Vᵀ with the directions that J does not control taken out.

    Attributes:
        left: (m, m) U.
        singular_values: (m,) Σ, descending.
        right: (m, n) Vᵀ; rows of uncontrollable directions are zero.
    """

    left: Matrix
    singular_values: Vector
    right: Matrix


@kernel
def _sorted(rows: Matrix, turns: Matrix) -> Decomposition:
    """Return U, Σ and Vᵀ of Σ Vᵀ and Uᵀ, by descending singular values."""
    m, n = rows.shape
    sizes = np.zeros(m)
    for i in range(m):
        for k in range(n):
            sizes[i] += rows[i, k] * rows[i, k]
    left, values, right = np.empty((m, m)), np.empty(m), np.zeros((m, n))
    for i in range(m):
        largest = 0
        for j in range(m):
            if sizes[j] > sizes[largest]:
                largest = j
        values[i] = math.sqrt(max(sizes[largest], 0.0))
        sizes[largest] = -1.0
        for k in range(m):
            left[k, i] = turns[largest, k]
        if values[i] > _RANK_TOLERANCE * values[0]:
            for k in range(n):
                right[i, k] = rows[largest, k] / values[i]
    return Decomposition(left, values, right)


@compiled
def decompose(jacobian: Matrix) -> Decomposition:
    """Decompose an (m, n) Jacobian, m ≤ n, by one-sided Jacobi rotations (Hestenes 1958).

    Rows of J are turned into each other, Uᵀ J, until they are orthogonal: then they are Σ Vᵀ.
    On so few numbers that takes less than half of LAPACK's time, and gives small singular values
    more exactly (Demmel and Veselić 1992).
    """
    m, n = jacobian.shape
    rows, turns = jacobian.copy(), np.eye(m)  # Uᵀ J and Uᵀ
    for _ in range(_MOST_SWEEPS):
        orthogonal = True
        for i in range(m - 1):
            for j in range(i + 1, m):
                a, b, c = 0.0, 0.0, 0.0
                for k in range(n):
                    a += rows[i, k] * rows[i, k]
                    b += rows[j, k] * rows[j, k]
                    c += rows[i, k] * rows[j, k]
                if c * c <= _ORTHOGONAL * _ORTHOGONAL * (a * b):
                    continue
                orthogonal = False
                apart = b - a
                tangent = 2.0 * c / (
                    apart + math.copysign(math.sqrt(apart * apart + 4.0 * c * c), apart))
                cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
                sine = cosine * tangent
                for k in range(n):
                    x, y = rows[i, k], rows[j, k]
                    rows[i, k], rows[j, k] = cosine * x - sine * y, sine * x + cosine * y
                for k in range(m):
                    x, y = turns[i, k], turns[j, k]
                    turns[i, k], turns[j, k] = cosine * x - sine * y, sine * x + cosine * y
        if orthogonal:
            break
    return _sorted(rows, turns)


@compiled
def orthogonal_factors(jacobian: Matrix) -> tuple[Array, Array]:
    """Return Q (n, n), orthogonal, and R (m, m), upper triangular, of Jᵀ = Q [R; 0].

    By Householder reflections: the last n − m columns of Q are orthogonal to every row of J, of
    any rank; with n < m the last rows of R are 0. A third of the time of `decompose`, for where
    no singular values are asked for.
    """
    m, n = jacobian.shape
    rows = np.empty((n, m))
    rows[:] = jacobian.T
    turned, mirror = np.eye(n), np.empty(n)
    for k in range(min(m, n - 1)):
        squared = 0.0
        for i in range(k, n):
            mirror[i] = rows[i, k]
            squared += rows[i, k] * rows[i, k]
        # Away from the entry itself, so that nothing cancels.
        mirror[k] += math.copysign(math.sqrt(squared), rows[k, k])
        length = squared - rows[k, k] * rows[k, k] + mirror[k] * mirror[k]
        if length == 0.0:
            continue
        for j in range(k, m):
            along = 0.0
            for i in range(k, n):
                along += mirror[i] * rows[i, j]
            for i in range(k, n):
                rows[i, j] -= 2.0 * along / length * mirror[i]
        for row in range(n):
            along = 0.0
            for i in range(k, n):
                along += turned[row, i] * mirror[i]
            for i in range(k, n):
                turned[row, i] -= 2.0 * along / length * mirror[i]
    upper = np.zeros((m, m))
    for i in range(min(m, n)):
        for j in range(i, m):
            upper[i, j] = rows[i, j]
    return turned, upper


@compiled
def manipulability(parts: Decomposition) -> float:
    """Return Yoshikawa's √det(JJᵀ), as the product of the singular values."""
    product = 1.0
    for value in parts.singular_values:
        product *= value
    return product


@compiled
def inverse_gains(singular_values: Vector, threshold: float, damping: float) -> Array:
    """Return σ / (σ² + λ²), with damping only where a singular value falls below a threshold.

    λ² = damping² (1 − (σ_min/threshold)²) for σ_min < threshold, else 0 (Nakamura and Hanafusa
    1986): J⁺ is the exact pseudo-inverse away from singularities and bounded at them. A
    threshold of 0 never damps; directions of exactly no gain then get none.

    Args:
        singular_values: (m,), descending.
        threshold: where damping begins [unit of J].
        damping: λ at σ = 0 [unit of J].
    """
    squared = 0.0
    if threshold > 0.0:
        share = min(singular_values[-1] / threshold, 1.0)
        squared = damping * damping * (1.0 - share * share)
    floor = (_RANK_TOLERANCE * singular_values[0]) ** 2
    gains = np.zeros(len(singular_values))
    for i in range(len(gains)):
        denominator = singular_values[i] * singular_values[i] + squared
        if denominator > floor:
            gains[i] = singular_values[i] / denominator
    return gains


@compiled
def least_norm(parts: Decomposition, gains: Vector, twist: Vector) -> Array:
    """Return J⁺ẋ, the first term of Eq. 1, (n,).

    Args:
        parts: of the (m, n) Jacobian.
        gains: (m,) from `inverse_gains`.
        twist: (m,) ẋ.
    """
    result = np.zeros(parts.right.shape[1])
    for i in range(len(gains)):
        along = 0.0
        for row in range(len(twist)):
            along += parts.left[row, i] * twist[row]
        for j in range(len(result)):
            result[j] += gains[i] * along * parts.right[i, j]
    return result


@compiled
def dual(parts: Decomposition, gains: Vector, twist: Vector) -> Array:
    """Return y = (JJᵀ)⁻¹ẋ, (m,), of which J⁺ẋ = Jᵀy; damped like `gains`."""
    result = np.zeros(len(twist))
    for i in range(len(gains)):
        along = 0.0
        for row in range(len(twist)):
            along += parts.left[row, i] * twist[row]
        for row in range(len(twist)):
            result[row] += gains[i] * gains[i] * along * parts.left[row, i]
    return result


@compiled
def project(parts: Decomposition, vector: Vector) -> Array:
    """Return P g = (I − J⁺J) g, (n,), without forming P."""
    result = vector.copy()
    for i in range(len(parts.right)):
        along = 0.0
        for j in range(len(vector)):
            along += parts.right[i, j] * vector[j]
        for j in range(len(vector)):
            result[j] -= along * parts.right[i, j]
    return result


def pseudo_inverse(parts: Decomposition, gains: Array) -> Array:
    """Return J⁺, (n, m)."""
    return (parts.right.T * gains) @ parts.left.T


def null_space_projector(parts: Decomposition) -> Array:
    """Return P = I − J⁺J, (n, n)."""
    return np.eye(parts.right.shape[1]) - parts.right.T @ parts.right


@compiled
def dynamic_factor(k_alpha: float, least_norm: Vector, projected: Vector) -> float:
    """Return k of Eq. 2: kα ‖J⁺ẋ‖ / (‖J⁺ẋ‖ + ‖P∇H‖), and 0 where both norms are 0.

    Args:
        k_alpha: kα, the adjustment coefficient.
        least_norm: (n,) J⁺ẋ.
        projected: (n,) P∇H.
    """
    squared, squared_projected = 0.0, 0.0
    for i in range(len(least_norm)):
        squared += least_norm[i] * least_norm[i]
        squared_projected += projected[i] * projected[i]
    size = math.sqrt(squared)
    total = size + math.sqrt(squared_projected)
    return k_alpha * size / total if total > 0.0 else 0.0
