"""How far the arm's links are from each other: capsule against capsule, in closed form."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import (
    compiled,
    IndexPairs,
    Indices,
    kernel,
    Matrix,
    OutStack,
    OutVector,
    Stack,
    Vector,
)
from redundant_planner.core.robot.jacobian import joint_shares
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.links_after import links_after
from redundant_planner.core.robot.se3 import Place, place

Array = npt.NDArray[np.float64]

_TINY = float(np.finfo(float).tiny)
# How often `near_links` returns a pair at most: as seen from here, and from where the arm rests.
MOST_VIEWS = 2


class LinkPairs(NamedTuple):
    """Pairs of links at one posture.

    Attributes:
        distance: (p,) between the surfaces [m], negative where they overlap.
        points: (p, 2, 3) nearest points of the two segments [m].
    """

    distance: Vector
    points: Stack


def link_distances(start: Array, end: Array, radii: Array, links: Indices) -> LinkPairs:
    """Return the distances of pairs of capsules, by the nearest points of their segments.

    Args:
        start, end: (c, 3) segments in the base frame [m].
        radii: (c,) [m].
        links: (p, 2) which links.
    """
    pairs = LinkPairs(np.empty(len(links)), np.empty((len(links), 2, 3)))
    write_link_distances(start, end, radii, links, *pairs)
    return pairs


@kernel
def _clipped(value: float) -> float:
    return min(max(value, 0.0), 1.0)


@kernel
def nearest_parameters(a: float, b: float, c: float, e: float, f: float) -> tuple[float, float]:
    """Return where two segments are nearest to each other: 0 at a start, 1 at an end.

    With d₁, d₂ along the segments and r from the second start to the first, the nearest
    parameters without ends solve a 2 × 2 system; the second is clipped to its segment and the
    first is then the best for it (Ericson, Real-Time Collision Detection, 5.1.9).

    Args:
        a, b, c, e, f: d₁·d₁, d₁·d₂, d₁·r, d₂·d₂ and d₂·r [m²].
    """
    # Parallel segments, and points, have many nearest points: from any s the rest is exact.
    s = _clipped((b * f - c * e) / max(a * e - b * b, _TINY))
    t = _clipped((b * s + f) / max(e, _TINY))
    return _clipped((b * t - c) / max(a, _TINY)), t


@compiled
def write_link_distances(
    start: Matrix, end: Matrix, radii: Vector, links: IndexPairs, distance: OutVector,
    points: OutStack,
) -> None:
    """Write the fields of `LinkPairs`."""
    for pair in range(len(links)):
        one, other = links[pair]
        a, b, c, e, f = 0.0, 0.0, 0.0, 0.0, 0.0  # d₁·d₁, d₁·d₂, d₁·r, d₂·d₂, d₂·r
        for axis in range(3):
            d1 = end[one, axis] - start[one, axis]
            d2 = end[other, axis] - start[other, axis]
            r = start[one, axis] - start[other, axis]
            a, b, c, e, f = a + d1 * d1, b + d1 * d2, c + d1 * r, e + d2 * d2, f + d2 * r
        s, t = nearest_parameters(a, b, c, e, f)
        squared = 0.0
        for axis in range(3):
            points[pair, 0, axis] = start[one, axis] + s * (end[one, axis] - start[one, axis])
            points[pair, 1, axis] = (
                start[other, axis] + t * (end[other, axis] - start[other, axis]))
            squared += (points[pair, 0, axis] - points[pair, 1, axis]) ** 2
        distance[pair] = math.sqrt(squared) - radii[one] - radii[other]


@compiled
def distance_gradients(
    points: Stack, chosen: Indices, joint_screws: Matrix, supports: Matrix,
) -> Array:
    """Return ∂distance/∂q of the chosen pairs, (k, n).

    Along the line between the nearest points, n = gap/|gap|: the first link's point moves by
    n · (v_j + w_j × x), the second's against it. Both points lie on that line, so it is one and
    the same wrench that acts on either link.

    Args:
        points: of the pairs, from `link_distances` [m].
        chosen: (k,) indices into the pairs.
        joint_screws: (6, n) see `Kinematics`.
        supports: (p, n) for every pair, see `SelfPairs`.
    """
    gradient = np.empty((len(chosen), joint_screws.shape[1]))
    for row in range(len(chosen)):
        pair = chosen[row]
        one, other = place(points[pair], 0), place(points[pair], 1)
        x, y, z = one.x - other.x, one.y - other.y, one.z - other.z
        size = max(math.sqrt(x * x + y * y + z * z), 1e-9)
        joint_shares(joint_screws, one, Place(x / size, y / size, z / size), supports[pair],
                     gradient[row])
    return gradient


@kernel
def _way(lever_arm_bounds: Vector, motion: Vector) -> float:
    """Return how far two links can approach each other in a motion (n,) of the joints [m]."""
    total = 0.0
    for j in range(len(motion)):
        total += lever_arm_bounds[j] * motion[j]
    return total


class SelfPairs(NamedTuple):
    """The pairs of links that can collide.

    Attributes:
        radii: (c,) of the links, half the margin included [m].
        links: (p, 2) which links.
        supports: (p, n) 1 where a joint moves the first link alone, −1 where it moves the second
            alone, else 0.
        lever_arm_bounds: (p, n) how fast their distance may fall per unit of joint velocity
            [m/rad, 1].
    """

    radii: Vector
    links: IndexPairs
    supports: Matrix
    lever_arm_bounds: Matrix


class NearLinks(NamedTuple):
    """The pairs of links that may meet in a tick, or where the arm would come to rest.

    Attributes:
        pairs: (k,) which; one may be there `MOST_VIEWS` times, seen from here and from there.
        distance: (k,) [m], 0 for those found closer than their margin; seen from there, what it
            would be here if it changed all the way as it does there.
        gradient: (k, n) of the distance.
    """

    pairs: Indices
    distance: Vector
    gradient: Matrix


@kernel
def _with_rest(
    here: NearLinks, all_here: Vector, arm: Links, pairs: SelfPairs, reach: Vector,
    stopping: Vector,
) -> NearLinks:
    """Return pairs of links, and those again that come nearer while the arm brakes than it seems.

    A distance may turn while the arm brakes, and does so in no time at all where another part of a
    link becomes the nearest. So the distance where the arm would come to rest makes another row.
    Proportional braking leaves that place where it is: what is kept now can be kept until then.

    Args:
        here: the pairs, as seen from here.
        all_here: (p,) distances of all pairs [m].
        arm, pairs, stopping: as for `near_links`.
        reach: (n,) how far the joints may move before a barrier has its way [rad, m].
    """
    if len(here.pairs) == 0:
        return here
    rest = links_after(arm, stopping)
    at_rest, points = np.empty(len(pairs.links)), np.empty((len(pairs.links), 2, 3))
    write_link_distances(rest.start, rest.end, pairs.radii, pairs.links, at_rest, points)
    gradient = distance_gradients(points, here.pairs, rest.joint_screws, pairs.supports)
    distance, chosen = np.empty(len(here.pairs)), np.empty(len(here.pairs), np.intp)
    count = 0
    for i in range(len(here.pairs)):
        pair = here.pairs[i]
        left = at_rest[pair] - min(all_here[pair], 0.0)
        expected, value, way = here.distance[i], left, 0.0
        for j in range(len(stopping)):
            expected += here.gradient[i, j] * stopping[j]
            value -= gradient[i, j] * stopping[j]
            way += abs(gradient[i, j]) * reach[j]
        if left < expected and value < way:
            distance[i], chosen[count] = value, i
            count += 1
    chosen = chosen[:count]
    return NearLinks(
        np.concatenate((here.pairs, here.pairs[chosen])),
        np.concatenate((here.distance, distance[chosen])),
        np.concatenate((here.gradient, gradient[chosen])))


@kernel
def near_links(arm: Links, pairs: SelfPairs, reach: Vector, stopping: Vector) -> NearLinks:
    """Return the pairs whose barrier could act in this tick.

    Links found closer than the margin may stay so; they only may not get closer. Capsules are
    fatter than links, and an arm must not start to move by itself because of it.

    Args:
        arm: its links.
        pairs: which of them can collide.
        reach: (n,) how far the joints may move before a barrier has its way [rad, m].
        stopping: (n,) how far the arm still goes if it brakes in proportion from now on [rad, m].
    """
    count = len(pairs.links)
    here, points = np.empty(count), np.empty((count, 2, 3))
    write_link_distances(arm.start, arm.end, pairs.radii, pairs.links, here, points)
    near, found = np.empty(count, np.intp), 0
    for pair in range(count):
        if here[pair] <= _way(pairs.lever_arm_bounds[pair], reach):
            near[found] = pair
            found += 1
    near = near[:found]
    distance = np.empty(found)
    for i in range(found):
        distance[i] = max(here[near[i]], 0.0)
    gradient = distance_gradients(points, near, arm.joint_screws, pairs.supports)
    return _with_rest(NearLinks(near, distance, gradient), here, arm, pairs, reach, stopping)
