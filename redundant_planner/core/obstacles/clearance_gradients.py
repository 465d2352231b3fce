"""How distances of links from obstacles change: with the arm's motion, and with the obstacles'."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, kernel, OutMatrix, OutVector, Vector
from redundant_planner.core.obstacles.clearance import (
    core_of,
    from_center,
    in_unit_ball,
    link_clearance,
    Pairs,
    segment_in_axes,
)
from redundant_planner.core.obstacles.inflation import inflated_obstacles, InflatedObstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.shapes import along, direction_along, ELLIPSOID
from redundant_planner.core.robot.jacobian import joint_shares
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.link_motions import acceleration_of, LinkMotions
from redundant_planner.core.robot.se3 import Place, place

Array = npt.NDArray[np.float64]


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


@kernel
def slope_at(
    obstacles: InflatedObstacles, link: int, obstacle: int, start: Place, end: Place, t: float,
    time: float,
) -> Place:
    """Return ∂ρ/∂x at the point x of a link's axis where ρ is smallest, base frame [1/m].

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
        a *= inverse[link, 0, obstacle] / size
        b *= inverse[link, 1, obstacle] / size
        c *= inverse[link, 2, obstacle] / size
    else:
        begin, way = segment_in_axes(obstacles, obstacle, time, start, end)
        away = direction_along(
            obstacles.shapes[obstacle], core_of(obstacles, obstacle), begin, way, t)
        size = obstacles.smallest[link, obstacle]
        a, b, c = away.x / size, away.y / size, away.z / size
    return Place(
        r[0, 0, obstacle] * a + r[0, 1, obstacle] * b + r[0, 2, obstacle] * c,
        r[1, 0, obstacle] * a + r[1, 1, obstacle] * b + r[1, 2, obstacle] * c,
        r[2, 0, obstacle] * a + r[2, 1, obstacle] * b + r[2, 2, obstacle] * c)


@compiled
def slope_of(
    obstacles: InflatedObstacles, link: int, obstacle: int, start: Place, end: Place, t: float,
) -> Place:
    """Do what `slope_at` does now, for Python."""
    return slope_at(obstacles, link, obstacle, start, end, t, 0.0)


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
    start, end = place(links.start, link), place(links.end, link)
    point = along(start, Place(end.x - start.x, end.y - start.y, end.z - start.z), t)
    slope = slope_at(obstacles, link, obstacle, start, end, t, time)
    joint_shares(links.joint_screws, point, slope, links.supports[link], gradient)
    if obstacles.speeds[obstacle] == 0.0:
        return 0.0
    a, b, c = from_center(obstacles, obstacle, time, point.x, point.y, point.z)
    x, y, z, u, v, w = obstacles.twists[:, obstacle]
    return -(slope.x * (x + v * c - w * b) + slope.y * (y + w * a - u * c)
             + slope.z * (z + u * b - v * a))


@kernel
def bending(
    obstacles: InflatedObstacles, link: int, obstacle: int, t: float, links: Links,
    motions: LinkMotions,
) -> float:
    """Return ∇ₓρ · ẍ of a pair while the joints keep their velocities [1/s²].

    Args:
        obstacles, link, obstacle, t, links: as for `clearance_gradient`.
        motions: of the links.
    """
    start, end = place(links.start, link), place(links.end, link)
    slope = slope_at(obstacles, link, obstacle, start, end, t, 0.0)
    change = acceleration_of(motions, link, along(
        start, Place(end.x - start.x, end.y - start.y, end.z - start.z), t))
    return slope.x * change.x + slope.y * change.y + slope.z * change.z


@compiled
def clearance_gradients_of(
    obstacles: InflatedObstacles, of_link: Indices, of_obstacle: Indices, parameter: Vector,
    links: Links, gradient: OutMatrix, rate: OutVector,
) -> None:
    """Write what `clearance_gradients` returns; `parameter` (p,) is where on the links."""
    for i in range(len(of_link)):
        rate[i] = clearance_gradient(
            obstacles, of_link[i], of_obstacle[i], parameter[i], 0.0, links, gradient[i])


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
        return point, some.centers[:, at] + (point - some.centers[:, at]) / size
    slope = slope_of(some, 0, at, Place(*start.tolist()), Place(*end.tolist()),
                     float(pairs.parameter[0, at]))
    return point, point - float(pairs.distance[0, at]) * some.smallest[0, at] * np.array(slope)
