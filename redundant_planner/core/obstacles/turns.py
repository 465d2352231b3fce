"""Turns of the first joints, followed through time among obstacles that move.

Each turn is followed within the limits of speed and acceleration, while obstacles go on as they
do. What it falls short of is the sum over links of their weight times (clear distance − smallest
distance)²: a link that cannot be saved costs the others nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import (
    compiled,
    entry,
    Indices,
    kernel,
    Matrix,
    OutMatrix,
    OutVector,
    Vector,
)
from redundant_planner.core.obstacles.clearance import is_contact, link_pair
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.shapes import ELLIPSOID
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.se3 import Place, place

Array = npt.NDArray[np.float64]

# Time between the postures that are looked at [s].
TIME_STEP = 0.05
# A link is clear at this distance from the obstacles, beyond what is kept from them anyway [m].
CLEAR_DISTANCE = 0.005
# A distance is exact up to this much more than is asked for: then it holds for a while [m].
_BEYOND = 0.01
# What the distance of another shape costs, in distances of ellipsoids: mostly a bound will do;
# and what it costs to look which of a link's pairs need one.
_COST_OF_OTHERS, _COST_OF_LINK = 3, 3
# More than any turn takes.
_NO_BOUND = 2**62


class TurningJoints(NamedTuple):
    """The first joints of an arm, which turn, and what they carry.

    Attributes:
        velocity_max, acceleration_max: (k,) what a turn may use of the limits.
        links: which links they carry.
        weights: (c,) how much it counts what a link falls short.
        lever_arm_bounds: (c, n) see `Robot`.
        horizon: for how long a turn is followed [s].
    """

    velocity_max: Vector
    acceleration_max: Vector
    links: Indices
    weights: Vector
    lever_arm_bounds: Matrix
    horizon: float


class Choice(NamedTuple):
    """What was found among some turns.

    Attributes:
        turn: index of the best one, −1 if none counts.
        shortage: what it falls short [m²].
        tried: how many turns are done with.
        distances: how many distances of links from ellipsoids would have taken as long.
    """

    turn: int
    shortage: float
    tried: int
    distances: int


@kernel
def _next_speed(
    rest: float, speed: float, speed_max: float, acceleration_max: float, dt: float,
) -> float:
    """Return a joint's velocity after dt that has this rest of its turn to go [rad/s, m/s]."""
    largest = min(speed_max, math.sqrt(2.0 * acceleration_max * abs(rest)), abs(rest) / dt)
    change = math.copysign(largest, rest) - speed
    return speed + min(max(change, -acceleration_max * dt), acceleration_max * dt)


@entry
def next_velocities(
    rest: Vector, velocities: Vector, joints: TurningJoints, dt: float,
) -> Array:
    """Return the velocities (k,) after these, towards the end of a turn that is (k,) away."""
    following = np.empty(len(rest))
    for j in range(len(rest)):
        following[j] = _next_speed(
            rest[j], velocities[j], joints.velocity_max[j], joints.acceleration_max[j], dt)
    return following


@compiled
def turn_point(joint_screw: Vector, turn: float, point: OutVector) -> None:
    """Take a point (3,) along with a joint of screw [v; w] at the base origin (Rodrigues)."""
    v1, v2, v3, w1, w2, w3 = joint_screw
    if w1 == 0.0 and w2 == 0.0 and w3 == 0.0:
        point[0] += turn * v1
        point[1] += turn * v2
        point[2] += turn * v3
        return
    # With r from w × v, the axis' point nearest to the origin: sin w × r + (1 − cos) w × (w × r).
    x = point[0] - w2 * v3 + w3 * v2
    y = point[1] - w3 * v1 + w1 * v3
    z = point[2] - w1 * v2 + w2 * v1
    a, b, c = w2 * z - w3 * y, w3 * x - w1 * z, w1 * y - w2 * x
    sine, rest = math.sin(turn), 1.0 - math.cos(turn)
    point[0] += sine * a + rest * (w2 * c - w3 * b)
    point[1] += sine * b + rest * (w3 * a - w1 * c)
    point[2] += sine * c + rest * (w1 * b - w2 * a)


@kernel
def _room(
    obstacles: InflatedObstacles, link: int, obstacle: int, time: float, start: Place, end: Place,
    enough: float,
) -> float:
    """Return how much further than clear a link is from where an obstacle is after a time [m].

    A little beyond what is enough it is a bound from below.
    """
    rho, _ = link_pair(
        obstacles, link, obstacle, time, start, end, enough + CLEAR_DISTANCE + _BEYOND)
    return rho * obstacles.smallest[link, obstacle] - CLEAR_DISTANCE


@kernel
def _rooms_now(arm: Links, obstacles: InflatedObstacles, joints: TurningJoints) -> Matrix:
    """Return how much further than clear (c, k) links are from obstacles now [m].

    Links that do not turn, and pairs that may touch, have more than enough.
    """
    rooms = np.full(obstacles.smallest.shape, np.inf)
    for link in joints.links:
        start, end = place(arm.start, link), place(arm.end, link)
        for obstacle in range(len(obstacles.speeds)):
            if not is_contact(obstacles, link, obstacle):
                rooms[link, obstacle] = _room(
                    obstacles, link, obstacle, 0.0, start, end, 0.0)
    return rooms


@kernel
def _turned(
    arm: Links, link: int, turned: Vector, ends: OutMatrix,
) -> tuple[Place, Place]:
    """Return where a link's ends are once the first joints have turned; writes them (2, 3)."""
    start, end = ends[0], ends[1]
    start[:], end[:] = arm.start[link], arm.end[link]
    for j in range(len(turned) - 1, -1, -1):
        if arm.supports[link, j] > 0.0:
            turn_point(arm.joint_screws[:, j], turned[j], start)
            turn_point(arm.joint_screws[:, j], turned[j], end)
    return place(ends, 0), place(ends, 1)


@kernel
def _shortage(
    arm: Links, obstacles: InflatedObstacles, joints: TurningJoints, velocities: Vector,
    turn: Vector, rooms_now: Matrix, limit: float, budget: int,
) -> tuple[float, int]:
    """Return what a turn (k,) falls short [m²], and what it took, see `Choice.distances`.

    It stops early at more than the limit or budget. A distance falls by no more than the link and
    the obstacle have moved: a pair is only measured when it could have come too close.

    Args:
        arm, obstacles, joints, velocities, limit: as for `best_turn`.
        turn: (k,) [rad, m].
        rooms_now: from `_rooms_now`.
        budget: how much it may take.
    """
    # A pair's room is kept with both ways until it was measured added: less both ways until now,
    # it is a bound from below. Only a pair nearer than the link has been so far counts, and
    # `spare` is what is left until there could be one.
    rooms, ways, spare = rooms_now.copy(), np.zeros(len(rooms_now)), np.zeros(len(rooms_now))
    least = np.zeros(len(rooms_now))
    speeds, turned = velocities.copy(), np.zeros(len(turn))
    ends = np.empty((2, 3))
    passing = TIME_STEP * obstacles.speeds.max()
    shortage, spent = 0.0, 0
    for step in range(1, math.ceil(joints.horizon / TIME_STEP) + 1):
        time = step * TIME_STEP
        for link in joints.links:
            spare[link] -= passing
        for j in range(len(turn)):
            before = speeds[j]
            speeds[j] = _next_speed(
                turn[j] - turned[j], before, joints.velocity_max[j], joints.acceleration_max[j],
                TIME_STEP)
            way = 0.5 * TIME_STEP * (before + speeds[j])
            turned[j] += way
            for link in joints.links:
                spare[link] -= joints.lever_arm_bounds[link, j] * abs(way)
                ways[link] += joints.lever_arm_bounds[link, j] * abs(way)
        for link in joints.links:
            if spare[link] > 0.0:
                continue
            spare[link] = np.inf
            start, end = _turned(arm, link, turned, ends)
            nearest = least[link]
            for obstacle in range(len(obstacles.speeds)):
                way = ways[link] + obstacles.speeds[obstacle] * time
                room = rooms[link, obstacle] - way
                if room <= least[link]:
                    room = _room(obstacles, link, obstacle, time, start, end, nearest)
                    rooms[link, obstacle] = room + way
                    nearest = min(nearest, room)
                    spent += 1 if obstacles.shapes[obstacle] == ELLIPSOID else _COST_OF_OTHERS
                spare[link] = min(spare[link], room)
            if nearest < least[link]:
                shortage += joints.weights[link] * (nearest ** 2 - least[link] ** 2)
                least[link] = nearest
            spare[link] -= nearest
            spent += _COST_OF_LINK
        if shortage >= limit or spent > budget:
            break
    return shortage, spent


@entry
def best_turn(
    arm: Links, obstacles: InflatedObstacles, joints: TurningJoints, velocities: Vector,
    turns: Matrix, limit: float, budget: int, at_least_one: bool,
) -> Choice:
    """Return the first turn that keeps clear, else the one that falls least short of that.

    Args:
        arm, obstacles: as they are now.
        joints: which turn.
        velocities: (k,) theirs now [rad/s, m/s].
        turns: (t, k) [rad, m].
        limit: turns that fall short by this much do not count [m²].
        budget: how many distances of ellipsoids they may take. None is begun that is likely to
            take more than what is left.
        at_least_one: whether the first is tried whatever it takes.
    """
    rooms = _rooms_now(arm, obstacles, joints)
    chosen, smallest, tried, spent, dearest = -1, limit, 0, 0, 0
    while tried < len(turns) and (tried == 0 or spent + dearest <= budget):
        left = _NO_BOUND if at_least_one and tried == 0 else budget - spent
        shortage, took = _shortage(
            arm, obstacles, joints, velocities, turns[tried], rooms, smallest, left)
        spent, dearest = spent + took, max(dearest, took)
        if took > left:
            break
        if shortage < smallest:
            chosen, smallest = tried, shortage
        # Nothing is better than a turn that falls short of nothing.
        tried = tried + 1 if smallest > 0.0 else len(turns)
    return Choice(chosen, smallest, tried, spent)
