"""What the drives were told: velocity, acceleration and jerk of the commands in a bag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.bounded_series import ThinnedRows
from redundant_planner.io.joint_chunk import GAP

Array = npt.NDArray[np.float64]

# Commands slower than this are none whose positions tell periods [rad/s, m/s].
_SLOW = 1e-3


@dataclass(frozen=True)
class CommandPeaks:
    """The largest of every joint's commands, (n,) each [rad/s, m/s; per s²; per s³]."""

    velocity: Array
    acceleration: Array
    jerk: Array


class Commands:
    """Velocity commands of n joints, taken in chunk by chunk.

    A command holds until the next one. The planner limits what changes from one to the next by its
    period, however late a busy machine has it send one or the other. So two successive commands
    are one period apart, unless others between them were lost.
    """

    def __init__(self, n: int, period: float | None) -> None:
        """Begin without commands.

        Args:
            n: number of joints.
            period: of the planner [s]; None to take the median of what is found.
        """
        self._period = period
        self._rows = ThinnedRows(2 * n + 2)
        self._last: tuple[float, Array, Array] | None = None
        self._acceleration: Array = np.full(n, np.nan)
        self._peaks = np.zeros((3, n))
        self.count = 0

    def add(self, stamps: Array, q: Array, dq: Array) -> None:
        """Take in commands: stamps (k,) [s], positions and velocities (k, n) [rad, m; per s].

        Those without velocities, and those of before the last one, are left out.
        """
        known = np.isfinite(dq).all(axis=1)
        stamps, q, dq = stamps[known], q[known], dq[known]
        if self._last is not None:
            stamps = np.append(self._last[0], stamps)
            q, dq = np.vstack((self._last[1], q)), np.vstack((self._last[2], dq))
        ahead = np.ones(len(stamps), bool)
        ahead[1:] = stamps[1:] > np.maximum.accumulate(stamps)[:-1]
        stamps, q, dq = stamps[ahead], q[ahead], dq[ahead]
        fresh = slice(0 if self._last is None else 1, None)
        if not len(stamps[fresh]):
            return
        steps = np.diff(stamps)
        period = self._period or (float(np.median(steps)) if len(steps) else 0.0)
        # Of a pause nobody knows how fast the arm was.
        elapsed = np.where(steps <= GAP, period * _periods_between(steps, q, dq, period), np.nan)
        elapsed = elapsed[:, None]
        with np.errstate(divide='ignore', invalid='ignore'):
            acceleration = np.diff(dq, axis=0) / elapsed
            before = np.vstack((self._acceleration, acceleration[:-1]))
            jerk = (acceleration - before)[:len(acceleration)] / elapsed
        for row, values in enumerate((dq[fresh], acceleration, jerk)):
            largest = np.abs(np.where(np.isfinite(values), values, 0.0)).max(axis=0, initial=0.0)
            self._peaks[row] = np.maximum(self._peaks[row], largest)
        if self._last is None:
            acceleration = np.vstack((self._acceleration, acceleration))
        taken = stamps[fresh], dq[fresh]
        self._rows.add(np.column_stack((*taken, acceleration, np.zeros(len(taken[0])))))
        self._last, self._acceleration = (float(stamps[-1]), q[-1], dq[-1]), acceleration[-1]
        self.count += len(taken[0])

    @property
    def peaks(self) -> CommandPeaks:
        """The largest of all."""
        return CommandPeaks(*self._peaks)

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return the velocities and accelerations (k, n) that held at times (k,); NaN for none."""
        rows = self._rows.rows()
        n = (rows.shape[1] - 2) // 2
        if not len(rows):
            return np.full((len(times), n), np.nan), np.full((len(times), n), np.nan)
        index = np.searchsorted(rows[:, 0], times, side='right') - 1
        # The last command before a pause holds for no longer than any other.
        reach = GAP if len(rows) < 2 else 2.0 * float(np.median(np.diff(rows[:, 0])))
        holds = (index >= 0) & (times - rows[index, 0] <= max(reach, 1e-9))
        held = np.where(holds[:, None], rows[index], np.nan)
        return held[:, 1:1 + n], held[:, 1 + n:-1]


def _periods_between(steps: Array, q: Array, dq: Array, period: float) -> Array:
    """Return how many periods each command (k,) is after the one before: 1, or more if some lack.

    The stamps alone cannot tell a late command from one after others that were lost. Positions
    can: they have gone on by so many periods' motion. Of an arm that hardly moves, and of one
    without positions, no command counts as lost.

    Args:
        steps: between the stamps [s].
        q, dq: (k + 1, n) commanded positions and velocities.
        period: [s].
    """
    mean = 0.5 * (dq[1:] + dq[:-1])
    squared = period * (mean * mean).sum(axis=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        gone = (np.diff(q, axis=0) * mean).sum(axis=1) / squared
        late = np.rint(steps / period)
    gone = np.where((squared > period * _SLOW ** 2) & np.isfinite(gone), np.rint(gone), 1.0)
    return np.asarray(np.clip(np.minimum(gone, late), 1.0, None))
