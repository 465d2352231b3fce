"""Barriers: what must not be used up in a tick, one function per kind of row.

A row keeps h ≥ 0 by ∇h·q̇ + ∂h/∂t ≥ −rate · h. h is a clearance, a distance between two links, a
singular value beyond its margin (`singularity_row`), or 0 where a row just bounds a velocity
(`self_motion`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import RobotConstants
from redundant_planner.core.kernels import compiled, IndexPairs, Indices, kernel, Matrix, Vector
from redundant_planner.core.obstacles.clearance_gradients import bending
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.near_pairs import MOST_ACTING, NearPairs
from redundant_planner.core.obstacles.self_collision import MOST_VIEWS, NearLinks
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.redundancy.null_space import Decomposition
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.cone import Cone, leaning
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.link_motions import link_motions
from redundant_planner.core.safety.limits import (
    barrier_rate,
    Limits,
    stopping_time,
    velocity_bounds,
)

Array = npt.NDArray[np.float64]

# Kinds of rows, in the order in which they stand; `own_barriers` inserts the user's. The last two
# are not urgent: they give way before anything else does.
OBSTACLE, LINK, CONE, OWN, OWN_AT_REST, SINGULARITY, SELF_MOTION = range(7)

# An arm is found inside a margin when it is deeper in than what linearisation may cost [m].
_FOUND_INSIDE = 1e-3
# Share of the cone's angle that is kept free, and of the rest that counts. What has drifted out by
# no more than this comes back; beyond twice that it counts as found outside [rad].
_SPARE_IN_CONE, _CAUTION_IN_CONE, _DRIFT = 0.03, 0.4, 0.01
# A link that is so little inside its margin leaves by no more null-space motion than that: an arm
# that slides along something must not start to shake [m], [rad/s, m/s].
_SLIGHT, _SLOWLY_OUT = 2e-5, 1e-3
# Links that have strayed less than this count as in place: the rest of the noise [m].
_IN_PLACE = 5e-4
# One for the singularity; besides, of each tip two for its cone and one for its null-space motion.
_OTHER_ROWS, _ROWS_OF_TIP = 1, 3


class Barriers(NamedTuple):
    """All rows of a tick, by kind.

    Attributes:
        gradient: (b, n) ∂h/∂q.
        time_derivative: (b,) ∂h/∂t from the obstacles' own motion [unit of h/s].
        value: (b,) h against the margin; negative inside it, where the arm has to get out.
        spare: (b,) how much of h is given up before the rest of any other is.
        kind: (b,) OBSTACLE, LINK, CONE, OWN, OWN_AT_REST, SINGULARITY or SELF_MOTION.
        first, second: (b,) a link and an obstacle, two links, or the user's barrier and −1; −1
            for other rows.
    """

    gradient: Matrix
    time_derivative: Vector
    value: Vector
    spare: Vector
    kind: Indices
    first: Indices
    second: Indices


class Rows(NamedTuple):
    """Room for a tick's rows, in as few arrays as can be: each costs time to hand over.

    Attributes:
        gradient: (b, n) see `Barriers`.
        terms: (3, b) time derivative, value and spare.
        about: (3, b) kind, first and second.
    """

    gradient: Matrix
    terms: Matrix
    about: IndexPairs


def barriers_in(rows: Rows, count: int) -> Barriers:
    """Return the first rows, as views."""
    terms, about = rows.terms, rows.about
    return Barriers(
        rows.gradient[:count], terms[0, :count], terms[1, :count], terms[2, :count],
        about[0, :count], about[1, :count], about[2, :count])


barriers_in_compiled = kernel(barriers_in)


def barriers_of(
    gradient: Array, time_derivative: Array, value: Array, spare: Array | None = None,
) -> Barriers:
    """Return barriers of obstacles from (b, n) gradients, and (b,) each of the other fields."""
    unknown = np.full(len(value), -1)
    return Barriers(gradient, time_derivative, value,
                    np.zeros(len(value)) if spare is None else spare,
                    np.full(len(value), OBSTACLE), unknown, unknown.copy())


def urgent_rows(barriers: Barriers) -> int:
    """Return how many of the first rows are urgent."""
    return int((barriers.kind < SINGULARITY).sum())


def barrier_bounds(barriers: Barriers, gain: float, stop: float, dt: float) -> Array:
    """Return b (b,) of ∇h·q̇ ≥ b: −rate h − ∂h/∂t.

    Inside the margin (h < 0) the same line asks the pair to move apart. What the user's barriers
    keep where the arm comes to rest may be used up at once: rate = 1 / (T/2 + dt).

    Args:
        barriers: of what is near.
        gain: largest share of h that may be used up per second [1/s].
        stop: stopping time T that the next velocity may have [s].
        dt: [s].
    """
    return _bounds(barriers.value, barriers.time_derivative, barriers.kind,
                   barrier_rate(gain, stop, dt), 1.0 / (0.5 * stop + dt))


@compiled
def _bounds(
    value: Vector, time_derivative: Vector, kind: Indices, rate: float, rate_at_rest: float,
) -> Array:
    bounds = np.empty(len(value))
    for row in range(len(value)):
        bounds[row] = -(rate_at_rest if kind[row] == OWN_AT_REST else rate) * value[
            row] - time_derivative[row]
    return bounds


@kernel
def admissible(
    dq: Vector, q: Vector, previous: Vector, limits: Limits, barriers: Barriers, gain: float,
    dt: float,
) -> bool:
    """Return whether a velocity (n,) keeps every limit and every barrier as it is.

    Args:
        dq: the velocity.
        q, previous: (n,) positions, and the velocity of the last tick.
        limits, barriers, gain, dt: as for `stages.safe_velocity`.
    """
    stop = stopping_time(previous, limits.acceleration_max) + dt
    lower, upper, kept = velocity_bounds(q, previous, limits, stop, dt)
    bounds = _bounds(barriers.value, barriers.time_derivative, barriers.kind,
                     barrier_rate(gain, stop, dt), 1.0 / (0.5 * stop + dt))
    if not kept:
        return False
    for i in range(len(dq)):
        if not lower[i] <= dq[i] <= upper[i]:
            return False
    for row in range(len(bounds)):
        along = 0.0
        for i in range(len(dq)):
            along += barriers.gradient[row, i] * dq[i]
        if not along >= bounds[row]:
            return False
    return True


def _most_rows(acting: int, own: int, tips: int) -> int:
    """Return how many rows a tick has at most.

    Args:
        acting: pairs of links and obstacles whose barrier could act.
        own: views of pairs of links that could meet, see `NearLinks`.
        tips: of the arm.
    """
    return acting + own + _ROWS_OF_TIP * tips + _OTHER_ROWS


most_rows = kernel(_most_rows)


def room_for_rows(constants: RobotConstants, tips: int = 1) -> Rows:
    """Return room for as many rows as a tick of a robot with so many tips may have."""
    n = len(constants.scaling)
    most = _most_rows(MOST_ACTING, MOST_VIEWS * len(constants.self_pairs), tips)
    return Rows(np.empty((most, n)), np.empty((3, most)), np.empty((3, most), np.intp))


@kernel
def cleared(rows: Rows, count: int) -> Barriers:
    """Return the first rows, as views, with nothing in them.

    What is written to them is bounded by `count`, and that is checked here, once a tick: machine
    code would write beyond the end without a word.
    """
    if count > len(rows.gradient):
        raise IndexError('a tick has more barriers than room_for_rows has room for')
    rows.gradient[:count], rows.terms[:, :count], rows.about[:, :count] = 0.0, 0.0, -1
    return barriers_in_compiled(rows, count)


@kernel
def strayed_distances(strayed: Vector, constants: RobotConstants) -> Vector:
    """Return how far (c,) each link may be from where it is thought to be [m].

    Args:
        strayed: (n,) of the joints [rad, m].
        constants: of the robot.
    """
    distances = np.empty(len(constants.radii))
    for link in range(len(distances)):
        distances[link] = -_IN_PLACE
        for j in range(len(strayed)):
            distances[link] += constants.lever_arm_bounds[link, j] * abs(strayed[j])
        distances[link] = max(distances[link], 0.0)
    return distances


@kernel
def obstacle_rows(
    rows: Barriers, at: int, near: NearPairs, maps: InflatedObstacles, lead: float,
    strayed: Vector,
) -> int:
    """Write a row for every link and obstacle whose barrier could act; return the next row.

    What may touch and is found doing so may stay there, and only not get deeper: a wall is a wish
    of the user's, and an allowed contact one too, not a thing that is to be left at once.

    Args:
        rows, at: where to, from which row on.
        near, maps: the pairs, and the obstacles.
        lead: time over which the way of moving obstacles is kept as spare distance [s].
        strayed: (c,) how far each link may be from where it is thought to be [m]: that much
            clearance is not there to be used up.
    """
    for pair in near.acting:
        link, obstacle = near.links[pair], near.obstacles[pair]
        rows.gradient[at] = near.gradient[pair]
        rows.time_derivative[at], rows.value[at] = near.rate[pair], near.normalized_distance[pair]
        if maps.may_touch[link, obstacle]:
            rows.value[at] = max(rows.value[at], 0.0)
        elif rows.value[at] > 0.0:
            rows.value[at] = max(
                rows.value[at] - strayed[link] / maps.smallest[link, obstacle], 0.0)
        rows.spare[at] = lead * maps.speeds[obstacle] / maps.smallest[link, obstacle]
        rows.kind[at], rows.first[at], rows.second[at] = OBSTACLE, link, obstacle
        at += 1
    return at


@kernel
def bend_obstacle_rows(
    rows: Barriers, near: NearPairs, maps: InflatedObstacles, links: Links, start: Start,
) -> None:
    """Add to the rows of obstacles, which come first, that a link's point moves in an arc.

    Within the tick the arc adds ½ dt ∇ₓρ·ẍ to the rate, at the velocities of the tick before.
    `Task.turning` is the same for the tip.

    Args:
        rows: as `obstacle_rows` has written them.
        near, maps, links: the pairs, the obstacles and the links.
        start: of the tick.
    """
    if len(near.acting) == 0:
        return
    motions = link_motions(links, start.previous)
    for row in range(len(near.acting)):
        pair = near.acting[row]
        rows.time_derivative[row] += 0.5 * start.dt * bending(
            maps, near.links[pair], near.obstacles[pair], near.parameter[pair], links, motions)


@kernel
def link_rows(rows: Barriers, at: int, own: NearLinks, constants: RobotConstants) -> int:
    """Write a row for every two links that could meet; return the next row."""
    for i in range(len(own.pairs)):
        rows.gradient[at], rows.value[at] = own.gradient[i], own.distance[i]
        rows.kind[at] = LINK
        rows.first[at], rows.second[at] = constants.self_pairs[own.pairs[i]]
        at += 1
    return at


@kernel
def ease_slight_intrusions(
    rows: Barriers, used: int, maps: InflatedObstacles, parts: Decomposition, scaling: Vector,
    gain: float,
) -> None:
    """Let rows of things at rest that are slightly inside their margin ask for little.

    Round-off leaves a link that slides some nanometres inside its margin. Out of it at once, by
    −gain · h, may need null-space motion where hardly any leads out. Such a row then asks for what
    `_SLOWLY_OUT` of null-space motion can do (docs/safety.md).

    Args:
        rows, used: those in use, of obstacles and links.
        maps: the obstacles.
        parts, scaling: of the tip's Jacobian in coordinates in which every joint costs the same.
        gain: see `barrier_bounds` [1/s].
    """
    for row in range(used):
        if rows.value[row] >= 0.0:
            continue
        metres = 1.0
        if rows.kind[row] == OBSTACLE:
            if maps.speeds[rows.second[row]] > 0.0:
                continue
            metres = maps.smallest[rows.first[row], rows.second[row]]
        leads_out = null_space.project(parts, scaling * rows.gradient[row])
        little = _SLOWLY_OUT / gain * math.sqrt(np.sum(leads_out * leads_out))
        rows.value[row] = max(
            rows.value[row], min(-little, rows.value[row] + _SLIGHT / metres))


@kernel
def cone_rows(rows: Barriers, at: int, start: Start, cone: Cone) -> int:
    """Write two rows that keep each tip's axis in its cone; return the next row.

    Along the cone's surface a tick's motion leads out by half its curvature. An axis that is
    found outside may stay there, and only not lean further.
    """
    if cone.angle >= math.pi:
        return at
    arm, dt = start.arm, start.dt
    for t in range(len(arm.tip_rotations)):
        found = leaning(cone, arm.tip_rotations[t], arm.tip_jacobian[6 * t:6 * t + 6],
                        start.previous)
        for i in range(2):
            if found.room[i] == np.inf:
                continue
            room = found.room[i] - _SPARE_IN_CONE * cone.angle
            outside = max(-room, 0.0) / _DRIFT
            rows.gradient[at] = found.gradient[i]
            rows.time_derivative[at] = 0.5 * dt * found.change[i]
            # Directions turn as it leans: what it may use up leaves room for that.
            rows.value[at] = (_CAUTION_IN_CONE * room if room > 0.0 else room if outside < 1.0
                              else _DRIFT * min(outside - 2.0, 0.0))
            rows.kind[at] = CONE
            at += 1
    return at


def with_rows(barriers: Barriers, more: Barriers) -> Barriers:
    """Return barriers with more rows, which are urgent, after the urgent ones."""
    at = urgent_rows(barriers)
    return Barriers(*(
        np.concatenate((rows[:at], added, rows[at:])) for rows, added in zip(barriers, more)))


def without_null_space(barriers: Barriers) -> Barriers:
    """Return the rows that count where no path of the tip is kept: they come first."""
    count = int(np.count_nonzero(barriers.kind < min(SINGULARITY, SELF_MOTION)))
    return Barriers(
        barriers.gradient[:count], barriers.time_derivative[:count], barriers.value[:count],
        barriers.spare[:count], barriers.kind[:count], barriers.first[:count],
        barriers.second[:count])


@kernel
def is_intruded(near: NearPairs, maps: InflatedObstacles) -> bool:
    """Return whether an obstacle moves towards the arm, or the arm was found too close to it."""
    intruded = False
    for pair in near.acting:
        inside = (near.distance[pair] < -_FOUND_INSIDE
                  and not maps.may_touch[near.links[pair], near.obstacles[pair]])
        intruded = intruded or inside or near.rate[pair] < 0.0
    return intruded
