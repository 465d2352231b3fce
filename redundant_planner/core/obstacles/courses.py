"""Which obstacle's course leads into a link that stands still.

An obstacle's course is the way it makes within a time if it goes on as it does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from redundant_planner.core.kernels import entry, kernel
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
from redundant_planner.core.obstacles.turns import TurningJoints
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.se3 import Place, place

# Golden sections of an obstacle's course: to within half a percent of it.
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_SECTIONS = 10


class Threat(NamedTuple):
    """A link, and the obstacle whose course leads into it; −1 twice if there is none."""

    link: int
    obstacle: int


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
    horizon: float, enough: float,
) -> float:
    """Return a bound on a link's smallest distance from another shape on its course [m].

    It is that of the ball around the shape, if this is enough; else the larger one of that and
    of the box around it, axis by axis, as if the course took every point of the link along.
    """
    x, y, z = obstacles.twists[:3, obstacle] * horizon
    a, b, c = from_center(obstacles, obstacle, 0.0, start.x, start.y, start.z)
    core = core_of(obstacles, obstacle)
    apart = _segments_apart(
        Place(end.x - start.x, end.y - start.y, end.z - start.z), Place(x, y, z), Place(a, b, c))
    apart -= obstacles.corners[obstacle] + obstacles.inflation[link, obstacle]
    if apart >= enough:
        return apart
    begin, way = segment_in_axes(obstacles, obstacle, 0.0, start, end)
    x, y, z = in_axes(obstacles, obstacle, x, y, z)
    inside = max(_gap_on_course(core.x, begin.x, way.x, x),
                 _gap_on_course(core.y, begin.y, way.y, y),
                 _gap_on_course(core.z, begin.z, way.z, z))
    return max(apart, inside - obstacles.inflation[link, obstacle])


@kernel
def _least_between(first: float, second: float, way: float) -> float:
    """Return a bound on a convex function in an interval, from its values at golden sections.

    Beyond the sections it goes on at least as steeply as between them, and nowhere does it fall
    faster than by this way over the interval.
    """
    outside = min(abs(first - second) / _GOLDEN, (1.0 - _GOLDEN) * way)
    between = 0.5 * (first + second - (2.0 * _GOLDEN - 1.0) * way)
    return min(min(first, second) - outside, between)


@kernel
def _course_of_other(
    obstacles: InflatedObstacles, link: int, obstacle: int, start: Place, end: Place,
    horizon: float, enough: float,
) -> float:
    """Return a link's smallest distance from any other shape on its course [m].

    The smallest distance of a segment from a convex shape that moves along a line is a convex
    function of time: golden sections find its minimum. They end early where that is more than
    enough.
    """
    low, high, smallest = 0.0, horizon, obstacles.smallest[link, obstacle]
    x, y, z = obstacles.twists[:3, obstacle]
    speed = math.sqrt(x * x + y * y + z * z)
    before, after = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    first, _ = link_pair(obstacles, link, obstacle, before, start, end, np.inf)
    second, _ = link_pair(obstacles, link, obstacle, after, start, end, np.inf)
    for _ in range(_SECTIONS):
        if _least_between(first * smallest, second * smallest, speed * (high - low)) > enough:
            break
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
def deepest_threat(
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
            more = kept + lead * speed
            if obstacles.shapes[obstacle] == ELLIPSOID:
                least = _course_of_ellipsoid(
                    obstacles, link, obstacle, start, end, joints.horizon)
            else:
                least = _least_on_course(
                    obstacles, link, obstacle, start, end, joints.horizon, -more)
            depths[link * count + obstacle] = least + more
    # The one that seems deepest comes first: then few others need more than a bound.
    first, deepest, at = int(depths.argmin()) if len(depths) else 0, 0.0, -1
    for i in range(-1 if len(depths) else 0, len(depths)):
        pair = i if i >= 0 else first
        depth, link, obstacle = depths[pair], pair // count, pair % count
        if depth < deepest and obstacles.shapes[obstacle] != ELLIPSOID:
            more = kept + lead * obstacles.speeds[obstacle]
            depth = more + _course_of_other(
                obstacles, link, obstacle, place(arm.start, link), place(arm.end, link),
                joints.horizon, deepest - more)
        if depth < deepest:
            deepest, at = depth, pair
    return Threat(at // count, at % count) if at >= 0 else Threat(-1, -1)
