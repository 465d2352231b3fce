"""Joints that were recorded in messages of several publishers, joined to postures of all of them.

A posture is that of a moment at which the joint that comes most often was measured. The other
joints are interpolated between their own measurements: held until the next one, they would seem
to move in leaps.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.io.joint_chunk import GAP, JointChunk
from redundant_planner.io.joint_turns import Unwrapping

Array = npt.NDArray[np.float64]

# The fields of a chunk that have a row for each message.
_ARRAYS = ('arrivals', 'stamps', 'positions', 'velocities', 'present')
# Messages that wait for a joint that was never measured.
_MOST_WAITING = 4096


class JointParts:
    """Joins parts as they are read from a bag."""

    def __init__(self) -> None:
        """Begin without any."""
        self._waiting: JointChunk | None = None
        self._base: int | None = None  # the joint whose moments count
        self._done = -np.inf  # until when postures were returned [s]

    def joined(self, chunk: JointChunk, unwrapping: Unwrapping) -> JointChunk | None:
        """Take messages of some of the joints; return the postures up to which all are known.

        Args:
            chunk: the messages, their columns all joints.
            unwrapping: of the joints.
        """
        measured = _held(np.vstack((unwrapping.measured, chunk.positions)))[1:]
        chunk = chunk._replace(
            positions=np.where(chunk.present, unwrapping.rows(measured), np.nan))
        found = []
        set_back = np.flatnonzero(np.diff(chunk.stamps) < -GAP) + 1
        for begin, end in zip((0, *set_back), (*set_back, len(chunk.stamps))):
            part = _rows(chunk, slice(begin, end))
            before = self._waiting
            if before is not None and part.stamps[0] < before.stamps[-1] - GAP:
                found.append(self.rest())
                before, self._done = None, -np.inf
            self._waiting = part if before is None else _together([before, part])
            found.append(self._known())
        known = [one for one in found if one is not None]
        return _together(known) if known else None

    def rest(self) -> JointChunk | None:
        """Return the postures that wait for other joints still."""
        return self._until(np.inf)

    def _known(self) -> JointChunk | None:
        waiting = self._waiting
        assert waiting is not None
        if not waiting.present.any(axis=0).all():
            self._waiting = _rows(waiting, slice(-_MOST_WAITING, None))
            return None
        times = np.maximum.accumulate(waiting.stamps)
        # No joint is waited for any longer than a pause.
        latest = min(times[there].max() for there in waiting.present.T)
        return self._until(max(float(latest), float(times[-1]) - GAP))

    def _until(self, end: float) -> JointChunk | None:
        """Return the postures up to a time [s], and keep what later ones need."""
        waiting = self._waiting
        if waiting is None or not waiting.present.any(axis=0).all():
            return None
        if self._base is None:
            self._base = int(waiting.present.sum(axis=0).argmax())
        times, present = np.maximum.accumulate(waiting.stamps), waiting.present
        first = max(times[there].min() for there in present.T)
        rows = present[:, self._base] & (times > self._done) & (times <= end) & (times >= first)
        at = times[rows]
        q, dq = (np.column_stack([
            np.interp(at, times[there], values[there, j])
            for j, there in enumerate(present.T)])
            for values in (waiting.positions, waiting.velocities))
        needed = min(int(np.flatnonzero(there & (times <= end)).max(initial=0))
                     for there in present.T)
        self._waiting = _rows(waiting, slice(needed, None))
        self._done = min(end, float(times[-1]))
        if not len(at):
            return None
        return waiting._replace(
            arrivals=waiting.arrivals[rows], stamps=waiting.stamps[rows], positions=q,
            velocities=dq, present=np.ones(q.shape, bool))


def _held(values: Array) -> Array:
    """Return rows (k, n) with the value before in place of NaN."""
    at = np.where(np.isnan(values), 0, np.arange(len(values))[:, None])
    return np.asarray(np.take_along_axis(values, np.maximum.accumulate(at), axis=0))


def _rows(chunk: JointChunk, rows: slice) -> JointChunk:
    return JointChunk(
        chunk.topic, chunk.names, *(getattr(chunk, name)[rows] for name in _ARRAYS))


def _together(chunks: list[JointChunk]) -> JointChunk:
    return JointChunk(chunks[0].topic, chunks[0].names, *(
        np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in _ARRAYS))
