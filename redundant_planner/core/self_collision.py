"""How far the arm's links are from each other: capsule against capsule, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles import wrenches

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


class LinkPairs(NamedTuple):
    """Pairs of links at one posture.

    Attributes:
        distance: (p,) between the surfaces [m], negative where they overlap.
        points: (p, 2, 3) nearest points of the two segments [m].
    """

    distance: Array
    points: Array


def link_distances(start: Array, end: Array, radii: Array, links: Indices) -> LinkPairs:
    """Return the distances of pairs of capsules.

    With d₁, d₂ along the segments and r from the second start to the first, the nearest
    parameters without ends solve a 2 × 2 system; the second is clipped to its segment and the
    first is then the best for it (Ericson, Real-Time Collision Detection, 5.1.9).

    Args:
        start, end: (c, 3) segments in the base frame [m].
        radii: (c,) [m].
        links: (p, 2) which links.
    """
    tiny = np.finfo(float).tiny
    points = start[links]
    vectors = np.empty((len(links), 3, 3))  # d₁, d₂, r
    vectors[:, :2] = (end - start)[links]
    vectors[:, 2] = points[:, 0] - points[:, 1]
    products = (vectors @ vectors.transpose(0, 2, 1)).reshape(-1, 9).T
    a, b, c, _, e, f = products[:6]
    # Parallel segments, and points, have many nearest points: from any s the rest is exact.
    s = _clipped((b * f - c * e) / np.maximum(a * e - b * b, tiny))
    t = _clipped((b * s + f) / np.maximum(e, tiny))
    s = _clipped((b * t - c) / np.maximum(a, tiny))
    points[:, 0] += s[:, None] * vectors[:, 0]
    points[:, 1] += t[:, None] * vectors[:, 1]
    gap = points[:, 0] - points[:, 1]
    return LinkPairs(
        np.sqrt((gap * gap).sum(axis=1)) - radii[links].sum(axis=1), points)


def distance_gradients(pairs: LinkPairs, chosen: Indices, columns: Array, moves: Array) -> Array:
    """Return ∂distance/∂q of the chosen pairs, (k, n).

    Along the line between the nearest points, n = gap/|gap|: the first link's point moves by
    n · (v_j + w_j × x), the second's against it. Both points lie on that line, so it is one and
    the same wrench that acts on either link.

    Args:
        pairs: from `link_distances`.
        chosen: (k,) indices into the pairs.
        columns: (6, n) joint screws at the base origin.
        moves: (p, n) for every pair, 1 where a joint moves its first link alone, −1 where it
            moves the second alone, else 0.
    """
    points = pairs.points[chosen]
    gap = points[:, 0] - points[:, 1]
    normal = gap / np.maximum(np.sqrt((gap * gap).sum(axis=1)), 1e-9)[:, None]
    return (wrenches(points[:, 0], normal) @ columns) * moves[chosen]


def _clipped(values: Array) -> Array:
    return np.minimum(np.maximum(values, 0.0), 1.0)
