"""How far points and segments are from boxes, cylinders, capsules and half-spaces.

Everything is in the obstacle's own axes and exact: the signed distance d(x) [m] is positive
outside and, inside, minus the way out that is shortest. All of these shapes are convex, so d is a
convex function along a segment y + t a, 0 ≤ t ≤ 1, and has one smallest value there. Outside a
box d² is piecewise quadratic in t with kinks where the segment passes the six planes of its
faces; outside a cylinder likewise at its two planes and its surface. Between two kinks a box
needs one step, a cylinder some.

A capsule is a box without width whose surface lies its radius further out (`inflation.py`).
Ellipsoids are measured otherwise (`clearance.py`).
"""

from __future__ import annotations

import math

import numpy as np

from redundant_planner.core.kernels import compiled, kernel
from redundant_planner.core.obstacles import obstacle
from redundant_planner.core.robot.se3 import Place

# The shapes as compiled code knows them.
ELLIPSOID, BOX, CYLINDER, CAPSULE, HALF_SPACE = map(obstacle.SHAPES.index, (
    obstacle.ELLIPSOID, obstacle.BOX, obstacle.CYLINDER, obstacle.CAPSULE, obstacle.HALF_SPACE))

# A link counts as lying flat over a face between its points that are this much further away than
# the nearest one, at most [m].
FLAT = 0.02
# Most steps towards a nearest point that has no closed form: bisection needs 47, the other some 8.
_STEPS = 60
_CLOSE_ENOUGH = 1e-14
# A point this near to a surface is on it: its direction from there would be round-off [m].
_TOUCHING = 1e-12
# How far along a segment the two sides of its deepest point are looked at.
_ASIDE = 1e-7
_KINKS = 6
_TINY = float(np.finfo(float).tiny)


@kernel
def along(start: Place, way: Place, t: float) -> Place:
    """Return the point at t of a segment, 0 at its start, 1 at the end of its way."""
    return Place(start.x + t * way.x, start.y + t * way.y, start.z + t * way.z)


@kernel
def beyond_faces(shape: int, half: Place, at: Place) -> Place:
    """Return how far a point lies beyond the faces of a box, or of a cylinder (side, 0, ends)."""
    if shape == CYLINDER:
        side = math.sqrt(at.x * at.x + at.y * at.y) - half.x
        # Nothing is ever less beyond than this, so it does not count.
        return Place(side, -np.inf, abs(at.z) - half.z)
    return Place(abs(at.x) - half.x, abs(at.y) - half.y, abs(at.z) - half.z)


@kernel
def signed_distance(shape: int, half: Place, at: Place) -> float:
    """Return how far a point is from the surface of a shape, negative inside [m].

    Args:
        shape: BOX, CYLINDER, CAPSULE or HALF_SPACE.
        half: half extents, of a capsule those of its segment.
        at: the point.
    """
    if shape == HALF_SPACE:
        return at.z
    x, y, z = beyond_faces(shape, half, at)
    inside = max(x, y, z)
    if inside <= 0.0:
        return inside
    x, y, z = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    return math.sqrt(x * x + y * y + z * z)


@kernel
def direction(shape: int, half: Place, at: Place) -> Place:
    """Return the gradient of `signed_distance`, a unit vector: away, inside the shortest way out.

    Where it is not unique, on an axis or between two faces, it is one of them.
    """
    if shape == HALF_SPACE:
        return Place(0.0, 0.0, 1.0)
    x, y, z = beyond_faces(shape, half, at)
    if max(x, y, z) <= _TOUCHING:
        one = Place(0.0, 0.0, 1.0)
        if x >= y and x >= z:
            one = Place(1.0, 0.0, 0.0)
        elif y >= z:
            one = Place(0.0, 1.0, 0.0)
        x, y, z = one
    x, y, z = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    size = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, math.copysign(z / size, at.z)
    if shape != CYLINDER:
        return Place(math.copysign(x, at.x), math.copysign(y, at.y), z)
    radius = math.sqrt(at.x * at.x + at.y * at.y)
    if radius <= _TOUCHING:  # on the axis every way out is as good
        return Place(x, 0.0, z)
    return Place(x * at.x / radius, x * at.y / radius, z)


@kernel
def direction_along(shape: int, half: Place, start: Place, way: Place, t: float) -> Place:
    """Return how the smallest distance of a segment changes as the segment moves, a vector.

    That is `direction` at its nearest point, but where this is deepest inside: there one face is
    the next on the one side and another on the other, and both count by as much as leaves the
    distance unchanged along the segment.

    Args:
        shape, half, start, way: as for `nearest_on_segment`.
        t: where the nearest point is.
    """
    there = along(start, way, t)
    if signed_distance(shape, half, there) > 0.0 or not 0.0 < t < 1.0:
        return direction(shape, half, there)
    one = direction(shape, half, along(start, way, t - _ASIDE))
    other = direction(shape, half, along(start, way, t + _ASIDE))
    falls = one.x * way.x + one.y * way.y + one.z * way.z
    rises = other.x * way.x + other.y * way.y + other.z * way.z
    if not falls < 0.0 < rises:
        return direction(shape, half, there)
    share = rises / (rises - falls)
    rest = 1.0 - share
    return Place(share * one.x + rest * other.x, share * one.y + rest * other.y,
                 share * one.z + rest * other.z)


@kernel
def _slope(shape: int, half: Place, start: Place, way: Place, t: float) -> float:
    """Return half the derivative of the squared distance along a segment, 0 inside [m²]."""
    at = along(start, way, t)
    x, y, z = beyond_faces(shape, half, at)
    ends = math.copysign(max(z, 0.0), at.z) * way.z
    if shape == CYLINDER:
        if x <= 0.0:
            return ends
        return ends + x / (x + half.x) * (at.x * way.x + at.y * way.y)
    return (math.copysign(max(x, 0.0), at.x) * way.x + math.copysign(max(y, 0.0), at.y) * way.y
            + ends)


@kernel
def _passes(half: float, start: float, way: float, side: int) -> float:
    """Return the t at which a coordinate passes one side of a face, NaN for nowhere."""
    # Without width there is nothing to pass: the slope has no kink.
    if way == 0.0 or half == 0.0:
        return np.nan
    return (math.copysign(half, side - 0.5) - start) / way


@kernel
def _kink(shape: int, half: Place, start: Place, way: Place, i: int) -> float:
    """Return the t of one of `_KINKS` places where a segment passes a face; NaN for nowhere."""
    side = i % 2
    if i >= 4:
        return _passes(half.z, start.z, way.z, side)
    if shape != CYLINDER:
        if i >= 2:
            return _passes(half.y, start.y, way.y, side)
        return _passes(half.x, start.x, way.x, side)
    a = way.x * way.x + way.y * way.y
    b = way.x * start.x + way.y * start.y
    squared = b * b - a * (start.x * start.x + start.y * start.y - half.x * half.x)
    if i >= 2 or a <= _TINY or squared < 0.0:
        return np.nan
    return (math.copysign(math.sqrt(squared), side - 0.5) - b) / a


@kernel
def _deepest(shape: int, half: Place, start: Place, way: Place) -> float:
    """Return the t of smallest distance for a segment that reaches inside, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(_STEPS):
        t = 0.5 * (low + high)
        out = direction(shape, half, along(start, way, t))
        if out.x * way.x + out.y * way.y + out.z * way.z <= 0.0:
            low = t
        else:
            high = t
        if high - low <= _CLOSE_ENOUGH:
            break
    # The slope may jump between the two: either is within round-off of the smallest.
    if (signed_distance(shape, half, along(start, way, low))
            <= signed_distance(shape, half, along(start, way, high))):
        return low
    return high


@kernel
def _root(half: Place, start: Place, way: Place, low: float, high: float) -> float:
    """Return where a cylinder's slope is 0, between t where it is below and above (Illinois)."""
    at_low = _slope(CYLINDER, half, start, way, low)
    at_high = _slope(CYLINDER, half, start, way, high)
    t, before = low, 0
    for _ in range(_STEPS):
        t = low - at_low * (high - low) / (at_high - at_low)
        slope = _slope(CYLINDER, half, start, way, t)
        if slope < 0.0:
            # An end that stays twice would hold the next steps back: it counts half.
            low, at_low, at_high = t, slope, at_high * (0.5 if before < 0 else 1.0)
            before = -1
        else:
            high, at_high, at_low = t, slope, at_low * (0.5 if before > 0 else 1.0)
            before = 1
        if high - low <= _CLOSE_ENOUGH or slope == 0.0:
            break
    return t


@compiled
def nearest_on_segment(
    shape: int, half: Place, start: Place, way: Place,
) -> tuple[float, float]:
    """Return the smallest signed distance of a segment [m], and the t where it is.

    Args:
        shape, half: as for `signed_distance`.
        start: where the segment begins.
        way: from there to its end.
    """
    if shape == HALF_SPACE:
        t = 1.0 if way.z < 0.0 else 0.0
        return start.z + t * way.z, t
    # The slope rises from low to high, and its root is between them if it has one.
    low, high = 0.0, 1.0
    at_low = _slope(shape, half, start, way, low)
    at_high = _slope(shape, half, start, way, high)
    for i in range(_KINKS):
        t = _kink(shape, half, start, way, i)
        if low < t < high:
            slope = _slope(shape, half, start, way, t)
            if slope <= 0.0:
                low, at_low = t, slope
            else:
                high, at_high = t, slope
    if at_low >= 0.0:
        t = low
    elif at_high <= 0.0:
        t = high
    else:
        t = low - at_low * (high - low) / (at_high - at_low)
        if shape == CYLINDER:
            t = _root(half, start, way, low, high)
    distance = signed_distance(shape, half, along(start, way, t))
    if distance <= 0.0:
        t = _deepest(shape, half, start, way)
        distance = signed_distance(shape, half, along(start, way, t))
    return distance, t


@compiled
def flat_stretch(
    shape: int, half: Place, start: Place, way: Place, nearest: float,
) -> tuple[float, float]:
    """Return the first and last t of where a segment lies flat over a face.

    That is where it begins, ends or passes an edge, and is no more than `FLAT` further away than
    its nearest point. A link parallel to a face has many nearest points, and the least turn makes
    one or the other end of them the nearest: both have to be looked at. 1 and 0 where there is
    no such stretch.

    Args:
        shape, half, start, way: as for `nearest_on_segment`.
        nearest: the smallest signed distance [m].
    """
    first, last = 1.0, 0.0
    for i in range(_KINKS + 2):
        t = float(i - _KINKS)
        if i < _KINKS:
            t = _kink(shape, half, start, way, i) if shape != HALF_SPACE else np.nan
        if 0.0 <= t <= 1.0 and (
                signed_distance(shape, half, along(start, way, t)) <= nearest + FLAT):
            first, last = min(first, t), max(last, t)
    return first, last


@kernel
def _gap(half: float, start: float, way: float) -> float:
    """Return how far a coordinate keeps beyond a slab all along a segment, negative inside."""
    end = start + way
    if start * end <= 0.0:
        return -half
    return min(abs(start), abs(end)) - half


@kernel
def least_distance(shape: int, half: Place, start: Place, way: Place) -> float:
    """Return a bound on the smallest signed distance of a segment, from below and cheap [m].

    Axis by axis, as if the segment could be nearest in all of them at once.
    """
    if shape == HALF_SPACE:
        return min(start.z, start.z + way.z)
    x, y = _gap(half.x, start.x, way.x), _gap(half.y, start.y, way.y)
    z = _gap(half.z, start.z, way.z)
    inside = max(x, y, z)
    if inside <= 0.0:
        return inside
    x, y, z = max(x, 0.0), max(y, 0.0), max(z, 0.0)
    return math.sqrt(x * x + y * y + z * z)
