"""Reads serialised chunks: a Path of stamped poses, or a JointTrajectory."""

from __future__ import annotations

from collections.abc import Sequence
import math
import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.chunk import MOST_POINTS
from redundant_planner.io.cdr import byte_order, ENCAPSULATION, text, words_and_doubles
from redundant_planner.io.joint_layout import MOST_JOINTS
from redundant_planner.io.target_reader import check_names, poses_of_numbers

Array = npt.NDArray[np.float64]

_BILLION = 10**9
_TURN = 2.0 * math.pi  # [rad]


class ReadChunk(NamedTuple):
    """A chunk as a message gives it.

    Attributes:
        stamp: when it begins [s]; 0 for as it arrives.
        frame: of the poses; empty for joints, or where none is named.
        times: (K,) since then [s].
        points: (K, n) joint positions [rad, m], or K poses in `frame`.
        velocities: (K, n) [rad/s, m/s]; None where they are not known.
    """

    stamp: float
    frame: str
    times: Array
    points: Array | tuple[Pose, ...]
    velocities: Array | None


class _Fields:
    """The fields of a message, one after another."""

    def __init__(self, raw: bytes) -> None:
        """Begin after the encapsulation; StateError as `byte_order`."""
        order = byte_order(raw)
        self._raw, self._at = raw, ENCAPSULATION
        self._word, self._stamp = struct.Struct(f'{order}I'), struct.Struct(f'{order}iI')
        self._order = order

    def count(self) -> int:
        """Return an unsigned integer."""
        return int(self._take(self._word, 4)[0])

    def nanoseconds(self) -> int:
        """Return a stamp or duration [ns]."""
        seconds, nanoseconds = self._take(self._stamp, 4)
        return int(seconds) * _BILLION + int(nanoseconds)

    def name(self) -> str:
        """Return a string."""
        length = self.count()
        found = text(self._raw, self._at, length)
        self._at += length
        return found

    def place(self, count: int) -> int:
        """Pass so many 64-bit numbers; return where in `rows` the first of them is."""
        if count:
            self._at = ENCAPSULATION + -(-(self._at - ENCAPSULATION) // 8) * 8
        first = (self._at - ENCAPSULATION) // 8
        self._at += 8 * count
        if self._at > len(self._raw):
            raise StateError(f'the bytes end too early: there are {len(self._raw)}')
        return first

    def rows(self, places: list[int], count: int) -> Array:
        """Return so many numbers (K, count) from each of K places on."""
        return np.asarray(words_and_doubles(self._raw, self._order)[1][
            np.array(places, np.intp)[:, None] + np.arange(count)])

    def _take(self, field: struct.Struct, size: int) -> tuple[int, ...]:
        self._at = ENCAPSULATION + -(-(self._at - ENCAPSULATION) // size) * size
        try:
            found = field.unpack_from(self._raw, self._at)
        except struct.error:
            raise StateError(f'the bytes end too early: there are {len(self._raw)}') from None
        self._at += field.size
        return found


def read_path(raw: bytes) -> ReadChunk:
    """Return the poses of a serialised nav_msgs/Path.

    The stamp of each pose says when it is due. Where the path's own header has no stamp, the
    first pose is due as the message arrives, and the differences count.

    Raises:
        StateError: the bytes are no Path, it has no or too many poses, poses are in several
            frames, have no stamps, or are none (`read_target`).
    """
    fields = _Fields(raw)
    stamped, frame = fields.nanoseconds() != 0, fields.name()
    count = _count_of(fields, 'poses')
    due, places = np.empty(count, np.int64), list[int]()
    for i in range(count):
        due[i], name = fields.nanoseconds(), fields.name()
        if not frame:
            frame = name
        if name not in ('', frame):
            raise StateError(f"pose {i} is given in frame '{name}', others in '{frame}'; all of "
                             'a path must be in one')
        places.append(fields.place(7))
    if not due.any():
        raise StateError('its poses have no stamps; the stamp of each must say when it is due')
    begin = int(due[0])
    return ReadChunk(begin / 1e9 if stamped else 0.0, frame, 1e-9 * np.array(due - begin, float),
                     poses_of_numbers(fields.rows(places, 7), 'pose {}: its'), None)


def read_trajectory(raw: bytes, robot: Robot, rest: Array) -> ReadChunk:
    """Return the joint positions of a serialised trajectory_msgs/JointTrajectory.

    Joints that it does not name stay. Joints without limits go the short way from point to point.
    Velocities count where all points have them; accelerations and efforts do not.

    Args:
        raw: the message.
        robot: the arm.
        rest: (n,) where its joints are [rad, m].

    Raises:
        StateError: the bytes are no such message, a joint is unknown or named twice, there are no
            or too many points, or one has another number of positions or velocities than joints.
    """
    fields = _Fields(raw)
    stamp, _ = fields.nanoseconds(), fields.name()
    names = _names_of(fields, robot)
    count, joints = _count_of(fields, 'points'), len(names)
    due, positions, velocities = np.empty(count, np.int64), list[int](), list[int]()
    for i in range(count):
        for what, found in (('positions', positions), ('velocities', velocities)):
            size = fields.count()
            if size != joints and (size or found is positions):
                raise StateError(f'point {i} has {size} {what} for {joints} joints; it takes one '
                                 'for each')
            if size:
                found.append(fields.place(size))
        for _ in ('accelerations', 'efforts'):
            fields.place(fields.count())
        due[i] = fields.nanoseconds()
    columns = [robot.joint_names.index(name) for name in names]
    points = np.tile(np.clip(rest, robot.position_min, robot.position_max), (count, 1))
    points[:, columns] = fields.rows(positions, joints)
    speeds = None
    if len(velocities) == count:
        speeds = np.zeros(points.shape)
        speeds[:, columns] = fields.rows(velocities, joints)
    return ReadChunk(stamp / 1e9, '', 1e-9 * np.array(due, float),
                     _short_way(points, rest, robot), speeds)


def _short_way(points: Array, rest: Array, robot: Robot) -> Array:
    """Return points (K, n) whose joints without limits go the short way, from `rest` (n,) on."""
    endless = np.isinf(robot.position_max)
    rows = np.vstack((rest, points))
    turns = np.cumsum(np.where(endless, np.rint(np.diff(rows, axis=0) / _TURN), 0.0), axis=0)
    return np.asarray(points - _TURN * turns)


def _count_of(fields: _Fields, what: str) -> int:
    count = fields.count()
    if not 1 <= count <= MOST_POINTS:
        raise StateError(f'it has {count} {what}; it takes 1 to {MOST_POINTS}')
    return count


def _names_of(fields: _Fields, robot: Robot) -> Sequence[str]:
    """Return the names of the joints; StateError if they are none of the arm, or come twice."""
    count = fields.count()
    if count > MOST_JOINTS:
        raise StateError(f'it has {count} joint names; up to {MOST_JOINTS} are read')
    names = [fields.name() for _ in range(count)]
    check_names(names, robot)
    return names
