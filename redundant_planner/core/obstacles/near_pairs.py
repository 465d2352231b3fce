"""The pairs of links and obstacles that count: in a tick, and along a joint path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, Matrix, Vector
from redundant_planner.core.obstacles.clearance import (
    clearance_gradient,
    clearance_gradients_of,
    measure,
    measure_along,
)
from redundant_planner.core.obstacles.inflation import InflatedEllipsoids
from redundant_planner.core.robot.kinematics import Chain, KinematicsAlong, Links

Array = npt.NDArray[np.float64]

# Most pairs of links and obstacles that a tick takes gradients of, and most that enter the filter
# as barriers: what bounds a tick's time in a crowd.
MOST_PAIRS = 120
MOST_ACTING = 60
# Most pairs that enter the problem of the joint path ahead.
MOST_AHEAD_PAIRS = 100


class NearPairs(NamedTuple):
    """The pairs of links and obstacles that count in a tick.

    Attributes:
        links, obstacles: (p,) indices.
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


@compiled
def near_pairs(
    ellipsoids: InflatedEllipsoids, arm: Links, speeds: Vector, rate: float,
    influence_distance: float, unseen: Vector,
) -> NearPairs:
    """Return the pairs that are within the influence distance, or whose barrier could act.

    Of too many those that could act soonest: `MOST_PAIRS`, and `MOST_ACTING` of them as barriers.

    Args:
        ellipsoids: the obstacles.
        arm: its links.
        speeds: (c,) the fastest any point of a link may move in this tick [m/s].
        rate: share of a clearance that may be used up per second [1/s].
        influence_distance: [m].
        unseen: (c,) how near to a link obstacles may be that are not among them [m].
    """
    shape = ellipsoids.smallest.shape
    rho, distance, parameter = np.empty(shape), np.empty(shape), np.empty(shape)
    measure(ellipsoids, arm.start, arm.end, 0.0, rho, distance, parameter)
    links, obstacles = np.empty(distance.size, np.intp), np.empty(distance.size, np.intp)
    # How much too far a pair is for its barrier to act [m].
    spare = np.empty(distance.size)
    count, acts, link_at, obstacle_at, least = 0, 0, -1, -1, np.inf
    for link in range(shape[0]):
        for obstacle in range(shape[1]):
            far = distance[link, obstacle]
            if far < least:
                link_at, obstacle_at, least = link, obstacle, far
            inactive = far - (speeds[link] + ellipsoids.speeds[obstacle]) / rate
            if inactive <= 0.0 or far <= influence_distance:
                links[count], obstacles[count], spare[count] = link, obstacle, inactive
                acts += inactive <= 0.0
                count += 1
    widest, urgent = np.inf, np.inf
    if count > MOST_PAIRS:
        widest = np.partition(spare[:count], MOST_PAIRS)[MOST_PAIRS]
    if acts > MOST_ACTING:
        urgent = np.partition(spare[:count], MOST_ACTING)[MOST_ACTING]
    unseen, kept = unseen.copy(), 0
    acting = np.empty(min(acts, MOST_ACTING), np.intp)
    acts = 0
    for i in range(count):
        link, obstacle, inactive = links[i], obstacles[i], spare[i]
        if inactive <= 0.0 and inactive < urgent:
            acting[acts] = kept
            acts += 1
        elif inactive <= 0.0:
            unseen[link] = min(unseen[link], distance[link, obstacle])
        if inactive < widest:
            links[kept], obstacles[kept] = link, obstacle
            kept += 1
    near, at = np.empty(kept), np.empty(kept)
    gradient, rates = np.empty((kept, arm.joint_screws.shape[1])), np.empty(kept)
    clearance_gradients_of(
        ellipsoids, parameter, links[:kept], obstacles[:kept], arm, gradient, rates)
    for i in range(kept):
        near[i] = rho[links[i], obstacles[i]]
        at[i] = distance[links[i], obstacles[i]]
    return NearPairs(
        links[:kept], obstacles[:kept], near, at, gradient, rates, acting[:acts], unseen,
        link_at, obstacle_at, rho[link_at, obstacle_at] if link_at >= 0 else np.inf, least)


class NearAlong(NamedTuple):
    """The pairs of links and obstacles that are near at any of N postures.

    Attributes:
        postures: (p,) indices.
        normalized_distance: (p,) ρ.
        smallest: (p,) what ρ is to be multiplied with for a distance [m].
        gradient: (p, n) ∂ρ/∂q at its posture.
        nearest: the smallest distance of all [m], infinite without obstacles.
    """

    postures: Indices
    normalized_distance: Vector
    smallest: Vector
    gradient: Matrix
    nearest: float


@compiled
def near_pairs_along(
    ellipsoids: InflatedEllipsoids, arms: KinematicsAlong, chain: Chain, times: Vector,
    within: float,
) -> NearAlong:
    """Return the pairs that are nearer than `within` [m] at postures reached at times (N,) [s].

    Of more than `MOST_AHEAD_PAIRS` the nearest.

    Args:
        ellipsoids: the obstacles now.
        arms: at the postures.
        chain: the arm.
        times: (N,) from now; the obstacles have moved by then.
        within: [m].
    """
    count, (links, obstacles) = len(times), ellipsoids.smallest.shape
    shape = (count, links, obstacles)
    rho, distance, parameter = np.empty(shape), np.empty(shape), np.empty(shape)
    measure_along(
        ellipsoids, arms.segment_start, arms.segment_end, times, rho, distance, parameter)
    found, nearest = 0, np.inf
    for at in range(count):
        for link in range(links):
            for obstacle in range(obstacles):
                nearest = min(nearest, distance[at, link, obstacle])
                found += distance[at, link, obstacle] < within
    if found > MOST_AHEAD_PAIRS:
        within = np.partition(distance.ravel(), MOST_AHEAD_PAIRS)[MOST_AHEAD_PAIRS]
        found = int(np.sum(distance < within))
    near = NearAlong(np.empty(found, np.intp), np.empty(found), np.empty(found),
                     np.empty((found, arms.q.shape[1])), nearest)
    i = 0
    for at in range(count):
        arm = Links(arms.segment_start[at], arms.segment_end[at], arms.joint_screws[at],
                    chain.supports)
        for link in range(links):
            for obstacle in range(obstacles):
                if distance[at, link, obstacle] < within:
                    near.postures[i] = at
                    near.normalized_distance[i] = rho[at, link, obstacle]
                    near.smallest[i] = ellipsoids.smallest[link, obstacle]
                    clearance_gradient(
                        ellipsoids, link, obstacle, parameter[at, link, obstacle], times[at],
                        arm, near.gradient[i])
                    i += 1
    return near
