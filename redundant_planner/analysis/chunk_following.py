"""How well the arm followed the chunks that it was sent: how late, how far off, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.robot.kinematics import KinematicsAlong
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import checked_target, checked_targets
from redundant_planner.io.bag_reader import Event
from redundant_planner.io.chunk_reader import read_path, read_trajectory, ReadChunk

Array = npt.NDArray[np.float64]

# The chunks' curve is looked at every so often; between, it is straight [s].
_GRID = 0.01
# How long after its last point an arm is still on its way along a chunk [s].
_AFTER = 10.0
# From when on an arm that was elsewhere follows: once it has been this near [m, rad].
_ARRIVED = 0.01
# How far back on its way the arm may seem to be, as measurements are noisy [s].
_BACK = 0.05
# How far ahead it may seem to be: a chunk without a stamp begins when the planner hears it, and
# the recorder may hear it later [s].
_AHEAD = 0.05
# Places on a curve that rests, or nearly so, are one: that which is due counts [m, rad].
_SAME = 1e-4
# How long before its beginning a chunk may come, see docs/targets.md [s].
_ANNOUNCED = 60.0


@dataclass(frozen=True)
class ChunkRun:
    """How the arm followed successive chunks of one kind.

    Attributes:
        of_joints: whether they are of the joints, rather than of a tip.
        tip: which one, of several; '' of the only one, and for joints.
        chunks: how many.
        begin, end: from when on they commanded the arm, and until when [s].
        lag_median, lag_longest, lag_at: how far the arm was behind their time, and when that was
            longest; negative where it was ahead of when the recorder heard them [s].
        off: the largest distance from their curve, wherever on it the arm should have been: of a
            joint [rad, m] or of the tip [m].
        off_at, joint: when that was [s], and of which joint; '' for the tip.
        turned: the largest angle of the tip from their curve [rad]; 0 for joints.
        ended: what ended them, empty if nothing did.
    """

    of_joints: bool
    tip: str
    chunks: int
    begin: float
    end: float
    lag_median: float
    lag_longest: float
    lag_at: float
    off: float
    off_at: float
    joint: str
    turned: float
    ended: str


class _Piece(NamedTuple):
    """The part of a chunk that counts, as the next one replaces its rest.

    Attributes:
        begin: from when on it commands [s].
        times: (K,) of its points [s].
        points: (K, n) of joints [rad, m]; (K, 7) of the tip, see `places_of`.
        velocities: (K, n), None if not known.
    """

    begin: float
    times: Array
    points: Array
    velocities: Array | None


class _Run(NamedTuple):
    of_joints: bool
    tip: str
    pieces: list[_Piece]
    ends: list[tuple[float, str]]  # at most one


def places_of(robot: Robot, positions: Array, rotations: Array) -> Array:
    """Return tip poses as (k, 7): the place [m], and twice the quaternion.

    Twice, as two of them are then as far from each other as the angle between them [rad]. It is
    the same for all where the arm's axes leave the orientation alone.
    """
    if not any(row >= 3 for row in robot.rows):
        return np.column_stack((positions, np.tile((0.0, 0.0, 0.0, 2.0), (len(positions), 1))))
    return np.column_stack((positions, [2.0 * quaternion_of(turn) for turn in rotations]))


class ChunkLog:
    """The chunks of a bag, taken in message by message."""

    def __init__(self, robot: Robot, origin: float) -> None:
        """Begin without any.

        Args:
            robot: the arm.
            origin: when the bag began, by the stamps' clock [s].
        """
        self._robot, self._origin = robot, origin
        self._runs: list[_Run] = []

    def end(self, time: float, what: str, tip: str = '') -> None:
        """Note what ends the chunks at a time [s]: another command, or the planner itself.

        Args:
            time: when.
            what: it was.
            tip: of several, the one that is commanded; '' for all.
        """
        for run in self._runs:
            if not run.ends and (not tip or run.tip in ('', tip)):
                run.ends.append((time, what))

    def add(self, event: Event, posture: Array | None, tip: str = '') -> None:
        """Take in a message of target_path or target_trajectory.

        Args:
            event: the message.
            posture: (n,) of the arm, for joints that are not named; None if not known.
            tip: of several, the one that it is for.

        Raises:
            StateError: the planner does not take it, or nobody knows where it is.
        """
        robot, of_joints = self._robot, event.topic == 'target_trajectory'
        of_tip = '' if of_joints else tip
        if of_joints:
            if posture is None:
                raise StateError('they come before the first joint_states')
            read = read_trajectory(event.raw, robot, posture)
            points = np.asarray(read.points)
        else:
            read = read_path(event.raw)
            if read.frame not in ('', robot.base_frame):
                raise StateError(f"they are given in frame '{read.frame}', and the bag does not "
                                 'tell where that is')
            points = places_of(robot, *(np.array(part) for part in zip(*read.points)))
            # A quaternion and its negative are one rotation: neighbours of one sign.
            signs = np.sign((points[1:, 3:] * points[:-1, 3:]).sum(axis=1))
            points[1:, 3:] *= np.cumprod(np.where(signs < 0.0, -1.0, 1.0))[:, None]
        # As the planner checks it.
        chunk = Chunk(read.times, read.points, read.velocities)
        if of_tip:
            checked_targets({of_tip: chunk}, robot)
        else:
            checked_target(chunk, robot)
        begin = self._begin_of(read, event.arrival)
        self._take(event.topic, _Run(of_joints, of_tip, [_Piece(
            max(begin, event.arrival), begin + read.times, points, read.velocities)], []))

    def _begin_of(self, read: ReadChunk, arrival: float) -> float:
        """Return when a chunk begins [s]; StateError if it is over, or begins too late."""
        begin = read.stamp - self._origin if read.stamp else arrival
        if not begin - _ANNOUNCED <= arrival <= begin + float(read.times[-1]):
            raise StateError('they are over by their stamps, or begin too late')
        return begin

    def _take(self, topic: str, new: _Run) -> None:
        """Put a run of one chunk at the end of the one that it goes on with, if there is one."""
        piece, kind = new.pieces[0], (new.of_joints, new.tip)
        known = next((run for run in self._runs
                      if not run.ends and (run.of_joints, run.tip) == kind), None)
        if known is None:
            self.end(piece.begin, topic, new.tip)
            self._runs.append(new)
            return
        pieces = known.pieces
        while pieces and pieces[-1].begin >= piece.begin:
            pieces.pop()
        if pieces:  # of a long bag not all that was never to happen is kept
            last = pieces[-1]
            kept = int(np.searchsorted(last.times, piece.begin)) + 1
            pieces[-1] = last._replace(
                times=last.times[:kept], points=last.points[:kept],
                velocities=None if last.velocities is None else last.velocities[:kept])
        pieces.append(piece)

    def runs(self, times: Array, positions: Array, arms: KinematicsAlong) -> tuple[ChunkRun, ...]:
        """Return how the arm followed them, as far as it was measured meanwhile.

        Args:
            times: (k,) of the samples [s].
            positions: (k, n) measured [rad, m].
            arms: there.
        """
        robot, found = self._robot, []
        for run in self._runs:
            if run.of_joints:
                measured = positions
            else:
                own = slice(robot.tips.index(run.tip) if run.tip else 0, None, len(robot.tips))
                measured = places_of(robot, arms.tip_positions[own], arms.tip_rotations[own])
            found.append(_followed(run, times, measured, robot.joint_names))
        return tuple(run for run in found if run is not None)


def _followed(
    run: _Run, times: Array, measured: Array, names: Sequence[str],
) -> ChunkRun | None:
    """Return how the samples of one run followed its curve; None without any samples."""
    begin, last = run.pieces[0].begin, float(run.pieces[-1].times[-1])
    until, ended = run.ends[0] if run.ends else (np.inf, '')
    inside = np.flatnonzero((times >= begin) & (times <= min(until, last + _AFTER)))
    if not len(inside):
        return None
    times, measured = times[inside], measured[inside]
    end = float(times[-1])
    grid = np.append(np.arange(begin, end + _AHEAD, _GRID), end + _AHEAD)
    curve = _curve(run.pieces, grid, quaternions=not run.of_joints)
    lag, off, turned, joint = (np.zeros(len(times)) for _ in range(4))
    at = 0
    for i, (time, here) in enumerate(zip(times, measured)):
        if not run.of_joints and here[3:] @ curve[at, 3:] < 0.0:
            here = np.append(here[:3], -here[3:])
        low = int(np.searchsorted(grid, grid[at] - _BACK))
        high = max(int(np.searchsorted(grid, time + _AHEAD, side='right')), low + 1)
        apart = _apart(here, curve[low:high], run.of_joints).max(axis=1)
        ties = low + np.flatnonzero(apart <= apart.min() + _SAME)
        at = int(ties[np.abs(grid[ties] - time).argmin()])
        place, when = _next_to(here, curve, grid, at)
        differences = _apart(here, place[None], run.of_joints)[0]
        lag[i], off[i] = time - when, differences[:-1].max()
        joint[i], turned[i] = differences.argmax(), differences[-1]
    # The way to the first point of an arm that was elsewhere is none of the chunk's.
    near = np.flatnonzero((off <= _ARRIVED) & (turned <= _ARRIVED))
    counted = slice(int(near[0]) if len(near) else 0, None)
    worst = int(off[counted].argmax()) + (counted.start or 0)
    latest = int(lag[counted].argmax()) + (counted.start or 0)
    return ChunkRun(
        run.of_joints, run.tip, len(run.pieces), begin, end, float(np.median(lag[counted])),
        float(lag[latest]), float(times[latest]), float(off[worst]), float(times[worst]),
        names[int(joint[worst])] if run.of_joints else '', float(turned[counted].max()), ended)


def _curve(pieces: Sequence[_Piece], grid: Array, *, quaternions: bool) -> Array:
    """Return the curve (g, w) at times (g,): of each the piece that commands then."""
    curve = np.empty((len(grid), pieces[0].points.shape[1]))
    begins = np.array([piece.begin for piece in pieces])
    which = np.searchsorted(begins, grid, side='right') - 1
    for i, piece in enumerate(pieces):
        curve[which == i] = _along(piece, grid[which == i])
    if quaternions:
        curve[:, 3:] *= 2.0 / np.linalg.norm(curve[:, 3:], axis=1, keepdims=True)
    return curve


def _along(piece: _Piece, times: Array) -> Array:
    """Return a smooth curve through a chunk's points at times (g,); at rest before and after."""
    at, points = piece.times, piece.points
    if len(at) == 1:
        return np.tile(points, (len(times), 1))
    slopes = piece.velocities
    if slopes is None:
        slopes = np.gradient(points, at, axis=0) if len(at) > 2 else np.tile(
            np.diff(points, axis=0) / np.diff(at), (2, 1))
    times = np.clip(times, at[0], at[-1])
    i = np.clip(np.searchsorted(at, times, side='right') - 1, 0, len(at) - 2)
    step = (at[i + 1] - at[i])[:, None]
    u = (times - at[i])[:, None] / step
    return np.asarray(
        (1.0 + 2.0 * u) * (1.0 - u) ** 2 * points[i] + u * (1.0 - u) ** 2 * step * slopes[i]
        + u * u * (3.0 - 2.0 * u) * points[i + 1] + u * u * (u - 1.0) * step * slopes[i + 1])


def _apart(here: Array, places: Array, of_joints: bool) -> Array:
    """Return how far places (g, w) are from here, for each joint or of the tip, and its angle."""
    if of_joints:
        away = np.abs(places - here)
        return np.column_stack((away, np.zeros(len(away))))
    away = np.linalg.norm(places[:, :3] - here[:3], axis=1)
    angle = 2.0 * np.arccos(np.minimum(0.25 * np.abs(places[:, 3:] @ here[3:]), 1.0))
    return np.column_stack((away, angle))


def _next_to(here: Array, curve: Array, grid: Array, at: int) -> tuple[Array, float]:
    """Return the place on the curve next to a grid point that is nearest, and its time [s]."""
    best, when = curve[at], float(grid[at])
    least = float(((here - best) ** 2).sum())
    for i in (at - 1, at):
        if not 0 <= i < len(grid) - 1:
            continue
        step = curve[i + 1] - curve[i]
        squared = float(step @ step)
        share = min(max(float((here - curve[i]) @ step) / max(squared, 1e-30), 0.0), 1.0)
        place = curve[i] + share * step
        away = float(((here - place) ** 2).sum())
        if away < least:
            least, best, when = away, place, float(grid[i] + share * (grid[i + 1] - grid[i]))
    return best, when
