"""Which voxels are occupied: what the last clouds have shown, each for as long as it counts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from redundant_planner.perception.voxel_grid import Keys

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# A cloud older than the newest one by more than this comes from a clock that was set back [s].
_SET_BACK = 1.0


class VoxelMemory:
    """Occupied voxels and when each was last seen.

    Attributes:
        keys: (k,) the voxels, ascending.
        seen_at: (k,) stamps of the last clouds with enough points in them [s].
        now: stamp of the newest cloud [s].
    """

    def __init__(self) -> None:
        """Begin without voxels."""
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self.keys: Keys = np.empty(0, np.intp)
        self.seen_at: Array = np.empty(0)
        self.now = -np.inf

    def update(
        self, seen: Keys, stamp: float, persistence: float,
        judge: Callable[[Keys], tuple[Flags, Flags]],
    ) -> None:
        """Take in what a cloud has shown.

        Args:
            seen: (s,) different voxels with enough points.
            stamp: of the cloud [s].
            persistence: how long an unseen voxel stays [s].
            judge: of voxels that the cloud does not show, returns which are certainly free, and
                which it cannot say anything about; the latter do not age.
        """
        if stamp < self.now - _SET_BACK:
            self.seen_at = np.full(len(self.keys), stamp)
            self.now = stamp
        self.now = max(self.now, stamp)
        seen = np.sort(seen)
        shown = _contains(seen, self.keys)
        old, seen_at = self.keys[~shown], self.seen_at[~shown]
        free, beyond_judgement = judge(old)
        seen_at[beyond_judgement] = self.now
        kept = ~free & (seen_at >= self.now - persistence)
        keys = np.concatenate([seen, old[kept]])
        seen_at = np.concatenate([np.full(len(seen), self.now), seen_at[kept]])
        order = np.argsort(keys, kind='stable')
        self.keys, self.seen_at = keys[order], seen_at[order]

    def keep(self, chosen: Flags) -> None:
        """Forget the voxels that are not marked (k,)."""
        self.keys, self.seen_at = self.keys[chosen], self.seen_at[chosen]


def _contains(sorted_keys: Keys, keys: Keys) -> Flags:
    """Return which keys (k,) are among sorted ones."""
    if not len(sorted_keys):
        return np.zeros(len(keys), dtype=bool)
    place = np.minimum(np.searchsorted(sorted_keys, keys), len(sorted_keys) - 1)
    return np.asarray(sorted_keys[place] == keys)
