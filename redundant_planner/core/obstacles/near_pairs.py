"""The pairs of links and obstacles that count: in a tick, and along a joint path."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, kernel, Matrix, OutMatrix, Vector
from redundant_planner.core.obstacles.clearance import (
    bound_by_balls,
    core_of,
    is_contact,
    measure,
    measure_unless,
    Pairs,
    PairsAlong,
    segment_in_axes,
)
from redundant_planner.core.obstacles.clearance_gradients import (
    clearance_gradient,
    clearance_gradients_of,
)
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.obstacles.selection import kth_smallest
from redundant_planner.core.obstacles.shapes import along, ELLIPSOID, flat_stretch, signed_distance
from redundant_planner.core.robot.kinematics import Chain, KinematicsAlong, Links, way_of_link
from redundant_planner.core.robot.se3 import place

Array = npt.NDArray[np.float64]

# Most pairs of links and obstacles that a tick takes gradients of, and most that enter the filter
# as barriers: what bounds a tick's time in a crowd.
MOST_PAIRS = 120
MOST_ACTING = 60
# Most pairs that enter the problem of the joint path ahead.
MOST_AHEAD_PAIRS = 100
# How much more than the gradient says a motion may use up, as points move in arcs.
_ARCS = 1.2
# Points of a link count by themselves if they are further apart than this [m].
_APART = 0.01


class NearPairs(NamedTuple):
    """The pairs of links and obstacles that count in a tick.

    Attributes:
        links, obstacles: (p,) indices.
        parameter: (p,) where on the links, 0 at a segment's start, 1 at its end.
        normalized_distance: (p,) ρ.
        distance: (p,) not more than the true distance [m].
        gradient: (p, n) ∂ρ/∂q.
        rate: (p,) ∂ρ/∂t from the obstacles' own motion [1/s].
        acting: (a,) which of them have a barrier that could act in this tick.
        unseen: (c,) no pair of a link that is left out is nearer than this [m].
        nearest_link, nearest_obstacle: the pair of smallest distance, −1 without obstacles.
        nearest_normalized_distance, nearest_distance: its ρ, and its distance [m].
    """

    links: Indices
    obstacles: Indices
    parameter: Vector
    normalized_distance: Vector
    distance: Vector
    gradient: Matrix
    rate: Vector
    acting: Indices
    unseen: Vector
    nearest_link: int
    nearest_obstacle: int
    nearest_normalized_distance: float
    nearest_distance: float


class _Candidates(NamedTuple):
    """Points of links that may count in a tick.

    Attributes:
        links, obstacles: (p,) indices of the pairs; a pair may be there several times.
        parameter: (p,) where on the link.
        normalized_distance: (p,) ρ there.
        spare: (p,) how much too far the point is for its barrier to act [m].
    """

    links: Indices
    obstacles: Indices
    parameter: Vector
    normalized_distance: Vector
    spare: Vector


@kernel
def _add(
    found: _Candidates, at: int, link: int, obstacle: int, t: float, rho: float, spare: float,
) -> int:
    """Write a candidate and return the next place."""
    found.links[at], found.obstacles[at], found.parameter[at] = link, obstacle, t
    found.normalized_distance[at], found.spare[at] = rho, spare
    return at + 1


@compiled
def _add_stretch(
    found: _Candidates, at: int, candidate: int, obstacles: InflatedObstacles, arm: Links,
) -> int:
    """Write the ends of the stretch over which a candidate's link is flat over a face.

    Args:
        found, at: where to, from which place on.
        candidate: which.
        obstacles, arm: as for `near_pairs`.

    Returns:
        The next place.
    """
    link, obstacle = found.links[candidate], found.obstacles[candidate]
    nearest, inflation = found.parameter[candidate], obstacles.inflation[link, obstacle]
    smallest = obstacles.smallest[link, obstacle]
    core, shape = core_of(obstacles, obstacle), obstacles.shapes[obstacle]
    start, way = segment_in_axes(
        obstacles, obstacle, 0.0, place(arm.start, link), place(arm.end, link))
    length = math.sqrt(way.x * way.x + way.y * way.y + way.z * way.z)
    least = signed_distance(shape, core, along(start, way, nearest))
    ends = flat_stretch(shape, core, start, way, least)
    for t in ends:
        if abs(t - nearest) * length > _APART and ends[0] <= ends[1]:
            distance = signed_distance(shape, core, along(start, way, t))
            at = _add(found, at, link, obstacle, t, (distance - inflation) / smallest,
                      found.spare[candidate] + distance - least)
    return at


@kernel
def _candidates(
    obstacles: InflatedObstacles, arm: Links, pairs: Pairs, speeds: Vector, rate: float,
    influence_distance: float,
) -> tuple[_Candidates, int, int, int]:
    """Return the points that may count, how many they are, and the nearest link and obstacle.

    Pairs that may touch only bound the motion: the arm need not keep far from them, and nobody
    asks for the nearest one.
    """
    links, count = obstacles.smallest.shape
    # With both ends of a stretch.
    most = links * count * (3 if np.any(obstacles.shapes != ELLIPSOID) else 1)
    found = _Candidates(np.empty(most, np.intp), np.empty(most, np.intp), np.empty(most),
                        np.empty(most), np.empty(most))
    at, link_at, obstacle_at, least = 0, -1, -1, np.inf
    for link in range(links):
        for obstacle in range(count):
            far = pairs.distance[link, obstacle]
            if far < least and not obstacles.may_touch[link, obstacle]:
                link_at, obstacle_at, least = link, obstacle, far
            room = (speeds[link] + obstacles.speeds[obstacle]) / rate
            if far <= room or (
                    far <= influence_distance and not obstacles.may_touch[link, obstacle]):
                at = _add(found, at, link, obstacle, pairs.parameter[link, obstacle],
                          pairs.normalized_distance[link, obstacle], far - room)
    # No point of a stretch is nearer than the nearest one.
    widest = kth_smallest(found.spare[:at], MOST_PAIRS) if at > MOST_PAIRS else np.inf
    for candidate in range(at):
        if found.spare[candidate] < widest and (
                obstacles.shapes[found.obstacles[candidate]] != ELLIPSOID):
            at = _add_stretch(found, at, candidate, obstacles, arm)
    return found, at, link_at, obstacle_at


@compiled
def near_pairs(
    obstacles: InflatedObstacles, arm: Links, fastest: Vector, speeds: Vector, rate: float,
    influence_distance: float, unseen: Vector,
) -> NearPairs:
    """Return the pairs that are within the influence distance, or whose barrier could act.

    Of too many those that could act soonest: `MOST_PAIRS`, and `MOST_ACTING` of them as barriers.
    A link that lies flat over a face of an obstacle counts with both ends of that stretch, too.

    Args:
        obstacles: the obstacles.
        arm: its links.
        fastest: (n,) speeds of the joints in this tick [rad/s, m/s].
        speeds: (c,) the fastest any point of a link may move with these [m/s].
        rate: share of a clearance that may be used up per second [1/s].
        influence_distance: [m].
        unseen: (c,) how near to a link obstacles may be that are not among them [m].
    """
    shape = obstacles.smallest.shape
    pairs = Pairs(np.empty(shape), np.empty(shape), np.empty(shape))
    approach, fastest_link = 0.0, 0.0
    for speed in obstacles.speeds:
        approach = max(approach, speed)
    for speed in speeds:
        fastest_link = max(fastest_link, speed)
    measure(obstacles, arm.start, arm.end, 0.0,
            max(influence_distance, (fastest_link + approach) / rate), pairs)
    found, count, link_at, obstacle_at = _candidates(
        obstacles, arm, pairs, speeds, rate, influence_distance)
    spare = found.spare
    widest = kth_smallest(spare[:count], MOST_PAIRS) if count > MOST_PAIRS else np.inf
    unseen, kept = unseen.copy(), 0
    for i in range(count):
        link, obstacle = found.links[i], found.obstacles[i]
        if spare[i] < widest:
            found.links[kept], found.obstacles[kept] = link, obstacle
            found.parameter[kept], found.spare[kept] = found.parameter[i], spare[i]
            found.normalized_distance[kept] = found.normalized_distance[i]
            kept += 1
        elif spare[i] <= 0.0:
            unseen[link] = min(unseen[link], found.normalized_distance[i]
                               * obstacles.smallest[link, obstacle])
    gradient, rates = np.empty((kept, arm.joint_screws.shape[1])), np.empty(kept)
    links, chosen = found.links[:kept], found.obstacles[:kept]
    clearance_gradients_of(
        obstacles, links, chosen, found.parameter[:kept], arm, gradient, rates)
    rho, distance = found.normalized_distance[:kept], np.empty(kept)
    for i in range(kept):
        distance[i] = rho[i] * obstacles.smallest[links[i], chosen[i]]
        if spare[i] <= 0.0 and obstacles.speeds[chosen[i]] == 0.0:
            # Towards a thing at rest a link may be slower than its fastest point.
            used = 0.0
            for j in range(len(fastest)):
                used += abs(gradient[i, j]) * fastest[j]
            spare[i] = distance[i] - _ARCS * used / rate * obstacles.smallest[links[i], chosen[i]]
    acts = int(np.sum(spare[:kept] <= 0.0))
    urgent = kth_smallest(spare[:kept], MOST_ACTING) if acts > MOST_ACTING else np.inf
    acting = np.empty(min(acts, MOST_ACTING), np.intp)
    acts = 0
    for i in range(kept):
        if spare[i] <= 0.0 and spare[i] < urgent:
            acting[acts] = i
            acts += 1
        elif spare[i] <= 0.0:
            unseen[links[i]] = min(unseen[links[i]], distance[i])
    near, least = np.inf, np.inf
    if link_at >= 0:
        near = pairs.normalized_distance[link_at, obstacle_at]
        least = pairs.distance[link_at, obstacle_at]
    return NearPairs(links, chosen, found.parameter[:kept], rho, distance, gradient, rates,
                     acting[:acts], unseen, link_at, obstacle_at, near, least)


@kernel
def kept_apart(
    near: NearPairs, obstacles: InflatedObstacles,
) -> tuple[Vector, Vector, Matrix]:
    """Return ρ (p,), distance (p,) and gradient (p, n) without the pairs that may touch."""
    kept = np.empty(len(near.obstacles), np.intp)
    count = 0
    for i in range(len(kept)):
        if not obstacles.may_touch[near.links[i], near.obstacles[i]]:
            kept[count] = i
            count += 1
    if count == len(kept):
        return near.normalized_distance, near.distance, near.gradient
    chosen = kept[:count]
    return near.normalized_distance[chosen], near.distance[chosen], near.gradient[chosen]


class NearAlong(NamedTuple):
    """The pairs of links and obstacles that are near at any of N postures.

    Attributes:
        postures: (p,) indices.
        normalized_distance: (p,) ρ.
        smallest: (p,) what ρ is to be multiplied with for a distance [m].
        gradient: (p, n) ∂ρ/∂q at its posture.
        nearest: the smallest distance of all [m], infinite without obstacles.
        nearest_link, nearest_obstacle: whose it is, −1 without obstacles.
    """

    postures: Indices
    normalized_distance: Vector
    smallest: Vector
    gradient: Matrix
    nearest: float
    nearest_link: int
    nearest_obstacle: int


@kernel
def _bound_after(
    before: Matrix, arms: KinematicsAlong, at: int, ways: Vector, distance: OutMatrix,
) -> None:
    """Raise what bounds (c, k) distances from below to what the posture before tells of them.

    A distance falls by no more than the link's ends and the obstacle move.

    Args:
        before: (c, k) what their distances were at least [m].
        arms, at: the postures, and which of them it is.
        ways: (k,) how far the obstacles move in between [m].
        distance: (c, k) raised [m].
    """
    for link in range(len(before)):
        way = way_of_link(link, arms.segment_start[at], arms.segment_end[at],
                          arms.segment_start[at - 1], arms.segment_end[at - 1])
        for obstacle in range(len(ways)):
            distance[link, obstacle] = max(
                distance[link, obstacle], before[link, obstacle] - way - ways[obstacle])


@compiled
def near_pairs_along(
    obstacles: InflatedObstacles, arms: KinematicsAlong, chain: Chain, times: Vector,
    within: float,
) -> NearAlong:
    """Return the pairs that are nearer than `within` [m] at postures reached at times (N,) [s].

    Of more than `MOST_AHEAD_PAIRS` the nearest. Contacts that are allowed are none of a plan's:
    one that is deep already would keep it from ever being free.

    Args:
        obstacles: the obstacles now.
        arms: at the postures.
        chain: the arm.
        times: (N,) from now; the obstacles have moved by then.
        within: [m].
    """
    count, (links, k) = len(times), obstacles.smallest.shape
    shape = (count, links, k)
    pairs = PairsAlong(np.empty(shape), np.empty(shape), np.empty(shape))
    distance = pairs.distance
    found, nearest, nearest_link, nearest_obstacle = 0, np.inf, -1, -1
    for at in range(count):
        bound_by_balls(
            obstacles, arms.segment_start[at], arms.segment_end[at], times[at], distance[at])
        if at > 0:
            ways = obstacles.speeds * (times[at] - times[at - 1])
            _bound_after(distance[at - 1], arms, at, ways, distance[at])
        measure_unless(
            obstacles, arms.segment_start[at], arms.segment_end[at], times[at], within, Pairs(
                pairs.normalized_distance[at], distance[at], pairs.parameter[at]))
        for link in range(links):
            for obstacle in range(k):
                if distance[at, link, obstacle] >= max(within, nearest):
                    continue
                if is_contact(obstacles, link, obstacle):
                    distance[at, link, obstacle] = np.inf
                if distance[at, link, obstacle] < nearest:
                    nearest = distance[at, link, obstacle]
                    nearest_link, nearest_obstacle = link, obstacle
                found += distance[at, link, obstacle] < within
        # What is beyond the nearest so far is beyond the nearest of all: a bound will do for it.
        # Selecting them after 1, 2, 4, … postures costs little.
        if found > MOST_AHEAD_PAIRS and (at & (at + 1) == 0 or at + 1 == count):
            seen = distance[:at + 1].ravel()
            within = kth_smallest(seen, MOST_AHEAD_PAIRS)
            found = int(np.sum(seen < within))
    near = NearAlong(np.empty(found, np.intp), np.empty(found), np.empty(found),
                     np.empty((found, arms.q.shape[1])), nearest, nearest_link,
                     nearest_obstacle)
    i = 0
    for at in range(count):
        arm = Links(arms.segment_start[at], arms.segment_end[at], arms.joint_screws[at],
                    chain.supports, chain.parents)
        for link in range(links):
            for obstacle in range(k):
                if distance[at, link, obstacle] < within:
                    near.postures[i] = at
                    near.normalized_distance[i] = pairs.normalized_distance[at, link, obstacle]
                    near.smallest[i] = obstacles.smallest[link, obstacle]
                    clearance_gradient(
                        obstacles, link, obstacle, pairs.parameter[at, link, obstacle],
                        times[at], arm, near.gradient[i])
                    i += 1
    return near
