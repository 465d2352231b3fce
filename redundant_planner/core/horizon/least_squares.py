"""Sums of squares in the joint positions of a path's nodes: built term by term, and solved.

A term joins a node with the next ones only, so the matrix is banded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, kernel, Matrix, OutMatrix, OutVector, Vector

Array = npt.NDArray[np.float64]


class Squares(NamedTuple):
    """Half a sum of squares, ½ xᵀ H x + cᵀ x + constant, in the step x (N n,) of all nodes.

    Attributes:
        hessian: H (N n, N n); empty, like c, where only its value is asked for.
        linear: c (N n,).
    """

    hessian: OutMatrix
    linear: OutVector


class Stencil(NamedTuple):
    """What a joint's positions at a node and the two before it count in a rate of it."""

    now: float
    before: float
    earlier: float


@kernel
def add_row(
    squares: Squares, first: int, gradient: Vector, residual: float, price: float,
) -> float:
    """Add ½ price (residual + gradient · x)², of x from `first` on; return twice its value."""
    hessian, linear = squares
    for j in range(len(gradient) if len(linear) else 0):
        slope = price * gradient[j]
        if slope != 0.0:
            linear[first + j] += slope * residual
            for k in range(len(gradient)):
                hessian[first + j, first + k] += slope * gradient[k]
    return price * residual * residual


@kernel
def add_of_rate(
    squares: Squares, at: int, n: int, stencil: Stencil, residual: float, price: float,
) -> float:
    """Add ½ price (residual + stencil · (x_i, x_{i−1}, x_{i−2}))² of one joint, likewise.

    Args:
        squares, residual, price: as for `add_row`.
        at: where the joint of node i is in x; those of nodes before the first do not move.
        n: number of joints.
        stencil: of the rate.
    """
    hessian, linear = squares
    for back in range(3 if len(linear) else 0):
        row = at - back * n
        slope = price * stencil[back]
        if row < 0 or slope == 0.0:
            continue
        linear[row] += slope * residual
        for other in range(3):
            if at - other * n >= 0:
                hessian[row, at - other * n] += slope * stencil[other]
    return price * residual * residual


@compiled
def smallest_of(hessian: Matrix, linear: Vector, band: int) -> Array:
    """Return the w of least ½ wᵀ H w + cᵀ w, by a Cholesky decomposition of H.

    Args:
        hessian: H (k, k), positive definite.
        linear: c (k,).
        band: entries of H that are further than this from its diagonal are 0.
    """
    size = len(linear)
    # Of the factor's row i, entries from i − band on: what lies before them is 0.
    lower, w = np.zeros((size, band + 1)), np.empty(size)
    for i in range(size):
        first = max(i - band, 0)
        for j in range(first, i + 1):
            total = hessian[i, j]
            for k in range(first, j):
                total -= lower[i, k - i + band] * lower[j, k - j + band]
            lower[i, j - i + band] = (
                math.sqrt(total) if i == j else total / lower[j, band])
        total = -linear[i]
        for k in range(first, i):
            total -= lower[i, k - i + band] * w[k]
        w[i] = total / lower[i, band]
    for i in range(size - 1, -1, -1):
        total = w[i]
        for k in range(i + 1, min(i + band + 1, size)):
            total -= lower[k, i - k + band] * w[k]
        w[i] = total / lower[i, band]
    return w
