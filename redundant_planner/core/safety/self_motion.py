"""Null-space motion that the arm can stop next to its path, as rows of the filter.

While an arm brakes its posture changes, and motion that was in the null space moves the tip. The
rows keep it slow enough for the tip to stay within `STRAY` of its path (docs/safety.md).
"""

from __future__ import annotations

import math

import numpy as np

from redundant_planner.core.constants import RobotConstants
from redundant_planner.core.kernels import compiled, Indices, kernel, OutMatrix, Vector
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.redundancy.null_space import Decomposition
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.jacobian import jdot_qdot
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.safety.barriers import Barriers, SELF_MOTION
from redundant_planner.core.safety.limits import Limits, stopping_time

# How far the tip may leave its path while null-space motion is being braked [m], [rad].
STRAY, STRAY_ANGLE = 2.5e-4, 2.5e-3


@compiled
def fastest_self_motion(
    arm: Kinematics, self_motion: Vector, limits: Limits, constants: RobotConstants,
) -> float:
    """Return how fast null-space motion h may be to stop next to the path [rad/s, m/s].

    All joints slowing in proportion within T, the tip is accelerated by J̇ h while h lasts, and
    has been moved aside by |J̇ h| T²/8 at the end (docs/safety.md). That grows with the fourth
    power of the speed. Infinite where h is far from that.
    """
    rate = jdot_qdot(
        arm.tip_jacobian, self_motion, arm.tip_rotations, constants.in_tool, constants.rows)
    squared, squared_angle = 0.0, 0.0
    for i in range(len(rate)):
        if constants.rows[i] % 6 < 3:
            squared += rate[i] * rate[i]
        else:
            squared_angle += rate[i] * rate[i]
    stop = stopping_time(self_motion, limits.acceleration_max)
    aside = stop * stop / 8.0 * max(
        math.sqrt(squared) / STRAY, math.sqrt(squared_angle) / STRAY_ANGLE)
    # A tick adds less than a tenth to a speed at which this matters.
    if aside < 0.6:
        return np.inf
    return math.sqrt(np.sum(self_motion * self_motion)) / aside ** 0.25


@kernel
def _roots(parents: Indices) -> Indices:
    """Return the joint (n,) at the base that each joint hangs on."""
    roots = np.empty(len(parents), np.intp)
    for j in range(len(roots)):
        roots[j] = j if parents[j] == 0 else roots[parents[j] - 1]
    return roots


@kernel
def self_motion_rows(
    rows: Barriers, at: int, start: Start, parts: Decomposition, limits: Limits,
    constants: RobotConstants,
) -> int:
    """Write rows that keep null-space motion slow enough to stop; return the next row.

    Arms that share no joint have one each: with one for both, what slows the first would have to
    push the second to and fro.
    """
    scaling, previous, dt = constants.scaling, start.previous, start.dt
    self_motion = scaling * null_space.project(parts, previous / scaling)
    slower = 1.0 - dt / max(stopping_time(previous, limits.acceleration_max), dt)
    roots, own = _roots(constants.parents), np.empty(len(previous))
    for root in range(len(roots)):
        if roots[root] != root:
            continue
        for j in range(len(roots)):
            own[j] = self_motion[j] if roots[j] == root else 0.0
        fastest = fastest_self_motion(start.arm, own, limits, constants)
        if fastest == np.inf:
            continue
        # h·q̇ / |h| may be that much at most, whatever the rate of the other barriers.
        speed = math.sqrt(np.sum(own * own))
        rows.gradient[at] = -own / speed
        rows.time_derivative[at] = max(fastest, slower * np.sum(own * previous) / speed)
        rows.kind[at], rows.first[at] = SELF_MOTION, root
        at += 1
    return at


@kernel
def slow_self_motion(
    motions: OutMatrix, rows: Barriers, first: int, end: int, constants: RobotConstants,
) -> None:
    """Slow the wish down to what the rows of null-space motion let through.

    They bound it along the motion of the last tick. In a null space of several dimensions the
    filter would keep them by motion aside, which the next tick's row turns against: the arm shakes
    where more than twice as much is asked for as may be.

    Args:
        motions: (3, n) see `Wish`.
        rows: of the tick.
        first, end: which of them are of null-space motion.
        constants: the robot.
    """
    dq, least_norm, homogeneous = motions[0], motions[1], motions[2]
    roots = _roots(constants.parents)
    for row in range(first, end):
        along, asked = -rows.gradient[row], rows.time_derivative[row]
        wanted, given = np.sum(along * homogeneous), np.sum(along * least_norm)
        if wanted <= 0.0 or given + wanted <= asked:
            continue
        share = max(asked - given, 0.0) / wanted
        for j in range(len(roots)):
            if roots[j] == rows.first[row]:
                homogeneous[j] *= share
                dq[j] = least_norm[j] + homogeneous[j]
