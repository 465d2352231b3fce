"""Which way round: turns of the first joints, out of where obstacles are going.

A barrier turns a link away from where an obstacle is. A link moved by only one or two joints can
only go a few ways, though. Those away from an obstacle may lead along in front of it and into a
corner. Evasion therefore looks at the obstacles' course. If that leads into a link, it gives the
first joints, which carry all others, turns to try, small ones first. Each turn is followed through
time (`turns.py`). The arm makes the first one that keeps clear; if none does, the one that falls
least short of it.

A turn takes the tip off its path. Links moved by more joints are therefore left to the barriers,
which try null-space motion first, until these lead off the path themselves.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import entry, kernel, Vector
from redundant_planner.core.obstacles.clearance import (
    core_of,
    from_center,
    in_axes,
    in_unit_ball,
    is_contact,
    link_pair,
    segment_in_axes,
)
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.self_collision import nearest_parameters
from redundant_planner.core.obstacles.shapes import ELLIPSOID
from redundant_planner.core.obstacles.turns import (
    best_turn,
    Choice,
    CLEAR_DISTANCE,
    next_velocities,
    TurningJoints,
)
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.kinematics import Kinematics, Links
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Place, place

Array = npt.NDArray[np.float64]

# How many joints turn, and for how long each at full speed: every combination is tried [s].
_TURNING_JOINTS = 2
_TURN_DURATIONS = (
    0.0, 0.08, -0.08, 0.16, -0.16, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8, 1.2, -1.2)
# How many turns a tick tries; all of them take 8 ticks. How many distances of links from obstacles
# it looks at for that, which bounds its time among many obstacles that move.
_MOST_TURNS = 24
_MOST_DISTANCES = 6000
# What a link counts that more joints move than turn: the other joints may still save it.
_WEIGHT_OF_OTHER_LINKS = 0.2
# Shares of a joint's limits that a turn uses: the rest of the arm moves, too.
_VELOCITY_SHARE, _ACCELERATION_SHARE = 0.9, 0.8
# A turn ends where standing still keeps this far from the obstacles' courses [m].
_SAFE_DISTANCE = 0.02
# A turn that is being made gives way to one that falls short by less than this share of its own.
_SHORTAGE_SHARE_TO_SWITCH = 0.8
# Golden sections of an obstacle's course: to within half a percent of it.
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_SECTIONS = 10


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


class Threat(NamedTuple):
    """A link, and the obstacle whose course leads into it; −1 twice if there is none."""

    link: int
    obstacle: int


class Evasion:
    """Turns of the first joints of one arm; remembers the one that is being made.

    Attributes:
        spent: how many distances of links from obstacles the last tick looked at.
        has_waited: whether the last tick looked for no turn.
    """

    def __init__(self, robot: Robot, parameters: PlannerParameters) -> None:
        """Prepare for an arm, and what is to be kept from obstacles."""
        self._robot = robot
        self._margin, self._lead = parameters.clearance_margin, parameters.clearance_lead
        count = min(_TURNING_JOINTS, robot.n)
        self._position_min = robot.position_min[:count] + parameters.limits_position_margin
        self._position_max = robot.position_max[:count] - parameters.limits_position_margin
        moved_by = (robot.supports > 0.0).sum(axis=1)
        self._joints = TurningJoints(
            _VELOCITY_SHARE * robot.velocity_max[:count],
            _ACCELERATION_SHARE * robot.acceleration_max[:count],
            np.flatnonzero(robot.supports[:, :count].any(axis=1)),
            np.where(moved_by <= count, 1.0, _WEIGHT_OF_OTHER_LINKS),
            np.array(robot.lever_arm_bounds), parameters.clearance_evasion_horizon)
        # Of the links only those that no other joint moves.
        self._alone = self._joints._replace(
            links=self._joints.links[moved_by[self._joints.links] <= count])
        durations = sorted(itertools.product(_TURN_DURATIONS, repeat=count), key=np.linalg.norm)
        self._turns = np.array(durations) * robot.velocity_max[:count]
        self.reset()

    def reset(self) -> None:
        """Forget the turn that is being made."""
        self._target: Array | None = None
        # What the turn that is being made falls short, and whether that is to be looked at again.
        self._shortage, self._is_due = np.inf, True
        self._next = 0
        self.spent = 0
        self.has_waited = False

    def turn(
        self, arm: Kinematics, obstacles: InflatedObstacles, previous: Array, leaving: bool,
        waits: bool, dt: float,
    ) -> Turn:
        """Return what the first joints shall do.

        Args:
            arm: its posture.
            obstacles: the obstacles, larger by the clearance margin and by the way that those
                that move make in `clearance.lead`.
            previous: (n,) velocity of the last tick [rad/s, m/s].
            leaving: whether the arm is leaving its path already.
            waits: whether the tick has other work to do that takes long. It then looks for no
                turn, and goes on with the one that is being made.
            dt: [s].
        """
        links, turning = self._robot.links(arm), self._target is not None
        threat = _threat(
            links, obstacles, self._joints if turning or leaving else self._alone,
            -_SAFE_DISTANCE if turning else self._margin, self._lead)
        if threat.link < 0:
            self.reset()
            return NO_TURN

        count = len(self._position_min)
        q, velocities = arm.q[:count], previous[:count].copy()

        def best(turns: Array, limit: float, budget: int) -> Choice:
            choice = best_turn(links, obstacles, self._joints, velocities, turns, limit, budget)
            self.spent += choice.distances
            return choice

        self.spent = 0
        tries = True
        self.has_waited = waits
        if waits:
            tries = False
        elif self._target is not None and self._is_due:
            self._shortage = best(self._target[None] - q, np.inf, 1).shortage
            # Where there is no time for both, the next tick tries others.
            tries = self._is_due = 2 * self.spent <= _MOST_DISTANCES
        else:
            self._is_due = True
        if tries and self._shortage > CLEAR_DISTANCE ** 2:
            until = min(self._next - self._next % _MOST_TURNS + _MOST_TURNS, len(self._turns))
            turns = np.minimum(np.maximum(
                self._turns[self._next:until], self._position_min - q), self._position_max - q)
            choice = best(
                turns, _SHORTAGE_SHARE_TO_SWITCH * self._shortage, _MOST_DISTANCES - self.spent)
            self._next = (self._next + choice.tried) % len(self._turns)
            if choice.turn >= 0:
                self._target, self._shortage = q + turns[choice.turn], choice.shortage
        if self._target is None:  # obstacles too large for numbers
            return NO_TURN
        return Turn(next_velocities(self._target - q, velocities, self._joints, dt), *threat)


@kernel
def _segments_apart(u: Place, v: Place, w: Place) -> float:
    """Return the distance between a link and a course, both of them segments.

    Args:
        u, v: along the link, and along the course.
        w: from the course's beginning to the link's.
    """
    a = u.x * u.x + u.y * u.y + u.z * u.z
    b = u.x * v.x + u.y * v.y + u.z * v.z
    c = u.x * w.x + u.y * w.y + u.z * w.z
    e = v.x * v.x + v.y * v.y + v.z * v.z
    f = v.x * w.x + v.y * w.y + v.z * w.z
    g = w.x * w.x + w.y * w.y + w.z * w.z
    s, t = nearest_parameters(a, b, c, e, f)
    return math.sqrt(max(g + s * s * a + t * t * e + 2.0 * (s * c - t * f - s * t * b), 0.0))


@kernel
def _course_of_ellipsoid(
    obstacles: InflatedObstacles, link: int, obstacle: int, start: Place, end: Place,
    horizon: float,
) -> float:
    """Return a link's smallest distance from an ellipsoid on its course [m].

    The course is a segment, so where the inflated ellipsoid is the unit ball it is segment
    against segment.
    """
    x, y, z = obstacles.twists[:3, obstacle] * horizon
    a, b, c = from_center(obstacles, obstacle, 0.0, start.x, start.y, start.z)
    apart = _segments_apart(
        Place(*in_unit_ball(
            obstacles, link, obstacle, end.x - start.x, end.y - start.y, end.z - start.z)),
        Place(*in_unit_ball(obstacles, link, obstacle, x, y, z)),
        Place(*in_unit_ball(obstacles, link, obstacle, a, b, c)))
    return (apart - 1.0) * obstacles.smallest[link, obstacle]


@kernel
def _gap_on_course(half: float, start: float, way: float, course: float) -> float:
    """Return how far a coordinate of a link keeps beyond a slab that moves, negative inside."""
    low = start + min(way, 0.0) - max(course, 0.0)
    high = start + max(way, 0.0) - min(course, 0.0)
    return max(low, -high) - half


@kernel
def _least_on_course(
    obstacles: InflatedObstacles, link: int, obstacle: int, start: Place, end: Place,
    horizon: float,
) -> float:
    """Return a bound on a link's smallest distance from another shape on its course [m].

    It is the larger one of two: of the ball around the shape; and of the box around it, axis by
    axis, as if the course took every point of the link along.
    """
    x, y, z = obstacles.twists[:3, obstacle] * horizon
    a, b, c = from_center(obstacles, obstacle, 0.0, start.x, start.y, start.z)
    core = core_of(obstacles, obstacle)
    corner = math.sqrt(core.x * core.x + core.y * core.y + core.z * core.z)
    apart = _segments_apart(
        Place(end.x - start.x, end.y - start.y, end.z - start.z), Place(x, y, z), Place(a, b, c))
    begin, way = segment_in_axes(obstacles, obstacle, 0.0, start, end)
    x, y, z = in_axes(obstacles, obstacle, x, y, z)
    inside = max(_gap_on_course(core.x, begin.x, way.x, x),
                 _gap_on_course(core.y, begin.y, way.y, y),
                 _gap_on_course(core.z, begin.z, way.z, z))
    return max(apart - corner, inside) - obstacles.inflation[link, obstacle]


@kernel
def _course_of_other(
    obstacles: InflatedObstacles, link: int, obstacle: int, start: Place, end: Place,
    horizon: float,
) -> float:
    """Return a link's smallest distance from any other shape on its course [m].

    The smallest distance of a segment from a convex shape that moves along a line is a convex
    function of time: golden sections find its minimum.
    """
    low, high, smallest = 0.0, horizon, obstacles.smallest[link, obstacle]
    before, after = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    first, _ = link_pair(obstacles, link, obstacle, before, start, end, np.inf)
    second, _ = link_pair(obstacles, link, obstacle, after, start, end, np.inf)
    for _ in range(_SECTIONS):
        if first < second:
            high, after, second = after, before, first
            before = high - _GOLDEN * (high - low)
            first, _ = link_pair(obstacles, link, obstacle, before, start, end, np.inf)
        else:
            low, before, first = before, after, second
            after = low + _GOLDEN * (high - low)
            second, _ = link_pair(obstacles, link, obstacle, after, start, end, np.inf)
    return min(first, second) * smallest


@entry
def _threat(
    arm: Links, obstacles: InflatedObstacles, joints: TurningJoints, kept: float, lead: float,
) -> Threat:
    """Return the link that an obstacle's course leads into if it stands still, and the obstacle.

    Of several it is the one that would be hit deepest.

    Args:
        arm, obstacles: as for `best_turn`.
        joints: which turn.
        kept: how much of the distance from the links is none, besides the lead [m].
        lead: as for `inflated_obstacles` [s].
    """
    count = len(obstacles.speeds)
    depths = np.full(len(arm.start) * count, np.inf)
    for link in joints.links:
        start, end = place(arm.start, link), place(arm.end, link)
        for obstacle in range(count):
            speed = obstacles.speeds[obstacle]
            if speed == 0.0 or is_contact(obstacles, link, obstacle):
                continue
            if obstacles.shapes[obstacle] == ELLIPSOID:
                least = _course_of_ellipsoid(
                    obstacles, link, obstacle, start, end, joints.horizon)
            else:
                least = _least_on_course(
                    obstacles, link, obstacle, start, end, joints.horizon)
            depths[link * count + obstacle] = least + kept + lead * speed
    # The one that seems deepest comes first: then few others need more than a bound.
    first, deepest, at = int(depths.argmin()) if count > 0 else 0, 0.0, -1
    for i in range(-1 if count > 0 else 0, len(depths)):
        pair = i if i >= 0 else first
        depth, link, obstacle = depths[pair], pair // count, pair % count
        if depth < deepest and obstacles.shapes[obstacle] != ELLIPSOID:
            depth = kept + lead * obstacles.speeds[obstacle] + _course_of_other(
                obstacles, link, obstacle, place(arm.start, link), place(arm.end, link),
                joints.horizon)
        if depth < deepest:
            deepest, at = depth, pair
    return Threat(at // count, at % count) if at >= 0 else Threat(-1, -1)
