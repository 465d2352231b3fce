"""A chunk: the future of a target, as a policy or a planned trajectory gives it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import shown, StateError
from redundant_planner.core.robot.se3 import checked_pose, Pose

Array = npt.NDArray[np.float64]

# Points that a chunk may have: 40 s at 50 Hz. To read so many takes longer than a tick may.
MOST_POINTS = 2000
# Points nearer in time are not told apart [s], and how long a chunk may be [s].
_NEAREST, LONGEST = 1e-6, 3600.0

# Poses within this, and that near to rotations, need no closer look [m, -].
_NEAR, _ROUND_OFF = 1e3, 1e-9


@dataclass(frozen=True, init=False, eq=False)
class Chunk:
    """Joint positions or tip poses with their times; the arm follows a smooth curve through them.

    Give `Planner.step` the same object in each tick while it holds. Another object replaces it.

    Attributes:
        times: (K,) ascending, from the chunk's beginning [s]. Read-only.
        points: (K, n) joint positions [rad, m], read-only; or a tuple of K poses, base frame.
        velocities: (K, n) of the joints [rad/s, m/s], read-only; None where they are not known.
        late: how long ago the chunk began when it is first given to `Planner.step` [s]; negative
            if it is to begin later.
    """

    times: Array
    points: Array | tuple[Pose, ...]
    velocities: Array | None
    late: float

    def __init__(
        self, times: npt.ArrayLike, points: npt.ArrayLike | Sequence[Pose],
        velocities: npt.ArrayLike | None = None, late: float = 0.0,
    ) -> None:
        """Check the points.

        Raises:
            StateError: there are none or too many, lengths differ, a value is not a finite number,
                times do not ascend from 0 or later on, or poses come with velocities.
        """
        times = _numbers('times', times)
        if times.ndim != 1 or not 1 <= len(times) <= MOST_POINTS:
            raise StateError(f'the chunk has times of shape {times.shape}; it takes 1 to '
                             f'{MOST_POINTS} points, each with its time')
        if not (times[0] >= 0.0 and times[-1] <= LONGEST):
            raise StateError(f'the chunk goes from {times[0]:g} to {times[-1]:g} s; it must be '
                             f'within 0 to {LONGEST:g} s')
        steps = np.diff(times)
        if (steps < _NEAREST).any():
            i = int((steps < _NEAREST).argmax())
            raise StateError(f'the times of the chunk do not ascend: point {i} is due at '
                             f'{times[i]:g} s, point {i + 1} at {times[i + 1]:g} s')
        if not abs(late) <= LONGEST:
            raise StateError(f'the chunk began {late} s ago; it must be within ±{LONGEST:g} s')
        object.__setattr__(self, 'times', times)
        object.__setattr__(self, 'points', _points(points, len(times), velocities))
        object.__setattr__(self, 'velocities', None if velocities is None else _rows(
            'velocities', velocities, len(times), self.points))
        object.__setattr__(self, 'late', float(late))

    @property
    def of_poses(self) -> bool:
        """Whether it is one of the tip, rather than of the joints."""
        return isinstance(self.points, tuple)

    @cached_property
    def range(self) -> Array:
        """The least and the largest position of each joint (2, n) [rad, m]."""
        assert isinstance(self.points, np.ndarray), 'poses have no such range'
        return np.array((self.points.min(axis=0), self.points.max(axis=0)))

    @property
    def end(self) -> Pose | Array:
        """Where it leads to: a pose, or joint positions (n,)."""
        end: Pose | Array = self.points[-1]
        return end


def _numbers(what: str, values: object) -> Array:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise StateError(f'the {what} of the chunk are {shown(values)}; they must be '
                         'numbers') from None
    if not np.isfinite(array).all():
        raise StateError(f'the {what} of the chunk have a number that is not finite')
    array.setflags(write=False)
    return array


def _points(
    points: object, count: int, velocities: object,
) -> Array | tuple[Pose, ...]:
    """Return as many points as times, checked."""
    if isinstance(points, Sequence) and len(points) and isinstance(points[0], Pose):
        if len(points) != count:
            raise StateError(f'the chunk has {count} times and {len(points)} poses')
        if velocities is not None:
            raise StateError('the chunk has velocities beside poses; they are of joints')
        return _checked(points)
    return _rows('points', points, count, None)


def _checked(poses: Sequence[Pose]) -> tuple[Pose, ...]:
    """Return poses as arrays of numbers; errors as `checked_pose`, which takes 25 µs for each."""
    try:
        position = np.array([pose[0] for pose in poses], dtype=float)
        rotation = np.array([pose[1] for pose in poses], dtype=float)
    except (TypeError, ValueError):  # of unequal sizes, or no numbers
        return tuple(checked_pose(Pose(*pose)) for pose in poses)
    if position.shape[1:] == (3,) and rotation.shape[1:] == (3, 3):
        off = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3))
        if (np.abs(position) <= _NEAR).all() and (off <= _ROUND_OFF).all() and (
                np.linalg.det(rotation) > 0.0).all():
            return tuple(map(Pose, position, rotation))
    return tuple(checked_pose(Pose(*pose)) for pose in poses)


def _rows(what: str, values: object, count: int, like: object) -> Array:
    rows = _numbers(what, values)
    shape = like.shape if isinstance(like, np.ndarray) else rows.shape
    if rows.ndim != 2 or len(rows) != count or rows.shape != shape:
        raise StateError(f'the chunk has {count} times and {what} of shape {rows.shape}; it '
                         f'takes one row of all joints for each time')
    return rows
