"""One stage of the safety filter as a QP, set up in machine code and solved by DAQP."""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, entry, Indices, Matrix, Vector
from redundant_planner.core.safety.limits import TOLERANCE

Array = npt.NDArray[np.float64]
Found = npt.NDArray[np.intp]

# Price of the whole twist in units of ½‖q̇_des‖²: null-space motion may be √200 times as fast as
# the desired motion before the twist slows down for it. Dearer, and the arm whips around.
_PRICE_SCALE = 100.0
# Prices per unit, each large enough to be paid only when nothing cheaper helps; the squared
# joint velocities they compete with are of the order of 1 (rad/s)².
_PRICE_RESIDUAL = 1e4
_PRICE_RESIDUAL_BESIDE = 1e6
_PRICE_PATH = 1e4
_PRICE_BARRIER = 1e6
# Price of a barrier's slack squared: two that cannot both be kept share it. Giving up the spare
# distance is cheaper.
_PRICE_BARRIER_SQUARED = 1e8
_PRICE_SPARE_SQUARED = 1e6
# The barriers that ask for most get slacks of their own, so many; the others share theirs, which
# keeps the problem small among many obstacles.
_OWN_SLACKS = 8
# Price of a residual twist where the path must not give way: it must not serve as a way around.
_PRICE_RESIDUAL_STRICT = 1e8
_UNBOUNDED = 1e30
# How far the shares s and r of a twist may lie outside of 0 to 1.
_ROUND_OFF = 1e-6
# Multipliers below this are round-off, not a constraint that acts.
_ACTIVE = 1e-9
# Iterations that a stage may take, and one whose barriers have slacks. In hard scenes one in a
# thousand and one in twenty take more. Then the next stage is tried.
MOST_ITERATIONS, MOST_ITERATIONS_WITH_SLACK = 40, 80
# The solver's tolerances are absolute. Where barriers share one slack its prices are this much
# smaller, or a standing arm may take a thousand iterations.
_SHARED_SCALE = 0.01
_SOLVED, _OUT_OF_ITERATIONS = 1, -4
_EQUALITY = 5


class StageProblem(NamedTuple):
    """What one stage of the filter asks.

    Attributes:
        desired: (n,) q̇_des.
        jacobian: (m, n).
        twist: (m,) ẋ, or the feedback alone once the command has stopped.
        turning: (m,) see `stages.Request`.
        residual: (m,) the twist that proportional braking leaves.
        lower, upper: (n,) bounds of q̇.
        gradient: (b, n) of the barriers.
        bounds: (b,) b of ∇h·q̇ ≥ b.
        spare: (b,) how much of a bound is cheap to give up; only looked at with slacks.
        weights: (n,) diagonal of W.
        prices: of the shares s, as shares of `_PRICE_SCALE`.
        share_of: (m,) which share s each axis of the twist goes with, 0 first.
        shares: how many there are.
        may_keep_residual: whether a share of the residual twist may remain.
        slack: whether barriers may give way.
        shared: whether all of them share one slack: fewer variables, and a solution sooner.
        path_gives_way: whether the path may, which is the first `path_axes` axes.
        path_axes: how many axes of the twist are the path's; what is kept beside it never gives
            way.
        whole: whether the shares s are 1.
    """

    desired: Vector
    jacobian: Matrix
    twist: Vector
    turning: Vector
    residual: Vector
    lower: Vector
    upper: Vector
    gradient: Matrix
    bounds: Vector
    spare: Vector
    weights: Vector
    prices: Vector
    share_of: Indices
    shares: int
    may_keep_residual: bool
    slack: bool
    shared: bool
    path_gives_way: bool
    path_axes: int
    whole: bool


class Solution(NamedTuple):
    """A stage's solution.

    Attributes:
        finite: whether every number of it is.
        dq: (n,) joint velocity.
        scales: s, the shares of the twist that are followed, see `StageProblem`.
        residual: r, the share of the residual twist that remains.
        joints: indices of the joints whose bound acts.
        pairs: indices of the barriers that act.
    """

    finite: bool
    dq: Array
    scales: Array
    residual: float
    joints: Found
    pairs: Found


def solve(problem: StageProblem) -> tuple[Solution | None, bool]:
    """Return a stage's solution, None where it has none, and whether iterations ran out."""
    hessian, linear, constraints, high, low, sense = _matrices(problem)
    x, _, flag, info = daqp.solve(
        hessian, linear, constraints, high, low, sense, primal_tol=TOLERANCE,
        iter_limit=MOST_ITERATIONS_WITH_SLACK if problem.slack else MOST_ITERATIONS)
    found = Solution(*_solution(
        x, info['lam'], problem.lower, problem.upper, problem.shares, len(problem.bounds)))
    return (found if flag == _SOLVED and found.finite else None), flag == _OUT_OF_ITERATIONS


@compiled
def _solution(
    x: Vector, multipliers: Vector, lower: Vector, upper: Vector, shares: int, barriers: int,
) -> tuple[bool, Array, Array, float, Found, Found]:
    """Return the fields of `Solution`."""
    n, finite = len(lower), True
    for value in x:
        finite = finite and np.isfinite(value)
    dq = np.minimum(np.maximum(x[:n], lower), upper)
    acting = np.abs(multipliers) > _ACTIVE
    residual = x[n + shares] if len(x) > n + shares else 0.0
    scales = np.minimum(np.maximum(x[n:n + shares], 0.0), 1.0)
    return (finite, dq, scales, residual, np.flatnonzero(acting[:n]),
            np.flatnonzero(acting[len(acting) - barriers:]))


@entry
def _matrices(
    problem: StageProblem,
) -> tuple[Array, Array, Array, Array, Array, npt.NDArray[np.int32]]:
    """Return the problem as DAQP takes it: ½ xᵀ H x + fᵀx, low ≤ (x, A x) ≤ high, sense.

    Variables are q̇ and the shares s, then r where a residual twist may remain, and another r for
    what is kept beside the path, then the barriers' slacks
    where they are allowed: first all that are `spare` at most, then all that are dearer. A path
    that gives way is a squared price on J q̇ + turning − s ẋ − r residual instead of a
    constraint.
    """
    jacobian, bounds, twist = problem.jacobian, problem.bounds, problem.twist
    m, n = jacobian.shape
    rows = len(bounds)
    shares, residual = problem.shares, n + problem.shares
    beside = problem.path_axes < m  # what is kept beside the path has a residual of its own
    slacks = residual + (1 + beside) * problem.may_keep_residual
    groups = min(rows, 1 if problem.shared else _OWN_SLACKS + 1)
    size = slacks + 2 * groups * problem.slack
    path = np.zeros((m, size))
    for row in range(m):
        for i in range(n):
            path[row, i] = jacobian[row, i]
        path[row, n + problem.share_of[row]] = -twist[row]
        if problem.may_keep_residual:
            path[row, residual + (row >= problem.path_axes)] = -problem.residual[row]
    hessian, linear = np.zeros((size, size)), np.empty(size)
    squared_speed = 0.0
    for i in range(n):
        hessian[i, i] = problem.weights[i]
        linear[i] = -problem.weights[i] * problem.desired[i]
        squared_speed += problem.weights[i] * problem.desired[i] * problem.desired[i]
    for i in range(n, size):
        hessian[i, i] = 1e-3
    for i in range(n, residual):
        linear[i] = -problem.prices[i - n] * _PRICE_SCALE * squared_speed - 1e-3
    if problem.may_keep_residual:
        linear[residual] = (_PRICE_RESIDUAL_STRICT if problem.slack and not problem.path_gives_way
                         else _PRICE_RESIDUAL)
        if beside:
            linear[residual + 1] = _PRICE_RESIDUAL_BESIDE
    soft = 0
    if problem.path_gives_way:
        soft = problem.path_axes
        for row in range(soft):
            for i in range(size):
                linear[i] += _PRICE_PATH * path[row, i] * problem.turning[row]
                for j in range(size):
                    hessian[i, j] += _PRICE_PATH * path[row, i] * path[row, j]
    hard = m - soft
    constraints = np.zeros((hard + rows, size))
    high, low = np.full(size + hard + rows, _UNBOUNDED), np.zeros(size + hard + rows)
    sense = np.zeros(size + hard + rows, dtype=np.int32)
    for i in range(size):
        # Proportional braking alone, r = 1, may be all there is: likewise.
        high[i] = 1.0 + _ROUND_OFF
    # An arm at rest on a barrier has s = 0 and nothing else: round-off must not shut that out.
    for i in range(n, n + shares):
        low[i], high[i] = 1.0 if problem.whole else -_ROUND_OFF, 1.0
    for i in range(n):
        low[i], high[i] = problem.lower[i], problem.upper[i]
    for row in range(hard):
        for i in range(size):
            constraints[row, i] = path[soft + row, i]
        low[size + row] = high[size + row] = -problem.turning[soft + row]
        sense[size + row] = _EQUALITY
    for row in range(rows):
        for i in range(n):
            constraints[hard + row, i] = problem.gradient[row, i]
        low[size + hard + row] = bounds[row]
    if problem.slack:
        demand = np.empty(rows)
        for row in range(rows):
            gradient = problem.gradient[row]
            demand[row] = bounds[row] / (1e-9 + np.sqrt(np.sum(gradient * gradient)))
        order = np.argsort(-demand)
        for rank in range(rows):
            row = int(order[rank])
            first = slacks + min(rank, groups - 1)
            second = first + groups
            constraints[hard + row, first] = constraints[hard + row, second] = 1.0
            hessian[first, first] = _PRICE_SPARE_SQUARED
            hessian[second, second] = _PRICE_BARRIER_SQUARED
            linear[first], linear[second] = 0.0, _PRICE_BARRIER
            spare = problem.spare[row]
            high[first] = min(high[first], spare) if rank >= groups else spare
            high[second] = _UNBOUNDED
    if problem.shared:
        hessian *= _SHARED_SCALE
        linear *= _SHARED_SCALE
    return hessian, linear, constraints, high, low, sense
