"""Obstacles made larger by the links' radii, so that a link can be treated as a bare segment.

A link is every point within its radius r of a segment. It is as far from an obstacle as its
segment is from obstacle ⊕ ball of radius r. Of an ellipsoid that sum is taken for its
trace-minimal outer ellipsoid, which has the obstacle's axes and the semi-axes
√((1+β) a² + (1+1/β) r²), β = √(3 r² / tr A²). Of other shapes it is what lies within r of them.

The radius contains the margin that a link keeps from obstacles, except where the two may touch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import (
    compiled,
    entry,
    FlagMatrix,
    Flags,
    Indices,
    kernel,
    Matrix,
    Stack,
    Vector,
)
from redundant_planner.core.obstacles.scene import Scene, surface_speeds
from redundant_planner.core.obstacles.shapes import CAPSULE, CYLINDER, ELLIPSOID, HALF_SPACE

Array = npt.NDArray[np.float64]


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


class InflatedObstacles(NamedTuple):
    """The obstacles, larger by the links' radii, as seen from bare segments.

    Links differ in radius, and so every obstacle is inflated once per link. An ellipsoid is
    turned into the unit ball by y = diag(1/a) Rᵀ (x − c). Other shapes are a core, in the
    obstacle's axes Rᵀ (x − c), and what is within some distance of it.

    The obstacles are the last axis of what every pair is measured with: numbers that lie side by
    side are taken several at once.

    Attributes:
        shapes: (k,) as in `Scene`.
        centers: (3, k) c [m].
        rotations: (3, 3, k) R.
        cores: (k, 3) half extents of what is inflated: of a capsule those of its segment [m].
        corners: (k,) radius of the ball around the core [m]; infinite for half-spaces, nothing for
            ellipsoids.
        inflation: (c, k) how far the surface is from the core [m]; nothing for ellipsoids.
        inverse: (c, 3, k) 1 / inflated semi-axes a [1/m]; nothing for other shapes.
        smallest: (c, k) smallest inflated half extent [m].
        may_touch: (c, k) pairs that are found closer than they should be without anything being
            wrong: they may stay so, and only not get closer. The walls of a workspace, and
            contacts that are allowed.
        twists: (6, k) velocities of the centres, and angular velocities, base frame [m/s, rad/s].
        speeds: (k,) the fastest that any point of an obstacle moves [m/s].
        moved: (c,) whether a joint moves the link. No motion of the arm changes how far one that
            stands still is from an obstacle: that counts as infinitely far.
    """

    shapes: Indices
    centers: Matrix
    rotations: Stack
    cores: Matrix
    corners: Vector
    inflation: Matrix
    inverse: Stack
    smallest: Matrix
    may_touch: FlagMatrix
    twists: Matrix
    speeds: Vector
    moved: Flags


class _Growth(NamedTuple):
    """By how much obstacles grow, see `inflated_obstacles`; contacts may be those of no pair."""

    radii: Vector
    lead: float
    contacts: FlagMatrix
    margin: float


_NO_CONTACTS = np.zeros((0, 0), bool)


def inflated_obstacles(
    scene: Scene, radii: npt.ArrayLike, lead: float = 0.0, chosen: Indices | None = None, *,
    contacts: FlagMatrix | None = None, margin: float = 0.0, moved: Flags | None = None,
) -> InflatedObstacles:
    """Inflate a scene's obstacles by the radii of links.

    Args:
        scene: the obstacles.
        radii: (c,) of the links [m].
        lead: obstacles that move are larger all round by their way within this time [s].
        chosen: (k,) indices of the obstacles to take; all if None.
        contacts: (c, all obstacles) which pairs may touch; none if None.
        margin: the part of the radii that these do not keep, nor the lead [m].
        moved: (c,) which links a joint moves, `Robot.moved`; all if None.
    """
    rows = slice(None) if chosen is None else chosen
    shapes = scene.shapes[rows]
    growth = _Growth(
        np.array(radii, dtype=float), lead,
        _NO_CONTACTS if contacts is None else np.array(contacts[:, rows], order='C'), margin)
    inflated = _room_for(len(growth.radii), len(shapes))
    inflated.moved[:] = True if moved is None else moved
    _inflate(shapes, scene.centers[rows], scene.rotations[rows], scene.half_extents[rows],
             scene.velocities[rows], scene.angular_velocities[rows], growth, inflated)
    return inflated


def _room_for(links: int, count: int) -> InflatedObstacles:
    """Return the arrays for so many links and obstacles, for `_inflate`."""
    return InflatedObstacles(
        np.empty(count, np.intp), np.empty((3, count)), np.empty((3, 3, count)),
        np.empty((count, 3)), np.empty(count), np.empty((links, count)),
        np.empty((links, 3, count)), np.empty((links, count)), np.empty((links, count), np.bool_),
        np.empty((6, count)), np.empty(count), np.empty(links, np.bool_))


@entry
def _inflate(
    shapes: Indices, places: Matrix, axes: Stack, half_extents: Matrix, velocities: Matrix,
    angular_velocities: Matrix, growth: _Growth, inflated: InflatedObstacles,
) -> None:
    """Write the inflated obstacles, of the fields of a `Scene`."""
    radii, lead, contacts, margin = growth
    count, links = len(shapes), len(radii)
    cores, inflation, smallest = inflated.cores, inflated.inflation, inflated.smallest
    may_touch, corners, inverse = inflated.may_touch, inflated.corners, inflated.inverse
    centers, rotations, twists = inflated.centers, inflated.rotations, inflated.twists
    inflated.shapes[:], cores[:], grown = shapes, half_extents, np.empty((links, count))
    speeds = surface_speeds(half_extents, velocities, angular_velocities)
    inflated.speeds[:] = speeds
    for i in range(count):
        a, b, c = half_extents[i]
        rounding = 0.0
        if shapes[i] == CAPSULE:
            rounding = a
            cores[i, 0], cores[i, 1], cores[i, 2] = 0.0, 0.0, max(c - a, 0.0)
        a_core, b_core, c_core = cores[i]
        if shapes[i] == CYLINDER:
            b_core = 0.0
        corners[i] = np.inf if shapes[i] == HALF_SPACE else math.sqrt(
            a_core * a_core + b_core * b_core + c_core * c_core)
        for link in range(links):
            may_touch[link, i] = shapes[i] == HALF_SPACE
            grown[link, i] = radii[link] + lead * speeds[i]
            if len(contacts) and contacts[link, i]:
                may_touch[link, i], grown[link, i] = True, max(radii[link] - margin, 0.0)
            inflation[link, i] = grown[link, i] + rounding
            smallest[link, i] = min(a, b, c) + grown[link, i]
    semi_axes = inflated_semi_axes(half_extents, grown)
    for i in range(count):
        for link in range(links):
            a, b, c = semi_axes[link, i]
            if shapes[i] == ELLIPSOID:
                smallest[link, i] = min(a, b, c)
            inverse[link, 0, i], inverse[link, 1, i], inverse[link, 2, i] = 1 / a, 1 / b, 1 / c
        for axis in range(3):
            centers[axis, i] = places[i, axis]
            twists[axis, i], twists[3 + axis, i] = velocities[i, axis], angular_velocities[i, axis]
            for other in range(3):
                rotations[axis, other, i] = axes[i, axis, other]
