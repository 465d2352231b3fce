"""Numbers from files and parameters, which may hold anything."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def floats_of(values: Any) -> Array:
    """Return a number or a list of them as floats; a single NaN where it is something else."""
    # A list of lists of lists may stand for more numbers than there is memory.
    if isinstance(values, Sequence) and any(isinstance(value, Sequence) for value in values):
        return np.array(np.nan)
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.array(np.nan)
