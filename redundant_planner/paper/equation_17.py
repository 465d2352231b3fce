"""Eq. 17 as printed, and why nothing of it reaches the joints (docs/derivations.md).

With Π = J⁺J and P = I − Π the equation reads, once its inverse is multiplied out,

    (P ∂Π) (∇H_f − J⁺ẋ) = 0,

because P ∂J⁺ = P ∂Π J⁺. Π is a projector, so P ∂Π P = 0: the matrix P ∂Π has no inverse, its
row space lies in that of J, and every least-norm solution lies there too. Projected, it is
nothing: P ∇H_f = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Equation17(NamedTuple):
    """One reading of Eq. 17 at one posture.

    Attributes:
        matrix: (r, n) what the equation inverts.
        gradient: (n,) its least-norm solution ∇H_f.
        projected_norm: ‖P∇H_f‖, what would reach q̇ per unit of k.
        rank: of the matrix.
        condition_number: of the matrix, largest over smallest of n singular values.
    """

    matrix: Array
    gradient: Array
    projected_norm: float
    rank: int
    condition_number: float


def projector_derivative(jacobian: Array, derivative: Array) -> Array:
    """Return ∂Π/∂q_k = P ∂Jᵀ J⁺ᵀ + (P ∂Jᵀ J⁺ᵀ)ᵀ, (n, n, n) with k first.

    Args:
        jacobian: (m, n), of full row rank.
        derivative: (n, m, n) ∂J/∂q_k.
    """
    inverse = np.linalg.pinv(jacobian)
    projector = np.eye(jacobian.shape[1]) - inverse @ jacobian
    half = projector @ derivative.transpose(0, 2, 1) @ inverse.T
    return half + half.transpose(0, 2, 1)


def pseudo_inverse_derivative(jacobian: Array, derivative: Array) -> Array:
    """Return ∂J⁺/∂q_k = −J⁺ ∂J J⁺ + P ∂Jᵀ (JJᵀ)⁻¹, (n, n, m) with k first.

    Args:
        jacobian: (m, n), of full row rank.
        derivative: (n, m, n) ∂J/∂q_k.
    """
    inverse = np.linalg.pinv(jacobian)
    projector = np.eye(jacobian.shape[1]) - inverse @ jacobian
    gram = np.linalg.inv(jacobian @ jacobian.T)
    return (-inverse @ derivative @ inverse
            + projector @ derivative.transpose(0, 2, 1) @ gram)


def as_tensor(jacobian: Array, derivative: Array, twist: Array) -> Equation17:
    """Read ∂/∂q as the derivative by every joint: n equations (P ∂Π/∂q_k) ∇H_f = P ∂J⁺/∂q_k ẋ.

    Args:
        jacobian: (m, n), of full row rank.
        derivative: (n, m, n) ∂J/∂q_k.
        twist: (m,) ẋ.
    """
    n = jacobian.shape[1]
    projector = np.eye(n) - np.linalg.pinv(jacobian) @ jacobian
    matrix = (projector @ projector_derivative(jacobian, derivative)).reshape(n * n, n)
    right = (projector @ pseudo_inverse_derivative(jacobian, derivative) @ twist).reshape(n * n)
    return _solved(matrix, right, projector)


def as_time_derivative(
    jacobian: Array, derivative: Array, twist: Array, dq: Array,
) -> Equation17:
    """Read ∂/∂q as the change along the motion: (P Π̇) ∇H_f = P J̇⁺ ẋ.

    Args:
        jacobian: (m, n), of full row rank.
        derivative: (n, m, n) ∂J/∂q_k.
        twist: (m,) ẋ.
        dq: (n,) the motion.
    """
    projector = np.eye(jacobian.shape[1]) - np.linalg.pinv(jacobian) @ jacobian
    matrix = projector @ np.tensordot(dq, projector_derivative(jacobian, derivative), 1)
    change = np.tensordot(dq, pseudo_inverse_derivative(jacobian, derivative), 1)
    return _solved(matrix, projector @ change @ twist, projector)


def _solved(matrix: Array, right: Array, projector: Array) -> Equation17:
    # Round-off leaves singular values of some 1e-16 where there are none.
    gradient = np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-10)[0], dtype=np.float64)
    values = np.linalg.svd(matrix, compute_uv=False)
    return Equation17(
        matrix, gradient, float(np.linalg.norm(projector @ gradient)),
        int((values > 1e-10 * values[0]).sum()),
        float(values[0] / max(values[-1], np.finfo(float).tiny)))
