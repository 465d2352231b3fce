"""What happened over time, in a bounded amount of memory however long the bag is."""

from __future__ import annotations

import array

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.scene import Scene

Array = npt.NDArray[np.float64]

# Rows are thinned out to at most this many, and so many numbers.
_SAMPLES = 40_000
_NUMBERS = 8_000_000
# Obstacles that are kept, all their places counted.
_OBSTACLES = 200_000


class ThinnedRows:
    """Rows of numbers, every second one dropped whenever there are too many.

    The last column is the smallest of what is dropped as well.
    """

    def __init__(self, width: int) -> None:
        """Begin without rows.

        Args:
            width: numbers in a row.
        """
        self._rows = np.empty((min(2 * _SAMPLES, _NUMBERS // width), width))
        self._count, self._stride, self._skip = 0, 1, 0
        self._lowest = np.inf

    def add(self, rows: Array) -> None:
        """Add rows (k, width)."""
        for row in rows if self._stride > 1 else ():
            self._lowest = min(self._lowest, row[-1])
            self._skip += 1
            if self._skip >= self._stride:
                self._append(row[None])
                self._rows[self._count - 1, -1] = self._lowest
                self._skip, self._lowest = 0, np.inf
        if self._stride == 1:
            self._append(rows)

    def _append(self, rows: Array) -> None:
        while self._count + len(rows) > len(self._rows):
            kept = self._rows[:self._count]
            lowest = np.minimum(kept[:-1:2, -1], kept[1::2, -1])
            half = len(lowest)
            self._rows[:half] = kept[1::2]
            self._rows[:half, -1] = lowest
            self._count, self._stride = half, 2 * self._stride
        self._rows[self._count:self._count + len(rows)] = rows
        self._count += len(rows)

    def rows(self) -> Array:
        """Return the rows that were kept."""
        return self._rows[:self._count].copy()


class HeldTwists:
    """The twists that held, without repetitions: from when to when, and six numbers."""

    def __init__(self, timeout: float) -> None:
        """Begin without any.

        Args:
            timeout: how long a twist holds without another one [s].
        """
        self._timeout = timeout
        self._rows = array.array('d')  # 8 numbers each: a long bag has millions

    def add(self, time: float, twist: Array) -> None:
        """Add a twist (6,) that arrived at a time [s]."""
        rows = self._rows
        if rows:
            rows[-7] = min(rows[-7], time)
            if rows[-7] >= time - 1e-12 and rows[-6:].tolist() == twist.tolist():
                rows[-7] = time + self._timeout
                return
        rows.extend((time, time + self._timeout, *twist.tolist()))

    def end(self, time: float) -> None:
        """Have the latest twist hold no longer than until a time [s]."""
        if self._rows:
            self._rows[-7] = min(self._rows[-7], time)

    def at(self, times: Array) -> Array:
        """Return the twists (k, 6) at times (k,); zero where none held."""
        if not self._rows:
            return np.zeros((len(times), 6))
        rows = np.frombuffer(self._rows).reshape(-1, 8)
        index = np.searchsorted(rows[:, 0], times, side='right') - 1
        holds = (index >= 0) & (times < rows[index, 1])
        return np.where(holds[:, None], rows[index, 2:], 0.0)


class KeptScenes:
    """How the obstacles stood from when on, every second time dropped when it is too much.

    Attributes:
        kept: from when on [s], and the scene.
    """

    def __init__(self, scene: Scene) -> None:
        """Begin with the scene at time 0."""
        self.kept: list[tuple[float, Scene]] = [(0.0, scene)]
        self._stride, self._seen = 1, 0

    def add(self, time: float, scene: Scene) -> None:
        """Add the scene from a time on [s]; nothing happens if it is the latest."""
        if scene is self.kept[-1][1]:
            return
        self._seen += 1
        if self._seen % self._stride == 0:
            self.kept.append((time, scene))
        if (len(scene.names) + 1) * len(self.kept) > _OBSTACLES:
            self.kept[1:] = self.kept[2::2]
            self._stride *= 2
