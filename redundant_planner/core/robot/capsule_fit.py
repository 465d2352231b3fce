"""Capsules around bodies: small in volume, and with every point inside by construction.

About an axis with direction d through a point, let z be a body point's place along the axis and
ρ its distance from it. A capsule of radius r ≥ max ρ contains the point if the ends of its
segment, a and b, satisfy a − √(r² − ρ²) ≤ z ≤ b + √(r² − ρ²). The shortest segment is therefore

    b = max (z − √(r² − ρ²)),   a = min (z + √(r² − ρ²))

in closed form, and only the axis and the radius have to be searched for (Nelder and Mead).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, QhullError

Array = npt.NDArray[np.float64]

# Every capsule costs time in every tick. A cut is worth another capsule when it saves this share
# of the volume; two capsules become one when that adds no more than this share. Less volume than
# the third [m³] never counts.
_LEAST_SAVED_SHARE = 0.25
_LARGEST_ADDED_SHARE = 0.1
_NEGLIGIBLE_VOLUME = 1e-4
# A rough guess this much larger than what is allowed is not worth being improved.
_LARGEST_GUESS_RATIO = 1.5
# Where cuts are tried, as shares of the body's extent.
_CUT_SHARES = (0.3, 0.5, 0.7)
# Of the function that the search for the best axis minimises.
_MOST_EVALUATIONS = 800
# What stands still may be covered by capsules that stick out of it this far [m], and by so many.
_LARGEST_OVERHANG, _MOST_PARTS = 0.1, 16
# Bodies thinner than this have no hull with a volume [m].
_LEAST_THICKNESS = 1e-6


class Shape(NamedTuple):
    """A capsule in the frame of its points.

    Attributes:
        start, end: (3,) of the segment [m].
        radius: [m].
    """

    start: Array
    end: Array
    radius: float

    @property
    def volume(self) -> float:
        """[m³]."""
        return float(np.pi * self.radius ** 2 * np.linalg.norm(self.end - self.start)
                     + 4.0 / 3.0 * np.pi * self.radius ** 3)


class Body(NamedTuple):
    """A convex body.

    Attributes:
        corners: (k, 3) [m].
        edges: (e, 2) indices of corners, none for a flat body.
        volume: [m³], 0 for a flat body.
    """

    corners: Array
    edges: npt.NDArray[np.intp]
    volume: float


def convex_hull(points: Array) -> Body:
    """Return the hull of points (k, 3); a flat body keeps all its points."""
    points = np.unique(np.asarray(points, dtype=float), axis=0)
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) < 4 or spread[-1] < _LEAST_THICKNESS:
        return Body(points, np.empty((0, 2), dtype=np.intp), 0.0)
    try:
        hull = ConvexHull(points)
    except QhullError:
        return Body(points, np.empty((0, 2), dtype=np.intp), 0.0)
    rank = np.full(len(points), -1)
    rank[hull.vertices] = np.arange(len(hull.vertices))
    faces = rank[hull.simplices]
    edges = np.unique(np.sort(np.vstack((faces[:, :2], faces[:, 1:], faces[:, ::2])), axis=1),
                      axis=0)
    return Body(points[hull.vertices], edges, float(hull.volume))


def fit_capsule(points: Array, *, improve: bool = True) -> Shape:
    """Return a small capsule around points (k, 3).

    Args:
        points: (k, 3) [m].
        improve: whether the best guesses along the principal axes are improved, or the best of
            them is good enough.
    """
    points = np.asarray(points, dtype=float)
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    size = max(float(np.abs(points - middle).max()), 1e-9)
    scaled = (points - middle) / size
    axes = _principal_axes(scaled)
    guesses = []
    for i in range(3):
        frame = np.array((axes[i - 2], axes[i - 1], axes[i]))
        local = scaled @ frame.T
        center = 0.5 * (local[:, :2].min(axis=0) + local[:, :2].max(axis=0))
        x = np.array((0.0, 0.0, *center, 0.1))
        guesses.append((*_capsule_about(local, x), frame, local, x))
    guesses.sort(key=lambda guess: guess[0])
    volume, shape, frame, *_ = guesses[0]
    for guess, _, about, local, x in guesses if improve else ():
        if guess > _LARGEST_GUESS_RATIO * guesses[0][0]:
            break
        found = minimize(
            lambda x, local=local: _capsule_about(local, x)[0], x, method='Nelder-Mead',
            options={'maxfev': _MOST_EVALUATIONS, 'xatol': 1e-3, 'fatol': 1e-5})
        if found.fun < volume:
            volume, shape = _capsule_about(local, found.x)
            frame = about
    shape = Shape(middle + size * (shape.start @ frame), middle + size * (shape.end @ frame),
                  size * shape.radius)
    # Round-off of the way back must not leave a point outside.
    return shape._replace(radius=max(shape.radius, float(distances(points, shape).max())))


def _principal_axes(points: Array) -> Array:
    """Return the axes (3, 3) along which points (k, 3) spread most, next and least."""
    offset = points - points.mean(axis=0)
    return np.linalg.eigh(offset.T @ offset)[1].T[::-1]


def _capsule_about(points: Array, x: Array) -> tuple[float, Shape]:
    """Return the shortest capsule about an axis near z, and its volume.

    Args:
        points: (k, 3).
        x: (5,) tilt of the axis towards x and y, where it passes z = 0, and the square root of
            the radius's share beyond the smallest one.
    """
    direction = np.array((x[0], x[1], 1.0))
    direction /= np.sqrt(direction @ direction)
    offset = points - np.array((x[2], x[3], 0.0))
    along = offset @ direction
    squared = np.maximum((offset * offset).sum(axis=1) - along * along, 0.0)
    radius = np.sqrt(squared.max()) * (1.0 + x[4] * x[4])
    reach = np.sqrt(np.maximum(radius * radius - squared, 0.0))
    high, low = float((along - reach).max()), float((along + reach).min())
    if high < low:
        high = low = 0.5 * (high + low)
    base = np.array((x[2], x[3], 0.0))
    shape = Shape(base + low * direction, base + high * direction, float(radius))
    return shape.volume, shape


def distances(points: Array, shape: Shape) -> Array:
    """Return the distances (k,) of points (k, 3) from a capsule's segment [m]."""
    along = shape.end - shape.start
    share = np.clip((points - shape.start) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - shape.start - share[:, None] * along, axis=1)


def fit_body(body: Body, most: int = 3) -> list[tuple[Shape, Array]]:
    """Return capsules that cover a convex body together, each with the corners of its part.

    As many as pay off, `most` at most.

    A cut goes through the whole body: both parts get the points where its edges cross the
    plane, so that their hulls, and with them the capsules, leave nothing out.
    """
    whole = fit_capsule(body.corners)
    if most < 2 or not len(body.edges):
        return [(whole, body.corners)]
    best = whole.volume, (body.corners, body.corners[:0])
    for axis in _principal_axes(body.corners):
        heights = body.corners @ axis
        for share in _CUT_SHARES:
            level = heights.min() + share * (heights.max() - heights.min())
            parts = _cut(body, axis, float(level))
            volume = sum(fit_capsule(part, improve=False).volume for part in parts)
            if volume < best[0]:
                best = volume, parts
    if not _pays(best[0], whole.volume):
        return [(whole, body.corners)]
    below, above = map(convex_hull, best[1])
    first = fit_body(below, most - 1)
    cut = first + fit_body(above, most - len(first))
    if not _pays(sum(shape.volume for shape, _ in cut), whole.volume):
        return [(whole, body.corners)]
    return cut


def fit_closely(body: Body) -> list[tuple[Shape, Array]] | None:
    """Return capsules that cover a convex body together and stick out of it by little.

    A link that moves is better kept too far away than not at all. A base stands where the arm
    works: a capsule around a table would take all the room above it.

    Returns:
        As `fit_body`; None if they would stick out too far, or be too many, and of a plate that is
        thinner than they may stick out, unless it is small.
    """
    thin, wide, _ = np.sort(np.ptp(body.corners @ _principal_axes(body.corners).T, axis=0))
    if thin < _LARGEST_OVERHANG and wide > 2.0 * _LARGEST_OVERHANG:
        return None
    # A flat body has no inside: a capsule sticks out of it by its radius at most.
    planes = ConvexHull(body.corners).equations if len(body.edges) else np.zeros((1, 4))
    parts, found = [body], list[tuple[Shape, Array]]()
    while parts:
        part = parts.pop()
        if len(found) + len(parts) >= _MOST_PARTS:
            return None
        capsule = fit_capsule(part.corners)
        ends = np.array((capsule.start, capsule.end))
        outside = float((ends @ planes[:, :3].T + planes[:, 3]).max())
        if outside + capsule.radius <= _LARGEST_OVERHANG:
            found.append((capsule, part.corners))
            continue
        if not len(part.edges):
            return None
        axes = _principal_axes(part.corners)
        heights = part.corners @ axes.T
        longest = int(np.ptp(heights, axis=0).argmax())
        middle = 0.5 * (heights[:, longest].min() + heights[:, longest].max())
        parts += map(convex_hull, _cut(part, axes[longest], float(middle)))
    return found


def _pays(cut: float, whole: float) -> bool:
    """Return whether a body is better covered in parts."""
    return whole - cut > max(_LEAST_SAVED_SHARE * whole, _NEGLIGIBLE_VOLUME)


def _cut(body: Body, normal: Array, level: float) -> tuple[Array, Array]:
    """Return the corners of the parts of a body below and above a plane."""
    heights = body.corners @ normal - level
    start, end = body.edges.T
    crossing = heights[start] * heights[end] < 0.0
    start, end = start[crossing], end[crossing]
    share = (heights[start] / (heights[start] - heights[end]))[:, None]
    points = body.corners[start] + share * (body.corners[end] - body.corners[start])
    return (np.vstack((body.corners[heights <= 0.0], points)),
            np.vstack((body.corners[heights >= 0.0], points)))


def merged(groups: Sequence[tuple[Shape, Array]]) -> list[tuple[Shape, Array, list[int]]]:
    """Make one capsule of two, again and again, where that costs next to nothing.

    Args:
        groups: capsules of one rigid body and the points (k, 3) that each contains.

    Returns:
        Capsules, their points, and which of the given ones each has taken in.
    """
    kept = {i: (shape, points, [i]) for i, (shape, points) in enumerate(groups)}
    guesses: dict[tuple[int, int], float] = {}  # pairs that are still to be tried
    fresh = list(kept)
    while True:
        for i in fresh:
            for j in kept:
                if j != i:
                    pair = min(i, j), max(i, j)
                    points = np.vstack((kept[pair[0]][1], kept[pair[1]][1]))
                    cost = fit_capsule(points, improve=False).volume
                    if (excess := cost - _allowed(kept, pair) * _LARGEST_GUESS_RATIO) < 0.0:
                        guesses[pair] = excess
        if not guesses:
            return list(kept.values())
        pair = min(guesses, key=lambda pair: guesses[pair])
        del guesses[pair]
        points = np.vstack((kept[pair[0]][1], kept[pair[1]][1]))
        shape = fit_capsule(points)
        fresh = []
        if shape.volume <= _allowed(kept, pair):
            members = sorted(kept[pair[0]][2] + kept[pair[1]][2])
            points = convex_hull(points).corners  # the others lie inside any capsule around them
            number = max(kept) + 1
            for i in pair:
                del kept[i]
            guesses = {p: v for p, v in guesses.items() if not set(p) & set(pair)}
            kept[number] = shape, points, members
            fresh = [number]


def _allowed(kept: Mapping[int, tuple[Shape, Array, list[int]]], pair: tuple[int, int]) -> float:
    """Return the largest volume that may take the place of two capsules [m³]."""
    separate = sum(kept[i][0].volume for i in pair)
    return separate + max(_LARGEST_ADDED_SHARE * separate, _NEGLIGIBLE_VOLUME)
