"""What a joint may do in a tick so that the arm can always stop (docs/safety.md)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, entry, kernel, Matrix, Vector

Array = npt.NDArray[np.float64]

# Differences below this are round-off [rad/s, m/s].
TOLERANCE = 1e-9
# Reserve on the stopping distance for gradients that turn while the arm brakes.
_CURVATURE_RESERVE = 1.25


class Limits(NamedTuple):
    """What a joint may do [rad, m; per s; per s²].

    Attributes:
        positions: (2, n) highest, then lowest, a margin taken off.
        velocity_max, acceleration_max: (n,).
        margin: [rad, m], half of which may be used up rather than an acceleration limit
            exceeded; half of the rest where an arm is found inside it.
    """

    positions: Matrix
    velocity_max: Vector
    acceleration_max: Vector
    margin: float


@compiled
def stopping_time(dq: Vector, acceleration_max: Vector) -> float:
    """Return the time in which all joints, slowing in proportion, come to rest [s]."""
    time = 0.0
    for i in range(len(dq)):
        time = max(time, abs(dq[i]) / acceleration_max[i])
    return time


@compiled
def braked(dq: Vector, acceleration_max: Vector, dt: float) -> Array:
    """Return the velocity (n,) a tick later when all joints slow down in proportion.

    Every stage of the filter keeps this way to rest open (docs/safety.md).
    """
    stop = stopping_time(dq, acceleration_max)
    return dq * ((1.0 - dt / stop) if stop > dt else 0.0)


@compiled
def barrier_rate(gain: float, stop: float, dt: float) -> float:
    """Return the share of a clearance that may be used up per second [1/s].

    `gain`, or less if proportional braking within the stopping time T cannot hold that.
    """
    return min(gain, 1.0 / (_CURVATURE_RESERVE * stop / 2.0 + dt))


@kernel
def velocity_bounds(
    q: Vector, previous: Vector, limits: Limits, stop: float, dt: float,
) -> tuple[Array, Array, bool]:
    """Return (lower, upper) joint velocities, (n,) each, from which the arm can always stop.

    Upper bound of a joint with distance d to its limit, at acceleration a:
    - the velocity limit, and previous + a dt;
    - d / (T/2 + dt), the largest speed at which braking the whole arm in proportion stops it
      in time. As T ≥ |q̇_j| / a_j for every joint, the joint alone can brake in time as well.
    The lower bound mirrors it. A joint outside its range may not move further out. Measurements
    are always a little old: an arm found further on than it could be may brake in proportion,
    which keeps its path, as long as that leads no further than half the margin. A joint that
    brakes as hard as it may can use half of what is left of the margin. Where the others ask for
    more than the acceleration limit gives, as after the margin has grown, a joint brakes as hard
    as it may, into the margin if it has to.

    Args:
        q: (n,) positions.
        previous: (n,) velocity of the last tick.
        limits: of the joints.
        stop: stopping time T that the next velocity may have [s].
        dt: [s].

    Returns:
        lower, upper, and whether the acceleration limits leave room for all others.
    """
    n = len(q)
    slowed = braked(previous, limits.acceleration_max, dt)
    bounds, kept = np.empty((2, n)), True
    for side in range(2):
        # Side 0 is the way down, side 1 the way up. First the fastest outwards.
        outward = 2.0 * side - 1.0
        for i in range(n):
            room = (limits.positions[1 - side, i] - q[i]) * outward
            speed = max(room, 0.0) / (stop / 2.0 + dt)
            inside, reach = min(room, 0.0), stop / 2.0 + dt
            half = max(room, 0.0) + max(0.5 * limits.margin + inside, 0.0)
            deep = max(room, 0.0) + 0.5 * max(limits.margin + inside, 0.0)
            hardest = previous[i] * outward - limits.acceleration_max[i] * dt
            speed = max(speed, min(slowed[i] * outward, half / reach),
                        min(hardest, deep / reach))
            bounds[side, i] = outward * min(limits.velocity_max[i], speed)
    for i in range(n):
        slowest, fastest = bounds[0, i], bounds[1, i]
        lower = previous[i] - limits.acceleration_max[i] * dt
        upper = previous[i] + limits.acceleration_max[i] * dt
        if lower > fastest + TOLERANCE:
            room = limits.positions[0, i] + limits.margin - q[i]
            kept, fastest = False, max(fastest, min(lower, room / dt))
        if upper < slowest - TOLERANCE:
            room = q[i] - limits.positions[1, i] + limits.margin
            kept, slowest = False, min(slowest, max(upper, -room / dt))
        bounds[0, i] = max(min(lower, fastest), slowest)
        bounds[1, i] = min(max(upper, slowest), fastest)
    return bounds[0], bounds[1], kept


@entry
def can_stop(q: Vector, dq: Vector, limits: Limits, dt: float) -> bool:
    """Return whether a velocity (n,) is within its limits, and braking from it within the range.

    Args:
        q, dq: (n,) [rad, m; per s].
        limits: of the joints.
        dt: of a tick [s].
    """
    reach = stopping_time(dq, limits.acceleration_max) / 2.0 + dt
    for i in range(len(q)):
        room = limits.positions[0, i] - q[i] if dq[i] > 0.0 else q[i] - limits.positions[1, i]
        if abs(dq[i]) > limits.velocity_max[i] or abs(dq[i]) * reach > max(room, 0.0):
            return False
    return True


@entry
def bounds_of_velocity(
    q: Vector, previous: Vector, limits: Limits, stop: float, dt: float,
) -> tuple[Array, Array, bool]:
    """Do what `velocity_bounds` does, for Python."""
    return velocity_bounds(q, previous, limits, stop, dt)


@compiled
def slowed_limits(
    previous: Vector, velocity_max: Vector, acceleration_max: Vector, share: float, dt: float,
) -> Array:
    """Return velocity limits (n,) of a share of the fastest motion that a tick can reach.

    They are never below the speed that proportional braking leaves.
    """
    limits, still = np.empty(len(previous)), braked(previous, acceleration_max, dt)
    for j in range(len(limits)):
        fastest = min(abs(previous[j]) + acceleration_max[j] * dt, velocity_max[j])
        limits[j] = max(share * fastest, abs(still[j]))
    return limits
