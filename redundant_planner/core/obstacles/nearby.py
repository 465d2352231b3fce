"""Which of many obstacles can matter for a while; the rest is not looked at.

A link's `distance` from an obstacle is 1-Lipschitz in its points (`clearance.py`), and no
point of link c moves further than Σ_j b_cj |Δq_j|, with the lever arm bounds b. An obstacle that
is further from every link than a range therefore stays out of that link's reach as long as

    Σ_j b_cj |q_j − q_j,then| ≤ range_c − reach_c          for every link c.

So does an obstacle that moves: its velocity counts in the reach, and a scene whose obstacles have
been moved is another scene.

Where there are more obstacles than a tick has time for, it takes those that come into reach first.
The range is then smaller than the reach. The planner slows down so that no link moves further than
that (`planner.unseen_share`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, entry, Indices, kernel, Matrix, Vector
from redundant_planner.core.obstacles.inflation import inflated_ellipsoids, InflatedEllipsoids
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.kinematics import Kinematics

Array = npt.NDArray[np.float64]

# With no more obstacles than this, looking at all of them is as quick.
FEW = 20
# Most obstacles that a tick looks at, and most that the joint path ahead and evasion look at.
MOST_NEAR = 200
MOST_AHEAD = 25
# How much further than needed the search looks, so that its result holds for a while [m].
_EXTRA_RANGE = 0.15
# Where there are too many obstacles, they are chosen anew after this motion of a link [m].
_MOTION_UNTIL_NEXT_CHOICE = 0.01
_TINY = float(np.finfo(float).tiny)


class Surroundings(NamedTuple):
    """The obstacles that can matter, and for how long.

    Attributes:
        scene: all obstacles.
        near: (k,) indices of those that can matter in a tick.
        maps: these, inflated.
        nearest: (a,) indices of those that are nearest, or soon can be, for what looks ahead.
        ahead: these, inflated.
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

    def hold(self, scene: Scene, q: Array, lever_arm_bounds: Array, reach: Array) -> bool:
        """Return whether no other obstacle can be within reach at a posture.

        Where it is crowded, a little motion makes no difference.

        Args:
            scene: the obstacles now.
            q: (n,) posture now.
            lever_arm_bounds: (c, n) of the links [m/rad, 1].
            reach: (c,) how near an obstacle must be to matter [m].
        """
        return scene is self.scene and _holds(
            lever_arm_bounds, q, self.q, reach, self.range, self.crowded)


@compiled
def _holds(
    lever_arm_bounds: Matrix, q: Vector, then: Vector, reach: Vector, limits: Vector,
    crowded: bool,
) -> bool:
    """Do what `Surroundings.hold` does, for the scene that it is about."""
    for link in range(len(lever_arm_bounds)):
        way = 0.0
        for j in range(len(q)):
            way += lever_arm_bounds[link, j] * abs(q[j] - then[j])
        if way > _MOTION_UNTIL_NEXT_CHOICE if crowded else reach[link] + way > limits[link]:
            return False
    return True


def everything(scene: Scene, radii: Array, lead: float, q: Array) -> Surroundings:
    """Take all obstacles of a small scene for what can matter, at any posture.

    Args:
        scene: the obstacles.
        radii, lead: as for `inflated_ellipsoids`.
        q: (n,) any posture.
    """
    ellipsoids, every = inflated_ellipsoids(scene, radii, lead), np.arange(len(scene.names))
    unbounded = np.full(len(radii), np.inf)
    return Surroundings(scene, every, ellipsoids, every, ellipsoids, q, unbounded, False)


def surroundings(
    scene: Scene, radii: Array, lead: float, arm: Kinematics, reach: Array, course: float,
) -> Surroundings:
    """Choose the obstacles that are, or may soon be, within reach of a link.

    The nearest obstacle is always among them. If more than `MOST_NEAR` are within reach, it
    chooses those that are deepest in it.

    Args:
        scene: all obstacles.
        radii: (c,) of the links, their margin included [m].
        lead: as for `inflated_ellipsoids` [s].
        arm: its posture.
        reach: (c,) how near an obstacle must be to matter [m].
        course: how far ahead obstacles are looked at in their course, at most [s].
    """
    reaches = _Reaches(arm.segment_start, arm.segment_end, radii, reach + _EXTRA_RANGE, lead)
    near, nearest, beyond = _chosen(
        scene.centers, scene.semi_axes, scene.velocities, reaches, course, MOST_NEAR, MOST_AHEAD)
    if len(near) == len(scene.names):
        reaches.range[:] = np.inf
    return Surroundings(
        scene, near, inflated_ellipsoids(scene, radii, lead, near), nearest,
        inflated_ellipsoids(scene, radii, lead, nearest), arm.q, reaches.range + beyond,
        beyond < 0.0)


class _Reaches(NamedTuple):
    """The links, and how far from each of them obstacles are looked for.

    Attributes:
        start, end: (c, 3) their segments [m].
        radii: (c,) [m].
        range: (c,) how far from them [m].
        lead: see `inflated_ellipsoids` [s].
    """

    start: Matrix
    end: Matrix
    radii: Vector
    range: Vector
    lead: float


@kernel
def _least_distances(
    centers: Matrix, semi_axes: Matrix, velocities: Matrix, links: _Reaches,
) -> tuple[Array, Array]:
    """Return bounds of obstacles' distances: how far beyond the range, and how far, (k,) each [m].

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
        led[i] = links.lead * math.sqrt(a * a + b * b + c * c)
    beyond, distance = np.full(count, np.inf), np.full(count, np.inf)
    for link in range(len(links.start)):
        x1, y1, z1 = links.start[link]
        dx, dy, dz = links.end[link] - links.start[link]
        inverse = 1.0 / max(dx * dx + dy * dy + dz * dz, _TINY)
        radius, limit = links.radii[link], links.range[link]
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


@entry
def _chosen(
    centers: Matrix, semi_axes: Matrix, velocities: Matrix, links: _Reaches, course: float,
    most: int, most_ahead: int,
) -> tuple[Indices, Indices, float]:
    """Return which obstacles can be within range of a link, and which are soon nearest.

    And how much further than the range all others are from every link, 0 or less.
    """
    beyond, distance = _least_distances(centers, semi_axes, velocities, links)
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
