"""The shortest joint path over the time ahead: Eqs. 11 and 12 as one small QP per step.

Eq. 11 asks for the joint path of least ∫ q̇ᵀq̇ dt, Eq. 12 that it follows the tip's path. Sampled
at times t₀ … t_N ahead, with the tip's pose known at every one of them, this is

    minimise    Σ ‖q_{i+1} − q_i‖² / (t_{i+1} − t_i)         q₀ is where the arm is
                + k_p Σ ‖q_{i+1} − q_p‖² (t_{i+1} − t_i)     where a posture is preferred
    subject to  pose(q_i) = pose_i                           Eq. 12 at every node
                ρ(q_i) ≥ 0,  q_min ≤ q_i ≤ q_max             for every link and obstacle

What is left of that about a guess of the nodes, linearised, is a QP in their null spaces
(`path_linearised.py`). One such step is taken per tick, from the solution of the last one moved on
by dt (real-time iteration): the arm acts on the problem while it is being solved.
docs/horizon.md has the derivation.
"""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import PathJoints
from redundant_planner.core.horizon.path_linearised import (
    CLEARANCE_RESERVE,
    LARGEST_STEP,
    linearised,
    LocalProblem,
    Measures,
    stepped,
)
from redundant_planner.core.kernels import compiled, entry, Matrix, Vector
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses

Array = npt.NDArray[np.float64]

# How exactly a plan that counts as free keeps its poses, clearances and limits [m, rad].
_TOLERANCE = 3e-3
# Price of being inside a clearance where paths are compared [1/m].
_INTRUSION_PRICE = 200.0
# Iterations that a step's problem may take: more than most scenes need. What the solver has by
# then minds the constraints that it has met so far, and the next step goes on from there.
_MOST_ITERATIONS = 40
# Of DAQP: a constraint that may be violated at a price, and how a solution has ended.
_SOFT = 8
_SOLVED, _SOLVED_SOFTLY, _OUT_OF_ITERATIONS = 1, 2, -4
_UNBOUNDED = 1e30


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
    return _INTRUSION_PRICE * max(intrusion + CLEARANCE_RESERVE, 0.0)


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
        measures, local = linearised(
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
        w = np.minimum(np.maximum(w, -LARGEST_STEP), LARGEST_STEP)
        return plan._replace(nodes=stepped(local.base, local.directions, w))


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
                span += LARGEST_STEP * abs(local.directions[i, w, j])
            reachable[i, j] = (span > high[j] - local.base[i, j]
                               or -span < low[j] - local.base[i, j])
            limits += reachable[i, j]
    rows = np.zeros((pairs + limits, size))
    least = np.full(size + pairs + limits, -LARGEST_STEP)
    most = np.full(size + pairs + limits, LARGEST_STEP)
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
