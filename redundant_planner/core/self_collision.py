"""How far the arm's links are from each other: capsule against capsule, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


class LinkPairs(NamedTuple):
    """Pairs of links at one posture.

    Attributes:
        distance: (p,) between the surfaces [m], negative where they overlap.
        first_point, second_point: (p, 3) nearest points of the two segments [m].
    """

    distance: Array
    first_point: Array
    second_point: Array


def link_distances(
    start: Array, end: Array, radii: Array, first: Indices, second: Indices,
) -> LinkPairs:
    """Return the distances of pairs of capsules.

    With d₁, d₂ along the segments and r from the second start to the first, the nearest
    parameters without ends solve a 2 × 2 system; the second is clipped to its segment and the
    first is then the best for it (Ericson, Real-Time Collision Detection, 5.1.9).

    Args:
        start, end: (c, 3) segments in the base frame [m].
        radii: (c,) [m].
        first, second: (p,) which links.
    """
    tiny = np.finfo(float).tiny
    d1, d2 = (end - start)[first], (end - start)[second]
    r = start[first] - start[second]
    a, e, b = _dot(d1, d1), _dot(d2, d2), _dot(d1, d2)
    c, f = _dot(d1, r), _dot(d2, r)
    determinant = a * e - b * b
    # Parallel segments have many nearest points: any will do.
    parallel = determinant <= 1e-12 * a * e
    s = np.where(parallel, 0.0, (b * f - c * e) / np.where(parallel, 1.0, determinant))
    t = _clipped((b * _clipped(s) + f) / np.maximum(e, tiny))
    s = _clipped((b * t - c) / np.maximum(a, tiny))
    first_point = start[first] + s[:, None] * d1
    second_point = start[second] + t[:, None] * d2
    gap = first_point - second_point
    return LinkPairs(np.sqrt(_dot(gap, gap)) - radii[first] - radii[second],
                     first_point, second_point)


def distance_gradients(
    pairs: LinkPairs, chosen: Indices, first: Indices, second: Indices, columns: Array,
    joint_count: Indices,
) -> Array:
    """Return ∂distance/∂q of the chosen pairs, (k, n).

    Along the line between the nearest points, n = gap/|gap|: the first link's point moves by
    n · (v_j + w_j × x), the second's against it. Joints that move both drop out by themselves.

    Args:
        pairs: from `link_distances`.
        chosen: (k,) indices into the pairs.
        first, second: (p,) which links.
        columns: (6, n) joint screws at the base origin.
        joint_count: (c,) number of leading joints that move each link.
    """
    joints = np.arange(columns.shape[1])
    gradient = np.zeros((len(chosen), columns.shape[1]))
    if not len(chosen):
        return gradient
    gap = pairs.first_point[chosen] - pairs.second_point[chosen]
    normal = gap / np.maximum(np.sqrt(_dot(gap, gap)), 1e-9)[:, None]
    for points, links, sign in ((pairs.first_point, first, 1.0),
                                (pairs.second_point, second, -1.0)):
        wrench = np.hstack((normal, np.cross(points[chosen], normal)))
        moved = joints < joint_count[links[chosen]][:, None]
        gradient += sign * np.where(moved, wrench @ columns, 0.0)
    return gradient


def _dot(a: Array, b: Array) -> Array:
    return (a * b).sum(axis=-1)


def _clipped(values: Array) -> Array:
    return np.minimum(np.maximum(values, 0.0), 1.0)
