"""The shortest joint path over the time ahead: Eqs. 11 and 12 as one small QP per step.

Eq. 11 asks for the joint path of least ∫ q̇ᵀq̇ dt, Eq. 12 that it follows the tip's path. Sampled
at times t₀ … t_N ahead, with the tip's pose known at every one of them, this is

    minimise    Σ ‖q_{i+1} − q_i‖² / (t_{i+1} − t_i)         q₀ is where the arm is
                + k_p Σ ‖q_{i+1} − q_p‖² (t_{i+1} − t_i)     where a posture is preferred
    subject to  pose(q_i) = pose_i                           Eq. 12 at every node
                ρ(q_i) ≥ 0,  q_min ≤ q_i ≤ q_max             for every link and obstacle

About a guess q̄ the second line is solved by q_i = q̄_i + J_i⁺e_i + Z_i w_i, where e_i is the pose
error of q̄_i and Z_i spans the null space of J_i. What remains is a QP in the null-space
coordinates w_i alone, n − m per node, with a block-tridiagonal Hessian. One such step is taken
per tick, from the solution of the last one moved on by dt (real-time iteration): the arm acts on
the problem while it is being solved. docs/horizon.md has the derivation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import daqp
import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import PathJoints, step_to_pose
from redundant_planner.core.horizon.poses_ahead import error_to, Poses
from redundant_planner.core.kernels import compiled, entry, Indices, kernel, Matrix, Stack, Vector
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.near_pairs import near_pairs_along
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.cone import cone_room
from redundant_planner.core.robot.kinematics import along_in, Chain, KinematicsAlong
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# How far one step may move a node in its null space [rad, m].
_LARGEST_STEP = 0.2
# How near a link is to an obstacle when the pair enters the QP [m].
_PAIRS_WITHIN = 0.15
# What a plan keeps beyond the margin: the filter slows down for what arrives right at it [m].
_CLEARANCE_RESERVE = 0.0005
# How exactly a plan that counts as free keeps its poses, clearances and limits [m, rad].
_TOLERANCE = 3e-3
# Price of being inside a clearance where paths are compared [1/m].
_INTRUSION_PRICE = 200.0
# Iterations that a step's problem may take: more than most scenes need. What the solver has by
# then minds the constraints that it has met so far, and the next step goes on from there.
_MOST_ITERATIONS = 50
# Of DAQP: a constraint that may be violated at a price, and how a solution has ended.
_SOFT = 8
_SOLVED, _SOLVED_SOFTLY, _OUT_OF_ITERATIONS = 1, 2, -4
_UNBOUNDED = 1e30


class Measures(NamedTuple):
    """How long a plan is, and what it violates.

    Attributes:
        cost: Σ ‖Δq‖² / Δt, joint weights included.
        error: how far it is off the poses [m, rad].
        intrusion: how far links are inside their clearance [m]; negative outside.
        beyond: how far joints are beyond their limits [rad, m]; negative within.
    """

    cost: float = np.inf
    error: float = np.inf
    intrusion: float = np.inf
    beyond: float = np.inf


class Plan(NamedTuple):
    """A joint path ahead.

    Attributes:
        nodes: (N, n) postures at times[1:].
        start: (n,) where it starts.
        times: (N + 1,) of start and nodes, from then [s].
        measures: when it was last looked at; infinite if it never was.
    """

    nodes: Array
    start: Array
    times: Array
    measures: Measures = Measures()

    @property
    def admissible(self) -> bool:
        """Whether the arm may follow it all the way."""
        m = self.measures
        return max(m.error, m.intrusion, m.beyond) < _TOLERANCE

    @property
    def price(self) -> float:
        """Its cost with that of being inside a clearance."""
        return self.measures.cost + intrusion_price(self.measures.intrusion)


@compiled
def intrusion_price(intrusion: float) -> float:
    """Return what it costs to be that far inside a clearance [m]."""
    return _INTRUSION_PRICE * max(intrusion + _CLEARANCE_RESERVE, 0.0)


class LocalProblem(NamedTuple):
    """The QP about a plan: q_i = base_i + w_i directions_i follows the poses to first order.

    Attributes:
        base: (N, n).
        directions: (N, n − m, n) the null space of every node.
        linear, hessian: of the cost in w, (N (n − m),) and square.
        gradients: (p, n) ∂ρ/∂q of the pairs of links and obstacles near any node, then those of
            the tip's cone at each of them, if there is one.
        bounds: (p,) what a step must add to ρ, or to the room in the cone, at least.
        at: (p,) their nodes.
        smallest: (N, n) the nodes of least cost, as if nothing bounded them.
        unbounded: whether these break none of the bounds: then they are the solution.
    """

    base: Matrix
    directions: Stack
    linear: Vector
    hessian: Matrix
    gradients: Matrix
    bounds: Vector
    at: Indices
    smallest: Matrix
    unbounded: bool


class _Linearised(NamedTuple):
    """What a plan's nodes measure, and the QP about them."""

    measures: Measures
    local: LocalProblem


class _Constraints(NamedTuple):
    """What bounds a step w, as DAQP takes it.

    Attributes:
        rows: (c, N (n − m)).
        most, least: (N (n − m) + c,) bounds of w, then of the rows.
        sense: likewise, which of them may be violated at a price.
    """

    rows: Matrix
    most: Vector
    least: Vector
    sense: npt.NDArray[np.int32]


class PathQP:
    """The problem of one arm's joint path, for poses and obstacles that change from step to step.

    Attributes:
        robot: the arm.
        times: (N + 1,) of the nodes, from now; the first is 0 [s]. They may be replaced.
        joints: how they are weighed and bounded.
        cut_short: whether the last step took more iterations than it may.
    """

    def __init__(self, robot: Robot, times: Array, joints: PathJoints) -> None:
        """Prepare for an arm and times from `node_times`."""
        self.robot, self.times, self.joints = robot, times, joints
        self.cut_short = False

    def look(
        self, q: Array, nodes: Array, poses: Poses, obstacles: InflatedObstacles,
    ) -> tuple[Plan, LocalProblem]:
        """Measure a plan and linearise about it.

        Args:
            q: (n,) where the arm is.
            nodes: (N, n) the plan's postures.
            poses: N, where the tip has to be.
            obstacles: the obstacles now.
        """
        measures, local = _linearised(
            q, nodes, poses, obstacles, self.times, self.robot.chain, self.joints)
        return Plan(nodes, q, self.times, measures), local

    def improved(self, plan: Plan, local: LocalProblem) -> Plan | None:
        """Return the QP's solution about a plan; None where it has none."""
        self.cut_short = False
        if local.unbounded:
            return plan._replace(nodes=local.smallest)
        joints = self.joints
        rows, most, least, sense = _constraints(local, joints.position_min, joints.position_max)
        w, _, flag, _ = daqp.solve(
            local.hessian, local.linear, rows, most, least, sense, iter_limit=_MOST_ITERATIONS)
        self.cut_short = flag == _OUT_OF_ITERATIONS
        if flag not in (_SOLVED, _SOLVED_SOFTLY, _OUT_OF_ITERATIONS) or not np.isfinite(w).all():
            return None
        w = np.minimum(np.maximum(w, -_LARGEST_STEP), _LARGEST_STEP)
        return plan._replace(nodes=_stepped(local.base, local.directions, w))


@compiled
def moved_on(start: Vector, nodes: Matrix, times: Vector, later: Vector) -> Array:
    """Return a plan's postures (L, n) at later times (L,), by interpolation.

    Args:
        start: (n,) at times[0].
        nodes: (N, n) at times[1:].
        times, later: (N + 1,) and (L,), ascending [s]; beyond the last the plan stands still.
    """
    found = np.empty((len(later), len(start)))
    node = 1
    for i in range(len(later)):
        while node < len(nodes) and times[node] <= later[i]:
            node += 1
        before = start if node == 1 else nodes[node - 2]
        share = (later[i] - times[node - 1]) / (times[node] - times[node - 1])
        share = min(max(share, 0.0), 1.0)
        for j in range(len(start)):
            found[i, j] = before[j] + share * (nodes[node - 1, j] - before[j])
    return found


@compiled
def taken_along(
    start: Vector, nodes: Matrix, times: Vector, later: Vector, q: Vector, fading: Vector,
) -> Array:
    """Return a plan's postures (L − 1, n) at later times later[1:], for an arm beside it.

    At later[0] the arm is at q. The plan comes along by as much, less and less towards its end:
    else its velocity would change with every tick that does not improve it.

    Args:
        start, nodes, times, later: as for `moved_on`.
        q: (n,) where the arm is.
        fading: (L − 1,) by what share of its way the plan comes along.
    """
    found = moved_on(start, nodes, times, later)
    for i in range(len(fading)):
        for j in range(len(q)):
            found[i + 1, j] += fading[i] * (q[j] - found[0, j])
    return found[1:]


class _Followed(NamedTuple):
    """Nodes that follow their poses to first order.

    Attributes:
        base: (N, n) the nodes, each a step to its pose further.
        steps: (N, n) these steps.
        basis: (N, n − m, n) of the null spaces, orthonormal in the scaled joints.
        error: the largest pose error before [m, rad].
    """

    base: Matrix
    steps: Matrix
    basis: Stack
    error: float


@kernel
def _followed(
    arms: KinematicsAlong, poses: Poses, chain: Chain, scaling: Vector,
) -> _Followed:
    """Take a damped least-norm step from every node to its pose, see `_linearised`."""
    count, n = arms.q.shape
    free = n - len(chain.rows)
    base, steps, basis = np.empty((count, n)), np.empty((count, n)), np.empty((count, free, n))
    largest = 0.0
    for i in range(count):
        error = error_to(
            Pose(poses.position[i], poses.rotation[i]),
            Pose(arms.tip_position[i], arms.tip_rotation[i]), chain.rows, chain.in_tool)
        largest = max(largest, np.abs(error).max())
        orthogonal, upper = null_space.orthogonal_factors(arms.jacobian[i] * scaling)
        steps[i] = scaling * step_to_pose(orthogonal, upper, error)
        base[i] = arms.q[i] + steps[i]
        for w in range(free):
            basis[i, w] = orthogonal[:, len(chain.rows) + w]
    return _Followed(base, steps, basis, largest)


@kernel
def _path_cost(
    q: Vector, base: Matrix, basis: Stack, times: Vector, joints: PathJoints,
) -> tuple[float, Array, Array]:
    """Return Σ ‖Δq‖² / Δt + k_p Σ ‖q − q_p‖² Δt; half its gradient and Hessian in w."""
    scaling = joints.scaling
    count, free, n = basis.shape
    size = count * free
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
        for j in range(n):
            preference = joints.preference * (times[i + 1] - times[i])
            off = base[i, j] - joints.preferred[j]
            if preference == 0.0 or math.isnan(off):
                continue
            cost += preference * off * off
            for w in range(free):
                slope = preference * scaling[j] * basis[i, w, j]
                linear[i * free + w] += slope * off
                for other in range(free):
                    hessian[i * free + w, i * free + other] += (
                        slope * scaling[j] * basis[i, other, j])
    return cost, linear, hessian


@compiled
def _stepped(base: Matrix, directions: Stack, w: Vector) -> Array:
    """Return the nodes (N, n) that a step w (N (n − m),) leads to, see `LocalProblem`."""
    count, free, n = directions.shape
    nodes = base.copy()
    for i in range(count):
        for k in range(free):
            for j in range(n):
                nodes[i, j] += w[i * free + k] * directions[i, k, j]
    return nodes


@compiled
def smallest_of(hessian: Matrix, linear: Vector, band: int) -> Array:
    """Return the w of least ½ wᵀ H w + cᵀ w, by a Cholesky decomposition of H.

    Args:
        hessian: H (k, k), positive definite.
        linear: c (k,).
        band: entries of H that are further than this from its diagonal are 0.
    """
    size = len(linear)
    lower, w = np.zeros((size, size)), np.empty(size)
    for i in range(size):
        first = max(i - band, 0)
        for j in range(first, i + 1):
            total = hessian[i, j]
            for k in range(first, j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
        total = -linear[i]
        for k in range(first, i):
            total -= lower[i, k] * w[k]
        w[i] = total / lower[i, i]
    for i in range(size - 1, -1, -1):
        total = w[i]
        for k in range(i + 1, min(i + band + 1, size)):
            total -= lower[k, i] * w[k]
        w[i] = total / lower[i, i]
    return w


@kernel
def _breaks_no_bound(
    w: Vector, smallest: Matrix, local: LocalProblem, joints: PathJoints,
) -> bool:
    """Return whether a step w, which leads to nodes (N, n), breaks none of the constraints."""
    count, n = smallest.shape
    for step in w:
        if abs(step) > _LARGEST_STEP:
            return False
    for i in range(count):
        for j in range(n):
            if not joints.position_min[j] <= smallest[i, j] <= joints.position_max[j]:
                return False
    for row in range(len(local.bounds)):
        at, change = local.at[row], 0.0
        for j in range(n):
            change += local.gradients[row, j] * (smallest[at, j] - local.base[at, j])
        if change < local.bounds[row]:
            return False
    return True


@entry
def _linearised(
    q: Vector, nodes: Matrix, poses: Poses, obstacles: InflatedObstacles, times: Vector,
    chain: Chain, joints: PathJoints,
) -> _Linearised:
    """Return what a plan's nodes measure, and the QP about them.

    Args:
        q: (n,) where the arm is.
        nodes: (N, n) the plan's.
        poses, obstacles: the problem.
        times: (N + 1,) of the nodes [s].
        chain: the arm.
        joints: see there.
    """
    count, n = nodes.shape
    beyond = -np.inf
    for i in range(count):
        for j in range(n):
            beyond = max(beyond, nodes[i, j] - joints.position_max[j],
                         joints.position_min[j] - nodes[i, j])
    arms = along_in(nodes, chain)
    followed = _followed(arms, poses, chain, joints.scaling)
    cost, linear, hessian = _path_cost(
        q, followed.base, followed.basis, times, joints)
    near = near_pairs_along(obstacles, arms, chain, times[1:], _PAIRS_WITHIN)
    pairs = len(near.postures)
    rows = pairs + (count if joints.cone.angle < math.pi else 0)
    gradients, bounds, at = np.empty((rows, n)), np.empty(rows), np.empty(rows, np.intp)
    for i in range(rows):
        if i < pairs:
            at[i], gradients[i] = near.postures[i], near.gradient[i]
            bounds[i] = _CLEARANCE_RESERVE / near.smallest[i] - near.normalized_distance[i]
        else:
            at[i] = i - pairs
            room, gradients[i] = cone_room(
                joints.cone, arms.tip_rotation[at[i]], arms.joint_screws[at[i]])
            bounds[i] = -room
        for j in range(n):
            bounds[i] -= gradients[i, j] * followed.steps[at[i], j]
    directions, base = followed.basis * joints.scaling, followed.base
    w = smallest_of(hessian, linear, 2 * directions.shape[1] - 1)
    smallest = _stepped(base, directions, w)
    local = LocalProblem(base, directions, linear, hessian, gradients, bounds, at, smallest, True)
    return _Linearised(
        Measures(cost, followed.error, -near.nearest, beyond),
        LocalProblem(base, directions, linear, hessian, gradients, bounds, at, smallest,
                     _breaks_no_bound(w, smallest, local, joints)))


@entry
def _constraints(local: LocalProblem, low: Vector, high: Vector) -> _Constraints:
    """Return what bounds a step.

    Args:
        local: the QP about a plan.
        low, high: (n,) the joint limits; only those enter that this step could reach.
    """
    count, free, n = local.directions.shape
    size, pairs = count * free, len(local.bounds)
    reachable = np.zeros((count, n), np.bool_)
    limits = 0
    for i in range(count):
        for j in range(n):
            span = 0.0
            for w in range(free):
                span += _LARGEST_STEP * abs(local.directions[i, w, j])
            reachable[i, j] = (span > high[j] - local.base[i, j]
                               or -span < low[j] - local.base[i, j])
            limits += reachable[i, j]
    rows = np.zeros((pairs + limits, size))
    least = np.full(size + pairs + limits, -_LARGEST_STEP)
    most = np.full(size + pairs + limits, _LARGEST_STEP)
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
    return _Constraints(rows, most, least, sense)
