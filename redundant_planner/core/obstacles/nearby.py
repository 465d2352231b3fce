"""Which of many obstacles can matter for a while; the rest is not looked at.

A link's `distance` from an obstacle is 1-Lipschitz in its points (`clearance.py`), and no
point of link c moves further than Σ_j lever_cj |Δq_j|. An obstacle that is further from every link
than a range therefore stays out of that link's reach as long as

    Σ_j lever_cj |q_j − q_j,then| ≤ range_c − reach_c          for every link c.

So does an obstacle that moves: its velocity counts in the reach, and a scene whose obstacles have
been moved is another scene.

Of more obstacles than a tick has time for, those are taken that come into reach first. The range
is then smaller than the reach: the planner slows down so that no link gets further than that
(`planner.unseen_share`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, kernel, Matrix, Vector
from redundant_planner.core.obstacles.clearance import (
    inflated_ellipsoids,
    InflatedEllipsoids,
    Scene,
)

Array = npt.NDArray[np.float64]

# With no more obstacles than this, looking at all of them is as quick.
FEW = 20
# Most obstacles that a tick looks at, and most that the joint path ahead and evasion look at.
MOST_NEAR = 200
MOST_AHEAD = 25
# How much further than needed one looks, so as not to look again soon [m].
_SLACK = 0.15
# Motion of a link after which obstacles are chosen anew where they are too many [m].
_LITTLE = 0.01
_TINY = float(np.finfo(float).tiny)


class Surroundings(NamedTuple):
    """The obstacles that can matter, and for how long.

    Attributes:
        scene: all obstacles.
        near: (k,) indices of those that can matter in a tick.
        maps: theirs.
        nearest: (a,) indices of those that are nearest, or soon can be, for what looks ahead.
        ahead: their maps.
        q: (n,) posture at which it was decided.
        range: (c,) distance that all others had from each link [m]; infinite if there are none.
        crowded: whether some are left out that were within reach, for there are too many.
    """

    scene: Scene
    near: Indices
    maps: InflatedEllipsoids
    nearest: Indices
    ahead: InflatedEllipsoids
    q: Array
    range: Array
    crowded: bool

    @property
    def complete(self) -> bool:
        """Whether all obstacles are among them."""
        return len(self.near) == len(self.scene.names)

    def hold(self, scene: Scene, q: Array, levers: Array, reach: Array) -> bool:
        """Return whether no other obstacle can be within reach at a posture.

        Where it is crowded, a little motion makes no difference.

        Args:
            scene: the obstacles now.
            q: (n,) posture now.
            levers: (c, n) of the links [m/rad, 1].
            reach: (c,) how near an obstacle must be to matter [m].
        """
        return scene is self.scene and _within(
            levers, q, self.q, reach, self.range, self.crowded)


@compiled
def _within(
    levers: Matrix, q: Vector, then: Vector, reach: Vector, limits: Vector, crowded: bool,
) -> bool:
    for link in range(len(levers)):
        way = 0.0
        for j in range(len(q)):
            way += levers[link, j] * abs(q[j] - then[j])
        if way > _LITTLE if crowded else reach[link] + way > limits[link]:
            return False
    return True


def everything(scene: Scene, radii: Array, lead: float, q: Array) -> Surroundings:
    """Take all obstacles of a small scene for what can matter, at any posture.

    Args:
        scene: the obstacles.
        radii, lead: as for `inflated_ellipsoids`.
        q: (n,) any posture.
    """
    maps, every = inflated_ellipsoids(scene, radii, lead), np.arange(len(scene.names))
    return Surroundings(scene, every, maps, every, maps, q, np.full(len(radii), np.inf), False)


def surroundings(
    scene: Scene, radii: Array, lead: float, start: Array, end: Array, q: Array, reach: Array,
    course: float,
) -> Surroundings:
    """Choose the obstacles that are, or may soon be, within reach of a link.

    The nearest one is among them in any case. Of more than `MOST_NEAR` those are chosen that are
    deepest within reach.

    Args:
        scene: all obstacles.
        radii: (c,) of the links, their margin included [m].
        lead: as for `inflated_ellipsoids` [s].
        start, end: (c, 3) the links' segments at the posture [m].
        q: (n,) the posture.
        reach: (c,) how near an obstacle must be to matter [m].
        course: how far ahead obstacles are looked at in their course, at most [s].
    """
    wide = reach + _SLACK
    near, nearest, beyond = _chosen(
        scene.centers, scene.semi_axes, scene.velocities, radii, lead, start, end, wide, course,
        MOST_NEAR, MOST_AHEAD)
    if len(near) == len(scene.names):
        wide[:] = np.inf
    return Surroundings(
        scene, near, inflated_ellipsoids(scene, radii, lead, near), nearest,
        inflated_ellipsoids(scene, radii, lead, nearest), q, wide + beyond, beyond < 0.0)


@kernel
def _least_distances(
    centers: Matrix, semi_axes: Matrix, velocities: Matrix, radii: Vector, lead: float,
    start: Matrix, end: Matrix, wide: Vector,
) -> tuple[Array, Array]:
    """Return bounds of obstacles' distances: how far beyond `wide`, and how far, (k,) each [m].

    With the distance d of the centre from the segment and the smallest and largest inflated
    semi-axes a and b, the link's `distance` ρ a is at least (d / b − 1) a; no axes need be turned
    for it. With m = √(tr A²/3) of the ellipsoid's own semi-axes (`inflated_square`), a is at least
    a₀ + r and b at most b₀ + (b₀/m + m/b₀) r / 2, with nothing lost for a ball.
    """
    count = len(centers)
    x, y, z, short, long, blunt, led = np.empty((7, count))
    for i in range(count):
        a, b, c = semi_axes[i]
        mean = math.sqrt((a * a + b * b + c * c) / 3.0)
        x[i], y[i], z[i] = centers[i]
        short[i], long[i] = min(a, b, c), max(a, b, c)
        blunt[i] = 0.5 * (long[i] / mean + mean / long[i])
        a, b, c = velocities[i]
        led[i] = lead * math.sqrt(a * a + b * b + c * c)
    beyond, distance = np.full(count, np.inf), np.full(count, np.inf)
    for link in range(len(start)):
        x1, y1, z1 = start[link]
        dx, dy, dz = end[link] - start[link]
        inverse = 1.0 / max(dx * dx + dy * dy + dz * dz, _TINY)
        radius, limit = radii[link], wide[link]
        # Without branches, so that it is done for several obstacles at once.
        for i in range(count):
            u, v, w = x[i] - x1, y[i] - y1, z[i] - z1
            t = min(max((u * dx + v * dy + w * dz) * inverse, 0.0), 1.0)
            u, v, w = u - t * dx, v - t * dy, w - t * dz
            inflation = radius + led[i]
            far = math.sqrt(u * u + v * v + w * w) / (long[i] + blunt[i] * inflation) - 1.0
            far *= short[i] + inflation
            distance[i] = min(distance[i], far)
            beyond[i] = min(beyond[i], far - limit)
    for i in range(count):
        if not np.isfinite(distance[i]):  # too large for numbers
            distance[i] = beyond[i] = -np.inf
    return beyond, distance


@kernel
def _up_to(values: Vector, limit: float, most: int) -> Indices:
    """Return the indices of the values below a limit, then of those at it, in their order."""
    below = 0
    for value in values:
        below += value < limit
    ties, found = most - below, 0
    index = np.empty(min(most, len(values)), np.intp)
    for i in range(len(values)):
        if values[i] == limit:
            ties -= 1
        if values[i] < limit or (values[i] == limit and ties >= 0):
            index[found] = i
            found += 1
    return index[:found]


@compiled
def _chosen(
    centers: Matrix, semi_axes: Matrix, velocities: Matrix, radii: Vector, lead: float,
    start: Matrix, end: Matrix, wide: Vector, course: float, most: int, most_ahead: int,
) -> tuple[Indices, Indices, float]:
    """Return which obstacles can be within a distance of a link, and which are soon nearest.

    And how much further than `wide` from every link all others are, 0 or less.
    """
    beyond, distance = _least_distances(
        centers, semi_axes, velocities, radii, lead, start, end, wide)
    near = 0
    for value in beyond:
        near += not value > 0.0
    cut = 0.0
    if near > most:
        cut = np.partition(beyond, most - 1)[most - 1]
    chosen = _up_to(beyond, cut, most)
    if len(chosen) == 0:
        chosen = _up_to(distance, distance.min(), 1)
    limit = np.inf
    for i in range(len(distance)):
        a, b, c = velocities[i]
        distance[i] -= course * math.sqrt(a * a + b * b + c * c)
    if len(distance) > most_ahead:
        limit = np.partition(distance, most_ahead - 1)[most_ahead - 1]
    return chosen, _up_to(distance, limit, most_ahead), cut
