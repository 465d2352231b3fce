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

from redundant_planner.core.kernels import (
    compiled,
    Indices,
    kernel,
    Matrix,
    OutMatrix,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.obstacles.inflation import inflated_obstacles, InflatedObstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.shapes import (
    direction_along,
    ELLIPSOID,
    HALF_SPACE,
    least_distance,
    nearest_on_segment,
    Place,
)
from redundant_planner.core.robot.jacobian import joint_shares
from redundant_planner.core.robot.kinematics import Links

Array = npt.NDArray[np.float64]
Number = TypeVar('Number', float, Array)

_TINY = float(np.finfo(float).tiny)


@kernel
def from_center(
    obstacles: InflatedObstacles, obstacle: int, time: float, x: float, y: float, z: float,
) -> tuple[float, float, float]:
    """Return where a point is as seen from an obstacle's centre, which moves on for a time [m]."""
    centers, velocities = obstacles.centers, obstacles.twists
    return (x - (centers[obstacle, 0] + time * velocities[obstacle, 0]),
            y - (centers[obstacle, 1] + time * velocities[obstacle, 1]),
            z - (centers[obstacle, 2] + time * velocities[obstacle, 2]))


@kernel
def in_axes(
    obstacles: InflatedObstacles, obstacle: int, x: float, y: float, z: float,
) -> tuple[float, float, float]:
    """Return Rᵀ x: a vector in an obstacle's axes."""
    r = obstacles.rotations
    return (r[obstacle, 0, 0] * x + r[obstacle, 1, 0] * y + r[obstacle, 2, 0] * z,
            r[obstacle, 0, 1] * x + r[obstacle, 1, 1] * y + r[obstacle, 2, 1] * z,
            r[obstacle, 0, 2] * x + r[obstacle, 1, 2] * y + r[obstacle, 2, 2] * z)


@kernel
def in_unit_ball(
    obstacles: InflatedObstacles, link: int, obstacle: int, x: float, y: float, z: float,
) -> tuple[float, float, float]:
    """Return diag(1/a) Rᵀ x: a vector [m] as it is where the ellipsoid is the unit ball."""
    inverse = obstacles.inverse
    x, y, z = in_axes(obstacles, obstacle, x, y, z)
    return (x * inverse[link, obstacle, 0], y * inverse[link, obstacle, 1],
            z * inverse[link, obstacle, 2])


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
def place(points: Matrix, i: int) -> Place:
    """Return a point (k, 3) as numbers."""
    return Place(points[i, 0], points[i, 1], points[i, 2])


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
    shape = (*start.shape[:-1], len(obstacles.centers))
    arrays = np.empty(shape), np.empty(shape), np.empty(shape)
    if start.ndim == 2:
        pairs = Pairs(*arrays)
        measure(obstacles, start, end, 0.0, enough, pairs)
        return pairs
    along = PairsAlong(*arrays)
    measure_along(
        obstacles, start, end, np.zeros(len(start)) if times is None else times, enough, along)
    return Pairs(*along)


@compiled
def measure(
    obstacles: InflatedObstacles, start: Matrix, end: Matrix, time: float, enough: float,
    pairs: Pairs,
) -> None:
    """Write all pairs at one posture, reached at a time from now [s].

    What is further away than `enough` [m], and than the nearest of all, may be given a bound
    from below.
    """
    smallest, least = obstacles.smallest, np.inf
    for link in range(len(start)):
        here, there = place(start, link), place(end, link)
        # As if all of them were ellipsoids: without a branch it is done for several at once.
        for obstacle in range(len(obstacles.shapes)):
            rho, t = _ellipsoid(obstacles, link, obstacle, time, here, there)
            pairs.normalized_distance[link, obstacle] = rho
            pairs.distance[link, obstacle] = rho * smallest[link, obstacle]
            pairs.parameter[link, obstacle] = t
        for obstacle in range(len(obstacles.shapes)):
            if obstacles.shapes[obstacle] == ELLIPSOID:
                continue
            rho, t = _other_shape(
                obstacles, link, obstacle, time, here, there, max(enough, least))
            distance = rho * smallest[link, obstacle]
            if obstacles.shapes[obstacle] != HALF_SPACE:
                least = min(least, distance)
            pairs.normalized_distance[link, obstacle] = rho
            pairs.distance[link, obstacle] = distance
            pairs.parameter[link, obstacle] = t


@compiled
def measure_along(
    obstacles: InflatedObstacles, start: Stack, end: Stack, times: Vector, enough: float,
    pairs: PairsAlong,
) -> None:
    """Do what `measure` does at each of N postures."""
    for i in range(len(times)):
        measure(obstacles, start[i], end[i], times[i], enough, Pairs(
            pairs.normalized_distance[i], pairs.distance[i], pairs.parameter[i]))


def surface_point(
    scene: Scene, rows: npt.NDArray[np.intp], start: Array, end: Array,
) -> tuple[Array, Array]:
    """Return a segment's point next to some obstacles, and the point of their surface next to it.

    Of an ellipsoid that is where the way from the point of smallest ρ to the centre meets the
    surface.

    Args:
        scene: the obstacles.
        rows: (k,) which of them.
        start, end: (3,) of the segment [m].

    Returns:
        (3,) x [m]; and (3,) c + (x − c) / (ρ + 1), for other shapes x − d ∇d [m].
    """
    some = inflated_obstacles(scene, np.zeros(1), chosen=rows)
    pairs = link_clearance(some, start[None], end[None])
    at = int(pairs.distance.argmin())
    point = start + float(pairs.parameter[0, at]) * (end - start)
    if some.shapes[at] == ELLIPSOID:
        size = max(float(pairs.normalized_distance[0, at]) + 1.0, 1e-9)
        return point, some.centers[at] + (point - some.centers[at]) / size
    slope = slope_at(some, 0, at, Place(*start.tolist()), Place(*end.tolist()),
                     float(pairs.parameter[0, at]), 0.0)
    return point, point - float(pairs.distance[0, at]) * some.smallest[0, at] * slope


def pseudo_distance(normalized_distance: Number) -> Number:
    """Return S (Eq. 6) of the normalized distance ρ: S = (ρ + 1)² − 1."""
    return normalized_distance * (normalized_distance + 2.0)


def clearance_gradients(
    obstacles: InflatedObstacles, pairs: Pairs, chosen: tuple[npt.NDArray[np.intp], ...],
    links: Links,
) -> tuple[Array, Array]:
    """Return ∂ρ/∂q and ∂ρ/∂t of the chosen pairs.

    At the minimising point x of the link, the parameter t of that point does not contribute
    (envelope theorem). With joint screws [v; w] at the base origin,
    ∂ρ/∂q_j = ∇ₓρ · v_j + (x × ∇ₓρ) · w_j for the joints that move the link.

    Args:
        obstacles, pairs: of the same scene and posture.
        chosen: (p,) indices of links and of obstacles.
        links: at the posture.

    Returns:
        (p, n) gradients in q, and (p,) rates of ρ caused by the obstacles' own motion.
    """
    of_link, of_obstacle = chosen
    count = len(of_link)
    gradient, rate = np.empty((count, links.joint_screws.shape[1])), np.empty(count)
    clearance_gradients_of(
        obstacles, of_link, of_obstacle, pairs.parameter[chosen], links, gradient, rate)
    return gradient, rate


@compiled
def slope_at(
    obstacles: InflatedObstacles, link: int, obstacle: int, start: Place, end: Place, t: float,
    time: float,
) -> Array:
    """Return ∂ρ/∂x at the point x of a link's axis where ρ is smallest, (3,), base frame [1/m].

    That is Aᵀ y/|y| for an ellipsoid, and ∇d/a for other shapes.

    Args:
        obstacles: as they are now.
        link, obstacle: which.
        start, end, t: of the link's segment [m], and where on it x is.
        time: when the link is there, from now [s].
    """
    r, inverse = obstacles.rotations, obstacles.inverse
    if obstacles.shapes[obstacle] == ELLIPSOID:
        a, b, c = from_center(
            obstacles, obstacle, time, start.x + t * (end.x - start.x),
            start.y + t * (end.y - start.y), start.z + t * (end.z - start.z))
        a, b, c = in_unit_ball(obstacles, link, obstacle, a, b, c)
        # In an ellipsoid's very centre every direction is as good: the guard leaves a zero.
        size = max(math.sqrt(a * a + b * b + c * c), 1e-9)
        a *= inverse[link, obstacle, 0] / size
        b *= inverse[link, obstacle, 1] / size
        c *= inverse[link, obstacle, 2] / size
    else:
        begin, way = segment_in_axes(obstacles, obstacle, time, start, end)
        away = direction_along(
            obstacles.shapes[obstacle], core_of(obstacles, obstacle), begin, way, t)
        size = obstacles.smallest[link, obstacle]
        a, b, c = away.x / size, away.y / size, away.z / size
    slope = np.empty(3)
    for axis in range(3):
        slope[axis] = (r[obstacle, axis, 0] * a + r[obstacle, axis, 1] * b
                       + r[obstacle, axis, 2] * c)
    return slope


@kernel
def clearance_gradient(
    obstacles: InflatedObstacles, link: int, obstacle: int, t: float, time: float,
    links: Links, gradient: OutVector,
) -> float:
    """Write the gradient of one pair, and return its rate.

    An obstacle's surface moves with v + w × (x − c), and ρ falls by as much as it comes nearer.

    Args:
        obstacles: as they are now.
        link, obstacle: which.
        t: where on the link's segment the smallest ρ is.
        time: when the posture is reached, from now [s].
        links: at the posture.
        gradient: (n,) ∂ρ/∂q, what is written.
    """
    point = links.start[link] + t * (links.end[link] - links.start[link])
    slope = slope_at(
        obstacles, link, obstacle, place(links.start, link), place(links.end, link), t, time)
    joint_shares(links.joint_screws, point, slope, links.supports[link], gradient)
    if obstacles.speeds[obstacle] == 0.0:
        return 0.0
    a, b, c = from_center(obstacles, obstacle, time, point[0], point[1], point[2])
    x, y, z, u, v, w = obstacles.twists[obstacle]
    return -(slope[0] * (x + v * c - w * b) + slope[1] * (y + w * a - u * c)
             + slope[2] * (z + u * b - v * a))


@compiled
def clearance_gradients_of(
    obstacles: InflatedObstacles, of_link: Indices, of_obstacle: Indices, parameter: Vector,
    links: Links, gradient: OutMatrix, rate: OutVector,
) -> None:
    """Write what `clearance_gradients` returns; `parameter` (p,) is where on the links."""
    for i in range(len(of_link)):
        rate[i] = clearance_gradient(
            obstacles, of_link[i], of_obstacle[i], parameter[i], 0.0, links, gradient[i])
