"""Which way round: turns of the first joints, out of where obstacles are going.

A barrier turns a link away from where an obstacle is. What hangs on few joints can only go a few
ways, though, and those away from an obstacle may lead along in front of it and into a corner.
Here the obstacles' course is looked at. Where it leads into a link, the first joints, which all
others hang on, are given turns to try, small ones first. Each turn is followed through time,
within the limits of speed and acceleration, among obstacles that go on as they do. The first that
keeps clear is made; if none does, the one that falls least short of it.

A turn takes the tip off its path. What more joints move is therefore left to the barriers, which
try null-space motion first, until these lead off the path themselves.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import (
    compiled,
    Fields,
    Indices,
    kernel,
    Matrix,
    OutVector,
    Vector,
)
from redundant_planner.core.obstacles.clearance import InflatedEllipsoids
from redundant_planner.core.obstacles.self_collision import nearest_parameters
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Kinematics, Robot

Array = npt.NDArray[np.float64]

# How many joints are turned, and turns to try, in seconds at full speed: in every combination.
_TURNED = 2
_TURNS = (0.0, 0.08, -0.08, 0.16, -0.16, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8, 1.2, -1.2)
# So many of them are tried in a tick; all of them take 8 ticks. And so many distances of links
# from obstacles are looked at for it, which bounds a tick's time among many that move.
_TRIED = 24
_BUDGET = 15_000
# What a link counts that is moved by more joints than turn: the others may still save it.
_SHARE_OF_OTHERS = 0.2
# Time between the postures that are looked at [s].
_STEP = 0.05
# Shares of a joint's limits that a turn takes: the rest of the arm moves, too.
_SPEED, _ACCELERATION = 0.9, 0.8
# A turn is enough when it stays that far from obstacles, beyond what is kept from them; no more
# turn is needed where standing still does so by [m].
_ENOUGH, _OVER = 0.005, 0.02
# A turn that is being made gives way to one that falls short by less than this share of its own.
_BETTER = 0.8
_TINY = float(np.finfo(float).tiny)


class Turn(NamedTuple):
    """What the first joints shall do in a tick.

    Attributes:
        velocities: (k,) of the first k joints [rad/s, m/s]; none of them where nothing threatens.
        link, obstacle: what would meet.
    """

    velocities: Vector
    link: int
    obstacle: int


NO_TURN = Turn(np.empty(0), -1, -1)


class _Joints(NamedTuple):
    """The joints that turn, and what they carry.

    Attributes:
        velocity_max, acceleration_max: (k,) what a turn takes of the limits.
        links: which they carry.
        shares: (c,) how much what a link falls short counts.
        levers, moves: (c, n) see `Robot`.
    """

    velocity_max: Vector
    acceleration_max: Vector
    links: Indices
    shares: Vector
    levers: Matrix
    moves: Matrix


class Evasion:
    """Turns of the first joints of one arm; remembers the one that is being made."""

    def __init__(self, robot: Robot, parameters: PlannerParameters) -> None:
        """Prepare for an arm, and what is to be kept from obstacles."""
        self._horizon = parameters.clearance_evasion_horizon
        self._margin, self._lead = parameters.clearance_margin, parameters.clearance_lead
        count = min(_TURNED, robot.n)
        self._position_min = robot.position_min[:count] + parameters.limits_position_margin
        self._position_max = robot.position_max[:count] - parameters.limits_position_margin
        moved_by = (robot.moves > 0.0).sum(axis=1)
        joints = _Joints(
            _SPEED * robot.velocity_max[:count], _ACCELERATION * robot.acceleration_max[:count],
            np.flatnonzero(robot.moves[:, :count].any(axis=1)),
            np.where(moved_by <= count, 1.0, _SHARE_OF_OTHERS), np.array(robot.levers),
            np.array(robot.moves))
        self._joints: tuple[Any, ...] = tuple(joints)
        self._first: tuple[Any, ...] = tuple(joints._replace(
            links=joints.links[moved_by[joints.links] <= count]))
        seconds = sorted(itertools.product(_TURNS, repeat=count), key=np.linalg.norm)
        self._turns = np.array(seconds) * robot.velocity_max[:count]
        self.reset()

    def reset(self) -> None:
        """Forget the turn that is being made."""
        self._target: Array | None = None
        self._next = 0
        self.spent = 0

    def turn(
        self, arm: Kinematics, maps: InflatedEllipsoids, previous: Array, leaving: bool, dt: float,
    ) -> Turn:
        """Return what the first joints shall do; `spent` is then how many distances it took.

        Args:
            arm: its posture.
            maps: the obstacles, larger by the clearance margin and by the way that those that
                move make in `obstacle_lead`.
            previous: (n,) velocity of the last tick [rad/s, m/s].
            leaving: whether the arm is leaving its path already.
            dt: [s].
        """
        plain, obstacles = tuple(arm), tuple(maps)
        if self._target is None:
            kept, threatened = self._margin, self._joints if leaving else self._first
        else:
            kept, threatened = -_OVER, self._joints
        link, obstacle = _threat(plain, obstacles, threatened, self._horizon, kept, self._lead)
        if link < 0:
            self.reset()
            return NO_TURN

        count = len(self._position_min)
        q, velocities = arm.q[:count], previous[:count].copy()

        def best(turns: Array, limit: float, budget: int) -> tuple[int, float, int]:
            at, shortage, tried, spent = _best(
                plain, obstacles, self._joints, velocities, turns, self._horizon, _ENOUGH, limit,
                budget)
            self.spent += spent
            return at, shortage, tried

        self.spent = 0
        shortage = np.inf
        if self._target is not None:
            _, shortage, _ = best(self._target[None] - q, np.inf, 1)
        if shortage > _ENOUGH ** 2:
            until = min(self._next - self._next % _TRIED + _TRIED, len(self._turns))
            turns = np.minimum(np.maximum(
                self._turns[self._next:until], self._position_min - q), self._position_max - q)
            at, _, tried = best(turns, _BETTER * shortage, _BUDGET - self.spent)
            self._next = (self._next + tried) % len(self._turns)
            if at >= 0:
                self._target = q + turns[at]
        if self._target is None:  # obstacles too large for numbers
            return NO_TURN
        return Turn(_heading(self._target - q, velocities, self._joints, dt), link, obstacle)


@compiled
def _threat(
    arm: Fields[Kinematics], maps: Fields[InflatedEllipsoids], joints: Fields[_Joints],
    horizon: float, kept: float, lead: float,
) -> tuple[int, int]:
    """Return the link that an obstacle's course leads into if it stands still, and the obstacle.

    Of several the one that would be hit deepest, −1 twice if there is none. The course is a
    segment, so where the inflated ellipsoid is a ball it is segment against segment.

    Args:
        arm, maps, horizon, lead: as for `Evasion.turn`.
        joints: which turn.
        kept: how much of the distance from the links is none, besides the lead [m].
    """
    arm, maps, joints = Kinematics(*arm), InflatedEllipsoids(*maps), _Joints(*joints)
    least, link_at, obstacle_at = 0.0, -1, -1
    for obstacle in range(len(maps.speeds)):
        if maps.speeds[obstacle] == 0.0:
            continue
        for link in joints.links:
            a, b, c, e, f, g = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for row in range(3):
                along, course, gap = 0.0, 0.0, 0.0
                for axis in range(3):
                    turn, x = maps.rotations[obstacle, axis, row], arm.segment_start[link, axis]
                    along += turn * (arm.segment_end[link, axis] - x)
                    course += turn * horizon * maps.velocities[obstacle, axis]
                    gap += turn * (x - maps.centers[obstacle, axis])
                scale = maps.inverse[link, obstacle, row]
                along, course, gap = along * scale, course * scale, gap * scale
                a, b, c = a + along * along, b + along * course, c + along * gap
                e, f, g = e + course * course, f + course * gap, g + gap * gap
            s, t = nearest_parameters(a, b, c, e, f)
            squared = g + s * s * a + t * t * e + 2.0 * (s * c - t * f - s * t * b)
            distance = (math.sqrt(max(squared, 0.0)) - 1.0) * maps.smallest[link, obstacle]
            depth = distance + kept + lead * maps.speeds[obstacle]
            if depth < least:
                least, link_at, obstacle_at = depth, link, obstacle
    return link_at, obstacle_at


@kernel
def _next_speed(
    rest: float, speed: float, speed_max: float, acceleration_max: float, dt: float,
) -> float:
    """Return a joint's velocity after dt that has this rest of its turn to go [rad/s, m/s]."""
    largest = min(speed_max, math.sqrt(2.0 * acceleration_max * abs(rest)), abs(rest) / dt)
    change = math.copysign(largest, rest) - speed
    return speed + min(max(change, -acceleration_max * dt), acceleration_max * dt)


@compiled
def _heading(rest: Vector, velocities: Vector, joints: Fields[_Joints], dt: float) -> Array:
    """Return the velocities (k,) after these, towards the end of a turn that is (k,) away."""
    joints, following = _Joints(*joints), np.empty(len(rest))
    for j in range(len(rest)):
        following[j] = _next_speed(
            rest[j], velocities[j], joints.velocity_max[j], joints.acceleration_max[j], dt)
    return following


@compiled
def _turned_about(column: Vector, turn: float, point: OutVector) -> None:
    """Take a point (3,) along with a joint of screw [v; w] at the base origin (Rodrigues)."""
    v1, v2, v3, w1, w2, w3 = column
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
def _distance(
    maps: InflatedEllipsoids, link: int, start: Vector, end: Vector, time: float,
) -> float:
    """Return a link's smallest distance from where obstacles are after a time [m].

    As in `link_clearance`: |y + t d|² has its minimum at t = clip(−y·d / d·d).
    """
    least = np.inf
    for obstacle in range(len(maps.speeds)):
        yy, yd, dd = 0.0, 0.0, 0.0
        for row in range(3):
            y, d = 0.0, 0.0
            for axis in range(3):
                turn = maps.rotations[obstacle, axis, row]
                y += turn * (start[axis] - maps.centers[obstacle, axis]
                             - time * maps.velocities[obstacle, axis])
                d += turn * (end[axis] - start[axis])
            y *= maps.inverse[link, obstacle, row]
            d *= maps.inverse[link, obstacle, row]
            yy, yd, dd = yy + y * y, yd + y * d, dd + d * d
        t = min(max(-yd / max(dd, _TINY), 0.0), 1.0)
        level = max(yy + t * (2.0 * yd + t * dd), 0.0)
        least = min(least, (math.sqrt(level) - 1.0) * maps.smallest[link, obstacle])
    return least


@kernel
def _shortage(
    arm: Kinematics, maps: InflatedEllipsoids, joints: _Joints, velocities: Vector, turn: Vector,
    at_first: Vector, horizon: float, enough: float, limit: float,
) -> tuple[float, int]:
    """Return what a turn (k,) falls short, and how often a link was measured for that [m²].

    More than the limit may be too little.

    A distance falls by no more than the link and the obstacles have moved: it is only measured
    where it could have come down to what is enough.

    Args:
        arm, maps, horizon, joints, velocities, enough, limit: as for `_best`.
        at_first: (c,) how much further than enough links are from obstacles now [m].
    """
    spare, least = at_first.copy(), np.full(len(at_first), enough)
    speeds, turned = velocities.copy(), np.zeros(len(turn))
    start, end = np.empty(3), np.empty(3)
    passing = _STEP * maps.speeds.max()
    shortage, measured = 0.0, 0
    for step in range(1, math.ceil(horizon / _STEP) + 1):
        for link in joints.links:
            spare[link] -= passing
        for j in range(len(turn)):
            before = speeds[j]
            speeds[j] = _next_speed(
                turn[j] - turned[j], before, joints.velocity_max[j], joints.acceleration_max[j],
                _STEP)
            way = 0.5 * _STEP * (before + speeds[j])
            turned[j] += way
            for link in joints.links:
                spare[link] -= joints.levers[link, j] * abs(way)
        for link in joints.links:
            if spare[link] > 0.0:
                continue
            start[:], end[:] = arm.segment_start[link], arm.segment_end[link]
            for j in range(len(turn) - 1, -1, -1):
                if joints.moves[link, j] > 0.0:
                    _turned_about(arm.columns[:, j], turned[j], start)
                    _turned_about(arm.columns[:, j], turned[j], end)
            distance = _distance(maps, link, start, end, step * _STEP)
            measured += 1
            spare[link] = distance - enough
            if distance < least[link]:
                shortage += joints.shares[link] * (
                    (enough - distance) ** 2 - (enough - least[link]) ** 2)
                least[link] = distance
        if shortage >= limit:
            break
    return shortage, measured


@compiled
def _best(
    arm: Fields[Kinematics], maps: Fields[InflatedEllipsoids], joints: Fields[_Joints],
    velocities: Vector, turns: Matrix, horizon: float, enough: float, limit: float, budget: int,
) -> tuple[int, float, int, int]:
    """Return the first turn that keeps clear, else the one that falls least short of that.

    What a turn falls short is the sum over links of their share times (enough − smallest
    distance)²: a link that cannot be saved costs the others nothing.

    Args:
        arm, maps, horizon: as for `Evasion.turn`.
        joints: which turn.
        velocities: (k,) theirs now [rad/s, m/s].
        turns: (t, k) [rad, m].
        enough: distance from which on a link is clear [m].
        limit: turns that fall short by this much do not count [m²].
        budget: no further turn is tried once so many distances have been looked at.

    Returns:
        The turn's index, −1 where none counts, what it falls short [m²], how many turns are
        done with, and how many distances were looked at.
    """
    arm, maps, joints = Kinematics(*arm), InflatedEllipsoids(*maps), _Joints(*joints)
    at_first = np.zeros(len(joints.moves))
    for link in joints.links:
        at_first[link] = _distance(
            maps, link, arm.segment_start[link], arm.segment_end[link], 0.0) - enough
    chosen, smallest, tried, spent = -1, limit, 0, 0
    while tried < len(turns) and (tried == 0 or spent < budget):
        shortage, measured = _shortage(
            arm, maps, joints, velocities, turns[tried], at_first, horizon, enough, smallest)
        spent += measured * len(maps.speeds)
        if shortage < smallest:
            chosen, smallest = tried, shortage
        # Nothing is better than a turn that falls short of nothing.
        tried = tried + 1 if smallest > 0.0 else len(turns)
    return chosen, smallest, tried, spent
