"""The safety filter: the joint velocity nearest to the desired one that breaks no limit.

One small QP per tick (DAQP) in the joint velocity q̇ and the share s of the commanded twist:

    minimise   ½ ‖q̇ − q̇_des‖²_W − price · s
    subject to J q̇ = s ẋ,  0 ≤ s ≤ 1          the direction is kept, only speed gives way
               lower ≤ q̇ ≤ upper               position, velocity and acceleration limits
               ∇ρ·q̇ + ∂ρ/∂t ≥ −rate · ρ        control barrier of every near pair

Barriers and position limits ask for no braking that the acceleration limits do not give. Let
T = max_j |q̇_j| / a_j be the time in which the arm can stop with all joints slowing in
proportion; a clearance or joint range h is then used up by at most |ḣ| T/2 until standstill, so
ḣ ≥ −h / (T/2 + dt) can always be kept by braking (docs/safety.md has the proof).

Where the first problem has no solution the next one is tried:

    SCALED    T may grow by dt: the arm may speed up.
    BRAKING   T must shrink by dt, and the twist may keep a share r ≤ 1 − dt/T of the present
              one, J q̇ = s ẋ + r J q̇_prev: an arm in motion cannot turn or stop at once.
    YIELDING  the path gives way, as little as possible: only where something moves into the arm
              or was found too close to it, and only if that is allowed.
    FORCED    the twist stops, s = 0, and each barrier gets a heavily priced slack of its own: one
              that nothing can be done about costs the others nothing; limits stay.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import daqp
import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Matrix, Vector

Array = npt.NDArray[np.float64]
Found = npt.NDArray[np.intp]

# Price of the whole twist in units of ½‖q̇_des‖²: null-space motion may be √200 times as fast as
# the desired motion before the twist slows down for it. Dearer, and the arm whips around.
_PRICE_SCALE = 100.0
# Prices per unit, each large enough to be paid only when nothing cheaper helps; the squared
# joint velocities they compete with are of the order of 1 (rad/s)².
_PRICE_COAST = 1e4
_PRICE_PATH = 1e4
_PRICE_BARRIER = 1e6
# Price of a barrier's slack squared: between two that cannot both be kept it is shared. Giving up
# what is kept in hand is cheaper.
_PRICE_BARRIER_SQUARED = 1e8
_PRICE_SPARE_SQUARED = 1e6
# So many barriers get slacks of their own, those that ask for most; the others share theirs, which
# keeps the problem small among many obstacles.
_OWN_SLACKS = 8
# Where the path must not give way, coasting on must not serve as a way around that.
_PRICE_COAST_STRICT = 1e8
_UNBOUNDED = 1e30
# Multipliers below this are round-off, not a constraint that acts.
_ACTIVE = 1e-9
_TOLERANCE = 1e-9
# Iterations that a stage may take: ten times what hard scenes need. Then the next stage is tried.
_MOST_ITERATIONS = 150
_SOLVED, _OUT_OF_ITERATIONS = 1, -4
_EQUALITY = 5
# Reserve on the stopping distance for gradients that turn while the arm brakes.
_CURVATURE_RESERVE = 1.25


class Stage(Enum):
    """Which problem gave the velocity, in the order in which they are tried."""

    DESIRED = 'the desired velocity breaks no limit'
    SCALED = 'the speed gave way'
    BRAKING = 'the arm brakes'
    YIELDING = 'the arm leaves its path to evade'
    FORCED = 'a clearance could not be kept at the rate asked for'
    STOPPED = 'no problem had a solution: every joint slows down as fast as it may'


class Limits(NamedTuple):
    """What a joint may do [rad, m; per s; per s²].

    Attributes:
        positions: (2, n) highest, then lowest, a margin taken off.
        velocity_max, acceleration_max: (n,).
        margin: [rad, m], half of which may be used up rather than an acceleration limit
            exceeded.
    """

    positions: Array
    velocity_max: Array
    acceleration_max: Array
    margin: float = 0.0


class Barriers(NamedTuple):
    """Reserves that must not be used up: clearances, and distances from singularities.

    Attributes:
        gradient: (p, n) ∂h/∂q.
        drift: (p,) ∂h/∂t from the obstacles' own motion [1/s].
        reserve: (p,) h against the margin; negative inside it, where the arm has to get out.
        soft: how many of the last rows are not urgent and give way before anything else does.
        spare: (p,) how much of a reserve is kept in hand and is given up before the rest of any;
            none if not given.
    """

    gradient: Array
    drift: Array
    reserve: Array
    soft: int = 0
    spare: Array | None = None


class Filtered(NamedTuple):
    """What the filter decided.

    Attributes:
        dq: (n,) joint velocity.
        scale: s, the share of the commanded twist that is followed.
        coast: r, the share of the previous twist that could not be braked away.
        stage: which problem it comes from.
        joints: indices of the joints whose bound acts.
        pairs: indices of the barriers that act.
        cut_short: stages before it whose problem took more iterations than it may.
    """

    dq: Array
    scale: float
    coast: float
    stage: Stage
    joints: Found
    pairs: Found
    cut_short: tuple[Stage, ...] = ()


_NONE = np.empty(0, dtype=np.intp)
_NO_SPARE: Array = np.empty(0)


@compiled
def stopping_time(dq: Vector, acceleration_max: Vector) -> float:
    """Return the time in which all joints, slowing in proportion, come to rest [s]."""
    time = 0.0
    for i in range(len(dq)):
        time = max(time, abs(dq[i]) / acceleration_max[i])
    return time


@compiled
def braked(dq: Vector, acceleration_max: Vector, dt: float) -> Array:
    """Return the velocity (n,) a tick later when all joints slow down in proportion.

    The way to rest that every stage of the filter keeps open (docs/safety.md).
    """
    stop = stopping_time(dq, acceleration_max)
    return dq * ((1.0 - dt / stop) if stop > dt else 0.0)


def velocity_bounds(
    q: Array, previous: Array, limits: Limits, stop: float, dt: float,
) -> tuple[Array, Array, bool]:
    """Return (lower, upper) joint velocities, (n,) each, from which the arm can always stop.

    Upper bound of a joint with distance d to its limit, at acceleration a:
    - the velocity limit, and previous + a dt;
    - d / (T/2 + dt), the largest speed at which braking the whole arm in proportion stops it
      in time. As T ≥ |q̇_j| / a_j for every joint, the joint alone can brake in time as well.
    The lower bound mirrors it. A joint outside its range may not move further out. Where the
    acceleration limit contradicts the others, they win; but measurements are always a little
    old, and an arm that is found further on than it could be may brake in proportion as long as
    that ends within the first half of the margin.

    Args:
        q: (n,) positions.
        previous: (n,) velocity of the last tick.
        limits: of the joints.
        stop: stopping time T that the next velocity may have [s].
        dt: [s].

    Returns:
        lower, upper, and whether they keep the acceleration limits.
    """
    return _velocity_bounds(q, previous, *limits, stop, dt)


@compiled
def _velocity_bounds(
    q: Vector, previous: Vector, positions: Matrix, velocity_max: Vector,
    acceleration_max: Vector, margin: float, stop: float, dt: float,
) -> tuple[Array, Array, bool]:
    n = len(q)
    slowed = braked(previous, acceleration_max, dt)
    highest, bounds, kept = np.empty(2), np.empty((2, n)), True
    for i in range(n):
        # Side 0 is the way up, side 1 the way down, both counted positive outwards.
        for side in range(2):
            outward = 1.0 - 2.0 * side
            room = (positions[side, i] - q[i]) * outward
            speed = max(room, 0.0) / (stop / 2.0 + dt)
            if margin > 0.0:
                last = max(room + 0.5 * margin, 0.0) / (stop / 2.0 + dt)
                speed = max(speed, min(slowed[i] * outward, last))
            highest[side] = min(velocity_max[i], speed)
        for side in range(2):
            reached = previous[i] * (1.0 - 2.0 * side) + acceleration_max[i] * dt
            lowest = -highest[1 - side]
            bounds[side, i] = min(max(reached, lowest), highest[side])
            kept = kept and reached >= lowest - _TOLERANCE
    return -bounds[1], bounds[0], kept


@compiled
def barrier_rate(gain: float, stop: float, dt: float) -> float:
    """Return the share of a clearance that may be used up per second [1/s].

    `gain`, or what proportional braking within the stopping time T can still hold if less.
    """
    return min(gain, 1.0 / (_CURVATURE_RESERVE * stop / 2.0 + dt))


def barrier_bounds(barriers: Barriers, gain: float, stop: float, dt: float) -> Array:
    """Return b (p,) of ∇h·q̇ ≥ b: −rate h − ∂h/∂t.

    Inside the margin (h < 0) the same line asks the pair to move apart.

    Args:
        barriers: what is near.
        gain: largest share of a reserve that may be used up per second [1/s].
        stop: stopping time T that the next velocity may have [s].
        dt: [s].
    """
    return _barrier_bounds(barriers.reserve, barriers.drift, barrier_rate(gain, stop, dt))


@compiled
def _barrier_bounds(reserve: Vector, drift: Vector, rate: float) -> Array:
    return -rate * reserve - drift


@compiled
def admissible(
    dq: Vector, q: Vector, previous: Vector, positions: Matrix, velocity_max: Vector,
    acceleration_max: Vector, margin: float, gradient: Matrix, drift: Vector, reserve: Vector,
    gain: float, dt: float,
) -> bool:
    """Return whether a velocity (n,) keeps every limit and every barrier as it is.

    The arguments are those of `safe_velocity`, with the fields of `Limits` and `Barriers`.
    """
    stop = stopping_time(previous, acceleration_max) + dt
    lower, upper, kept = _velocity_bounds(
        q, previous, positions, velocity_max, acceleration_max, margin, stop, dt)
    bounds = _barrier_bounds(reserve, drift, barrier_rate(gain, stop, dt))
    if not kept:
        return False
    for i in range(len(dq)):
        if not lower[i] <= dq[i] <= upper[i]:
            return False
    for row in range(len(bounds)):
        along = 0.0
        for i in range(len(dq)):
            along += gradient[row, i] * dq[i]
        if not along >= bounds[row]:
            return False
    return True


def safe_velocity(
    desired: Array, exact: bool, jacobian: Array, twist: Array, q: Array, previous: Array,
    limits: Limits, barriers: Barriers, *, weights: Array, gain: float, may_yield: bool,
    dt: float, feedback: Array | None = None, turning: Array | None = None,
) -> Filtered:
    """Return the admissible joint velocity nearest to the desired one.

    Args:
        desired: (n,) what the method asks for.
        exact: whether J q̇_des = ẋ, so that it need not change if it is admissible; not so where
            the least-norm solution is damped.
        jacobian: (m, n).
        twist: (m,) ẋ, drift feedback included.
        q, previous: (n,) measured positions and the velocity of the last tick.
        limits: of the joints.
        barriers: of what is near.
        weights: (n,) diagonal of W.
        gain: barrier gain [1/s].
        may_yield: whether the path may give way to a barrier.
        dt: [s].
        feedback: (m,) the part of ẋ that leads back to the path, zero if not given: the arm may
            return where it must not go on.
        turning: (m,) the tip velocity ½ dt J̇ q̇ that comes of J's turning within the tick, zero if
            not given: J q̇ is that much less than what the tip shall do, at any speed.
    """
    turning = np.zeros(len(twist)) if turning is None else turning
    cut_short: list[Stage] = []
    gradient = barriers.gradient
    a = limits.acceleration_max
    stop = stopping_time(previous, a)
    lower, upper, kept = velocity_bounds(q, previous, limits, stop + dt, dt)
    bounds = barrier_bounds(barriers, gain, stop + dt, dt)
    if kept:
        if exact and admissible(desired, q, previous, *limits, *barriers[:3], gain, dt):
            return Filtered(desired, 1.0, 0.0, Stage.DESIRED, _NONE, _NONE)
        found = _solve(Stage.SCALED, desired, jacobian, twist, turning, None, lower, upper,
                       gradient, bounds, weights, cut_short)
        if found is not None:
            return found

    shorter = max(stop - dt, 0.0)
    # r ≤ 1 enters the problem; the share that proportional braking leaves enters here.
    share = shorter / stop if stop > 0.0 else 0.0
    coasting = share * (jacobian @ previous) + turning
    low, high, _ = velocity_bounds(q, previous, limits, shorter, dt)
    low, high = (np.minimum(np.maximum(low, -a * shorter), high),
                 np.maximum(np.minimum(high, a * shorter), low))
    bounds = barrier_bounds(barriers, gain, shorter, dt)
    found = _solve(Stage.BRAKING, desired, jacobian, twist, turning, coasting, low, high,
                   gradient, bounds, weights, cut_short, share=share)
    if found is not None:
        return found
    # Where nothing but proportional braking is left, the solver may miss it by round-off.
    braked = share * previous
    if bool((braked >= low - _TOLERANCE).all() and (braked <= high + _TOLERANCE).all()
            and (gradient @ braked >= bounds - _TOLERANCE).all()):
        return Filtered(np.minimum(np.maximum(braked, low), high), 0.0, share, Stage.BRAKING,
                        _NONE, _NONE, tuple(cut_short))
    if not kept:
        # Speeding up would cost an acceleration limit later: brake, whatever else gives way.
        lower, upper = low, high
    urgent = len(gradient) - barriers.soft
    gradient, bounds = gradient[:urgent], barrier_bounds(barriers, gain, stop + dt, dt)[:urgent]
    if may_yield:
        found = _solve(Stage.YIELDING, desired, jacobian, twist, turning, coasting, lower, upper,
                       gradient, bounds, weights, cut_short, share=share,
                       path_gives_way=True)
        if found is not None:
            return found
    back = np.zeros(len(twist)) if feedback is None else feedback
    spare = np.zeros(urgent) if barriers.spare is None else (
        barrier_rate(gain, stop + dt, dt) * barriers.spare[:urgent])
    found = _solve(Stage.FORCED, desired, jacobian, back, turning, coasting, lower, upper,
                   gradient, bounds, weights, cut_short, share=share, path_gives_way=may_yield,
                   spare=spare)
    if found is not None:
        return found._replace(scale=0.0)
    still = np.minimum(np.maximum(0.0, lower), upper)
    return Filtered(still, 0.0, 1.0, Stage.STOPPED, _NONE, _NONE, tuple(cut_short))


def _solve(
    stage: Stage, desired: Array, jacobian: Array, twist: Array, turning: Array,
    coasting: Array | None, lower: Array, upper: Array, gradient: Array, bounds: Array,
    weights: Array, cut_short: list[Stage], *, share: float = 0.0, path_gives_way: bool = False,
    spare: Array = _NO_SPARE,
) -> Filtered | None:
    """Set up and solve one stage; None where it has no solution, or none within its iterations.

    The latter is noted in `cut_short`.

    Variables are (q̇, s), then r where the twist may coast, then the barriers' slacks where they
    are allowed: first all that are `spare` (p,) at most, then all that are dearer. A path
    that gives way is a squared price on J q̇ + turning − s ẋ − r coasting instead of a
    constraint.
    """
    slack = stage is Stage.FORCED
    hessian, linear, constraints, high, low, sense = _problem(
        desired, jacobian, twist, turning, twist if coasting is None else coasting, lower, upper,
        gradient, bounds, spare, weights, coasting is not None, slack, path_gives_way)
    x, _, flag, info = daqp.solve(
        hessian, linear, constraints, high, low, sense, primal_tol=_TOLERANCE,
        iter_limit=_MOST_ITERATIONS)
    solved, dq, scale, coast, joints, pairs = _solution(x, info['lam'], lower, upper, len(bounds))
    if flag == _OUT_OF_ITERATIONS:
        cut_short.append(stage)
    if flag != _SOLVED or not solved:
        return None
    return Filtered(dq, scale, share * coast if coasting is not None else 0.0, stage, joints,
                    pairs, tuple(cut_short))


@compiled
def _solution(
    x: Vector, multipliers: Vector, lower: Vector, upper: Vector, pairs: int,
) -> tuple[bool, Array, float, float, Found, Found]:
    """Return whether a solution is finite, then q̇, s, r, and the bounds and barriers that act."""
    n, solved = len(lower), True
    for value in x:
        solved = solved and np.isfinite(value)
    dq = np.minimum(np.maximum(x[:n], lower), upper)
    acting = np.abs(multipliers) > _ACTIVE
    coast = x[n + 1] if len(x) > n + 1 else 0.0
    return (solved, dq, min(max(x[n], 0.0), 1.0), coast, np.flatnonzero(acting[:n]),
            np.flatnonzero(acting[len(acting) - pairs:]))


@compiled
def _problem(
    desired: Vector, jacobian: Matrix, twist: Vector, turning: Vector, coasting: Vector,
    lower: Vector, upper: Vector, gradient: Matrix, bounds: Vector, spare: Vector,
    weights: Vector, may_coast: bool, slack: bool, path_gives_way: bool,
) -> tuple[Array, Array, Array, Array, Array, npt.NDArray[np.int32]]:
    """Return a stage's problem as DAQP takes it: ½ xᵀ H x + fᵀx, low ≤ (x, A x) ≤ high, sense."""
    m, n = jacobian.shape
    rows = len(bounds)
    slacks, groups = n + 1 + may_coast, min(rows, _OWN_SLACKS + 1)
    size = slacks + 2 * groups * slack
    path = np.zeros((m, size))
    for row in range(m):
        for i in range(n):
            path[row, i] = jacobian[row, i]
        path[row, n] = -twist[row]
        if may_coast:
            path[row, n + 1] = -coasting[row]
    hessian, linear = np.zeros((size, size)), np.empty(size)
    effort = 0.0
    for i in range(n):
        hessian[i, i] = weights[i]
        linear[i] = -weights[i] * desired[i]
        effort += weights[i] * desired[i] * desired[i]
    for i in range(n, size):
        hessian[i, i] = 1e-3
    linear[n] = -_PRICE_SCALE * effort - 1e-3
    if may_coast:
        linear[n + 1] = (
            _PRICE_COAST_STRICT if slack and not path_gives_way else _PRICE_COAST)
    if path_gives_way:
        for row in range(m):
            for i in range(size):
                linear[i] += _PRICE_PATH * path[row, i] * turning[row]
                for j in range(size):
                    hessian[i, j] += _PRICE_PATH * path[row, i] * path[row, j]
        m = 0
    constraints = np.zeros((m + rows, size))
    high, low = np.full(size + m + rows, _UNBOUNDED), np.zeros(size + m + rows)
    sense = np.zeros(size + m + rows, dtype=np.int32)
    for i in range(size):
        # Proportional braking alone, r = 1, may be all there is: round-off must not shut it out.
        high[i] = 1.0 + 1e-6
    high[n] = 1.0
    for i in range(n):
        low[i], high[i] = lower[i], upper[i]
    for row in range(m):
        for i in range(size):
            constraints[row, i] = path[row, i]
        low[size + row] = high[size + row] = -turning[row]
        sense[size + row] = _EQUALITY
    for row in range(rows):
        for i in range(n):
            constraints[m + row, i] = gradient[row, i]
        low[size + m + row] = bounds[row]
    if slack:
        demand = np.empty(rows)
        for row in range(rows):
            demand[row] = bounds[row] / (1e-9 + np.sqrt(np.sum(gradient[row] * gradient[row])))
        order = np.argsort(-demand)
        for rank in range(rows):
            row = int(order[rank])
            first = slacks + min(rank, groups - 1)
            second = first + groups
            constraints[m + row, first] = constraints[m + row, second] = 1.0
            hessian[first, first] = _PRICE_SPARE_SQUARED
            hessian[second, second] = _PRICE_BARRIER_SQUARED
            linear[first], linear[second] = 0.0, _PRICE_BARRIER
            high[first] = min(high[first], spare[row]) if rank >= groups else spare[row]
            high[second] = _UNBOUNDED
    return hessian, linear, constraints, high, low, sense
