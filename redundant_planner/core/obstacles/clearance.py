"""Ellipsoidal obstacles and how far points and links are from them (Eqs. 4–7).

The level value of an ellipsoid with centre c, axes R and semi-axes a is, with
y = diag(1/a) Rᵀ (x − c),

    S(x) = |y|² − 1        (Eq. 6; 0 on the surface, −1 in the centre)
    ρ(x) = |y| − 1         (the same level, linear in distance)

Along a segment S is a parabola in the segment's parameter, so its smallest value over a whole
link has a closed form. A link's radius r enters through the ellipsoid: the trace-minimal outer
ellipsoid of ellipsoid ⊕ ball has the same axes and the semi-axes √((1+β) a² + (1+1/β) r²).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.kernels import (
    compiled,
    Indices,
    kernel,
    Matrix,
    OutMatrix,
    OutStack,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.jacobian import joint_shares

Array = npt.NDArray[np.float64]
Number = TypeVar('Number', float, Array)

_TINY = float(np.finfo(float).tiny)
# Most pairs of links and obstacles that a tick takes gradients of, and most that enter the filter
# as barriers: what bounds a tick's time in a crowd.
MOST_PAIRS = 120
MOST_ACTING = 60
# Most pairs that enter the problem of the joint path ahead.
MOST_AHEAD_PAIRS = 100


@compiled
def rotations(quaternions: Matrix) -> Array:
    """Return the rotation matrices (k, 3, 3) of quaternions (k, 4), x y z w, of any length."""
    result = np.empty((len(quaternions), 3, 3))
    for i in range(len(quaternions)):
        x, y, z, w = quaternions[i]
        size = math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / size, y / size, z / size, w / size
        r = result[i]
        r[0, 0], r[1, 1], r[2, 2] = (
            1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z), 1 - 2 * (x * x + y * y))
        r[0, 1], r[0, 2], r[1, 2] = (
            2 * (x * y - z * w), 2 * (x * z + y * w), 2 * (y * z - x * w))
        r[1, 0], r[2, 0], r[2, 1] = (
            2 * (x * y + z * w), 2 * (x * z - y * w), 2 * (y * z + x * w))
    return result


@dataclass(frozen=True)
class Scene:
    """All obstacles, stacked; built once when something changes, not once per tick.

    Attributes:
        names: k names.
        centers: (k, 3) [m].
        rotations: (k, 3, 3) ellipsoid axes → base axes.
        semi_axes: (k, 3) [m].
        velocities: (k, 3) [m/s].
    """

    names: tuple[str, ...]
    centers: Array
    rotations: Array
    semi_axes: Array
    velocities: Array

    @classmethod
    def of(cls, obstacles: Iterable[Obstacle] = ()) -> Scene:
        """Stack obstacles into a scene."""
        obstacles = tuple(obstacles)
        arrays = (
            np.array([o.center for o in obstacles]).reshape(-1, 3),
            np.array([o.rotation for o in obstacles]).reshape(-1, 3, 3),
            np.array([o.semi_axes for o in obstacles]).reshape(-1, 3),
            np.array([o.velocity for o in obstacles]).reshape(-1, 3))
        for array in arrays:
            array.setflags(write=False)
        return cls(tuple(o.name for o in obstacles), *arrays)

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return the obstacles one by one."""
        return tuple(
            Obstacle(name, center, axes, pin.Quaternion(rotation).coeffs(), velocity)
            for name, center, axes, rotation, velocity in zip(
                self.names, self.centers, self.semi_axes, self.rotations, self.velocities))


@kernel
def inflated_square(semi_axis: float, radius: float, trace: float) -> float:
    """Return the squared semi-axis of the trace-minimal ellipsoid around ellipsoid ⊕ ball [m²].

    With A² = diag(a²): (1+β) A² + (1+1/β) r² I, β = √(3 r² / tr A²). Adding r to the semi-axes
    instead would not contain the sum.

    Args:
        semi_axis: a of the ellipsoid [m].
        radius: r of the ball, 0 or more [m].
        trace: tr A², the sum of the three squared semi-axes [m²].
    """
    r2 = radius * radius
    # r² / β without the division, as β is 0 for a bare segment.
    beta, beyond = math.sqrt(3.0 * r2 / trace), math.sqrt(r2 * trace / 3.0)
    return (1.0 + beta) * (semi_axis * semi_axis) + r2 + beyond


@compiled
def inflated_semi_axes(semi_axes: Matrix, radii: Matrix) -> Array:
    """Return the semi-axes of the trace-minimal ellipsoids around ellipsoid ⊕ ball, (c, k, 3).

    Args:
        semi_axes: (k, 3) [m].
        radii: (c, k) of the balls, 0 or more [m].
    """
    inflated = np.empty((*radii.shape, 3))
    for ball in range(len(radii)):
        for ellipsoid in range(len(semi_axes)):
            a, b, c = semi_axes[ellipsoid]
            trace = a * a + b * b + c * c
            for axis in range(3):
                inflated[ball, ellipsoid, axis] = math.sqrt(inflated_square(
                    semi_axes[ellipsoid, axis], radii[ball, ellipsoid], trace))
    return inflated


class InflatedEllipsoids(NamedTuple):
    """What turns each inflated ellipsoid into the unit ball: y = diag(1/a) Rᵀ (x − c).

    Attributes:
        centers: (k, 3) c [m].
        rotations: (k, 3, 3) R.
        inverse: (c, k, 3) 1 / inflated semi-axes a [1/m]; one per link, as links differ in
            radius.
        smallest: (c, k) smallest inflated semi-axis [m].
        velocities: (k, 3) obstacle velocities in the base frame [m/s].
        speeds: (k,) their size [m/s].
    """

    centers: Matrix
    rotations: Stack
    inverse: Stack
    smallest: Matrix
    velocities: Matrix
    speeds: Vector


def inflated_ellipsoids(
    scene: Scene, radii: npt.ArrayLike, lead: float = 0.0, chosen: Indices | None = None,
) -> InflatedEllipsoids:
    """Prepare a scene for links of the given radii (c,) [m].

    Obstacles that move are taken as larger all round by the way that they make within `lead` [s].
    Of the scene's obstacles those with the indices `chosen` (k,) are taken, or all.
    """
    every = np.arange(len(scene.names)) if chosen is None else chosen
    return _inflated_ellipsoids(scene.centers, scene.rotations, scene.semi_axes, scene.velocities,
                      np.array(radii, dtype=float), lead, every)


@compiled
def _inflated_ellipsoids(
    centers: Matrix, rotations: Stack, semi_axes: Matrix, velocities: Matrix, radii: Vector,
    lead: float, chosen: Indices,
) -> InflatedEllipsoids:
    centers, rotations, velocities = centers[chosen], rotations[chosen], velocities[chosen]
    speeds = np.empty(len(chosen))
    for obstacle in range(len(chosen)):
        a, b, c = velocities[obstacle]
        speeds[obstacle] = math.sqrt(a * a + b * b + c * c)
    inverse = inflated_semi_axes(semi_axes[chosen], radii[:, None] + lead * speeds)
    smallest = np.empty(inverse.shape[:2])
    for obstacle in range(len(chosen)):
        for link in range(len(radii)):
            a, b, c = inverse[link, obstacle]
            smallest[link, obstacle] = min(a, b, c)
            for axis in range(3):
                inverse[link, obstacle, axis] = 1.0 / inverse[link, obstacle, axis]
    return InflatedEllipsoids(centers, rotations, inverse, smallest, velocities, speeds)


class Pairs(NamedTuple):
    """Every link × every obstacle, at one posture or at each of N postures (then N leads).

    Attributes:
        clearance: (c, k) ρ, the smallest over the link; negative inside.
        distance: (c, k) [m] ρ times the smallest semi-axis: never more than the true distance.
        parameter: (c, k) where on the segment, 0 at its start, 1 at its end.
    """

    clearance: Array
    distance: Array
    parameter: Array


def link_clearance(
    maps: InflatedEllipsoids, start: Array, end: Array, times: Array | None = None,
) -> Pairs:
    """Return the smallest ρ of every obstacle over every whole link, in closed form.

    S(t) = |y₀ + t d|² − 1 has its minimum over [0, 1] at t = clip(−y₀·d / d·d).

    Args:
        maps: from `inflated_ellipsoids`, with one row per link.
        start: (c, 3) segment starts in the base frame [m], or (N, c, 3).
        end: likewise, segment ends.
        times: (N,) with N postures, when each of them is reached: obstacles that move have
            moved by then [s].
    """
    shape = (*start.shape[:-1], len(maps.centers))
    pairs = Pairs(np.empty(shape), np.empty(shape), np.empty(shape))
    if start.ndim == 2:
        _link_clearance(maps, start, end, 0.0, *pairs)
    else:
        _link_clearance_along(
            maps, start, end, np.zeros(len(start)) if times is None else times, *pairs)
    return pairs


@compiled
def _link_clearance(
    maps: InflatedEllipsoids, start: Matrix, end: Matrix, time: float, clearance: OutMatrix,
    distance: OutMatrix, parameter: OutMatrix,
) -> None:
    """Write the fields of `Pairs` for one posture, reached at a time from now [s]."""
    y, d = np.empty(3), np.empty(3)
    for link in range(len(start)):
        for obstacle in range(len(maps.centers)):
            squared, product = 0.0, 0.0
            for row in range(3):
                y[row], d[row] = 0.0, 0.0
                for axis in range(3):
                    turn, x = maps.rotations[obstacle, axis, row], start[link, axis]
                    center = (maps.centers[obstacle, axis]
                              + time * maps.velocities[obstacle, axis])
                    y[row] += turn * (x - center)
                    d[row] += turn * (end[link, axis] - x)
                y[row] *= maps.inverse[link, obstacle, row]
                d[row] *= maps.inverse[link, obstacle, row]
                product += y[row] * d[row]
                squared += d[row] * d[row]
            t = min(max(-product / max(squared, _TINY), 0.0), 1.0)
            level = 0.0
            for row in range(3):
                level += (y[row] + t * d[row]) ** 2
            clearance[link, obstacle] = math.sqrt(level) - 1.0
            distance[link, obstacle] = clearance[link, obstacle] * maps.smallest[link, obstacle]
            parameter[link, obstacle] = t


@compiled
def _link_clearance_along(
    maps: InflatedEllipsoids, start: Stack, end: Stack, times: Vector, clearance: OutStack,
    distance: OutStack, parameter: OutStack,
) -> None:
    """Do what `_link_clearance` does at each of N postures."""
    for i in range(len(times)):
        _link_clearance(maps, start[i], end[i], times[i], clearance[i], distance[i],
                        parameter[i])


def surface_point(scene: Scene, obstacle: int, start: Array, end: Array) -> tuple[Array, Array]:
    """Return a segment's point of smallest ρ and, towards the centre, the ellipsoid's surface.

    Args:
        scene: the obstacles.
        obstacle: which.
        start, end: (3,) of the segment [m].

    Returns:
        (3,) and (3,): x and c + (x − c) / (ρ + 1) [m].
    """
    one = slice(obstacle, obstacle + 1)
    maps = inflated_ellipsoids(Scene(scene.names[one], scene.centers[one], scene.rotations[one],
                           scene.semi_axes[one], scene.velocities[one]), np.zeros(1))
    pairs = link_clearance(maps, start[None], end[None])
    point = start + float(pairs.parameter[0, 0]) * (end - start)
    center = scene.centers[obstacle]
    return point, center + (point - center) / max(float(pairs.clearance[0, 0]) + 1.0, 1e-9)


def pseudo_distance(clearance: Number) -> Number:
    """Return S (Eq. 6) of the level ρ: S = (ρ + 1)² − 1."""
    return clearance * (clearance + 2.0)


def clearance_gradients(
    maps: InflatedEllipsoids, pairs: Pairs, chosen: tuple[npt.NDArray[np.intp], ...], start: Array,
    end: Array, columns: Array, moves: Array,
) -> tuple[Array, Array]:
    """Return ∂ρ/∂q and ∂ρ/∂t of the chosen pairs.

    At the minimising point x of the link, ∇ₓρ = Aᵀ y/|y|; the parameter t of that point does
    not contribute (envelope theorem). With joint screws [v; w] at the base origin,
    ∂ρ/∂q_j = ∇ₓρ · v_j + (x × ∇ₓρ) · w_j for the joints that move the link.

    Args:
        maps, pairs: of the same scene and posture.
        chosen: (p,) indices of links and of obstacles.
        start, end: (c, 3) the segments [m].
        columns: (6, n) joint screws at the base origin.
        moves: (c, n) 1 where a joint moves a link, else 0.

    Returns:
        (p, n) gradients in q, and (p,) rates of ρ caused by the obstacles' own motion.
    """
    links, obstacles = chosen
    gradient, rate = np.empty((len(links), columns.shape[1])), np.empty(len(links))
    _clearance_gradients(
        maps, pairs.parameter, links, obstacles, start, end, columns, moves, gradient, rate)
    return gradient, rate


@kernel
def _clearance_gradient(
    maps: InflatedEllipsoids, link: int, obstacle: int, first: Vector, last: Vector, t: float,
    columns: Matrix, moves: Vector, time: float, gradient: OutVector,
) -> float:
    """Write the gradient of one pair and return its rate."""
    rotation, velocity = maps.rotations[obstacle], maps.velocities[obstacle]
    inverse = maps.inverse[link, obstacle]
    point = first + t * (last - first)
    y, slope = np.zeros(3), np.zeros(3)
    for row in range(3):
        for axis in range(3):
            center = maps.centers[obstacle, axis] + time * velocity[axis]
            y[row] += rotation[axis, row] * (point[axis] - center)
        y[row] *= inverse[row]
    # In an ellipsoid's very centre every direction is as good: the guard leaves a zero gradient.
    size = max(math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]), 1e-9)
    rate = 0.0
    for axis in range(3):
        for row in range(3):
            slope[axis] += rotation[axis, row] * y[row] * inverse[row] / size
        rate -= slope[axis] * velocity[axis]
    joint_shares(columns, point, slope, moves, gradient)
    return rate


@compiled
def _clearance_gradients(
    maps: InflatedEllipsoids, parameter: Matrix, links: Indices, obstacles: Indices, start: Matrix,
    end: Matrix, columns: Matrix, moves: Matrix, gradient: OutMatrix, rate: OutVector,
) -> None:
    """Write what `clearance_gradients` returns."""
    for i in range(len(links)):
        link, obstacle = links[i], obstacles[i]
        rate[i] = _clearance_gradient(
            maps, link, obstacle, start[link], end[link], parameter[link, obstacle], columns,
            moves[link], 0.0, gradient[i])


class NearPairs(NamedTuple):
    """The pairs of links and obstacles that count in a tick.

    Attributes:
        links, obstacles: (p,) indices.
        clearance: (p,) ρ.
        distance: (p,) not more than the true distance [m].
        gradient: (p, n) ∂ρ/∂q.
        rate: (p,) ∂ρ/∂t from the obstacles' own motion [1/s].
        acting: (a,) which of them have a barrier that could act in this tick.
        unseen: (c,) no pair of a link that is left out is nearer than this [m].
        nearest_link, nearest_obstacle: the pair of smallest distance, −1 without obstacles,
        nearest_clearance, nearest_distance: and its ρ and distance [m].
    """

    links: Indices
    obstacles: Indices
    clearance: Vector
    distance: Vector
    gradient: Matrix
    rate: Vector
    acting: Indices
    unseen: Vector
    nearest_link: int
    nearest_obstacle: int
    nearest_clearance: float
    nearest_distance: float


@compiled
def near_pairs(
    maps: InflatedEllipsoids, start: Matrix, end: Matrix, columns: Matrix, moves: Matrix,
    speeds: Vector, rate: float, influence_distance: float, unseen: Vector,
) -> NearPairs:
    """Return the pairs that are within the influence distance, or whose barrier could act.

    Of too many those that could act soonest: `MOST_PAIRS`, and `MOST_ACTING` of them as barriers.

    Args:
        maps: the obstacles.
        start, end, columns, moves: as for `clearance_gradients`.
        speeds: (c,) the fastest any point of a link may move in this tick [m/s].
        rate: share of a clearance that may be used up per second [1/s].
        influence_distance: [m].
        unseen: (c,) how near to a link obstacles may be that are not in `maps` [m].
    """
    shape = maps.smallest.shape
    clearance, distance, parameter = np.empty(shape), np.empty(shape), np.empty(shape)
    _link_clearance(maps, start, end, 0.0, clearance, distance, parameter)
    links, obstacles = np.empty(distance.size, np.intp), np.empty(distance.size, np.intp)
    # How much too far a pair is for its barrier to act [m].
    spare = np.empty(distance.size)
    count, acts, link_at, obstacle_at, least = 0, 0, -1, -1, np.inf
    for link in range(shape[0]):
        for obstacle in range(shape[1]):
            far = distance[link, obstacle]
            if far < least:
                link_at, obstacle_at, least = link, obstacle, far
            inactive = far - (speeds[link] + maps.speeds[obstacle]) / rate
            if inactive <= 0.0 or far <= influence_distance:
                links[count], obstacles[count], spare[count] = link, obstacle, inactive
                acts += inactive <= 0.0
                count += 1
    widest, urgent = np.inf, np.inf
    if count > MOST_PAIRS:
        widest = np.partition(spare[:count], MOST_PAIRS)[MOST_PAIRS]
    if acts > MOST_ACTING:
        urgent = np.partition(spare[:count], MOST_ACTING)[MOST_ACTING]
    unseen, kept = unseen.copy(), 0
    acting = np.empty(min(acts, MOST_ACTING), np.intp)
    acts = 0
    for i in range(count):
        link, obstacle, inactive = links[i], obstacles[i], spare[i]
        if inactive <= 0.0 and inactive < urgent:
            acting[acts] = kept
            acts += 1
        elif inactive <= 0.0:
            unseen[link] = min(unseen[link], distance[link, obstacle])
        if inactive < widest:
            links[kept], obstacles[kept] = link, obstacle
            kept += 1
    near, at = np.empty(kept), np.empty(kept)
    gradient, rates = np.empty((kept, columns.shape[1])), np.empty(kept)
    _clearance_gradients(maps, parameter, links[:kept], obstacles[:kept], start, end, columns,
                         moves, gradient, rates)
    for i in range(kept):
        near[i] = clearance[links[i], obstacles[i]]
        at[i] = distance[links[i], obstacles[i]]
    return NearPairs(
        links[:kept], obstacles[:kept], near, at, gradient, rates, acting[:acts], unseen,
        link_at, obstacle_at, clearance[link_at, obstacle_at] if link_at >= 0 else np.inf, least)


class NearAlong(NamedTuple):
    """The pairs of links and obstacles that are near at any of N postures.

    Attributes:
        postures: (p,) indices.
        clearance: (p,) ρ.
        smallest: (p,) what ρ is to be multiplied with for a distance [m].
        gradient: (p, n) ∂ρ/∂q at its posture.
        nearest: the smallest distance of all [m], infinite without obstacles.
    """

    postures: Indices
    clearance: Vector
    smallest: Vector
    gradient: Matrix
    nearest: float


@compiled
def near_pairs_along(
    maps: InflatedEllipsoids, start: Stack, end: Stack, columns: Stack, moves: Matrix,
    times: Vector, within: float,
) -> NearAlong:
    """Return the pairs that are nearer than `within` [m] at postures reached at times (N,) [s].

    Of more than `MOST_AHEAD_PAIRS` the nearest.

    Args:
        maps: the obstacles now.
        start, end: (N, c, 3) the segments [m].
        columns: (N, 6, n) joint screws at the base origin.
        moves: (c, n) 1 where a joint moves a link, else 0.
        times: (N,) from now; the obstacles have moved by then.
        within: [m].
    """
    count, (links, obstacles) = len(times), maps.smallest.shape
    shape = (count, links, obstacles)
    clearance, distance, parameter = np.empty(shape), np.empty(shape), np.empty(shape)
    _link_clearance_along(maps, start, end, times, clearance, distance, parameter)
    found, nearest = 0, np.inf
    for at in range(count):
        for link in range(links):
            for obstacle in range(obstacles):
                nearest = min(nearest, distance[at, link, obstacle])
                found += distance[at, link, obstacle] < within
    if found > MOST_AHEAD_PAIRS:
        within = np.partition(distance.ravel(), MOST_AHEAD_PAIRS)[MOST_AHEAD_PAIRS]
        found = int(np.sum(distance < within))
    near = NearAlong(np.empty(found, np.intp), np.empty(found), np.empty(found),
                     np.empty((found, columns.shape[2])), nearest)
    i = 0
    for at in range(count):
        for link in range(links):
            for obstacle in range(obstacles):
                if distance[at, link, obstacle] < within:
                    near.postures[i] = at
                    near.clearance[i] = clearance[at, link, obstacle]
                    near.smallest[i] = maps.smallest[link, obstacle]
                    _clearance_gradient(
                        maps, link, obstacle, start[at, link], end[at, link],
                        parameter[at, link, obstacle], columns[at], moves[link], times[at],
                        near.gradient[i])
                    i += 1
    return near
