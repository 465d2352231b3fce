"""Joint states from a bag, many messages at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.joint_layout import joint_layout, JointLayout, LayoutError
from redundant_planner.io.left_out import LeftOut
from redundant_planner.io.plausible import LARGEST

Array = npt.NDArray[np.float64]

# Messages of a joint topic that are taken together.
_CHUNK = 4096
# And that many bytes of them.
_CHUNK_BYTES = 32_000_000
# More joints than any machine has: such a message is damaged.
_JOINTS = 256
# Joint states further apart belong to two motions: nothing was commanded between them [s].
GAP = 1.0


class JointChunk(NamedTuple):
    """Successive JointState messages of one topic.

    Attributes:
        topic: without its namespace.
        names: joint names, the order of the columns.
        arrivals: (k,) when they were recorded [s].
        stamps: (k,) of their headers, `arrivals` where there are none [s].
        positions: (k, n) [rad, m].
        velocities: (k, n) [rad/s, m/s], NaN where there are none.
    """

    topic: str
    names: tuple[str, ...]
    arrivals: Array
    stamps: Array
    positions: Array
    velocities: Array


class JointsMissingError(RecordingError):
    """The joints asked for were not recorded."""


class JointBatch:
    """Collects JointState messages of the same joints, and decodes them all at once.

    Decoded one by one, ten minutes at 1 kHz would take as long as they lasted. All messages of a
    publisher differ in stamp and numbers alone, so that one look at the first tells where the
    numbers are.
    """

    def __init__(self, topic: str, left_out: LeftOut) -> None:
        """Collect a topic's messages; `left_out` takes those that cannot be used."""
        self._topic, self._left_out = topic, left_out
        self._raw: list[bytes] = []
        self._arrivals: list[float] = []
        self._layout: JointLayout | None = None

    def fits(self, raw: bytes) -> bool:
        """Return whether a message may join the others."""
        return not self._raw or (
            self._layout is not None and self._layout.fits(raw, self._raw[0]))

    @property
    def full(self) -> bool:
        """Whether it is time for a chunk."""
        return len(self._raw) >= _CHUNK or len(self._raw) * len(self._raw[0]) >= _CHUNK_BYTES

    def add(self, arrival: float, raw: bytes) -> None:
        """Take in a message."""
        if not self._raw:
            try:
                self._layout = joint_layout(raw)
                self._problem = _problem_of(self._layout.names)
            except LayoutError as error:
                self._layout, self._problem = None, str(error)
        self._raw.append(raw)
        self._arrivals.append(arrival)

    def chunk(self, origin_ns: int) -> Iterator[JointChunk]:
        """Yield what was collected, if anything, and begin anew."""
        if not self._raw:
            return
        raws, arrivals = self._raw, np.array(self._arrivals)
        self._raw, self._arrivals = [], []
        if self._layout is None or self._problem:
            self._left_out.add(self._topic, self._problem, len(raws))
            return
        names, positions, velocities, order = self._layout[:4]
        block = np.frombuffer(b''.join(raws), np.uint8).reshape(len(raws), -1)

        def numbers(at: int, kind: str, count: int) -> npt.NDArray[Any]:
            size = np.dtype(kind).itemsize * count
            return np.ascontiguousarray(block[:, at:at + size]).view(order + kind)

        seconds = numbers(4, 'i4', 1)[:, 0].astype(np.int64)
        nanoseconds = seconds * 10**9 + numbers(8, 'u4', 1)[:, 0]
        stamps = (nanoseconds - origin_ns) * 1e-9
        stamps = np.where(nanoseconds > 0, stamps, arrivals)
        shape = len(raws), len(names)
        q = numbers(positions, 'f8', len(names)).astype(float)
        dq = (numbers(velocities, 'f8', len(names)).astype(float) if velocities
              else np.full(shape, np.nan))
        yield JointChunk(self._topic, names, arrivals, stamps, q, dq)


def _problem_of(names: Sequence[str]) -> str:
    """Return what is wrong with joint names, if anything."""
    if not names:
        return 'they name no joint'
    if len(names) > _JOINTS:
        return f'they name {len(names)} joints; {_JOINTS} at most are taken'
    if not all(name.isprintable() and len(name) <= _JOINTS for name in names):
        return 'their joint names are no text'
    return ''


class ChosenJoints:
    """Picks certain joints out of a topic's chunks, and leaves out what cannot be used."""

    def __init__(self, topic: str, names: Sequence[str], left_out: LeftOut) -> None:
        """Pick the joints of these names; without names those of the first chunk."""
        self.names = tuple(names)
        self._topic, self._left_out = topic, left_out
        self._seen: tuple[str, ...] = ()

    def of(self, chunk: JointChunk) -> JointChunk | None:
        """Return a chunk's joints and messages that can be used, None if there are none."""
        self.names = self.names or chunk.names
        self._seen = self._seen or chunk.names
        try:
            columns = columns_of(chunk.names, self.names)
        except JointsMissingError:
            self._left_out.add(self._topic, 'they are of other joints', len(chunk.stamps))
            return None
        q, dq = chunk.positions[:, columns], chunk.velocities[:, columns]
        # As in the node, which skips such a message; a comparison with NaN is false.
        fine = np.asarray((np.abs(q) <= LARGEST).all(axis=1))
        if not fine.all():
            self._left_out.add(self._topic, 'they have positions that are not finite, or beyond '
                               f'{LARGEST:g}', int((~fine).sum()))
        if not fine.any():
            return None
        dq = np.where(np.abs(dq) <= LARGEST, dq, np.nan)
        return JointChunk(chunk.topic, self.names, chunk.arrivals[fine], chunk.stamps[fine],
                          q[fine], dq[fine])

    def check_found(self) -> None:
        """Raise an error if the joints were never all there.

        Raises:
            JointsMissingError: naming those that were not recorded.
        """
        if self._seen:
            columns_of(self._seen, self.names)


def columns_of(recorded: Sequence[str], wanted: Sequence[str]) -> list[int]:
    """Return where the wanted joints stand among the recorded ones.

    Raises:
        JointsMissingError: a joint was not recorded.
    """
    missing = [name for name in wanted if name not in recorded]
    if missing:
        raise JointsMissingError(
            f'joints {missing} were not recorded; the bag has {list(recorded)}')
    return [list(recorded).index(name) for name in wanted]
