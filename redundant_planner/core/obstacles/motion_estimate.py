"""Obstacles as they were last seen, and how fast they move: as is said, or by their positions."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, kernel, Matrix, Stack, Vector
from redundant_planner.core.obstacles.shapes import ELLIPSOID

Array = npt.NDArray[np.float64]

# Faster apparent motion is a teleport: the obstacle was moved, it does not move [m/s].
TELEPORT_SPEED = 3.0
# Likewise for turning: what names its axes differently from one time to the next [rad/s].
TELEPORT_TURN = 6.0
# Stamps closer to each other belong to one measurement: noise divided by less is any velocity [s].
SHORTEST_STEP = 1e-3
# Without an update for this long an obstacle counts as static; a stamp older than the last one by
# more comes from a clock that was set back [s].
STATIC_AFTER = 0.3


class Tracks(NamedTuple):
    """The k obstacles that are known; `take_in` writes into the arrays.

    Attributes:
        centers: (k, 3) in the base frame [m]; NaN before the first sighting.
        rotations: (k, 3, 3) the obstacles' axes in the base frame.
        shapes: (k,) as in `Scene`.
        half_extents: (k, 3) [m].
        velocities: (k, 3) of the centres [m/s].
        angular_velocities: (k, 3) about the centres [rad/s].
        stamps: (k,) of the latest measurement [s]; −∞ before the first.
        heard: (k,) when the latest message came [s].
        expiry: (k,) when they end [s]: ∞ for never, −∞ for those that were removed.
    """

    centers: Matrix
    rotations: Stack
    shapes: Indices
    half_extents: Matrix
    velocities: Matrix
    angular_velocities: Matrix
    stamps: Vector
    heard: Vector
    expiry: Vector


class Sightings(NamedTuple):
    """What one message says of obstacles, in its order.

    Attributes:
        rows: (j,) the obstacles' rows in `Tracks`; a row may appear several times.
        removed: (j,) 1 where the obstacle is removed, else 0.
        centers: (j, 3) in the base frame [m].
        rotations: (j, 3, 3).
        shapes: (j,) as in `Scene`.
        half_extents: (j, 3) [m].
        stamps: (j,) when they were measured [s]; 0 where that is not known.
        lifetimes: (j,) [s]; 0 for unlimited.
        twists: (j, 6) velocities and angular velocities where they are known, else NaN [m/s,
            rad/s]; (0, 6) if none is.
    """

    rows: Indices
    removed: Indices
    centers: Matrix
    rotations: Stack
    shapes: Indices
    half_extents: Matrix
    stamps: Vector
    lifetimes: Vector
    twists: Matrix


def unseen(count: int) -> Tracks:
    """Return tracks of `count` obstacles that nobody has seen yet."""
    return Tracks(
        np.full((count, 3), np.nan), np.zeros((count, 3, 3)), np.zeros(count, np.intp),
        np.ones((count, 3)), np.zeros((count, 3)), np.zeros((count, 3)), np.full(count, -np.inf),
        np.zeros(count), np.full(count, np.inf))


def appended(tracks: Tracks, more: int) -> Tracks:
    """Return tracks with room for so many obstacles more."""
    fields: list[Any] = [np.concatenate(both) for both in zip(tracks, unseen(more))]
    return Tracks(*fields)


def kept(tracks: Tracks, keep: npt.NDArray[np.bool_]) -> Tracks:
    """Return the tracks that are marked (k,)."""
    fields: list[Any] = [field[keep] for field in tracks]
    return Tracks(*fields)


def forget(tracks: Tracks) -> None:
    """Make all obstacles look as if nobody had seen them, but keep their places."""
    tracks.centers[:], tracks.stamps[:] = np.nan, -np.inf
    tracks.velocities[:] = tracks.angular_velocities[:] = 0.0


def _moves(tracks: Tracks) -> npt.NDArray[np.bool_]:
    """Return which obstacles move or turn (k,)."""
    return np.asarray(tracks.velocities.any(axis=1) | tracks.angular_velocities.any(axis=1))


def stop_silent(tracks: Tracks, now: float) -> bool:
    """Stop the obstacles without an update for `STATIC_AFTER`; return whether there are any."""
    silent = (now - tracks.heard > STATIC_AFTER) & _moves(tracks)
    tracks.velocities[silent] = tracks.angular_velocities[silent] = 0.0
    return bool(silent.any())


def next_change(tracks: Tracks) -> float:
    """Return when an obstacle ends or counts as static, at the earliest [s]; ∞ for never."""
    moving = tracks.heard[_moves(tracks)]
    return min(float(tracks.expiry.min(initial=np.inf)),
               float(moving.min(initial=np.inf)) + STATIC_AFTER + 1e-6)


@kernel
def _is_ball(sightings: Sightings, i: int) -> bool:
    """Return whether an obstacle looks the same from everywhere: its turning means nothing."""
    a, b, c = sightings.half_extents[i]
    return sightings.shapes[i] == ELLIPSOID and a == b == c


@kernel
def _turn(before: Matrix, after: Matrix) -> Array:
    """Return the rotation vector (3,) from one rotation matrix to another [rad].

    Near half a turn its direction means nothing; no obstacle turns that fast.
    """
    turn, trace = np.empty(3), 0.0
    relative = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                relative[i, j] += after[i, k] * before[j, k]
        trace += relative[i, i]
    turn[0] = 0.5 * (relative[2, 1] - relative[1, 2])
    turn[1] = 0.5 * (relative[0, 2] - relative[2, 0])
    turn[2] = 0.5 * (relative[1, 0] - relative[0, 1])
    sine, cosine = math.sqrt(np.sum(turn * turn)), 0.5 * (trace - 1.0)
    return turn * (math.atan2(sine, cosine) / sine if sine > 0.0 else 1.0)


@kernel
def _estimate(tracks: Tracks, sightings: Sightings, i: int, elapsed: float) -> bool:
    """Estimate a velocity; return whether it changed.

    Args:
        tracks, sightings: as in `take_in`.
        i: the sighting.
        elapsed: since the last measurement [s]; ∞ where that means nothing: the velocity is 0.
    """
    row, squared = sightings.rows[i], 0.0
    for axis in range(3):
        squared += ((sightings.centers[i, axis] - tracks.centers[row, axis]) / elapsed) ** 2
    # NaN where it was never seen before: it counts as static.
    moves = squared < TELEPORT_SPEED ** 2
    changed = False
    turn = np.zeros(3)
    if moves and not _is_ball(sightings, i):
        turn = _turn(tracks.rotations[row], sightings.rotations[i])
        if not np.sum(turn * turn) < (TELEPORT_TURN * elapsed) ** 2:
            turn[:] = 0.0
    for axis in range(3):
        step = sightings.centers[i, axis] - tracks.centers[row, axis]
        speed = step / elapsed if moves else 0.0
        rate = turn[axis] / elapsed
        changed = (changed or speed != tracks.velocities[row, axis]
                   or rate != tracks.angular_velocities[row, axis])
        tracks.velocities[row, axis], tracks.angular_velocities[row, axis] = speed, rate
    return changed


@kernel
def _set_twist(tracks: Tracks, row: int, twist: Vector) -> bool:
    """Write a twist (6,) into a track; return whether it changed."""
    changed = False
    for axis in range(3):
        changed = (changed or twist[axis] != tracks.velocities[row, axis]
                   or twist[3 + axis] != tracks.angular_velocities[row, axis])
        tracks.velocities[row, axis] = twist[axis]
        tracks.angular_velocities[row, axis] = twist[3 + axis]
    return changed


@kernel
def _copy_shape(tracks: Tracks, sightings: Sightings, i: int) -> bool:
    """Copy place, axes and size of sighting i into its track; return whether any is new."""
    row = sightings.rows[i]
    changed = sightings.shapes[i] != tracks.shapes[row]
    tracks.shapes[row] = sightings.shapes[i]
    for axis in range(3):
        changed = (changed or sightings.centers[i, axis] != tracks.centers[row, axis]
                   or sightings.half_extents[i, axis] != tracks.half_extents[row, axis])
        tracks.centers[row, axis] = sightings.centers[i, axis]
        tracks.half_extents[row, axis] = sightings.half_extents[i, axis]
        for other in range(3):
            changed = (changed or sightings.rotations[i, axis, other]
                       != tracks.rotations[row, axis, other])
            tracks.rotations[row, axis, other] = sightings.rotations[i, axis, other]
    return changed


@compiled
def take_in(
    tracks: Tracks, sightings: Sightings, now: float, estimate_velocity: bool,
) -> tuple[bool, float]:
    """Write sightings into their tracks, one after another.

    Removed obstacles expire at −∞ and look as if nobody had seen them.

    Args:
        tracks: written to.
        sightings: of one message.
        now: when the message came, the measurement's time for sightings without a stamp [s].
        estimate_velocity: whether velocities that are not known come from successive positions,
            else they are 0.

    Returns:
        Whether anything is new, and when an obstacle ends or counts as static at the earliest [s].
    """
    changed, soonest, nothing = False, np.inf, np.zeros(6)
    for i in range(len(sightings.rows)):
        row = sightings.rows[i]
        if sightings.removed[i]:
            for axis in range(3):
                tracks.centers[row, axis] = np.nan
                tracks.velocities[row, axis] = tracks.angular_velocities[row, axis] = 0.0
            tracks.stamps[row], tracks.expiry[row] = -np.inf, -np.inf
            changed = True
            continue
        stamp = sightings.stamps[i] if sightings.stamps[i] > 0.0 else now
        elapsed = stamp - tracks.stamps[row]
        set_back = elapsed < -STATIC_AFTER
        known = len(sightings.twists) > 0 and not np.isnan(sightings.twists[i, 0])
        if known or not estimate_velocity:
            changed = _set_twist(
                tracks, row, sightings.twists[i] if known else nothing) or changed
        if elapsed >= SHORTEST_STEP or set_back:  # else it is the same measurement once more
            if not known and estimate_velocity:
                changed = _estimate(
                    tracks, sightings, i, np.inf if set_back else elapsed) or changed
            tracks.stamps[row] = stamp
        changed = _copy_shape(tracks, sightings, i) or changed
        tracks.heard[row] = now
        lifetime = sightings.lifetimes[i]
        tracks.expiry[row] = now + lifetime if lifetime > 0.0 else np.inf
        soonest = min(soonest, tracks.expiry[row])
        if tracks.velocities[row].any() or tracks.angular_velocities[row].any():
            soonest = min(soonest, now + STATIC_AFTER + 1e-6)
    return changed, soonest
