"""The safety filter: the joint velocity nearest to the desired one that breaks no limit.

One small QP per tick (DAQP) in the joint velocity q̇ and the share s of the commanded twist. Of
an arm with several tips each twist has a share of its own, unless the tips are coupled:

    minimise   ½ ‖q̇ − q̇_des‖²_W − price · s
    subject to J q̇ = s ẋ,  0 ≤ s ≤ 1          the direction is kept, only speed gives way
               lower ≤ q̇ ≤ upper               position, velocity and acceleration limits
               ∇h·q̇ + ∂h/∂t ≥ −rate · h        control barrier of every near pair

Barriers and position limits ask for no braking that the acceleration limits do not give. Let
T = max_j |q̇_j| / a_j be the time in which the arm can stop with all joints slowing in
proportion; a clearance or joint range h is then used up by at most |ḣ| T/2 until standstill, so
ḣ ≥ −h / (T/2 + dt) can always be kept by braking (docs/safety.md has the proof).

Where a problem has no solution the next of `_RULES` is tried. A residual twist is a share
r ≤ 1 − dt/T of the present one that remains, J q̇ = s ẋ + r J q̇_prev: an arm in motion cannot
turn or stop at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import Indices
from redundant_planner.core.safety.barriers import barrier_bounds, Barriers, urgent_rows
from redundant_planner.core.safety.limits import (
    barrier_rate,
    bounds_of_velocity,
    Limits,
    stopping_time,
    TOLERANCE,
)
from redundant_planner.core.safety.qp import Found, solve, StageProblem
from redundant_planner.core.safety.stage import Stage

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


class _Rule(NamedTuple):
    """What may give way in a stage.

    Attributes:
        stage: which.
        brakes: whether the stopping time T must shrink by dt; else it may grow by dt.
        residual: whether a residual twist may remain.
        path: whether the path gives way, as little as possible.
        soft: whether rows that are not urgent count.
        slack: whether the twist stops, and each barrier gets a heavily priced slack: a barrier
            that nothing can keep then costs the others nothing.
        shared: whether all barriers share one slack instead.
    """

    stage: Stage
    brakes: bool
    residual: bool
    path: bool
    soft: bool
    slack: bool
    shared: bool = False


# The order of giving way. Limits of position, velocity and acceleration hold in every stage.
_RULES = (
    _Rule(Stage.SCALED, brakes=False, residual=False, path=False, soft=True, slack=False),
    _Rule(Stage.BRAKING, brakes=True, residual=True, path=False, soft=True, slack=False),
    # Rows that are not urgent turn while the arm moves: it may always brake on its path.
    _Rule(Stage.BRAKING, brakes=True, residual=True, path=False, soft=False, slack=False),
    # Only where something moves into the arm or was found too close to it, if that is allowed.
    _Rule(Stage.YIELDING, brakes=False, residual=True, path=True, soft=False, slack=False),
    _Rule(Stage.FORCED, brakes=False, residual=True, path=True, soft=False, slack=True),
    _Rule(Stage.FORCED, brakes=False, residual=True, path=True, soft=False, slack=True,
          shared=True),
)


class Request(NamedTuple):
    """What the tip and the joints shall do, and where the arm is.

    Attributes:
        desired: (n,) what the method asks for.
        aside: (n,) the null-space part of it.
        jacobian: (m, n).
        twist: (m,) ẋ, feedback included.
        feedback: (m,) the part of ẋ that leads back to the path: the arm may return where it
            must not go on.
        turning: (m,) the tip velocity ½ dt J̇ q̇ that comes of J's turning within the tick:
            J q̇ is that much less than the tip's motion, at any speed.
        q, previous: (n,) measured positions and the velocity of the last tick.
        share_of: (m,) which share s each axis goes with, 0 first; all with one if None.
        order: what each share is worth, as a multiple of the others; 1 if None.
        path_axes: how many axes are the path's, the first ones; all if None. What coupled tips
            keep beside it never gives way.
        spare: how many times the acceleration limits a braking tick may use. In proportional
            braking one joint is at its limit; coupled tips need some room for the others' turning.
    """

    desired: Array
    aside: Array
    jacobian: Array
    twist: Array
    feedback: Array
    turning: Array
    q: Array
    previous: Array
    share_of: Indices | None = None
    order: Array | None = None
    path_axes: int | None = None
    spare: float = 1.0


class Filtered(NamedTuple):
    """What the filter decided.

    Attributes:
        dq: (n,) joint velocity.
        scale: s, the least share of the commanded twist that is followed.
        residual: r, the share of the previous twist that could not be braked away.
        stage: which problem it comes from.
        joints: indices of the joints whose bound acts.
        pairs: indices of the barriers that act.
        cut_short: stages before it whose problem took more iterations than it may.
        scales: all shares, where there are several; None where all are `scale`.
    """

    dq: Array
    scale: float
    residual: float
    stage: Stage
    joints: Found
    pairs: Found
    cut_short: tuple[Stage, ...] = ()
    scales: Array | None = None

    @classmethod
    def untouched(cls, dq: Array) -> Filtered:
        """Return a velocity that needs no change."""
        return cls(dq, 1.0, 0.0, Stage.DESIRED, _NONE, _NONE)


_NONE = np.empty(0, dtype=np.intp)
_NO_SPARE: Array = np.empty(0)
# An acceleration that limits nothing [rad/s², m/s²].
_AT_ONCE = 1e9
# The tip comes to slide along something within about so long [s]. Which way that is turns with
# each tick's gradients, and these with the motion: at once, the arm would shake.
_TURNING_ASIDE = 0.05
# What a slide aims at could be ended with this share of the acceleration limits. With all of it
# each joint that nears its limit would make all joints brake, one such joint after the other.
_GENTLE = 0.125
# How many times dearer joint motion is where the tip slides. With the path's price, 1e4, that is
# 0.05² of the tip's squared deviation [m²]: beside a singularity joints would race for little.
_SLIDING_COST = 25.0
# A radian that a sliding tip turns aside weighs as much as so many metres that it is shifted,
# where it is to be shifted, and where it is to be turned [m/rad]: what is not commanded is to stay
# as it is. A turn that cannot go on would else lead the tip far through the room.
_SHIFTING, _TURNING = 1.0, 0.1


def safe_velocity(
    request: Request, limits: Limits, barriers: Barriers, *, weights: Array, gain: float,
    may_yield: bool, may_slide: bool, dt: float, slides: bool = False, leaves: bool = False,
    price: float = 1.0, angular: Flags | None = None,
) -> Filtered:
    """Return the admissible joint velocity nearest to the desired one.

    Args:
        request: what is asked for.
        limits: of the joints.
        barriers: of what is near.
        weights: (n,) diagonal of W.
        gain: barrier gain [1/s].
        may_yield: whether the path may give way to a barrier.
        may_slide: whether the direction may, rather than the speed.
        slides: whether it did in the last tick. It then goes on to, until the speed need not
            give way: joints at their limits hold the speed back too, and would take turns with
            the barriers.
        dt: [s].
        leaves: whether what is asked for leaves the path already: then nothing is to be scaled,
            and what the barriers leave of it comes next to it.
        price: of the twist, as a share of what it is worth at most.
        angular: (m,) which axes of the twist turn the tip; none if None.
    """
    previous = request.previous
    stop = stopping_time(previous, limits.acceleration_max)
    longer, shorter = stop + dt, max(stop - dt, 0.0)
    lower, upper, kept = bounds_of_velocity(request.q, previous, limits, longer, dt)
    low, high = _braking_bounds(request, limits, shorter, dt)
    # The share of the present twist that proportional braking leaves; r ≤ 1 is of this.
    share = shorter / stop if stop > 0.0 else 0.0
    # To leave a margin less soon is cheaper than to bring another pair nearer to each other.
    spare = barriers.spare + np.maximum(-barriers.value, 0.0)
    residual = share * (request.jacobian @ previous) + request.turning
    share_of = np.zeros(len(residual), np.intp) if request.share_of is None else request.share_of
    shares = 1 if request.share_of is None else int(share_of.max()) + 1
    prices = np.full(shares, price)
    if request.order is not None:
        prices *= request.order
    coupled = request.path_axes is not None
    path_shares = slice(1 if coupled else None)
    path_axes = len(residual) if request.path_axes is None else request.path_axes
    cut_short: list[Stage] = []
    for rule in _RULES:
        # Speeding up would cost an acceleration limit later, if none can be kept now: brake.
        brakes = rule.brakes or not kept
        rows = len(barriers.value) if rule.soft else urgent_rows(barriers)
        again = rule.stage is Stage.BRAKING and not rule.soft and (
            may_yield or rows == len(barriers.value))
        if again or (rule.stage is Stage.SCALED and not kept) or (
                rule.stage is Stage.YIELDING and not may_yield) or (
                leaves and kept and not rule.path):
            continue
        until = shorter if rule.brakes else longer
        gradient = barriers.gradient[:rows]
        bounds = barrier_bounds(barriers, gain, until, dt)[:rows]
        problem = StageProblem(
            request.desired, request.jacobian, request.feedback if rule.slack else request.twist,
            request.turning, residual, low if brakes else lower, high if brakes else upper,
            gradient, bounds,
            barrier_rate(gain, until, dt) * spare[:rows] if rule.slack else _NO_SPARE,
            weights, prices, share_of, shares, rule.residual and not leaves, rule.slack,
            rule.shared, rule.path and may_yield, path_axes, leaves and rule.path)
        found, out_of_iterations = solve(problem)
        if out_of_iterations and rule.stage not in cut_short:
            cut_short.append(rule.stage)
        if may_slide and rows and rule.stage is Stage.SCALED and not (
                found is not None and (
                    found.scales[path_shares].min() >= 1.0
                    or not (slides or len(found.pairs)))):
            far = longer / _GENTLE
            slid = _slid(problem, request, limits, far, dt, _lengths(problem, angular),
                         barrier_bounds(barriers, gain, far, dt)[:rows])
            if slid is not None:
                return slid
        if found is not None:
            return Filtered(
                found.dq, 0.0 if rule.slack else float(found.scales[path_shares].min()),
                share * found.residual if rule.residual else 0.0, rule.stage, found.joints,
                found.pairs, tuple(cut_short),
                None if shares == 1 or coupled or rule.slack else found.scales)
        # Where nothing but proportional braking is left, the solver may miss it by round-off.
        slowed = share * previous
        if rule.stage is Stage.BRAKING and bool(
                (slowed >= low - TOLERANCE).all() and (slowed <= high + TOLERANCE).all()
                and (gradient @ slowed >= bounds - TOLERANCE).all()):
            return Filtered(np.minimum(np.maximum(slowed, low), high), 0.0, share,
                            Stage.BRAKING, _NONE, _NONE, tuple(cut_short))
    still = np.minimum(np.maximum(0.0, lower if kept else low), upper if kept else high)
    return Filtered(still, 0.0, 1.0, Stage.STOPPED, _NONE, _NONE, tuple(cut_short))


def _lengths(problem: StageProblem, angular: Flags | None) -> Array:
    """Return how much each axis (m,) counts where a tip slides [m/rad]; see `_SHIFTING`."""
    lengths = np.ones(len(problem.twist))
    if angular is None:
        return lengths
    for share in range(problem.shares):
        own = problem.share_of == share
        shift = float(np.square(problem.twist[own & ~angular]).sum())
        turn = float(np.square(problem.twist[own & angular]).sum())
        if turn > 0.0:
            lengths[own & angular] = math.sqrt(
                (_SHIFTING**2 * shift + _TURNING**2 * turn) / (shift + turn))
    return lengths


def _slid(
    problem: StageProblem, request: Request, limits: Limits, stop: float, dt: float,
    lengths: Array, bounds: Array,
) -> Filtered | None:
    """Return a velocity that turns aside from what is in the way, None where there is none.

    That is towards the velocity that comes nearest to the twist within all that holds in the long
    run. Joints go there in proportion, so that the arm does not turn on its way.

    Args:
        problem: of the stage in which the speed alone gives way.
        request, limits, dt: see `safe_velocity`.
        stop: stopping time T in which the arm is to be able to end the slide [s].
        lengths: (m,) how much each axis of the twist counts.
        bounds: (b,) of the barriers, for that time. What is commanded keeps those of the problem.
    """
    previous = request.previous
    lower, upper, _ = bounds_of_velocity(
        request.q, previous, limits._replace(acceleration_max=np.full(len(previous), _AT_ONCE)),
        stop, dt)
    slide = problem._replace(
        path_gives_way=True, whole=True, jacobian=lengths[:, None] * problem.jacobian,
        twist=lengths * problem.twist, turning=lengths * problem.turning)
    then, _ = solve(slide._replace(
        desired=request.aside, weights=_SLIDING_COST * problem.weights, lower=lower, upper=upper,
        bounds=bounds))
    if then is None:
        return None
    change = then.dq - previous
    step = limits.acceleration_max * dt
    next_one = previous + change * min(
        dt / (dt + _TURNING_ASIDE),
        float((step / np.maximum(np.abs(change), TOLERANCE)).min()))
    found, _ = solve(slide._replace(
        desired=next_one, twist=lengths * (request.jacobian @ next_one + request.turning)))
    if found is None:
        return None
    squared = float(problem.twist @ problem.twist)
    along = float((problem.jacobian @ found.dq) @ problem.twist)
    return Filtered(
        found.dq, min(max(along / squared, 0.0), 1.0) if squared > 0.0 else 0.0, 0.0,
        Stage.SLIDING, then.joints, then.pairs)


def _braking_bounds(
    request: Request, limits: Limits, shorter: float, dt: float,
) -> tuple[Array, Array]:
    """Return the (lower, upper) velocities (n,) whose stopping time is no longer than asked."""
    low, high, _ = bounds_of_velocity(
        request.q, request.previous, limits if request.spare == 1.0 else limits._replace(
            acceleration_max=request.spare * limits.acceleration_max), shorter, dt)
    fastest = limits.acceleration_max * shorter
    return np.minimum(np.maximum(low, -fastest), high), np.maximum(np.minimum(high, fastest), low)
