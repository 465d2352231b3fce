"""The shortest joint path over the time ahead: Eqs. 11 and 12 as one small QP per tick.

Eq. 11 asks for the joint path of least ∫ q̇ᵀq̇ dt, Eq. 12 that it follows the tip's path. Sampled
at times t₀ … t_N ahead, with the tip's pose known at every one of them, this is

    minimise    Σ ‖q_{i+1} − q_i‖² / (t_{i+1} − t_i)         q₀ is where the arm is
    subject to  pose(q_i) = pose_i                           Eq. 12 at every node
                ρ(q_i) ≥ 0,  q_min ≤ q_i ≤ q_max             for every link and obstacle

About a guess q̄ the second line is solved by q_i = q̄_i + J_i⁺e_i + Z_i w_i, where e_i is the pose
error of q̄_i and Z_i spans the null space of J_i. What remains is a QP in the null-space
coordinates w_i alone, n − m per node, with a block-tridiagonal Hessian. One such step is taken
per tick, from the solution of the last one moved on by dt (real-time iteration): the arm acts on
the problem while it is being solved. docs/horizon.md has the derivation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import NamedTuple

import daqp
import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Fields, Indices, kernel, Matrix, Stack, Vector
from redundant_planner.core.obstacles.clearance import (
    InflatedEllipsoids,
    link_clearance,
    near_pairs_along,
)
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Chain, fill, Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# How far one step may move a node in its null space, and how near a link is to an obstacle when
# it enters the QP [rad, m].
_TRUST = 0.2
_NEAR = 0.15
# What a plan keeps beyond the margin: the filter slows down for what arrives right at it [m].
_RESERVE = 0.0005
# A plan whose poses are further off than the first, as the command has changed, may be worse than
# a new one; further off than the second it is not worth mending [m, rad].
_ASTRAY = 1e-2
_LOST = 0.15
# A plan this near to its poses, clearances and limits counts as free [m, rad]; not being so twice
# in a row counts, as one step mends what a change of the command has done. What else is found must
# be that much shorter to be followed.
_ADMISSIBLE = 3e-3
_PATIENCE = 2
_SHORTER = 0.9
# A survey looks so far to either side of the least-norm path, in steps of that size [rad], and
# what it finds gets so many steps to settle.
_SIDESTEPS = 9
_SIDESTEP_SIZES = (0.3, 0.1)
_SETTLING = 5
# Squared damping of the way back to the poses: near a singularity it takes some more steps [m²].
_DAMPING = 1e-4
# Price of being inside a clearance where paths are compared [1/m].
_PRICE = 200.0
# The first interval is a small one, for the velocity of now; the later ones grow.
_STRETCH = 1.5
_SOFT = 8
# Iterations that a step's problem may take: more than most scenes need. What the solver has by
# then minds the constraints that it has met so far, and the next step goes on from there.
_MOST_ITERATIONS = 50
_SOLVED, _SOLVED_SOFTLY, _OUT_OF_ITERATIONS = 1, 2, -4
_UNBOUNDED = 1e30


def node_times(duration: float, nodes: int) -> Array:
    """Return the times t₀ = 0 … t_N = duration of N nodes, dense at the beginning [s]."""
    return duration * (np.arange(nodes + 1) / nodes) ** _STRETCH


def middles(times: Array) -> Array:
    """Return the times (N,) half way between N + 1 others."""
    return 0.5 * (times[:-1] + times[1:])


class Poses(NamedTuple):
    """Tip poses in the base frame.

    Attributes:
        position: (N, 3) [m].
        rotation: (N, 3, 3) tip axes in the base frame.
    """

    position: Matrix
    rotation: Stack


@compiled
def poses_ahead(start: Pose, twists: Matrix, times: Vector, in_tool: bool) -> Poses:
    """Return where the tip has to be at times[1:].

    Args:
        start: the reference pose at times[0].
        twists: (N, 6) the mean ones from each time to the next [m/s, rad/s].
        times: (N + 1,) from now [s].
        in_tool: whether twists are in tool axes.
    """
    position, rotation = np.empty((len(twists), 3)), np.empty((len(twists), 3, 3))
    for i in range(len(twists)):
        start = se3.integrate(start, twists[i], times[i + 1] - times[i], in_tool)
        position[i], rotation[i] = start
    return Poses(position, rotation)


class _Plan(NamedTuple):
    """A joint path ahead.

    Attributes:
        nodes: (N, n) postures at times[1:].
        cost: Σ ‖Δq‖² / Δt, joint weights included, when it was last looked at.
        error: how far it was off the poses [m, rad].
        intrusion: how far links were inside their clearance [m].
        beyond: how far joints were beyond their limits [rad, m].
    """

    nodes: Array
    cost: float = np.inf
    error: float = np.inf
    intrusion: float = np.inf
    beyond: float = np.inf

    @property
    def admissible(self) -> bool:
        """Whether the arm may follow it all the way."""
        return max(self.error, self.intrusion, self.beyond) < _ADMISSIBLE

    @property
    def price(self) -> float:
        """Its cost with that of being inside a clearance."""
        return self.cost + _PRICE * max(self.intrusion + _RESERVE, 0.0)


class _Arms(NamedTuple):
    """The fields of `Kinematics` at N postures."""

    nodes: Matrix
    columns: Stack
    tip_position: Matrix
    tip_rotation: Stack
    tip_jacobian: Stack
    jacobian: Stack
    segment_start: Stack
    segment_end: Stack


class _Local(NamedTuple):
    """A plan's surroundings: q_i = base_i + w_i directions_i follows the poses to first order.

    Attributes:
        base: (N, n).
        directions: (N, n − m, n) the null space of every node.
        linear, hessian: of the cost in w, (N (n − m),) and square.
        gradients: (p, n) ∂ρ/∂q of the pairs of links and obstacles near any node.
        bounds: (p,) what a step must add to ρ at least.
        at: (p,) their nodes.
    """

    base: Matrix
    directions: Stack
    linear: Vector
    hessian: Matrix
    gradients: Matrix
    bounds: Vector
    at: Indices


@dataclass
class _Survey:
    """Paths that start to either side of the arm, on a snapshot of the problem.

    Attributes:
        q, poses, maps: the snapshot.
        aside: (n,) the direction looked in; its projection on the null space counts.
        size: of a step aside [rad, m].
        here: (n,) where the next path starts.
        elapsed: time since the snapshot [s].
        rows: what was seen to one side and then the other, outwards each: postures (N, n) and
            their price (N,).
    """

    q: Array
    poses: Poses
    maps: InflatedEllipsoids
    aside: Array
    size: float
    here: Array
    elapsed: float = 0.0
    rows: list[tuple[Array, Array]] = field(default_factory=list)


class Horizon:
    """The joint path ahead of one arm.

    It remembers the plan that the arm follows from tick to tick. A linearised problem finds the
    best path on its own side of an obstacle, not the better side. Every other tick therefore
    goes to a survey: least-norm paths that start where the arm would be had it moved aside
    along its null space, one per tick, further and further to one side and to the other.
    Dynamic programming then picks the cheapest free way through all their postures, which
    settles for a few steps and replaces the plan if the plan is not free or clearly longer.
    With one spare degree of freedom a survey sees every way within its reach; with more it sees
    a slice, each time another one. The order is fixed, and so is the result.

    Attributes:
        times: (N + 1,) of the nodes, from now [s].
        cut_short: whether the last problem took more iterations than it may.
    """

    def __init__(
        self, robot: Robot, times: Array, scaling: Array, position_min: Array,
        position_max: Array,
    ) -> None:
        """Prepare for times (N + 1,) ahead.

        Args:
            robot: the arm.
            times: from `node_times`.
            scaling: (n,) 1 / square root of the joint weights.
            position_min, position_max: (n,) margins taken off [rad, m].
        """
        self.times = times
        self._robot, self._scaling = robot, scaling
        self._low, self._high = position_min, position_max
        self._stiffness = 1.0 / np.diff(times)
        self._moving_on: tuple[float, Array] | None = None
        self.cut_short = False
        self.reset()

    @property
    def nodes(self) -> Array | None:
        """The planned postures (N, n) at times[1:]; None before the first tick."""
        return None if self._plan is None else self._plan.nodes.copy()

    @property
    def free(self) -> bool:
        """Whether the plan led all the way when it was last looked at."""
        return self._plan is not None and self._plan.admissible

    def reset(self) -> None:
        """Forget the plan and the survey."""
        self._plan: _Plan | None = None
        self._survey: _Survey | None = None
        self._found: _Plan | None = None
        self._closest: Array | None = None
        self._ticks, self._settled, self._surveys, self._troubled = 0, 0, 0, 0
        self._random = np.random.default_rng(0)

    def advance(self, q: Array, poses: Poses, maps: InflatedEllipsoids, dt: float) -> Array | None:
        """Move the plan on by `dt`, take one step to improve it, and return its velocity (n,) now.

        None where the QP has no solution; the next tick then starts afresh.

        Args:
            q: (n,) where the arm is.
            poses: N, from `poses_ahead`.
            maps: the obstacles now, for links with their margin.
            dt: time since the last tick [s].
        """
        self.cut_short = False
        if self._plan is not None:
            self._plan = self._moved_on(self._plan, q, dt)
        if self._found is not None:
            self._found = self._moved_on(self._found, q, dt)
        if self._survey is not None:
            self._survey.elapsed += dt
        self._step(q, poses, maps)
        return None if self._plan is None else (self._plan.nodes[0] - q) * self._stiffness[0]

    def _step(self, q: Array, poses: Poses, maps: InflatedEllipsoids) -> None:
        """Give one step to the plan, to a survey or to what one has found."""
        self._ticks += 1
        if self._plan is None or self._ticks % (4 if self._blocked else 2) == 0:
            self._follow(q, poses, maps)
        elif self._found is not None:
            self._settle(q, poses, maps)
        else:
            self._look_around(q, poses, maps)

    @property
    def _blocked(self) -> bool:
        """Whether the plan leads nowhere."""
        return self._troubled >= _PATIENCE

    def _follow(self, q: Array, poses: Poses, maps: InflatedEllipsoids) -> None:
        """Take one step with the plan; start anew where that is better than mending it."""
        plan = None
        if self._plan is not None:
            plan, local = self._look(q, self._plan.nodes, poses, maps)
            self._troubled = 0 if plan.admissible else self._troubled + 1
            self._closest = (local.gradients[int(local.bounds.argmax())]
                             if local.bounds.size else None)
            if plan.error < _ASTRAY:
                self._plan = self._improved(plan, local)
                return
        fresh, around = self._look(q, self._least_norm_path(q, poses), poses, maps)
        if plan is not None and plan.error < _LOST and fresh.price >= _SHORTER * plan.price:
            self._plan = self._improved(plan, local)
            return
        self._survey = self._found = None
        # Having looked twice, it leaves the rest of the work to the next step.
        self._plan, self._troubled = self._improved(fresh, around) if plan is None else fresh, 0

    def _look_around(self, q: Array, poses: Poses, maps: InflatedEllipsoids) -> None:
        """Take one step of a survey; at its end, the cheapest way that it has found."""
        if self._survey is None:
            # Away from the obstacle that the plan is closest to, or just anywhere.
            aside = self._random.normal(size=len(q))
            if self._closest is not None and self._surveys % 4 < 2:
                aside = self._closest
            size = _SIDESTEP_SIZES[self._surveys % len(_SIDESTEP_SIZES)]
            self._surveys += 1
            self._survey = _Survey(q, poses, maps, aside, size, q)
        survey = self._survey
        nodes = self._least_norm_path(survey.here, survey.poses)
        survey.rows.append((nodes, self._price(nodes, survey.maps)))
        if len(survey.rows) > 2 * _SIDESTEPS:
            self._survey = None
            self._found, self._settled = self._cheapest(survey, q), 0
            return
        if len(survey.rows) == _SIDESTEPS + 1:
            survey.here, survey.aside = survey.q, -survey.aside
        survey.here, survey.aside = self._sidestep(
            survey.here, survey.aside, survey.size)

    def _sidestep(self, q: Array, aside: Array, size: float) -> tuple[Array, Array]:
        """Return a posture (n,) a step aside with the same tip pose, and the step's direction."""
        arm = self._robot.kinematics(q)
        step = null_space.project(
            null_space.decompose(arm.jacobian * self._scaling), aside / self._scaling)
        step *= self._scaling / max(math.sqrt(step @ step), 1e-9)
        pose = Poses(arm.tip_position[None], arm.tip_rotation[None])
        return self._least_norm_path(q + size * step, pose)[0], step

    def _price(self, nodes: Array, maps: InflatedEllipsoids) -> Array:
        """Return what being at postures (N, n) costs a survey, (N,)."""
        arms = self._robot.kinematics_along(nodes)
        pairs = link_clearance(maps, arms.segment_start, arms.segment_end, self.times[1:])
        intrusion = -pairs.distance.min(axis=(1, 2), initial=np.inf)
        return _PRICE * np.maximum(intrusion + _RESERVE, 0.0)

    def _cheapest(self, survey: _Survey, q: Array) -> _Plan:
        """Return the cheapest way through a survey's postures, by dynamic programming."""
        postures = np.array([row for row, _ in survey.rows]).transpose(1, 0, 2)
        prices = np.array([price for _, price in survey.rows]).T
        scaled = postures / self._scaling
        gaps = scaled[:-1, :, None] - scaled[1:, None]
        steps = (gaps * gaps).sum(axis=-1) * self._stiffness[1:, None, None]
        first = scaled[0] - survey.q / self._scaling
        value = (first * first).sum(axis=-1) * self._stiffness[0] + prices[0]
        origins = []
        for step, price in zip(steps, prices[1:]):
            total = value[:, None] + step
            origins.append(total.argmin(axis=0))
            value = total.min(axis=0) + price
        at = int(value.argmin())
        way = [at]
        for origin in reversed(origins):
            at = int(origin[at])
            way.append(at)
        nodes = postures[np.arange(len(way)), way[::-1]]
        return self._moved_on(_Plan(nodes), q, survey.elapsed)

    def _settle(self, q: Array, poses: Poses, maps: InflatedEllipsoids) -> None:
        """Take one step with what a survey has found; take it over if it is better."""
        assert self._found is not None and self._plan is not None
        found, local = self._look(q, self._found.nodes, poses, maps)
        self._settled += 1
        if self._settled > 2 and found.admissible and (
                self._blocked or found.cost < _SHORTER * self._plan.cost):
            self._plan, self._found, self._troubled = found, None, 0
        elif self._settled > _SETTLING:
            self._found = None
        else:
            self._found = self._improved(found, local)

    def _moved_on(self, plan: _Plan, q: Array, dt: float) -> _Plan:
        """Return a plan at the new times, by interpolation."""
        if self._moving_on is None or self._moving_on[0] != dt:
            self._moving_on = dt, np.array([
                np.interp(self.times[1:] + dt, self.times, row)
                for row in np.eye(len(self.times))]).T
        return plan._replace(nodes=self._moving_on[1] @ np.vstack((q, plan.nodes)))

    def _least_norm_path(self, q: Array, poses: Poses) -> Array:
        """Return the postures (N, n) that follow the poses with the least motion each."""
        robot = self._robot
        nodes = np.empty((len(poses.position), len(q)))
        for i in range(len(nodes)):
            q = nodes[i] = _least_norm_step(
                q, poses.position[i], poses.rotation[i], *robot.joints(q), robot.chain,
                self._scaling, self._low, self._high)
        return nodes

    def _look(
        self, q: Array, nodes: Array, poses: Poses, maps: InflatedEllipsoids,
    ) -> tuple[_Plan, _Local]:
        """Measure a plan and linearise about it."""
        robot = self._robot
        arms = robot.kinematics_along(nodes)
        *measured, local = _linearised(
            q, tuple(arms), tuple(poses), tuple(maps), self.times, self._scaling, self._low,
            self._high, robot.moves, robot.rows, robot.in_tool)
        return _Plan(nodes, *measured), _Local(*local)

    def _improved(self, plan: _Plan, local: _Local) -> _Plan | None:
        """Return the QP's solution about a plan; None where it has none."""
        constraints, high, low, sense = _constraints(
            tuple(local), self._low, self._high)
        w, _, flag, _ = daqp.solve(
            local.hessian, local.linear, constraints, high, low, sense,
            iter_limit=_MOST_ITERATIONS)
        self.cut_short = flag == _OUT_OF_ITERATIONS
        if flag not in (_SOLVED, _SOLVED_SOFTLY, _OUT_OF_ITERATIONS) or not np.isfinite(w).all():
            return None
        w = np.minimum(np.maximum(w, -_TRUST), _TRUST)
        count, free, _ = local.directions.shape
        step = (w.reshape(count, 1, free) @ local.directions)[:, 0]
        return plan._replace(nodes=local.base + step)


@kernel
def _pose_error(
    poses: Poses, at: int, position: Vector, rotation: Matrix, rows: Indices, in_tool: bool,
) -> Array:
    """Return the controlled error (m,) of a tip pose against the one due at a node."""
    due = Pose(poses.position[at].copy(), poses.rotation[at].copy())
    return se3.pose_error(due, Pose(position.copy(), rotation.copy()), in_tool)[rows]


@compiled
def _step_to_pose(orthogonal: Matrix, upper: Matrix, error: Vector) -> Array:
    """Return the damped least-norm step Jᵀ (J Jᵀ + damping)⁻¹ e, (n,), of Jᵀ = Q [R; 0].

    With J Jᵀ = Rᵀ R: a Cholesky decomposition of Rᵀ R + damping, and two substitutions.
    """
    m = len(error)
    lower, dual = np.zeros((m, m)), np.empty(m)
    for i in range(m):
        for j in range(i + 1):
            total = _DAMPING if i == j else 0.0
            for k in range(j + 1):
                total += upper[k, i] * upper[k, j] - (
                    lower[i, k] * lower[j, k] if k < j else 0.0)
            lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
    for i in range(m):
        total = error[i]
        for k in range(i):
            total -= lower[i, k] * dual[k]
        dual[i] = total / lower[i, i]
    for i in range(m - 1, -1, -1):
        total = dual[i]
        for k in range(i + 1, m):
            total -= lower[k, i] * dual[k]
        dual[i] = total / lower[i, i]
    step = np.zeros(len(orthogonal))
    for i in range(m):
        along = 0.0
        for k in range(i, m):
            along += upper[i, k] * dual[k]
        for j in range(len(step)):
            step[j] += orthogonal[j, i] * along
    return step


@compiled
def _linearised(
    q: Vector, arms: Fields[_Arms], poses: Fields[Poses], maps: Fields[InflatedEllipsoids],
    times: Vector, scaling: Vector, low: Vector, high: Vector, moves: Matrix, rows: Indices,
    in_tool: bool,
) -> tuple[float, float, float, float, Fields[_Local]]:
    """Return a plan's cost, error, intrusion and beyond, see `_Plan`, and its surroundings.

    Args:
        q: (n,) where the arm is.
        arms: at the plan's nodes.
        poses, maps: the problem.
        times: (N + 1,) of `Horizon`.
        scaling: (n,) 1 / square root of the joint weights.
        low, high: (n,) the joint limits.
        moves, rows, in_tool: see `Robot`.
    """
    arms, poses, maps = _Arms(*arms), Poses(*poses), InflatedEllipsoids(*maps)
    count, n = arms.nodes.shape
    free = n - len(rows)
    size = count * free
    base, steps, basis = np.empty((count, n)), np.empty((count, n)), np.empty((count, free, n))
    error, beyond = 0.0, -np.inf
    for i in range(count):
        for j in range(n):
            beyond = max(beyond, arms.nodes[i, j] - high[j], low[j] - arms.nodes[i, j])
        off = _pose_error(
            poses, i, arms.tip_position[i], arms.tip_rotation[i], rows, in_tool)
        error = max(error, np.abs(off).max())
        orthogonal, upper = null_space.orthogonal_factors(arms.jacobian[i] * scaling)
        steps[i] = scaling * _step_to_pose(orthogonal, upper, off)
        base[i] = arms.nodes[i] + steps[i]
        for w in range(free):
            basis[i, w] = orthogonal[:, len(rows) + w]

    # Σ ‖Δq‖² / Δt in the coordinates w; the basis is orthonormal in the scaled joints.
    cost, linear, hessian = 0.0, np.zeros(size), np.zeros((size, size))
    for i in range(count):
        stiffness = 1.0 / (times[i + 1] - times[i])
        for j in range(n):
            before = q[j] if i == 0 else base[i - 1, j]
            stretch = (base[i, j] - before) / scaling[j]
            cost += stiffness * stretch * stretch
            for w in range(free):
                linear[i * free + w] += stiffness * stretch * basis[i, w, j]
                if i > 0:
                    linear[(i - 1) * free + w] -= stiffness * stretch * basis[i - 1, w, j]
        for w in range(free):
            here = i * free + w
            hessian[here, here] += stiffness
            if i > 0:
                hessian[here - free, here - free] += stiffness
                for other in range(free):
                    there, along = (i - 1) * free + other, 0.0
                    for j in range(n):
                        along += basis[i, w, j] * basis[i - 1, other, j]
                    hessian[here, there] = hessian[there, here] = -stiffness * along

    near = near_pairs_along(
        maps, arms.segment_start, arms.segment_end, arms.columns, moves, times[1:], _NEAR)
    bounds = np.empty(len(near.clearance))
    for i in range(len(bounds)):
        bounds[i] = _RESERVE / near.smallest[i] - near.clearance[i]
        for j in range(n):
            bounds[i] -= near.gradient[i, j] * steps[near.postures[i], j]
    local = _Local(base, basis * scaling, linear, hessian, near.gradient, bounds, near.postures)
    return cost, error, -near.nearest, beyond, local[:]


@compiled
def _constraints(
    local: Fields[_Local], low: Vector, high: Vector,
) -> tuple[Array, Array, Array, npt.NDArray[np.int32]]:
    """Return what bounds a step w: (c, N (n − m)) rows, their bounds after those of w, sense.

    Args:
        local: a plan's surroundings.
        low, high: (n,) the joint limits, of which those enter that this step could reach.
    """
    local = _Local(*local)
    count, free, n = local.directions.shape
    size, pairs = count * free, len(local.bounds)
    reachable = np.zeros((count, n), np.bool_)
    limits = 0
    for i in range(count):
        for j in range(n):
            span = 0.0
            for w in range(free):
                span += _TRUST * abs(local.directions[i, w, j])
            reachable[i, j] = (span > high[j] - local.base[i, j]
                               or -span < low[j] - local.base[i, j])
            limits += reachable[i, j]
    rows = np.zeros((pairs + limits, size))
    least = np.full(size + pairs + limits, -_TRUST)
    most = np.full(size + pairs + limits, _TRUST)
    sense = np.zeros(size + pairs + limits, np.int32)
    sense[size:] = _SOFT
    for row in range(pairs):
        at = local.at[row]
        for w in range(free):
            for j in range(n):
                rows[row, at * free + w] += (
                    local.directions[at, w, j] * local.gradients[row, j])
        least[size + row], most[size + row] = local.bounds[row], _UNBOUNDED
    row = pairs
    for i in range(count):
        for j in range(n):
            if reachable[i, j]:
                for w in range(free):
                    rows[row, i * free + w] = local.directions[i, w, j]
                least[size + row] = low[j] - local.base[i, j]
                most[size + row] = high[j] - local.base[i, j]
                row += 1
    return rows, most, least, sense


@compiled
def _least_norm_step(
    q: Vector, position: Vector, rotation: Matrix, screws: Matrix, rotations: Stack,
    positions: Matrix, chain: Fields[Chain], scaling: Vector, low: Vector, high: Vector,
) -> Array:
    """Return the posture (n,) that a damped least-norm step towards a tip pose leads to.

    Args:
        q: (n,) where it starts.
        position, rotation: the pose.
        screws, rotations, positions, chain: see `fill`.
        scaling: (n,) 1 / square root of the joint weights.
        low, high: (n,) what the joints stay within.
    """
    n, rows, in_tool = len(q), chain[5], chain[6]
    links = len(chain[3])
    tip, turn, jacobian = np.empty(3), np.empty((3, 3)), np.empty((len(rows), n))
    fill(screws, rotations, positions, chain, np.empty((6, n)), tip, turn, np.empty((6, n)),
         jacobian, np.empty((links, 3)), np.empty((links, 3)))
    error = se3.pose_error(
        Pose(position.copy(), rotation.copy()), Pose(tip, turn), in_tool)[rows]
    orthogonal, upper = null_space.orthogonal_factors(jacobian * scaling)
    step = scaling * _step_to_pose(orthogonal, upper, error)
    return np.minimum(np.maximum(q + step, low), high)
