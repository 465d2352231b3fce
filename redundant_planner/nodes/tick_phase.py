"""When ticks should come, seen from the controller that takes their positions.

A controller manager reads, updates its controllers and writes in each of its cycles, and says on
`joint_states` where the arm is. Where a command comes just before a cycle or just after it, some
cycles have two commands and others none: positions then stand still and make up for it. Half way
between two cycles no jitter of less than half a period matters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Fewer measurements tell nothing.
_ENOUGH = 50
# The measurements' period may differ from the ticks' by this share: others drift past each other.
_SAME_PERIOD = 0.05
# How closely the measurements must keep to their beat: the length of their mean as unit vectors.
_REGULAR = 0.8
# Commands within this share of the period of the middle stay where they are.
_NEAR = 0.15


def delay_to_middle(measured: Sequence[float], due: float, period: float) -> float:
    """Return by how much commands should come later to fall half way between measurements [s].

    Args:
        measured: when the latest measurements were sent, of one clock with `due` [s].
        due: when a command was, infinite before the first [s].
        period: of the commands [s].

    Returns:
        0 to `period`; 0 also where the measurements have no beat of that period.
    """
    if len(measured) < _ENOUGH or not np.isfinite(due):
        return 0.0
    times = np.asarray(measured)
    if abs(float(np.median(np.diff(times))) / period - 1.0) > _SAME_PERIOD:
        return 0.0
    mean = np.exp(2j * np.pi * (times - due) / period).mean()
    # How long after a command the next measurement comes, as a share of the period.
    after = float(np.angle(mean)) / (2.0 * np.pi) % 1.0
    if abs(mean) < _REGULAR or abs(after - 0.5) < _NEAR:
        return 0.0
    return (after + 0.5) % 1.0 * period
