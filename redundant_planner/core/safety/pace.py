"""How far a tick can lead, and how near an obstacle must be to matter in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.kernels import entry, kernel, Matrix, Vector
from redundant_planner.core.robot.kinematics import way_of_link
from redundant_planner.core.safety.limits import barrier_rate, Limits, stopping_time

Array = npt.NDArray[np.float64]


class Pace(NamedTuple):
    """How far a tick can lead.

    Attributes:
        fastest: (n,) the fastest the joints may move [rad/s, m/s].
        link_speeds: (c,) the fastest any point of a link may then move, Σ |q̇_j| b_j [m/s], with
            the lever arm bounds b.
        rate: share of a clearance that may be used up per second [1/s].
    """

    fastest: Vector
    link_speeds: Vector
    rate: float


@kernel
def pace(
    previous: Vector, limits: Limits, constants: RobotConstants, gain: float, dt: float,
) -> Pace:
    """Return how far a tick can lead from a velocity (n,)."""
    n = len(previous)
    fastest, speeds = np.empty(n), np.zeros(len(constants.lever_arm_bounds))
    for j in range(n):
        fastest[j] = min(abs(previous[j]) + limits.acceleration_max[j] * dt,
                         limits.velocity_max[j])
        for link in range(len(speeds)):
            speeds[link] += constants.lever_arm_bounds[link, j] * fastest[j]
    stop = stopping_time(previous, limits.acceleration_max) + dt
    return Pace(fastest, speeds, barrier_rate(gain, stop, dt))


@entry
def reach(
    previous: Vector, obstacle_speed: float, limits: Limits, constants: RobotConstants,
    gains: Gains, dt: float,
) -> Array:
    """Return how near an obstacle must be to each link to matter in a tick, (c,) [m].

    Args:
        previous: (n,) velocity of the last tick.
        obstacle_speed: of the fastest obstacle [m/s].
        limits, constants, gains: the robot and the parameters.
        dt: [s].
    """
    can = pace(previous, limits, constants, gains.clearance_gain, dt)
    least = max(gains.clearance_influence_distance,
                gains.clearance_evasion_horizon * obstacle_speed)
    return np.maximum((can.link_speeds + obstacle_speed) / can.rate, least)


@kernel
def unseen_distances(
    start: Matrix, end: Matrix, start_then: Matrix, end_then: Matrix, ranges: Vector,
) -> Array:
    """Return how near to a link an obstacle may be that is not looked at, (c,) [m].

    Args:
        start, end: (c, 3) the links' segments [m].
        start_then, end_then, ranges: where and what the range was, see `Surroundings`.
    """
    unseen = ranges.copy()
    for link in range(len(unseen)):
        unseen[link] -= way_of_link(link, start, end, start_then, end_then)
    return unseen


@kernel
def unseen_share(unseen: Vector, can: Pace) -> float:
    """Return the share of the fastest motion that keeps clear of obstacles not looked at.

    A link that moves no faster than `rate` times its distance from one keeps its barrier.

    Args:
        unseen: (c,) how near such an obstacle may be to a link [m].
        can: how far the tick can lead.
    """
    share = 1.0
    for link in range(len(can.link_speeds)):
        if can.rate * unseen[link] < can.link_speeds[link]:
            share = min(share, max(can.rate * unseen[link], 0.0) / can.link_speeds[link])
    return share
