"""Joint states from a bag, many messages at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.io.joint_layout import joint_layout, JointLayout, LayoutError
from redundant_planner.io.joint_parts import JointParts
from redundant_planner.io.joint_turns import Seams, Unwrapping
from redundant_planner.io.left_out import LeftOut
from redundant_planner.io.plausible import LARGEST

Array = npt.NDArray[np.float64]

# Messages of a joint topic that are taken together.
_CHUNK = 4096
# And that many bytes of them.
_CHUNK_BYTES = 32_000_000
# Publishers whose messages are taken together.
_MOST_KINDS = 64
# More joints than any machine has: such a message is damaged.
_JOINTS = 256


class JointsMissingError(RecordingError):
    """The joints asked for were not recorded."""


class _Kind:
    """Messages of one layout: their bytes, and which of all they were."""

    def __init__(self, raw: bytes) -> None:
        """Begin with the layout of the first one."""
        self.first = raw
        self.layout: JointLayout | None = None
        self.raws: list[bytes] = []
        self.places: list[int] = []
        try:
            self.layout = joint_layout(raw)
            self.problem = _problem_of(self.layout.names)
        except LayoutError as error:
            self.problem = str(error)

    def fits(self, raw: bytes) -> bool:
        """Return whether a message has this layout."""
        return self.layout is not None and self.layout.fits(raw, self.first)

    def numbers(self, at: int, kind: str, count: int) -> npt.NDArray[Any]:
        """Return so many numbers of all messages from a place on (k, count)."""
        assert self.layout is not None
        size = np.dtype(kind).itemsize * count
        block = np.frombuffer(b''.join(self.raws), np.uint8).reshape(len(self.raws), -1)
        return np.ascontiguousarray(block[:, at:at + size]).view(self.layout.order + kind)


class JointBatch:
    """Collects JointState messages, and decodes them all at once.

    Decoded one by one, ten minutes at 1 kHz would take as long as they lasted. All messages of a
    publisher differ in stamp and numbers alone, so that one look at the first tells where the
    numbers are.
    """

    def __init__(self, topic: str, left_out: LeftOut) -> None:
        """Collect a topic's messages; `left_out` takes those that cannot be used."""
        self._topic, self._left_out = topic, left_out
        self._begin()

    def _begin(self) -> None:
        self._kinds: list[_Kind] = []
        self._arrivals: list[float] = []
        self._bytes = 0

    @property
    def full(self) -> bool:
        """Whether it is time for a chunk."""
        return (len(self._arrivals) >= _CHUNK or self._bytes >= _CHUNK_BYTES
                or len(self._kinds) >= _MOST_KINDS)

    def add(self, arrival: float, raw: bytes) -> None:
        """Take in a message."""
        kind = next((kind for kind in self._kinds if kind.fits(raw)), None)
        if kind is None:
            kind = _Kind(raw)
            self._kinds.append(kind)
        kind.raws.append(raw)
        kind.places.append(len(self._arrivals))
        self._arrivals.append(arrival)
        self._bytes += len(raw)

    def chunk(self, origin_ns: int) -> Iterator[JointChunk]:
        """Yield what was collected, if anything, and begin anew."""
        kinds, arrivals = self._kinds, np.array(self._arrivals)
        self._begin()
        for kind in kinds:
            if kind.problem:
                self._left_out.add(self._topic, kind.problem, len(kind.raws))
        kinds = [kind for kind in kinds if not kind.problem]
        if not kinds:
            return
        names = tuple(dict.fromkeys(
            name for kind in kinds if kind.layout for name in kind.layout.names))
        count = len(arrivals)
        stamps = arrivals.copy()
        q, dq = np.full((2, count, len(names)), np.nan)
        present = np.zeros((count, len(names)), bool)
        for kind in kinds:
            assert kind.layout is not None
            own, positions, velocities, _ = kind.layout[:4]
            seconds = kind.numbers(4, 'i4', 1)[:, 0].astype(np.int64)
            nanoseconds = seconds * 10**9 + kind.numbers(8, 'u4', 1)[:, 0]
            stamps[kind.places] = np.where(
                nanoseconds > 0, (nanoseconds - origin_ns) * 1e-9, arrivals[kind.places])
            where = np.ix_(kind.places, [names.index(name) for name in own])
            present[where] = True
            q[where] = kind.numbers(positions, 'f8', len(own))
            if velocities:
                dq[where] = kind.numbers(velocities, 'f8', len(own))
        rows = present.any(axis=1)
        yield JointChunk(self._topic, names, arrivals[rows], stamps[rows], q[rows], dq[rows],
                         present[rows])


def _problem_of(names: Sequence[str]) -> str:
    """Return what is wrong with joint names, if anything."""
    if not names:
        return 'they name no joint'
    if len(names) > _JOINTS:
        return f'they name {len(names)} joints; {_JOINTS} at most are taken'
    if len(set(names)) < len(names):
        return 'they name a joint twice'
    if not all(name.isprintable() and len(name) <= _JOINTS for name in names):
        return 'their joint names are no text'
    return ''


class ChosenJoints:
    """Picks certain joints out of a topic's chunks, and leaves out what cannot be used.

    Positions that a driver wraps go on as the joints turned. Where joints come in messages of
    several publishers, each posture is that of a moment at which the joint that comes most often
    was measured; the others are interpolated.
    """

    def __init__(
        self, topic: str, names: Sequence[str], left_out: LeftOut, seams: Seams | None = None,
    ) -> None:
        """Pick the joints of these names; without names those of the first message."""
        self.names = tuple(names)
        self._topic, self._left_out = topic, left_out
        self._seen: tuple[str, ...] = ()
        self._seams, self._unwrapping = seams, None if seams is None else Unwrapping(seams)
        self._parts: JointParts | None = None

    def of(self, chunk: JointChunk) -> JointChunk | None:
        """Return the postures of a chunk that can be used; None if there are none.

        In parts, those that wait for other joints come later.
        """
        self.names = self.names or tuple(
            name for name, there in zip(chunk.names, chunk.present[0]) if there)
        self._seen = tuple(dict.fromkeys((*self._seen, *chunk.names)))
        count, n = len(chunk.stamps), len(self.names)
        columns = [chunk.names.index(name) for name in self.names if name in chunk.names]
        ours = [name in chunk.names for name in self.names]
        q, dq = np.full((2, count, n), np.nan)
        present = np.zeros((count, n), bool)
        q[:, ours], dq[:, ours] = chunk.positions[:, columns], chunk.velocities[:, columns]
        present[:, ours] = chunk.present[:, columns]
        # As in the node, which skips such a message; a comparison with NaN is false.
        fine = np.asarray(((np.abs(q) <= LARGEST) | ~present).all(axis=1))
        others = ~present.any(axis=1)
        for rows, problem in (
                (others, 'they are of other joints'),
                (~fine, f'they have positions that are not finite, or beyond {LARGEST:g}')):
            if rows.any():
                self._left_out.add(self._topic, problem, int(rows.sum()))
        fine &= ~others
        if not fine.any():
            return None
        dq = np.where(np.abs(dq) <= LARGEST, dq, np.nan)
        found = JointChunk(chunk.topic, self.names, chunk.arrivals[fine], chunk.stamps[fine],
                           q[fine], dq[fine], present[fine])
        if self._unwrapping is None:
            self._unwrapping = Unwrapping(self._seams or Seams.unknown(n))
        if self._parts is None and found.present.all():
            return found._replace(positions=self._unwrapping.rows(found.positions))
        if self._parts is None:
            self._parts = JointParts()
        return self._parts.joined(found, self._unwrapping)

    def rest(self) -> JointChunk | None:
        """Return the postures that wait for other joints still, at the end."""
        return None if self._parts is None else self._parts.rest()

    def check_found(self) -> None:
        """Raise an error if a joint was never there.

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
