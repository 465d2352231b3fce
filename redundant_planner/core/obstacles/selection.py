"""The value that a given number of others do not exceed."""

from __future__ import annotations

import math

from redundant_planner.core.kernels import compiled, Vector


@compiled
def kth_smallest(values: Vector, k: int) -> float:
    """Return `np.sort(values)[k]` without sorting (Hoare's selection).

    At most k values are smaller. A NaN counts as infinite. np.partition does the same, but Numba
    needs a twentieth of all compile time for it.

    Args:
        values: (n,), left as they are.
        k: 0 to n - 1.
    """
    kept = values.copy()
    for i in range(len(kept)):
        if math.isnan(kept[i]):
            kept[i] = math.inf
    left, right = 0, len(kept) - 1
    while left < right:
        first, middle, last = kept[left], kept[(left + right) // 2], kept[right]
        pivot = max(min(first, middle), min(max(first, middle), last))
        i, j = left, right
        while i <= j:
            while kept[i] < pivot:
                i += 1
            while kept[j] > pivot:
                j -= 1
            if i <= j:
                kept[i], kept[j] = kept[j], kept[i]
                i += 1
                j -= 1
        if k >= i:
            left = i
        elif k <= j:
            right = j
        else:
            break
    return kept[k]
