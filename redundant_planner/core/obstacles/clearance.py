"""How far points and links are from obstacles, and how that changes (Eqs. 4–7).

The level value of an ellipsoid with centre c, axes R and semi-axes a is, with
y = diag(1/a) Rᵀ (x − c),

    S(x) = |y|² − 1        (Eq. 6; 0 on the surface, −1 in the centre)
    ρ(x) = |y| − 1         (the normalized distance: the same level, linear in distance)

y is a point's place relative to the ellipsoid turned into the unit ball. There a link is a
segment again, and its point of smallest ρ is the one nearest to the origin: a closed form.

Other shapes have an exact distance d (`shapes.py`). With their smallest half extent a, inflated
like the surface, ρ = d/a and S = (1 + d/a)² − 1: what an ellipsoid has along its shortest axis.

Whatever measures links against obstacles is made of `link_pair` or its two parts. They take and
return plain numbers: like this the compiler merges them into the loops that call them. Functions
on whole pairs, with arrays as arguments, make a tick among 1000 obstacles 60 % longer.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, kernel, Matrix, OutMatrix, Stack, Vector
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.shapes import (
    ELLIPSOID,
    HALF_SPACE,
    least_distance,
    nearest_on_segment,
)
from redundant_planner.core.robot.se3 import Place, place

Array = npt.NDArray[np.float64]
Number = TypeVar('Number', float, Array)

_TINY = float(np.finfo(float).tiny)


@kernel
def from_center(
    obstacles: InflatedObstacles, obstacle: int, time: float, x: float, y: float, z: float,
) -> tuple[float, float, float]:
    """Return where a point is as seen from an obstacle's centre, which moves on for a time [m]."""
    centers, velocities = obstacles.centers, obstacles.twists
    return (x - (centers[0, obstacle] + time * velocities[0, obstacle]),
            y - (centers[1, obstacle] + time * velocities[1, obstacle]),
            z - (centers[2, obstacle] + time * velocities[2, obstacle]))


@kernel
def in_axes(
    obstacles: InflatedObstacles, obstacle: int, x: float, y: float, z: float,
) -> tuple[float, float, float]:
    """Return Rᵀ x: a vector in an obstacle's axes."""
    r = obstacles.rotations
    return (r[0, 0, obstacle] * x + r[1, 0, obstacle] * y + r[2, 0, obstacle] * z,
            r[0, 1, obstacle] * x + r[1, 1, obstacle] * y + r[2, 1, obstacle] * z,
            r[0, 2, obstacle] * x + r[1, 2, obstacle] * y + r[2, 2, obstacle] * z)


@kernel
def in_unit_ball(
    obstacles: InflatedObstacles, link: int, obstacle: int, x: float, y: float, z: float,
) -> tuple[float, float, float]:
    """Return diag(1/a) Rᵀ x: a vector [m] as it is where the ellipsoid is the unit ball."""
    inverse = obstacles.inverse
    x, y, z = in_axes(obstacles, obstacle, x, y, z)
    return (x * inverse[link, 0, obstacle], y * inverse[link, 1, obstacle],
            z * inverse[link, 2, obstacle])


@kernel
def nearest_to_origin(
    y1: float, y2: float, y3: float, d1: float, d2: float, d3: float,
) -> tuple[float, float]:
    """Return how near a segment y + t d, 0 ≤ t ≤ 1, comes to the origin, and the t where it does.

    |y + t d|² is a parabola in t, smallest at t = clip(−y·d / d·d).
    """
    squared = d1 * d1 + d2 * d2 + d3 * d3
    t = min(max(-(y1 * d1 + y2 * d2 + y3 * d3) / max(squared, _TINY), 0.0), 1.0)
    return math.sqrt((y1 + t * d1) ** 2 + (y2 + t * d2) ** 2 + (y3 + t * d3) ** 2), t


@kernel
def core_of(obstacles: InflatedObstacles, obstacle: int) -> Place:
    """Return the half extents of what is inflated [m]."""
    cores = obstacles.cores
    return Place(cores[obstacle, 0], cores[obstacle, 1], cores[obstacle, 2])


@kernel
def is_contact(obstacles: InflatedObstacles, link: int, obstacle: int) -> bool:
    """Return whether a pair may touch, and is not a link and a wall."""
    return (obstacles.may_touch[link, obstacle]
            and obstacles.shapes[obstacle] != HALF_SPACE)


@kernel
def segment_in_axes(
    obstacles: InflatedObstacles, obstacle: int, time: float, start: Place, end: Place,
) -> tuple[Place, Place]:
    """Return where a segment begins in an obstacle's axes, and its way to the end."""
    a, b, c = from_center(obstacles, obstacle, time, start.x, start.y, start.z)
    a, b, c = in_axes(obstacles, obstacle, a, b, c)
    u, v, w = in_axes(obstacles, obstacle, end.x - start.x, end.y - start.y, end.z - start.z)
    return Place(a, b, c), Place(u, v, w)


@compiled
def _other_shape(
    obstacles: InflatedObstacles, link: int, obstacle: int, time: float, start: Place,
    end: Place, enough: float,
) -> tuple[float, float]:
    """Return what `link_pair` does, of anything but an ellipsoid."""
    core, shape = core_of(obstacles, obstacle), obstacles.shapes[obstacle]
    begin, way = segment_in_axes(obstacles, obstacle, time, start, end)
    inflation = obstacles.inflation[link, obstacle]
    bound = least_distance(shape, core, begin, way) - inflation
    if bound > enough:
        return bound / obstacles.smallest[link, obstacle], 0.0
    distance, t = nearest_on_segment(shape, core, begin, way)
    return (distance - inflation) / obstacles.smallest[link, obstacle], t


@kernel
def _ellipsoid(
    obstacles: InflatedObstacles, link: int, obstacle: int, time: float, start: Place, end: Place,
) -> tuple[float, float]:
    """Return what `link_pair` does, of an ellipsoid."""
    a, b, c = from_center(obstacles, obstacle, time, start.x, start.y, start.z)
    a, b, c = in_unit_ball(obstacles, link, obstacle, a, b, c)
    u, v, w = in_unit_ball(
        obstacles, link, obstacle, end.x - start.x, end.y - start.y, end.z - start.z)
    size, t = nearest_to_origin(a, b, c, u, v, w)
    return size - 1.0, t


@kernel
def link_pair(
    obstacles: InflatedObstacles, link: int, obstacle: int, time: float, start: Place,
    end: Place, enough: float,
) -> tuple[float, float]:
    """Return the smallest ρ of a link from an obstacle, and where on the link it is.

    Args:
        obstacles: as they are now.
        link, obstacle: which.
        time: when the link is there, from now [s].
        start, end: of the link's segment [m].
        enough: anything that is surely further away [m] may be given a bound from below.
    """
    if obstacles.shapes[obstacle] == ELLIPSOID:
        return _ellipsoid(obstacles, link, obstacle, time, start, end)
    return _other_shape(obstacles, link, obstacle, time, start, end, enough)


class Pairs(NamedTuple):
    """Every link × every obstacle, at one posture.

    Attributes:
        normalized_distance: (c, k) ρ, the smallest over the link; negative inside.
        distance: (c, k) [m] ρ times the smallest half extent: never more than the true distance,
            and just that for other shapes than ellipsoids.
        parameter: (c, k) where on the segment, 0 at its start, 1 at its end.
    """

    normalized_distance: Matrix
    distance: Matrix
    parameter: Matrix


class PairsAlong(NamedTuple):
    """The fields of `Pairs` at N postures: N leads every array."""

    normalized_distance: Stack
    distance: Stack
    parameter: Stack


def link_clearance(
    obstacles: InflatedObstacles, start: Array, end: Array, times: Array | None = None,
    enough: float = math.inf,
) -> Pairs:
    """Return the smallest ρ of every obstacle over every whole link; N leads with N postures.

    Args:
        obstacles: from `inflated_obstacles`, with one row per link.
        start: (c, 3) segment starts in the base frame [m], or (N, c, 3).
        end: likewise, segment ends.
        times: (N,) with N postures, when each of them is reached: obstacles that move have
            moved by then [s].
        enough: what is further away than this [m], and than the nearest at its posture, may be
            given a bound from below, which is quicker.
    """
    shape = (*start.shape[:-1], len(obstacles.shapes))
    arrays = np.empty(shape), np.empty(shape), np.empty(shape)
    if start.ndim == 2:
        pairs = Pairs(*arrays)
        measure(obstacles, start, end, 0.0, enough, pairs)
        return pairs
    along = PairsAlong(*arrays)
    measure_along(
        obstacles, start, end, np.zeros(len(start)) if times is None else times, enough, along)
    return Pairs(*along)


@kernel
def has_ellipsoids(obstacles: InflatedObstacles) -> bool:
    """Return whether any obstacle is an ellipsoid."""
    found = 0
    for obstacle in range(len(obstacles.shapes)):
        found += obstacles.shapes[obstacle] == ELLIPSOID
    return found > 0


@kernel
def measure_link(
    obstacles: InflatedObstacles, link: int, start: Place, end: Place, time: float,
    enough: float, least: float, some: bool, pairs: Pairs,
) -> tuple[float, int]:
    """Write what a link's row of `Pairs` is, unless it is known to be more than is asked for.

    `pairs.distance` is what is known: it bounds the distances from below.

    Args:
        obstacles: as they are now.
        link: which.
        start, end: of its segment [m].
        time: when it is there, from now [s].
        enough: what is further away than this, and than the nearest, may keep its bound [m].
        least: how near the nearest is that is known [m].
        some: whether there are ellipsoids.
        pairs: which are written.

    Returns:
        how near the nearest is then, and how many shapes other than ellipsoids were measured.
    """
    smallest, count, measured = obstacles.smallest, len(obstacles.shapes), 0
    # As if all of them were ellipsoids: without a branch it is done for several at once.
    for obstacle in range(count if some else 0):
        rho, t = _ellipsoid(obstacles, link, obstacle, time, start, end)
        pairs.normalized_distance[link, obstacle] = rho
        pairs.parameter[link, obstacle] = t
    for obstacle in range(count):
        if obstacles.shapes[obstacle] == ELLIPSOID:
            pairs.distance[link, obstacle] = (
                pairs.normalized_distance[link, obstacle] * smallest[link, obstacle])
            continue
        if pairs.distance[link, obstacle] > max(enough, least):
            pairs.normalized_distance[link, obstacle] = (
                pairs.distance[link, obstacle] / smallest[link, obstacle])
            continue
        rho, t = _other_shape(
            obstacles, link, obstacle, time, start, end, max(enough, least))
        distance = rho * smallest[link, obstacle]
        measured += 1
        if not obstacles.may_touch[link, obstacle]:
            least = min(least, distance)
        pairs.normalized_distance[link, obstacle] = rho
        pairs.distance[link, obstacle] = distance
        pairs.parameter[link, obstacle] = t
    return least, measured


@compiled
def measure_unless(
    obstacles: InflatedObstacles, start: Matrix, end: Matrix, time: float, enough: float,
    pairs: Pairs,
) -> None:
    """Do what `measure` does, unless a pair's distance is known to be more than is asked for.

    `pairs.distance` is what is known of them: it bounds them from below.
    """
    least, some = np.inf, has_ellipsoids(obstacles)
    for link in range(len(start)):
        if not obstacles.moved[link]:
            pairs.distance[link], pairs.normalized_distance[link] = np.inf, np.inf
            pairs.parameter[link] = 0.0
            continue
        least, _ = measure_link(
            obstacles, link, place(start, link), place(end, link), time, enough, least, some,
            pairs)


@compiled
def measure_until(
    obstacles: InflatedObstacles, start: Matrix, end: Matrix, enough: Vector, too_near: Vector,
    forgiven: Vector, pairs: Pairs,
) -> int:
    """Write distances as `measure_unless` does, for each link by itself, until one is too near.

    The last links come first: they are the first to touch something. Those before it are left as
    they were then, and of links that do not move the distance alone is written.

    Args:
        obstacles: as they are now.
        start, end: (c, 3) of the links' segments [m].
        enough: (c,) what is further from a link than this may keep its bound [m].
        too_near: (c,) it ends with a link that is nearer than this [m].
        forgiven: (c,) what is added to its distances before.
        pairs: which are written.

    Returns:
        how many shapes other than ellipsoids were measured.
    """
    measured, some = 0, has_ellipsoids(obstacles)
    for link in range(len(start) - 1, -1, -1):
        if not obstacles.moved[link]:
            pairs.distance[link] = np.inf
            continue
        _, more = measure_link(obstacles, link, place(start, link), place(end, link), 0.0,
                               enough[link], -np.inf, some, pairs)
        measured += more
        for obstacle in range(len(obstacles.shapes)):
            distance = pairs.distance[link, obstacle] + forgiven[link]
            if distance < too_near[link] and not is_contact(obstacles, link, obstacle):
                return measured
    return measured


@kernel
def bound_by_balls(
    obstacles: InflatedObstacles, start: Matrix, end: Matrix, time: float, distance: OutMatrix,
) -> None:
    """Write how far links are from the balls around shapes (c, k) [m]; of ellipsoids anything."""
    if np.all(obstacles.shapes == ELLIPSOID):
        return
    # Without branches, so that it is done for several at once.
    for link in range(len(start)):
        here, there = place(start, link), place(end, link)
        dx, dy, dz = there.x - here.x, there.y - here.y, there.z - here.z
        for obstacle in range(len(obstacles.shapes)):
            a, b, c = from_center(obstacles, obstacle, time, here.x, here.y, here.z)
            away, _ = nearest_to_origin(a, b, c, dx, dy, dz)
            distance[link, obstacle] = (
                away - obstacles.corners[obstacle] - obstacles.inflation[link, obstacle])


@compiled
def measure(
    obstacles: InflatedObstacles, start: Matrix, end: Matrix, time: float, enough: float,
    pairs: Pairs,
) -> None:
    """Write all pairs at one posture, reached at a time from now [s].

    What is further away than `enough` [m], and than the nearest of all, may be given a bound
    from below.
    """
    bound_by_balls(obstacles, start, end, time, pairs.distance)
    measure_unless(obstacles, start, end, time, enough, pairs)


@compiled
def measure_along(
    obstacles: InflatedObstacles, start: Stack, end: Stack, times: Vector, enough: float,
    pairs: PairsAlong,
) -> None:
    """Do what `measure` does at each of N postures."""
    for i in range(len(times)):
        measure(obstacles, start[i], end[i], times[i], enough, Pairs(
            pairs.normalized_distance[i], pairs.distance[i], pairs.parameter[i]))


def pseudo_distance(normalized_distance: Number) -> Number:
    """Return S (Eq. 6) of the normalized distance ρ: S = (ρ + 1)² − 1."""
    return normalized_distance * (normalized_distance + 2.0)
