"""One tick's inputs as planner_node publishes them, enough to compute the tick again."""

from __future__ import annotations

import array
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple
import zlib

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.robot.se3 import checked_pose, Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Target

Array = npt.NDArray[np.float64]

# A stamp in nanoseconds is more than a float holds: seconds and nanoseconds apart are not.
_BILLION = 10**9
_HEAD, _TWIST = 8, 6
# Rows with a count of messages on `attached` add this to their kind; those of 0.1.0 have none.
_WITH_ATTACHED = 10
# Rows of a tick that goes to a pose add this, and have position and rotation matrix at the end;
# those of one that goes to joint positions have these.
_WITH_POSE, _WITH_JOINTS = 20, 40
_POSE = 12
# The row of the first tick along a chunk adds the former, and has the chunk at its end; those of
# further ones along the same chunk add the latter.
_WITH_CHUNK, _WITH_SAME_CHUNK = 60, 80
# The last numbers of a chunk: how late it was, its points, numbers of each, and a code of what
# they are.
_CHUNK_END = 4
_POSITIONS, _VELOCITIES, _POSES = range(3)
# Rows add this for each topic with obstacles and a checksum, which come last of all. Earlier rows
# have none for the first topic.
_WITH_TOPIC = 100
# Stamps count seconds in 32 bits, and every other number is smaller.
_LARGEST = 2.0**32


class TickKind(IntEnum):
    """What a tick did."""

    BRAKING = 0  # without the planner
    GOING_ON = 1
    STARTING = 2  # from rest, the planner reset
    TRYING = 3  # gently, after the arm did not follow


class RecordedTick(NamedTuple):
    """The inputs of a tick.

    Attributes:
        stamp_ns: of the joint_command that came of it.
        time: the loop's clock, which lifetimes of obstacles refer to [s].
        kind: what it did.
        obstacle_messages, preview_messages: how many had been taken in before the tick.
        preview_elapsed: where the latest preview began at this tick [s]; NaN if none holds.
        attached_messages: how many on `attached` had been taken in before the tick.
        twist: (6,) in the command frame [m/s, rad/s].
        q: (n,) measured posture [rad, m].
        target: that commands the arm in place of the twist; None for none, or where `goes_on`.
        checked_messages: as `obstacle_messages`, of all topics with obstacles, each with the
            `checksum` of the latest one: a recorder may come later than the planner, or earlier.
        goes_on: whether the latest chunk that was a target is the target still.
    """

    stamp_ns: int
    time: float
    kind: TickKind
    obstacle_messages: int
    preview_messages: int
    preview_elapsed: float
    attached_messages: int
    twist: Array
    q: Array
    target: Target | None = None
    checked_messages: tuple[tuple[int, int], ...] = ()
    goes_on: bool = False

    def numbers(self) -> array.array[float]:
        """Return all of it as one row of numbers."""
        kind, target = self.kind + _WITH_ATTACHED, np.empty(0)
        if isinstance(self.target, Pose):
            kind += _WITH_POSE
            target = np.concatenate((self.target.position, self.target.rotation.ravel()))
        elif isinstance(self.target, Chunk):
            kind, target = kind + _WITH_CHUNK, _numbers_of(self.target)
        elif self.goes_on:
            kind += _WITH_SAME_CHUNK
        elif self.target is not None:
            kind, target = kind + _WITH_JOINTS, self.target
        kind += _WITH_TOPIC * len(self.checked_messages)
        return array.array('d', np.concatenate((
            (*divmod(self.stamp_ns, _BILLION), self.time, kind, self.obstacle_messages,
             self.preview_messages, self.preview_elapsed, self.attached_messages), self.twist,
            self.q, target, *self.checked_messages)).tobytes())

    @classmethod
    def of(cls, numbers: Sequence[float], n: int) -> RecordedTick:
        """Return the tick that `numbers` gives, of an arm with n joints.

        Raises:
            StateError: there are more or fewer numbers, the kind is none, or a number is
                impossible.
        """
        row, target, more, goes_on = _parted(np.array(numbers, dtype=float).ravel(), n)
        if len(row) >= _HEAD:
            if row[3] >= _WITH_ATTACHED:
                row[3] -= _WITH_ATTACHED
            else:
                row = np.insert(row, _HEAD - 1, 0.0)
        if row.shape != (_HEAD + _TWIST + n,):
            raise StateError(f'a recorded tick has {row.size} numbers; of a robot with {n} joints '
                             f'it takes {_HEAD + _TWIST + n}')
        if row[3] not in list(TickKind):
            raise StateError(f'a recorded tick is of kind {row[3]:g}; it must be one of '
                             f'{[int(kind) for kind in TickKind]}')
        # Of all numbers, `preview_elapsed` alone may be NaN.
        whole = np.concatenate((row[[0, 1, 4, 5, 7]], more))
        rest = np.concatenate((np.delete(row, 6), more))
        if isinstance(target, np.ndarray):
            rest = np.concatenate((rest, target))
        if not (np.abs(rest) <= _LARGEST).all() or np.isinf(row[6]):
            raise StateError('a recorded tick has numbers that are not finite, or beyond '
                             f'{_LARGEST:g}')
        if (whole != np.round(whole)).any() or (whole < 0.0).any():
            raise StateError(f'a recorded tick has stamp and counts {whole.tolist()}; they must '
                             'be whole numbers, 0 or more')
        return cls(int(row[0]) * _BILLION + int(row[1]), float(row[2]), TickKind(int(row[3])),
                   int(row[4]), int(row[5]), float(row[6]), int(row[7]),
                   row[_HEAD:_HEAD + _TWIST], row[_HEAD + _TWIST:], target,
                   tuple((int(count), int(check)) for count, check in more.reshape(-1, 2)),
                   goes_on)


def _parted(row: Array, n: int) -> tuple[Array, Target | None, Array, bool]:
    """Return a row without what only some have at their end, and that.

    Returns:
        The row, its target, further topics, and whether the latest chunk is the target still.
    """
    target: Target | None = None
    goes_on = False
    more = np.empty(0)
    if len(row) > _HEAD and _WITH_TOPIC <= row[3] < _WITH_TOPIC * (
            (len(row) - _HEAD) // 2):
        topics = int(row[3] // _WITH_TOPIC)
        row, more = row[:-2 * topics], row[-2 * topics:]
        row[3] -= topics * _WITH_TOPIC
    if len(row) > _HEAD and row[3] >= _WITH_ATTACHED + _WITH_SAME_CHUNK:
        goes_on = True
        row[3] -= _WITH_SAME_CHUNK
    elif len(row) >= _HEAD + _CHUNK_END and row[3] >= _WITH_ATTACHED + _WITH_CHUNK:
        row, target = _chunk_parted(row)
        row[3] -= _WITH_CHUNK
    elif len(row) >= _HEAD + n and row[3] >= _WITH_ATTACHED + _WITH_JOINTS:
        row, target = row[:-n], row[-n:]
        row[3] -= _WITH_JOINTS
    elif len(row) >= _HEAD + _POSE and row[3] >= _WITH_ATTACHED + _WITH_POSE:
        row, pose = row[:-_POSE], row[-_POSE:]
        target = checked_pose(Pose(pose[:3], pose[3:].reshape(3, 3)))
        row[3] -= _WITH_POSE
    return row, target, more, goes_on


def _numbers_of(chunk: Chunk) -> Array:
    """Return a chunk as numbers, the last of which say how many there are."""
    poses = isinstance(chunk.points, tuple)
    points = np.array([np.concatenate((pose.position, pose.rotation.ravel()))
                       for pose in chunk.points]) if poses else np.array(chunk.points)
    code = _POSES if poses else _POSITIONS if chunk.velocities is None else _VELOCITIES
    return np.concatenate((
        chunk.times, points.ravel(),
        np.empty(0) if chunk.velocities is None else chunk.velocities.ravel(),
        (chunk.late, *points.shape, code)))


def _chunk_parted(row: Array) -> tuple[Array, Chunk]:
    """Return a row without the chunk at its end, and that; StateError if it is none."""
    late, count, width, code = row[-_CHUNK_END:].tolist()
    size = count * (1 + width * (1 + (code == _VELOCITIES)))
    if not (count >= 1.0 and width >= 1.0 and 0.0 < size <= len(row) - _HEAD - _CHUNK_END
            and size == int(size)) or (code == _POSES and width != _POSE):
        raise StateError(f'a recorded tick has a chunk of {count:g} points with {width:g} numbers '
                         f'each, and {row.size} numbers')
    begin = len(row) - _CHUNK_END - int(size)
    times, rows = np.split(row[begin:-_CHUNK_END], [int(count)])
    rows = rows.reshape(-1, int(width))
    points, more = rows[:int(count)], rows[int(count):]
    if code == _POSES:
        return row[:begin], Chunk(times, [
            Pose(pose[:3], pose[3:].reshape(3, 3)) for pose in points], late=late)
    return row[:begin], Chunk(times, points, more if len(more) else None, late)


def checksum(message: bytes) -> int:
    """Return the CRC-32 of a serialised message.

    Without the zeros at its end: one that has come from another process may have some more.
    """
    return zlib.crc32(message.rstrip(b'\0'))
