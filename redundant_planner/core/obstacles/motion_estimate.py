"""Obstacles as they were last seen, and how fast they move: by successive positions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, kernel, Matrix, Stack, Vector

Array = npt.NDArray[np.float64]

# Faster apparent motion is a teleport: the obstacle was moved, it does not move [m/s].
TELEPORT_SPEED = 3.0
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
        semi_axes: (k, 3) [m].
        velocities: (k, 3) of the centres [m/s].
        stamps: (k,) of the latest measurement [s]; −∞ before the first.
        heard: (k,) when the latest message came [s].
        expiry: (k,) when they end [s]: ∞ for never, −∞ for those that were removed.
    """

    centers: Matrix
    rotations: Stack
    semi_axes: Matrix
    velocities: Matrix
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
        semi_axes: (j, 3) [m].
        stamps: (j,) when they were measured [s]; 0 where that is not known.
        lifetimes: (j,) [s]; 0 for unlimited.
    """

    rows: Indices
    removed: Indices
    centers: Matrix
    rotations: Stack
    semi_axes: Matrix
    stamps: Vector
    lifetimes: Vector


def unseen(count: int) -> Tracks:
    """Return tracks of `count` obstacles that nobody has seen yet."""
    return Tracks(
        np.full((count, 3), np.nan), np.zeros((count, 3, 3)), np.ones((count, 3)),
        np.zeros((count, 3)), np.full(count, -np.inf), np.zeros(count), np.full(count, np.inf))


def forget(tracks: Tracks) -> None:
    """Make all obstacles look as if nobody had seen them, but keep their places."""
    tracks.centers[:], tracks.velocities[:], tracks.stamps[:] = np.nan, 0.0, -np.inf


def stop_silent(tracks: Tracks, now: float) -> bool:
    """Stop the obstacles without an update for `STATIC_AFTER`; return whether there are any."""
    silent = (now - tracks.heard > STATIC_AFTER) & tracks.velocities.any(axis=1)
    tracks.velocities[silent] = 0.0
    return bool(silent.any())


def next_change(tracks: Tracks) -> float:
    """Return when an obstacle ends or counts as static, at the earliest [s]; ∞ for never."""
    moving = tracks.heard[tracks.velocities.any(axis=1)]
    return min(float(tracks.expiry.min(initial=np.inf)),
               float(moving.min(initial=np.inf)) + STATIC_AFTER + 1e-6)


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
    for axis in range(3):
        step = sightings.centers[i, axis] - tracks.centers[row, axis]
        speed = step / elapsed if moves else 0.0
        changed = changed or speed != tracks.velocities[row, axis]
        tracks.velocities[row, axis] = speed
    return changed


@kernel
def _copy_shape(tracks: Tracks, sightings: Sightings, i: int) -> bool:
    """Copy place, axes and size of sighting i into its track; return whether any is new."""
    row, changed = sightings.rows[i], False
    for axis in range(3):
        changed = (changed or sightings.centers[i, axis] != tracks.centers[row, axis]
                   or sightings.semi_axes[i, axis] != tracks.semi_axes[row, axis])
        tracks.centers[row, axis] = sightings.centers[i, axis]
        tracks.semi_axes[row, axis] = sightings.semi_axes[i, axis]
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
        estimate_velocity: whether velocities come from successive positions, else they stay 0.

    Returns:
        Whether anything is new, and when an obstacle ends or counts as static at the earliest [s].
    """
    changed, soonest = False, np.inf
    for i in range(len(sightings.rows)):
        row = sightings.rows[i]
        if sightings.removed[i]:
            for axis in range(3):
                tracks.centers[row, axis], tracks.velocities[row, axis] = np.nan, 0.0
            tracks.stamps[row], tracks.expiry[row] = -np.inf, -np.inf
            changed = True
            continue
        stamp = sightings.stamps[i] if sightings.stamps[i] > 0.0 else now
        elapsed = stamp - tracks.stamps[row]
        set_back = elapsed < -STATIC_AFTER
        if elapsed >= SHORTEST_STEP or set_back:  # else it is the same measurement once more
            if estimate_velocity:
                changed = _estimate(
                    tracks, sightings, i, np.inf if set_back else elapsed) or changed
            tracks.stamps[row] = stamp
        changed = _copy_shape(tracks, sightings, i) or changed
        tracks.heard[row] = now
        lifetime = sightings.lifetimes[i]
        tracks.expiry[row] = now + lifetime if lifetime > 0.0 else np.inf
        soonest = min(soonest, tracks.expiry[row])
        if tracks.velocities[row].any():
            soonest = min(soonest, now + STATIC_AFTER + 1e-6)
    return changed, soonest
