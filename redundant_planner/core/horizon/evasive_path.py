"""The joint path that leaves the commanded path least, past obstacles that move: one step to it.

Nodes q_1 … q_N, at times t_i about Δ apart, are to minimise

    Δ Σ ‖e(q_i)‖² + k_v ‖q̇_i‖² + k_a ‖q̈_i‖²
    + ½ Δ k_c Σ max(0, reserve − d(q, t))²          for every link and obstacle, moved on until t,
                                                    at the nodes and halfway between them
    + k_b Σ of the squares by which limits of position, velocity and acceleration are exceeded

e is how far the tip is from the path, metres and radians alike: it counts little how far it stays
behind. Clearances and limits are prices, not constraints: then there is always a solution, and
the safety filter keeps both anyway.

A step solves that with e and d linearised about a guess. What is left is a least-squares problem
whose prices begin at a bound each. Those beyond their bound are found by solving it again until
they stay the same. Its matrix is banded: a node shares terms with the next two. As much of the
step is taken as makes the sum smaller. `evasive_plan` has the paths to begin with, and when the
arm follows one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_squares import (
    add_of_rate,
    add_row,
    smallest_of,
    Squares,
    Stencil,
)
from redundant_planner.core.horizon.poses_ahead import error_to, poses_at
from redundant_planner.core.kernels import entry, kernel, Matrix, OutVector, Vector
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.near_pairs import near_pairs_along, NearAlong
from redundant_planner.core.robot.kinematics import along_in, Chain, KinematicsAlong
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.safety.limits import Limits

Array = npt.NDArray[np.float64]

# What counts beside the squared error: velocities [s²], accelerations [s⁴], and how far the tip
# stays behind, as a share of what any other error counts.
_EFFORT, _SMOOTHNESS, _BEHIND = 1e-3, 3e-3, 0.1
# What being too near to an obstacle counts beside being off the path, and what being beyond a
# limit does: of position [1], velocity [s²] and acceleration [s⁴], the last times Δ².
CLEARANCE_PRICE = 1e3
_POSITION_PRICE, _RATE_PRICE = 100.0, 1.0
# Shares of the limits of velocity and acceleration that are used: the filter needs the rest.
_VELOCITY_SHARE, _ACCELERATION_SHARE = 0.9, 0.8
# Clearance that is kept beyond what the obstacles are inflated by, and pairs nearer than this are
# looked at [m].
RESERVE, _PAIRS_WITHIN = 0.005, 0.1
# Keeps the matrix positive definite, and how far a step moves a joint of a node [rad, m].
_DAMPING, _LARGEST_STEP = 1e-4, 0.3
# How often a step solves its problem at the most.
_SOLUTIONS = 6
# How many shares of a step are tried, and what share each is of the one before.
_SHARES, _SMALLER = 2, 0.3


class Due(NamedTuple):
    """Where the tip is to be at the nodes.

    Attributes:
        poses: N, those of the command if it goes on.
        along: (m,) unit vector of the commanded twist; 0 without one.
        behind: (N,) how far behind along that the tip may stay: where it is now [m, rad].
    """

    poses: Poses
    along: Vector
    behind: Vector


class Demand(NamedTuple):
    """What is asked of clearances: less to begin with, so that a path finds its way past.

    Attributes:
        price: what the square of a shortage counts.
        reserve: kept beyond what the obstacles are inflated by [m].
    """

    price: float
    reserve: float


class PathProblem(NamedTuple):
    """What the sum above is of, but for the path.

    Attributes:
        q, previous: (n,) where the arm is, and its velocity [rad, m; per s].
        due: where the tip is to be.
        obstacles: the obstacles now, with what is kept from them.
        chain, limits: of the arm.
        scaling: (n,) 1 / square root of the joint weights.
        times: (N,) of the nodes, from now [s].
        demand: of clearances.
    """

    q: Vector
    previous: Vector
    due: Due
    obstacles: InflatedObstacles
    chain: Chain
    limits: Limits
    scaling: Vector
    times: Vector
    demand: Demand


class Improved(NamedTuple):
    """A path after a step, and what was found of it.

    Attributes:
        nodes: (N, n).
        price: of the sum above.
        deviation, at_end: the largest ‖e‖, and that at the last node [m, rad].
        nearest: the smallest distance [m]; and of which link and obstacle.
        nearest_link, nearest_obstacle: these, −1 without obstacles.
        threatened: whether a clearance bends the path.
    """

    nodes: Matrix
    price: float
    deviation: float
    at_end: float
    nearest: float
    nearest_link: int
    nearest_obstacle: int
    threatened: bool


class _Sum(NamedTuple):
    """The sum about a path, without limits and clearances.

    Attributes:
        price: twice its value.
        deviation, at_end: see `Improved`.
        near: pairs near the path, and halfway between its nodes.
    """

    price: float
    deviation: float
    at_end: float
    near: NearAlong


@kernel
def _width(times: Vector, node: int) -> float:
    """Return the time from the node before to this one [s]."""
    return times[0] if node == 0 else times[node] - times[node - 1]


@kernel
def _between(times: Vector, node: int) -> float:
    """Return the time over which the velocity changes to that on the way to a node [s]."""
    return times[0] if node == 0 else 0.5 * (_width(times, node - 1) + _width(times, node))


@kernel
def _velocity_stencil(times: Vector, node: int) -> Stencil:
    per = 1.0 / _width(times, node)
    return Stencil(per, -per, 0.0)


@kernel
def _acceleration_stencil(times: Vector, node: int) -> Stencil:
    per = 1.0 / _between(times, node)
    now = per / _width(times, node)
    before = 0.0 if node == 0 else per / _width(times, node - 1)
    return Stencil(now, -now - before, before)


@kernel
def _rates(
    q: Vector, previous: Vector, nodes: Matrix, node: int, joint: int, times: Vector,
) -> tuple[float, float]:
    """Return a joint's velocity on its way to a node, and its acceleration since the last one."""
    before = q[joint] if node == 0 else nodes[node - 1, joint]
    velocity = (nodes[node, joint] - before) / _width(times, node)
    if node == 0:
        return velocity, (velocity - previous[joint]) / times[0]
    earlier = q[joint] if node == 1 else nodes[node - 2, joint]
    slower = (before - earlier) / _width(times, node - 1)
    return velocity, (velocity - slower) / _between(times, node)


@kernel
def _beyond(value: float, low: float, high: float) -> float:
    """Return how far a value is above a range, or, negative, below it; 0 within."""
    return value - min(max(value, low), high)


@kernel
def _add_errors(
    squares: Squares, problem: PathProblem, arms: KinematicsAlong,
) -> tuple[float, float, float]:
    """Add how far the tip is from its path.

    Returns:
        Twice the value, the largest ‖e‖, and that at the last node.
    """
    due, chain, price, largest, last = problem.due, problem.chain, 0.0, 0.0, 0.0
    (m, n), tips = arms.jacobian.shape[1:], len(chain.tip_joints)
    along, step = due.along, problem.times[-1] / len(due.behind)
    gradient = np.empty(n)
    for i in range(len(due.behind)):
        error = error_to(
            poses_at(due.poses, i, tips),
            poses_at(Poses(arms.tip_positions, arms.tip_rotations), 2 * i + 1, tips), chain.rows,
            chain.in_tool)
        lag = 0.0
        for r in range(m):
            lag += along[r] * error[r]
        share = _BEHIND if 0.0 < lag < due.behind[i] else 1.0
        error -= (1.0 - _BEHIND) * min(max(lag, 0.0), due.behind[i]) * along
        squared = 0.0
        for r in range(m):
            squared += error[r] * error[r]
            for j in range(n):
                forward = 0.0
                for k in range(m):
                    forward += along[k] * arms.jacobian[2 * i + 1, k, j]
                gradient[j] = (1.0 - share) * along[r] * forward - arms.jacobian[2 * i + 1, r, j]
            price += add_row(squares, i * n, gradient, error[r], step)
        last = math.sqrt(squared)
        largest = max(largest, last)
    return price, largest, last


@kernel
def _add_motion(squares: Squares, problem: PathProblem, nodes: Matrix) -> float:
    """Add velocities and accelerations; return twice the value."""
    q, previous, scaling, times = problem.q, problem.previous, problem.scaling, problem.times
    price, n = 0.0, len(q)
    for i in range(len(nodes)):
        for j in range(n):
            velocity, acceleration = _rates(q, previous, nodes, i, j, times)
            weight = _width(times, i) / (scaling[j] * scaling[j])
            price += add_of_rate(
                squares, i * n + j, n, _velocity_stencil(times, i), velocity, _EFFORT * weight)
            price += add_of_rate(
                squares, i * n + j, n, _acceleration_stencil(times, i), acceleration,
                _SMOOTHNESS * weight)
    return price


@kernel
def _add_limits(squares: Squares, problem: PathProblem, nodes: Matrix, trial: Matrix) -> float:
    """Add the limits that trial nodes (N, n) exceed, about other ones; return twice the value."""
    q, previous, limits, times = problem.q, problem.previous, problem.limits, problem.times
    price, n = 0.0, len(q)
    gradient = np.zeros(n)
    for i in range(len(nodes)):
        for j in range(n):
            at, low, high = i * n + j, limits.positions[1, j], limits.positions[0, j]
            if _beyond(trial[i, j], low, high) != 0.0:
                bound = high if trial[i, j] > high else low
                gradient[j] = 1.0
                price += add_row(squares, i * n, gradient, nodes[i, j] - bound, _POSITION_PRICE)
                gradient[j] = 0.0
            velocity, acceleration = _rates(q, previous, trial, i, j, times)
            now, changing = _rates(q, previous, nodes, i, j, times)
            most = _VELOCITY_SHARE * limits.velocity_max[j]
            if abs(velocity) > most:
                price += add_of_rate(
                    squares, at, n, _velocity_stencil(times, i),
                    now - math.copysign(most, velocity), _RATE_PRICE)
            # The first node's is the mean on the way there: it is half of what it starts with.
            since = _between(times, i)
            most = _ACCELERATION_SHARE * limits.acceleration_max[j] * (0.5 if i == 0 else 1.0)
            if abs(acceleration) > most:
                price += add_of_rate(
                    squares, at, n, _acceleration_stencil(times, i),
                    changing - math.copysign(most, acceleration), _RATE_PRICE * since * since)
    return price


@kernel
def _add_clearances(
    squares: Squares, problem: PathProblem, near: NearAlong, nodes: Matrix, trial: Matrix,
    acting: OutVector,
) -> tuple[float, bool]:
    """Add the clearances that trial nodes (N, n) fall short of, likewise.

    Args:
        squares, problem, nodes, trial: see above.
        near: pairs, linearised about the nodes.
        acting: (p,) 1 for pairs that were added the last time, else 0; brought up to date.

    Returns:
        Twice the value, and whether others act than the last time.
    """
    price, changed, (count, n) = 0.0, False, nodes.shape
    demand, step = problem.demand, problem.times[-1] / count
    for pair in range(len(near.postures)):
        node, smallest = near.postures[pair] // 2, near.smallest[pair]
        lack = near.normalized_distance[pair] * smallest - demand.reserve
        then = lack
        # Halfway between two nodes half of it is each one's; the arm does not move with the plan.
        halfway = near.postures[pair] % 2 == 0
        first = max(node - 1, 0) if halfway else node
        gradient = np.empty((node - first + 1) * n)
        for j in range(len(gradient)):
            gradient[j] = (0.5 if halfway else 1.0) * smallest * near.gradient[pair, j % n]
            at = first + j // n
            then += gradient[j] * (trial[at, j % n] - nodes[at, j % n])
        acts = 1.0 if then < 0.0 else 0.0
        changed = changed or acts != acting[pair]
        acting[pair] = acts
        if acts == 1.0:
            price += add_row(squares, first * n, gradient, lack, 0.5 * demand.price * step)
    return price, changed


@kernel
def _sum(squares: Squares, problem: PathProblem, nodes: Matrix, within: float) -> _Sum:
    """Add what always counts about a path; find the pairs that are nearer than `within` [m]."""
    q, times, (count, n) = problem.q, problem.times, nodes.shape
    # Halfway between two nodes the arm is looked at, too: a fast obstacle passes there.
    seen, seen_times = np.empty((2 * count, n)), np.empty(2 * count)
    for i in range(count):
        before, earlier = (q, 0.0) if i == 0 else (nodes[i - 1], times[i - 1])
        seen[2 * i], seen_times[2 * i] = 0.5 * (before + nodes[i]), 0.5 * (earlier + times[i])
        seen[2 * i + 1], seen_times[2 * i + 1] = nodes[i], times[i]
    arms = along_in(seen, problem.chain)
    near = near_pairs_along(problem.obstacles, arms, problem.chain, seen_times, within)
    of_errors, deviation, at_end = _add_errors(squares, problem, arms)
    return _Sum(of_errors + _add_motion(squares, problem, nodes), deviation, at_end, near)


@entry
def improved(problem: PathProblem, nodes: Matrix) -> Improved:
    """Return a path (N, n) that leaves the commanded one less than another one does."""
    count, n = nodes.shape
    size = count * n
    always = Squares(_DAMPING * np.eye(size), np.zeros(size))
    best = _sum(always, problem, nodes, _PAIRS_WITHIN)
    price = best.price
    squares = Squares(np.empty((size, size)), np.empty(size))
    x, trial, found = np.zeros(size), nodes.copy(), nodes
    acting = np.zeros(len(best.near.postures))
    for solution in range(_SOLUTIONS):
        squares.hessian[:], squares.linear[:] = always.hessian, always.linear
        of_limits = _add_limits(squares, problem, nodes, trial)
        of_clearances, changed = _add_clearances(
            squares, problem, best.near, nodes, trial, acting)
        if solution == 0:
            price += of_limits + of_clearances
        elif not changed:
            break
        x = smallest_of(squares.hessian, squares.linear, 3 * n - 1)
        trial = nodes + x.reshape(count, n)
    threatened = bool(np.any(acting > 0.0))
    # Distances bend on the way: the whole step may lead to a worse path.
    none, share = Squares(np.empty((0, 0)), np.empty(0)), 1.0
    for _ in range(_SHARES):
        for i in range(count):
            for j in range(n):
                trial[i, j] = nodes[i, j] + share * min(
                    max(x[i * n + j], -_LARGEST_STEP), _LARGEST_STEP)
        then = _sum(none, problem, trial, problem.demand.reserve)
        now = then.price + _add_limits(none, problem, trial, trial)
        now += _add_clearances(
            none, problem, then.near, trial, trial, np.zeros(len(then.near.postures)))[0]
        if now < price:
            best, price, found = then, now, trial
            break
        share *= _SMALLER
    near = best.near
    return Improved(found, price, best.deviation, best.at_end, near.nearest, near.nearest_link,
                    near.nearest_obstacle, threatened)
