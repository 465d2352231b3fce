"""Successive joint states of a bag."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Joint states further apart belong to two motions: nothing was commanded between them [s].
GAP = 1.0


class JointChunk(NamedTuple):
    """Successive JointState messages of one topic, of any publishers.

    Attributes:
        topic: without its namespace.
        names: joint names, the order of the columns.
        arrivals: (k,) when they were recorded [s].
        stamps: (k,) of their headers, `arrivals` where there are none [s].
        positions: (k, n) [rad, m].
        velocities: (k, n) [rad/s, m/s], NaN where there are none.
        present: (k, n) whether a message has a joint. Without it, both are NaN.
    """

    topic: str
    names: tuple[str, ...]
    arrivals: Array
    stamps: Array
    positions: Array
    velocities: Array
    present: npt.NDArray[np.bool_]
