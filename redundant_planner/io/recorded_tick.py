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
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Goal, TipTargets
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.io.recorded_target import parted, RecordedTarget

Array = npt.NDArray[np.float64]

# A stamp in nanoseconds is more than a float holds: seconds and nanoseconds apart are not.
_BILLION = 10**9
_HEAD, _TWIST = 8, 6
# Rows with a count of messages on `attached` add this to their kind; those of 0.1.0 have none.
_WITH_ATTACHED = 10
# Rows add this for each topic with obstacles and a checksum, which come last of all. Earlier rows
# have none for the first topic.
_WITH_TOPIC = 100
# And this for each tick that did not take place before them.
_MISSED = 1_000_000
# Stamps count seconds in 32 bits, and every other number is smaller.
_LARGEST = 2.0**32


class TickKind(IntEnum):
    """What a tick did."""

    BRAKING = 0  # without the planner
    GOING_ON = 1
    STARTING = 2  # from rest, the planner reset
    TRYING = 3  # gently, after the arm did not follow
    SETTING_OFF = 4  # carefully, until the arm is seen to move


class RecordedTick(NamedTuple):
    """The inputs of a tick.

    Attributes:
        stamp_ns: of the joint_command that came of it.
        time: the loop's clock, which lifetimes of obstacles refer to [s].
        kind: what it did.
        obstacle_messages, preview_messages: how many had been taken in before the tick.
        preview_elapsed: where the latest preview began at this tick [s]; NaN if none holds.
        attached_messages: how many on `attached` had been taken in before the tick.
        twist: (6,) in the command frame [m/s, rad/s]; of t tips that are not coupled (t, 6).
        q: (n,) measured posture [rad, m].
        target: that commands the arm in place of the twist; None for none, or where `goes_on`; of
            tips that are not coupled see `RecordedTarget`.
        checked_messages: as `obstacle_messages`, of all topics with obstacles, each with the
            `checksum` of the latest one: a recorder may come later than the planner, or earlier.
        goes_on: whether the latest chunk that was a target is the target still.
        news: see `Planner.step`.
        tips_go_on: tips of which the latest chunk is the target still, see `RecordedTarget`.
        missed: ticks that did not take place before it, see `Planner.missed`.
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
    target: Goal | Chunk | TipTargets | None = None
    checked_messages: tuple[tuple[int, int], ...] = ()
    goes_on: bool = False
    news: tuple[Sighting, ...] = ()
    tips_go_on: tuple[str, ...] = ()
    missed: int = 0

    def numbers(self) -> array.array[float]:
        """Return all of it as one row of numbers."""
        more, target = RecordedTarget(
            self.target, self.goes_on, self.news, self.tips_go_on).numbers()
        kind = (self.kind + _WITH_ATTACHED + more + _WITH_TOPIC * len(self.checked_messages)
                + _MISSED * self.missed)
        return array.array('d', np.concatenate((
            (*divmod(self.stamp_ns, _BILLION), self.time, kind, self.obstacle_messages,
             self.preview_messages, self.preview_elapsed, self.attached_messages),
            self.twist.ravel(), self.q, target, *self.checked_messages)).tobytes())

    @classmethod
    def of(cls, numbers: Sequence[float], n: int, tips: Sequence[str] = ()) -> RecordedTick:
        """Return the tick that `numbers` gives, of an arm with n joints.

        Args:
            numbers: the row.
            n: joints.
            tips: of an arm with several. Its rows have a twist for each, or one if they are
                coupled.

        Raises:
            StateError: there are more or fewer numbers, the kind is none, or a number is
                impossible.
        """
        given = np.array(numbers, dtype=float).ravel()
        if len(tips) > 1:
            try:  # its length fits only one of the two
                return cls._of(given.copy(), n, tips)
            except StateError:
                return cls._of(given, n, ())
        return cls._of(given, n, ())

    @classmethod
    def _of(cls, numbers: Array, n: int, tips: Sequence[str]) -> RecordedTick:
        missed = 0
        if len(numbers) > _HEAD and _MISSED <= numbers[3] <= _LARGEST:
            missed = int(numbers[3] // _MISSED)
            numbers[3] -= missed * _MISSED
        row, aimed, more = _parted(numbers, n, tips)
        twist = _TWIST * max(len(tips), 1)
        if len(row) >= _HEAD:
            if row[3] >= _WITH_ATTACHED:
                row[3] -= _WITH_ATTACHED
            else:
                row = np.insert(row, _HEAD - 1, 0.0)
        if row.shape != (_HEAD + twist + n,):
            raise StateError(f'a recorded tick has {row.size} numbers; of a robot with {n} joints '
                             f'it takes {_HEAD + twist + n}')
        if row[3] not in list(TickKind):
            raise StateError(f'a recorded tick is of kind {row[3]:g}; it must be one of '
                             f'{[int(kind) for kind in TickKind]}')
        # Of all numbers, `preview_elapsed` alone may be NaN.
        whole = np.concatenate((row[[0, 1, 4, 5, 7]], more))
        rest = np.concatenate((np.delete(row, 6), more))
        if isinstance(aimed.target, np.ndarray):
            rest = np.concatenate((rest, aimed.target))
        if not (np.abs(rest) <= _LARGEST).all() or np.isinf(row[6]):
            raise StateError('a recorded tick has numbers that are not finite, or beyond '
                             f'{_LARGEST:g}')
        if (whole != np.round(whole)).any() or (whole < 0.0).any():
            raise StateError(f'a recorded tick has stamp and counts {whole.tolist()}; they must '
                             'be whole numbers, 0 or more')
        return cls(int(row[0]) * _BILLION + int(row[1]), float(row[2]), TickKind(int(row[3])),
                   int(row[4]), int(row[5]), float(row[6]), int(row[7]),
                   row[_HEAD:_HEAD + twist].reshape((-1, 6) if tips else 6),
                   row[_HEAD + twist:], aimed.target,
                   tuple((int(count), int(check)) for count, check in more.reshape(-1, 2)),
                   aimed.goes_on, aimed.news, aimed.tips_go_on, missed)


def _parted(
    row: Array, n: int, tips: Sequence[str],
) -> tuple[Array, RecordedTarget, Array]:
    """Return a row without what only some have at their end, its target, and further topics."""
    more, aimed = np.empty(0), RecordedTarget()
    if len(row) <= _HEAD:
        return row, aimed, more
    if _WITH_TOPIC <= row[3] < _WITH_TOPIC * ((len(row) - _HEAD) // 2):
        topics = int(row[3] // _WITH_TOPIC)
        row, more = row[:-2 * topics], row[-2 * topics:]
        row[3] -= topics * _WITH_TOPIC
    if 0.0 <= row[3] < _WITH_TOPIC and row[3] == round(row[3]):
        head, rest = np.split(row, [_HEAD - 1])
        rest, head[3], aimed = parted(rest, int(row[3]), n, tips)
        row = np.concatenate((head, rest))
    return row, aimed, more


def checksum(message: bytes) -> int:
    """Return the CRC-32 of a serialised message.

    Without the zeros at its end: one that has come from another process may have some more.
    """
    return zlib.crc32(message.rstrip(b'\0'))
