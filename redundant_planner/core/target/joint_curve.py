"""A smooth curve of postures along a polygon: a uniform cubic B-spline.

It begins and ends at the polygon's ends and lies within the polygon's corners: the closer its
control points, the closer it comes to them.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# The polynomials of a span in u: weights of four control points (rows: powers of u).
_BASIS = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0],
                   [-1.0, 3.0, -3.0, 1.0]]) / 6.0
# Most pieces of a polygon: the way of an arm that is found far away takes no longer than others.
_MOST_PIECES = 2000


class JointCurve:
    """A curve of postures over 0 … spans.

    Attributes:
        spans: how many pieces it has.
    """

    def __init__(self, points: Array) -> None:
        """Take control points (k, n), two at least."""
        # One more on either side, mirrored: so the curve reaches the ends, and is straight there.
        points = np.vstack((2.0 * points[:1] - points[1:2], points,
                            2.0 * points[-1:] - points[-2:-1]))
        self.spans = len(points) - 3
        windows = np.lib.stride_tricks.sliding_window_view(points, 4, axis=0)
        self._powers = np.einsum('pk,snk->spn', _BASIS, windows)

    def at(self, u: Array) -> Array:
        """Return the postures (N, n) at parameters (N,)."""
        u = np.asarray(u, dtype=float)
        span = np.minimum(np.maximum(u.astype(np.intp), 0), self.spans - 1)
        x = (u - span)[:, None]
        one, two, three, four = self._powers[span].transpose(1, 0, 2)
        return np.asarray(one + x * (two + x * (three + x * four)))


def resampled(polygon: Array, scaling: Array, spacing: float) -> Array:
    """Return points (k, n) along a polygon (c, n), no further apart than a spacing.

    Of a polygon longer than `_MOST_PIECES` of these, that many pieces are returned.

    Args:
        polygon: its corners, finite and so near that the squares of their distances are.
        scaling: (n,) of the joints' lengths, see `PathJoints`.
        spacing: with joint weights [rad].
    """
    size = float(lengths_along(polygon, scaling)[-1])
    return evenly(polygon, scaling, max(math.ceil(min(size / spacing, _MOST_PIECES)), 4))


def evenly(polygon: Array, scaling: Array, pieces: int) -> Array:
    """Return points (pieces + 1, n) along a polygon (c, n), evenly spaced; see `resampled`."""
    along = lengths_along(polygon, scaling)
    at = np.linspace(0.0, along[-1], pieces + 1)
    return np.stack([np.interp(at, along, column) for column in polygon.T], axis=1)


def lengths_along(polygon: Array, scaling: Array) -> Array:
    """Return how long a polygon (c, n) is up to each corner (c,), with joint weights [rad]."""
    steps = np.diff(polygon, axis=0) / scaling
    return np.concatenate((np.zeros(1), np.cumsum(np.sqrt((steps * steps).sum(axis=1)))))
