"""Which of many obstacles can matter for a while; the rest is not looked at.

A link's `distance` from an obstacle is 1-Lipschitz in its points (`clearance.py`), and no point
of link c moves further than one of its ends s and e. An obstacle that is further from every link
than a range therefore stays out of that link's reach as long as

    max(|s_c − s_c,then|, |e_c − e_c,then|) ≤ range_c − reach_c          for every link c.

So does an obstacle that moves: its velocity counts in the reach, and a scene whose obstacles have
been moved is another scene.

Where there are more obstacles than a tick has time for, it takes those that come into reach first.
The range is then smaller than the reach. The planner slows down so that no link moves further than
that (`safety.pace.unseen_share`).
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
from redundant_planner.core.obstacles.inflation import inflated_obstacles, InflatedObstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.selection import kth_smallest
from redundant_planner.core.obstacles.shapes import ELLIPSOID, HALF_SPACE, least_distance
from redundant_planner.core.robot.kinematics import Kinematics, way_of_link
from redundant_planner.core.robot.se3 import Place

Array = npt.NDArray[np.float64]

# With no more obstacles than this, looking at all of them is as quick.
FEW = 20
# Most obstacles that a tick looks at, and most that the joint paths ahead look at.
MOST_NEAR = 200
MOST_AHEAD = 25
# How much further than needed the search looks, so that its result holds for a while [m].
_EXTRA_RANGE = 0.15
# Where there are too many obstacles, they are chosen anew after this motion of a link [m].
_MOTION_UNTIL_NEXT_CHOICE = 0.01
# The share of either motion that is to be left when it is chosen ahead of time.
_SPARE = 0.5
# A bound from the ball around a shape that may be this much too low is made better [m].
_LOOSE = 0.03
_TINY = float(np.finfo(float).tiny)


class Surroundings(NamedTuple):
    """The obstacles that can matter, and for how long.

    Attributes:
        scene: all obstacles.
        near: (k,) indices of those that can matter in a tick.
        maps: these, inflated.
        nearest: (a,) indices of those that are nearest, or soon can be, for what looks ahead.
        ahead: these, inflated.
        start, end: (c, 3) the links' segments when it was decided [m].
        range: (c,) distance that all others had from each link [m]; infinite if there are none.
        crowded: whether some are left out that were within reach, for there are too many.
    """

    scene: Scene
    near: Indices
    maps: InflatedObstacles
    nearest: Indices
    ahead: InflatedObstacles
    start: Matrix
    end: Matrix
    range: Array
    crowded: bool

    @property
    def complete(self) -> bool:
        """Whether all obstacles are among them."""
        return len(self.near) == len(self.scene.names)

    def hold(
        self, scene: Scene, arm: Kinematics, reach: Array, *, to_spare: bool = False,
    ) -> bool:
        """Return whether no other obstacle can be within reach at a posture.

        Where it is crowded, a little motion makes no difference.

        Args:
            scene: the obstacles now.
            arm: its posture now.
            reach: (c,) how near an obstacle must be to matter [m].
            to_spare: whether that must be so with further motion to spare.
        """
        if scene is not self.scene:
            return False
        return _hold(arm.segment_start, arm.segment_end, self.start, self.end, self.range, reach,
                     self.crowded, _SPARE if to_spare else 0.0)


@compiled
def _hold(
    start: Matrix, end: Matrix, start_then: Matrix, end_then: Matrix, ranges: Vector,
    reach: Vector, crowded: bool, spare: float,
) -> bool:
    """Do what `Surroundings.hold` does, with this share of the motion to spare."""
    for link in range(len(ranges)):
        may = ranges[link] - reach[link] - spare * _EXTRA_RANGE
        if crowded:
            may = (1.0 - spare) * _MOTION_UNTIL_NEXT_CHOICE
        if way_of_link(link, start, end, start_then, end_then) > may:
            return False
    return True


class Kept(NamedTuple):
    """How far the arm keeps from obstacles.

    Attributes:
        radii: (c,) of the links, their margin included [m].
        margin: that [m].
        lead: as for `inflated_obstacles` [s].
        contacts: (c, all obstacles) which pairs may touch; None for no pair.
        moved: (c,) which links a joint moves; None for all.
    """

    radii: Array
    margin: float
    lead: float
    contacts: FlagMatrix | None = None
    moved: Flags | None = None

    def inflated(self, scene: Scene, chosen: Indices | None = None) -> InflatedObstacles:
        """Return obstacles of a scene, inflated."""
        return inflated_obstacles(scene, self.radii, self.lead, chosen, contacts=self.contacts,
                                  margin=self.margin, moved=self.moved)


def everything(scene: Scene, kept: Kept, arm: Kinematics) -> Surroundings:
    """Take all obstacles of a small scene for what can matter, at any posture.

    Args:
        scene: the obstacles.
        kept: how far from them.
        arm: any posture of it.
    """
    maps, every = kept.inflated(scene), np.arange(len(scene.names))
    unbounded = np.full(len(kept.radii), np.inf)
    return Surroundings(scene, every, maps, every, maps, arm.segment_start, arm.segment_end,
                        unbounded, False)


def surroundings(
    scene: Scene, kept: Kept, arm: Kinematics, reach: Array, course: float,
) -> Surroundings:
    """Choose the obstacles that are, or may soon be, within reach of a link.

    The nearest obstacle is always among them. If more than `MOST_NEAR` are within reach, it
    chooses those that are deepest in it.

    Args:
        scene: all obstacles.
        kept: how far from them.
        arm: its posture.
        reach: (c,) how near an obstacle must be to matter [m].
        course: how far ahead obstacles are looked at in their course, at most [s].
    """
    moved = slice(None) if kept.moved is None else kept.moved
    reaches = _Reaches(arm.segment_start[moved], arm.segment_end[moved], kept.radii[moved],
                       reach[moved] + _EXTRA_RANGE, kept.lead)
    near, nearest, beyond = _chosen(
        scene.shapes, scene.centers, scene.rotations, scene.half_extents, scene.speeds, reaches,
        _Wanted(course, MOST_NEAR, MOST_AHEAD))
    ranges = np.full(len(kept.radii), np.inf)
    if len(near) < len(scene.names):
        ranges[moved] = reaches.range + beyond
    return Surroundings(
        scene, near, kept.inflated(scene, near), nearest, kept.inflated(scene, nearest),
        arm.segment_start, arm.segment_end, ranges, beyond < 0.0)


class _Reaches(NamedTuple):
    """The links, and how far from each of them obstacles are looked for.

    Attributes:
        start, end: (c, 3) their segments [m].
        radii: (c,) [m].
        range: (c,) how far from them [m].
        lead: see `inflated_obstacles` [s].
    """

    start: Matrix
    end: Matrix
    radii: Vector
    range: Vector
    lead: float


class _Wanted(NamedTuple):
    """What is to be chosen.

    Attributes:
        course: how far ahead obstacles are looked at in their course [s].
        most: how many of those within range, at most.
        most_ahead: how many of those that are soon nearest, at most.
    """

    course: float
    most: int
    most_ahead: int


@kernel
def _least_distances(
    shapes: Indices, centers: Matrix, half_extents: Matrix, speeds: Vector, links: _Reaches,
) -> tuple[Array, Array, Array]:
    """Return bounds from the centres alone; see `_bounds`, and `_LOOSE` for the third, (k,) each.

    With the distance d of the centre from the segment and the smallest and largest inflated
    semi-axes a and b, the link's `distance` ρ a from an ellipsoid is at least (d / b − 1) a; no
    axes need be turned for it. With m = √(tr A²/3) of the ellipsoid's own semi-axes
    (`inflated_square`), a is at least a₀ + r and b at most b₀ + (b₀/m + m/b₀) r / 2, with nothing
    lost for a ball. Any other shape lies in the ball around its corners.
    """
    count = len(centers)
    x, y, z, short, long, blunt, led, loose = np.empty((8, count))
    for i in range(count):
        a, b, c = half_extents[i]
        squared = a * a + b * b + c * c
        mean = math.sqrt(squared / 3.0)
        x[i], y[i], z[i] = centers[i]
        short[i], long[i], loose[i] = min(a, b, c), max(a, b, c), 0.0
        blunt[i] = 0.5 * (long[i] / mean + mean / long[i])
        if shapes[i] != ELLIPSOID:
            corner = math.sqrt(squared)
            loose[i] = np.inf if shapes[i] == HALF_SPACE else corner - short[i]
            short[i] = long[i] = corner
            blunt[i] = 1.0
        led[i] = links.lead * speeds[i]
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
    return beyond, distance, loose


@kernel
def _axis_by_axis(
    shape: int, center: Vector, rotation: Matrix, half_extents: Vector, grown: float,
    links: _Reaches,
) -> tuple[float, float]:
    """Return an obstacle's bounds by `least_distance`, in its own axes; see `_bounds`.

    Args:
        shape, center, rotation, half_extents: of the obstacle.
        grown: by how much it is larger all round, besides the links' radii [m].
        links: the links.
    """
    beyond, distance = np.inf, np.inf
    half = Place(half_extents[0], half_extents[1], half_extents[2])
    start, way = np.empty(3), np.empty(3)
    for link in range(len(links.start)):
        for axis in range(3):
            start[axis] = way[axis] = 0.0
            for row in range(3):
                begin = links.start[link, row]
                start[axis] += rotation[row, axis] * (begin - center[row])
                way[axis] += rotation[row, axis] * (links.end[link, row] - begin)
        far = least_distance(shape, half, Place(start[0], start[1], start[2]),
                             Place(way[0], way[1], way[2])) - links.radii[link] - grown
        distance = min(distance, far)
        beyond = min(beyond, far - links.range[link])
    return beyond, distance


@kernel
def _smallest(values: Vector, most: int) -> float:
    """Return the largest of so many of the smallest values; infinity if there are no more."""
    if len(values) <= most:
        return float(np.inf)
    return kth_smallest(values, most - 1)


@kernel
def _bounds(
    shapes: Indices, centers: Matrix, rotations: Stack, half_extents: Matrix, speeds: Vector,
    links: _Reaches, wanted: _Wanted,
) -> tuple[Array, Array]:
    """Return bounds of obstacles' distances: how far beyond the range, and how far, (k,) each [m].

    From below, both of them. The ball around a shape reaches no further than `loose` out of the
    ball inside it, which bounds the distance from above. So of many within range only those that
    may be chosen need a better bound, in a crowd of 10 000 a tenth of them.
    """
    beyond, distance, loose = _least_distances(shapes, centers, half_extents, speeds, links)
    deepest, soonest = np.full((2, len(shapes)), np.inf)
    for i in range(len(shapes)):
        if np.isfinite(beyond[i] + loose[i]):
            deepest[i] = beyond[i] + loose[i]
            soonest[i] = distance[i] + loose[i] - wanted.course * speeds[i]
    deep = min(_smallest(deepest, wanted.most), 0.0)
    soon = _smallest(soonest, wanted.most_ahead)
    for i in range(len(shapes)):
        is_wanted = beyond[i] <= deep or (
            beyond[i] <= 0.0 and distance[i] - wanted.course * speeds[i] <= soon)
        if shapes[i] == HALF_SPACE or (loose[i] > _LOOSE and is_wanted):
            further, far = _axis_by_axis(
                shapes[i], centers[i], rotations[i], half_extents[i], links.lead * speeds[i],
                links)
            # The ball around a box may say more than the box's faces, towards an edge of it.
            beyond[i], distance[i] = max(beyond[i], further), max(distance[i], far)
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
    shapes: Indices, centers: Matrix, rotations: Stack, half_extents: Matrix, speeds: Vector,
    links: _Reaches, wanted: _Wanted,
) -> tuple[Indices, Indices, float]:
    """Return which obstacles can be within range of a link, and which are soon nearest.

    And how much further than the range all others are from every link, 0 or less.
    """
    beyond, distance = _bounds(
        shapes, centers, rotations, half_extents, speeds, links, wanted)
    near = 0
    for value in beyond:
        near += not value > 0.0
    cut = 0.0
    if near > wanted.most:
        cut = _smallest(beyond, wanted.most)
    chosen = _up_to(beyond, cut, wanted.most)
    if len(chosen) == 0:
        chosen = _up_to(distance, distance.min(), 1)
    for i in range(len(distance)):
        distance[i] -= wanted.course * speeds[i]
    soon = _smallest(distance, wanted.most_ahead)
    return chosen, _up_to(distance, soon, wanted.most_ahead), cut
