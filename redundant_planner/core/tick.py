"""The part of a tick that is machine code: J⁺ẋ + k P∇H (Eq. 1), and the barriers around it.

Every line of `wish` is an equation of the paper, or a section of docs/derivations.md or
docs/safety.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.kernels import entry, kernel, Matrix, OutMatrix, Vector
from redundant_planner.core.machine_code.packed import Packed
from redundant_planner.core.obstacles.clearance import is_contact, link_pair
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.near_pairs import kept_apart, near_pairs, NearPairs
from redundant_planner.core.obstacles.self_collision import near_links, SelfPairs
from redundant_planner.core.obstacles.shapes import ELLIPSOID
from redundant_planner.core.redundancy import criteria, null_space
from redundant_planner.core.redundancy.null_space import Decomposition
from redundant_planner.core.redundancy.reference import poses_after, Start, Task, task_of
from redundant_planner.core.robot.jacobian import derivative_between
from redundant_planner.core.robot.kinematics import Kinematics, Links
from redundant_planner.core.robot.se3 import Place, place, Poses
from redundant_planner.core.safety import barriers as rows
from redundant_planner.core.safety.barriers import barriers_in_compiled, Rows
from redundant_planner.core.safety.limits import Limits, stopping_time
from redundant_planner.core.safety.pace import pace, unseen_distances, unseen_share
from redundant_planner.core.safety.self_motion import self_motion_rows, slow_self_motion
from redundant_planner.core.safety.singularity_row import singularity_row

Array = npt.NDArray[np.float64]

# How often a link is looked at on its way past an obstacle.
_LOOKS = 12


class Setup(NamedTuple):
    """What a planner has in place from tick to tick.

    Attributes:
        constants, limits, gains: see there.
        rows: each tick writes its barriers into the first of these.
    """

    constants: RobotConstants
    limits: Limits
    gains: Gains
    rows: Rows


class World(NamedTuple):
    """What a tick knows of the world, and of the time ahead.

    Attributes:
        obstacles: the obstacles that can matter.
        seen_start, seen_end, ranges: how far all others are, see `Surroundings`.
        path: (n,) velocity of the joint path ahead; anything where it is not followed.
        guided: share of the homogeneous solution that follows it.
        worth: share of the rest of it that is worth its while, see `Planner`.
        strayed: (n,) see `JointObserver`.
        own_gradient: (n,) of the user's criteria, weights included; zero without any.
    """

    obstacles: InflatedObstacles
    seen_start: Matrix
    seen_end: Matrix
    ranges: Vector
    path: Vector
    guided: float
    worth: float
    strayed: Vector
    own_gradient: Vector


class Wish(NamedTuple):
    """What the method asks for, and what the safety filter needs to know.

    Attributes:
        motions: (3, n) q̇ of Eq. 1, J⁺ẋ and k P∇H, see `StepResult`.
        task: what the tips shall do.
        reached: their reference poses after the tick if the whole command is followed.
        factor, clearance_index, manipulability: see `StepResult`.
        rows_used: how many of the setup's rows are barriers.
        intruded: whether an obstacle moves towards the arm, or the arm was found too close.
        nearest_link, nearest_obstacle, nearest_normalized_distance, nearest_distance: see
            `NearPairs`.
        admissible: whether q̇ breaks no limit and no barrier.
        blocked: whether the least-norm motion, gone on with, leads into something.
        unseen_share: of the fastest motion, see `pace.unseen_share`.
    """

    motions: Matrix
    task: Task
    reached: Poses
    factor: float
    clearance_index: float
    manipulability: float
    rows_used: int
    intruded: bool
    nearest_link: int
    nearest_obstacle: int
    nearest_normalized_distance: float
    nearest_distance: float
    admissible: bool
    blocked: bool
    unseen_share: float


class LeastNorm(NamedTuple):
    """The least-norm solution, in coordinates in which every joint costs the same.

    Attributes:
        parts: of the (m, n) Jacobian.
        inverse: (m,) gains of its inverse.
        twist: (m,) ẋ.
        motion: (n,) J⁺ẋ.
    """

    parts: Decomposition
    inverse: Vector
    twist: Vector
    motion: Vector


@kernel
def _total_gradient(
    start: Start, clearance: Vector, least: LeastNorm, constants: RobotConstants, gains: Gains,
) -> Array:
    """Return ∇H of Eq. 18; a criterion of no weight costs nothing.

    Args:
        start, constants, gains: see there.
        clearance: (n,) ∇H_w.
        least: the least-norm solution.
    """
    arm, parts, scaling = start.arm, least.parts, constants.scaling
    joint_limit, shortest_path, manipulability, posture = np.zeros((4, len(scaling)))
    if gains.criteria_k_s > 0.0:
        _, joint_limit = criteria.joint_limit_index(
            arm.q, constants.position_min, constants.position_max)
    if gains.criteria_k_f > 0.0:
        _, shortest_path = criteria.shortest_path_index(least.motion, derivative_between(
            null_space.dual(parts, least.inverse, least.twist), arm.tip_jacobian,
            scaling * least.motion, arm.tip_rotations, constants.in_tool, constants.rows))
    nearness = parts.singular_values[-1] / max(gains.singularity_margin, 1e-9) - 1.0
    if gains.criteria_k_m > 0.0 and nearness < 1.0:
        changes = np.empty(parts.right.shape)
        for i in range(len(changes)):
            changes[i] = derivative_between(
                parts.left[:, i], arm.tip_jacobian, scaling * parts.right[i],
                arm.tip_rotations, constants.in_tool, constants.rows)
        _, manipulability = criteria.manipulability_index(parts, changes)
        manipulability = criteria.fade(nearness) * manipulability
    if gains.posture_weight > 0.0:
        _, posture = criteria.posture_index(
            arm.q, constants.preferred, constants.position_max)
    return criteria.total_gradient(
        clearance, joint_limit, shortest_path, manipulability, posture, criteria.IndexWeights(
            gains.criteria_k_w, gains.criteria_k_s, gains.criteria_k_f, gains.criteria_k_m,
            gains.posture_weight))


@kernel
def _meets(
    obstacles: InflatedObstacles, links: Links, link: int, obstacle: int, motion: Vector,
    look_ahead: float,
) -> bool:
    """Return whether a motion (n,), gone on with for `look_ahead` [s], takes a link into a shape.

    The ends of its segment are taken to go on straight.
    """
    start, end = place(links.start, link), place(links.end, link)
    u, v = np.zeros(3), np.zeros(3)
    for j in range(len(motion)):
        speed = motion[j] * links.supports[link, j]
        if speed != 0.0:
            a, b, c, x, y, z = links.joint_screws[:, j]
            for way, at in ((u, start), (v, end)):
                way[0] += speed * (a + y * at.z - z * at.y)
                way[1] += speed * (b + z * at.x - x * at.z)
                way[2] += speed * (c + x * at.y - y * at.x)
    for step in range(1, _LOOKS + 1):
        t = look_ahead * step / _LOOKS
        rho, _ = link_pair(
            obstacles, link, obstacle, t,
            Place(start.x + t * u[0], start.y + t * u[1], start.z + t * u[2]),
            Place(end.x + t * v[0], end.y + t * v[1], end.z + t * v[2]), 0.0)
        if rho < 0.0:
            return True
    return False


@kernel
def _blocked(
    near: NearPairs, obstacles: InflatedObstacles, arm: Kinematics, links: Links, motion: Vector,
    limits: Limits, look_ahead: float,
) -> bool:
    """Return whether a motion (n,), gone on with, leads into an obstacle or a joint limit.

    Clearances and positions are taken to go on changing as they do, for `look_ahead` [s]. That is
    a bound from below. It is far too low for a box that the arm passes, so other shapes than
    ellipsoids are then looked at on the way.
    """
    if look_ahead == 0.0:
        return False
    for i in range(len(near.normalized_distance)):
        if is_contact(obstacles, near.links[i], near.obstacles[i]):
            continue
        rate = near.rate[i]
        for j in range(len(motion)):
            rate += near.gradient[i, j] * motion[j]
        if near.normalized_distance[i] + look_ahead * rate < 0.0 and (
                obstacles.shapes[near.obstacles[i]] == ELLIPSOID or _meets(
                    obstacles, links, near.links[i], near.obstacles[i], motion, look_ahead)):
            return True
    for j in range(len(motion)):
        ahead = arm.q[j] + look_ahead * motion[j]
        if not limits.positions[1, j] <= ahead <= limits.positions[0, j]:
            return True
    return False


def wish(start: Start, world: World, setup: Packed[Setup]) -> Wish:
    """Return J⁺ẋ + k P∇H, and the barriers around it."""
    (m, n), tips = start.arm.jacobian.shape, len(start.arm.tip_positions)
    motions, task = np.empty((3, n)), Task(np.empty((3, m)), np.empty(6 * tips))
    reached = Poses(np.empty((tips, 3)), np.empty((tips, 3, 3)))
    return Wish(motions, task, reached, *_wish(start, world, setup, motions, task, reached))


@entry
def _wish(
    start: Start, world: World, setup: Packed[Setup], motions: OutMatrix, asked: Task,
    reached: Poses,
) -> tuple[float, float, float, int, bool, int, int, float, float, bool, bool, float]:
    """Fill the arrays of a `Wish`, `asked` being its task; return the rest of it."""
    constants, limits, gains, room = setup.value
    arm, obstacles, scaling, dt = start.arm, world.obstacles, constants.scaling, start.dt

    # ẋ: the command plus the feedback to the reference poses.
    task, reference = task_of(start, constants, gains)

    # J⁺ẋ, in coordinates in which every joint costs the same.
    parts = null_space.decompose(arm.jacobian * scaling)
    inverse = null_space.inverse_gains(
        parts.singular_values, gains.singularity_damping_threshold, gains.singularity_damping)
    commanded, feedback, turning = task.twists[0], task.twists[1], task.twists[2]
    twist = commanded + feedback - turning
    least = LeastNorm(
        parts, inverse, twist, null_space.least_norm(parts, inverse, twist))

    # What the arm may come close to in this tick.
    can = pace(start.previous, limits, constants, gains.clearance_gain, dt)
    links = Links(arm.segment_start, arm.segment_end, arm.joint_screws, constants.supports,
                  constants.parents)
    near = near_pairs(
        obstacles, links, can.fastest, can.link_speeds, can.rate,
        gains.clearance_influence_distance,
        unseen_distances(arm.segment_start, arm.segment_end, world.seen_start, world.seen_end,
                         world.ranges))
    self_pairs = SelfPairs(constants.radii, constants.self_pairs, constants.self_supports,
                           constants.self_lever_arm_bounds)
    stopping = 0.5 * stopping_time(start.previous, limits.acceleration_max) * start.previous
    own = near_links(links, self_pairs, can.fastest / can.rate, stopping)

    # k P∇H, Eqs. 2 and 18.
    level, clearance = criteria.clearance_index(
        *kept_apart(near, obstacles), gains.clearance_smoothing,
        gains.clearance_influence_distance)
    factor, homogeneous = 1.0, np.zeros(len(scaling))
    if world.guided < 1.0:
        gradient = world.own_gradient + _total_gradient(
            start, clearance, least, constants, gains)
        projected = null_space.project(parts, gradient * scaling)
        factor = gains.criteria_k_fixed if gains.fixed else null_space.dynamic_factor(
            gains.criteria_k_alpha, least.motion, projected)
        homogeneous = (1.0 - world.guided) * world.worth * factor * projected
    if world.guided > 0.0:
        homogeneous += world.guided * null_space.project(parts, world.path / scaling)
    dq, least_norm = motions[0], motions[1]
    least_norm[:], motions[2] = scaling * least.motion, scaling * homogeneous
    dq[:] = least_norm + motions[2]  # Eq. 1

    # The barriers. To evade, any null-space speed is better than leaving the path.
    intruded = rows.is_intruded(near, obstacles)
    found = rows.cleared(room, rows.most_rows(
        len(near.acting), len(own.pairs), len(arm.tip_positions)))
    at = rows.obstacle_rows(
        found, 0, near, obstacles, gains.clearance_lead,
        rows.strayed_distances(world.strayed, constants))
    rows.bend_obstacle_rows(found, near, obstacles, links, start)
    at = rows.link_rows(found, at, own, constants)
    rows.ease_slight_intrusions(found, at, obstacles, parts, scaling, gains.clearance_gain)
    at = rows.cone_rows(found, at, start, constants.cone)
    at = singularity_row(found, at, arm, parts, constants, gains.singularity_margin)
    if not intruded:
        first = at
        at = self_motion_rows(found, at, start, parts, limits, constants)
        if len(scaling) - len(twist) > 1:
            slow_self_motion(motions, found, first, at, constants)
    barriers = barriers_in_compiled(room, at)

    share = unseen_share(near.unseen, can)
    admissible = (
        share == 1.0 and parts.singular_values[-1] >= gains.singularity_damping_threshold
        and rows.admissible(
            dq, arm.q, start.previous, limits, barriers, gains.clearance_gain, dt))
    then = poses_after(reference, commanded, constants.rows, constants.in_tool, dt)
    reached.position[:], reached.rotation[:] = then.position, then.rotation
    asked.twists[:], asked.error[:] = task.twists, task.error
    return (
        factor, level, null_space.manipulability(parts), at, intruded, near.nearest_link,
        near.nearest_obstacle, near.nearest_normalized_distance, near.nearest_distance, admissible,
        _blocked(near, obstacles, arm, links, least_norm, limits, gains.horizon_look_ahead), share)
