"""Distances from segments to shapes, with derivatives by JAX.

The nearest points are found first and held for the derivative: where they are nearest, they
change a distance to second order only (the envelope theorem).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID

# Halvings of an interval: to a thousandth of a micrometre, and to a thousandth of a segment.
_HALVINGS, _THIRDS = 40, 24
_TINY = 1e-12


def capsule_gap(starts, ends, other_starts, other_ends):  # type: ignore
    """Return the distances (k,) of segments to segments, by their ends (k, 3) [m]."""
    along, other, between = ends - starts, other_ends - other_starts, starts - other_starts
    a, e = _dot(along, along), _dot(other, other)
    b, c, f = _dot(along, other), _dot(along, between), _dot(other, between)
    spread = a * e - b * b
    s = jnp.clip(jnp.where(spread > _TINY, (b * f - c * e) / jnp.maximum(spread, _TINY), 0.0),
                 0.0, 1.0)
    t = jnp.clip((b * s + f) / jnp.maximum(e, _TINY), 0.0, 1.0)
    s = jnp.clip((b * t - c) / jnp.maximum(a, _TINY), 0.0, 1.0)
    s, t = jax.lax.stop_gradient(s)[:, None], jax.lax.stop_gradient(t)[:, None]
    return jnp.linalg.norm(between + s * along - t * other, axis=1)


def to_shapes(
    starts: Any, ends: Any, kinds: Sequence[tuple[str, tuple[float, ...]]], centers: Any,
    rotations: Any,
) -> Any:
    """Return the distances (o, c) of shapes to segments by their ends (c, 3); negative inside.

    Args:
        starts, ends: (c, 3) [m].
        kinds: of the o shapes, with their half extents [m].
        centers, rotations: (o, 3), (o, 3, 3) of the shapes.
    """
    gaps = []
    for i, (kind, size) in enumerate(kinds):
        local_starts = (starts - centers[i]) @ rotations[i]
        local_ends = (ends - centers[i]) @ rotations[i]
        gaps.append(_to_shape(local_starts, local_ends, kind, size))
    return jnp.stack(gaps)


def _to_shape(starts, ends, kind, size):  # type: ignore
    """Return the distances (c,) to a shape at the origin; convex along each segment."""
    if kind == CAPSULE or (kind == ELLIPSOID and len(set(size)) == 1):
        reach = jnp.array([0.0, 0.0, size[2] - size[0]])
        one = jnp.broadcast_to(-reach, starts.shape)
        return capsule_gap(starts, ends, one, -one) - size[0]
    distance = {BOX: _box, CYLINDER: _cylinder, ELLIPSOID: _ellipsoid}[kind]

    def at(share):  # type: ignore
        return distance(starts + share[:, None] * (ends - starts), size)

    low, high = jnp.zeros(len(starts)), jnp.ones(len(starts))

    def narrowed(_, ends_of):  # type: ignore
        first, last = ends_of
        third = (last - first) / 3.0
        left = at(first + third) < at(last - third)
        return jnp.where(left, first, first + third), jnp.where(left, last - third, last)

    low, high = jax.lax.fori_loop(0, _THIRDS, narrowed, (low, high))
    return at(jax.lax.stop_gradient(0.5 * (low + high)))


def _box(points, size):  # type: ignore
    return _outside(jnp.abs(points) - jnp.array(size))


def _cylinder(points, size):  # type: ignore
    radius = jnp.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2 + _TINY)
    return _outside(jnp.stack(
        (radius - size[0], jnp.abs(points[:, 2]) - size[2]), axis=1))


def _outside(beyond):  # type: ignore
    """Return the distance by how far (k, axes) a point is beyond each of a shape's faces."""
    out = jnp.maximum(beyond, 0.0)
    square = _dot(out, out)
    outside = jnp.sqrt(jnp.where(square > 0.0, square, 1.0))
    return jnp.where(square > 0.0, outside, beyond.max(axis=1))


def _ellipsoid(points, size):  # type: ignore
    """Return the distance to the nearest point x of the surface: (p − x) ∥ its normal there."""
    axes = jnp.array(size)
    held = jax.lax.stop_gradient(points)
    least = min(size) ** 2

    def beyond(t):  # type: ignore
        share = axes * held / (t[:, None] + axes ** 2)
        return _dot(share, share) - 1.0

    low = jnp.full(len(points), -least + _TINY)
    high = jnp.linalg.norm(held, axis=1) * max(size)

    def halved(_, ends_of):  # type: ignore
        first, last = ends_of
        middle = 0.5 * (first + last)
        outer = beyond(middle) > 0.0
        return jnp.where(outer, middle, first), jnp.where(outer, last, middle)

    low, high = jax.lax.fori_loop(0, _HALVINGS, halved, (low, high))
    root = 0.5 * (low + high)[:, None]
    nearest = jax.lax.stop_gradient(axes ** 2 * held / (root + axes ** 2))
    square = _dot(points - nearest, points - nearest)
    sign = jnp.where(_dot(held / axes, held / axes) > 1.0, 1.0, -1.0)
    return sign * jnp.sqrt(square + _TINY)


def _dot(one, other):  # type: ignore
    return (one * other).sum(axis=-1)
