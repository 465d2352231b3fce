"""Where the arm was at a moment: its measured postures, by their stamps."""

from __future__ import annotations

from bisect import bisect_left
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# How long postures are kept: a cloud that comes later than this after its stamp has no use [s].
_KEPT = 5.0
_MOST_KEPT = 10_000
# A stamp older than the newest one by more than this comes from a clock that was set back [s].
_SET_BACK = 0.3
# Postures further apart than this say too little about what the arm did in between [s].
LONGEST_GAP = 0.1


class Fit(Enum):
    """What the buffer can say about a moment."""

    KNOWN = 'known'
    TOO_EARLY_TO_SAY = 'the moment is later than every posture'
    TOO_OLD = 'the moment is earlier than every posture'
    GAP = 'the postures around the moment are too far apart'


class Posture(NamedTuple):
    """The arm at a moment.

    Attributes:
        fit: whether the rest says anything.
        q: (n,) posture [rad, m].
        speed: (n,) the largest speed of each joint around that moment [rad/s, m/s].
        away: from the moment to the nearest posture that was asked too early or too late for, or
            between the postures that are too far apart [s].
    """

    fit: Fit
    q: Array
    speed: Array
    away: float


class PostureBuffer:
    """The postures of the last seconds."""

    def __init__(self, velocity_max: Array) -> None:
        """Begin empty.

        Args:
            velocity_max: (n,) bounds what differences of postures say, whose stamps may be
                close together [rad/s, m/s].
        """
        self._velocity_max = velocity_max
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._stamps: list[float] = []
        self._postures: list[tuple[Array, Array | None]] = []

    def __len__(self) -> int:
        """Return the number of postures."""
        return len(self._stamps)

    def add(self, stamp: float, q: Array, dq: Array | None) -> bool:
        """Take in a measurement.

        Args:
            stamp: of the message [s].
            q: (n,) posture [rad, m].
            dq: (n,) velocities [rad/s, m/s], None where the message has none.

        Returns:
            Whether the clock was set back, so that all earlier ones are forgotten.
        """
        set_back = bool(self._stamps) and stamp < self._stamps[-1] - _SET_BACK
        if set_back:
            self.clear()
        elif self._stamps and stamp <= self._stamps[-1]:
            return False
        self._stamps.append(stamp)
        self._postures.append((q, dq))
        if len(self._stamps) > 2 * _MOST_KEPT or self._stamps[0] < stamp - 2.0 * _KEPT:
            old = max(bisect_left(self._stamps, stamp - _KEPT), len(self._stamps) - _MOST_KEPT)
            del self._stamps[:old], self._postures[:old]
        return set_back

    def at(self, stamp: float) -> Posture:
        """Return the arm at a moment [s]: between two measurements, by interpolation."""
        stamps, nothing = self._stamps, np.empty(0)
        if not stamps or stamp > stamps[-1]:
            away = stamp - stamps[-1] if stamps else np.inf
            return Posture(Fit.TOO_EARLY_TO_SAY, nothing, nothing, away)
        if stamp < stamps[0]:
            return Posture(Fit.TOO_OLD, nothing, nothing, stamps[0] - stamp)
        after = bisect_left(stamps, stamp)
        before = max(after - 1, 0)
        gap = stamps[after] - stamps[before]
        if gap > LONGEST_GAP and stamp < stamps[after]:
            return Posture(Fit.GAP, nothing, nothing, gap)
        (q0, dq0), (q1, dq1) = self._postures[before], self._postures[after]
        share = (stamp - stamps[before]) / gap if gap > 0.0 else 1.0
        speed = np.zeros(len(q1))
        if 0.0 < gap <= LONGEST_GAP:
            speed = np.minimum(np.abs(q1 - q0) / gap, self._velocity_max)
        for dq in (dq0, dq1):
            if dq is not None:
                speed = np.maximum(speed, np.abs(dq))
        return Posture(Fit.KNOWN, q0 + share * (q1 - q0), speed, 0.0)


class PosturesInParts:
    """The postures of the last seconds of n joints that are measured in any parts."""

    def __init__(self, velocity_max: Array) -> None:
        """Begin empty; `velocity_max` (n,) as for `PostureBuffer`."""
        self._velocity_max = velocity_max
        self._parts: dict[tuple[int, ...], PostureBuffer] = {}

    def add(
        self, stamp: float, which: npt.NDArray[np.intp], q: Array, dq: Array | None,
    ) -> bool:
        """Take in a measurement of some joints.

        Args:
            stamp: of the message [s].
            which: (k,) the joints, by number.
            q, dq: (k,) as for `PostureBuffer.add`.

        Returns:
            Whether the clock was set back.
        """
        part = tuple(which.tolist())
        if part not in self._parts:
            self._parts[part] = PostureBuffer(self._velocity_max[which])
        return self._parts[part].add(stamp, q, dq)

    def at(self, stamp: float) -> Posture:
        """Return the arm at a moment [s], each part between two measurements of its own."""
        n = len(self._velocity_max)
        q, speed = np.full(n, np.nan), np.zeros(n)
        unknown = Posture(Fit.TOO_EARLY_TO_SAY, np.empty(0), np.empty(0), np.inf)
        unfit: list[tuple[list[int], Posture]] = []
        for part, buffer in self._parts.items():
            found, joints = buffer.at(stamp), list(part)
            if found.fit is Fit.KNOWN:
                q[joints], speed[joints] = found.q, np.maximum(found.speed, speed[joints])
            else:
                unfit.append((joints, found))
        lacking = np.isnan(q)
        if not lacking.any():
            return Posture(Fit.KNOWN, q, speed, 0.0)
        reasons = [found for joints, found in unfit if lacking[joints].any()]
        # What may still come is waited for.
        return min(reasons, key=lambda found: found.fit is not Fit.TOO_EARLY_TO_SAY,
                   default=unknown)
