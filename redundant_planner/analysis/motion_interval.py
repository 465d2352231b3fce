"""When in a bag the arm moved, or was told to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.results import Curves

Array = npt.NDArray[np.float64]

# A joint moves where it is faster than this share of the motion's largest velocity.
_MOVING = 0.01
# Largest velocity of an arm at rest, by the noise of its encoders [rad/s, m/s].
_REST = 1e-3
# What is shown before and after the motion: a share of it, and at least this [s].
_MARGIN, _LEAST_MARGIN = 0.05, 0.1


def motion_interval(curves: Curves) -> tuple[float, float]:
    """Return the first and the last time [s] at which the arm moved or was commanded to.

    It goes by the commanded velocities where there are some, for the measured ones are noisy.
    The whole time is returned for an arm that never moves.
    """
    told = curves.commanded[0] if curves.commanded is not None else None
    speeds = curves.velocities
    if told is not None and np.nanmax(np.abs(told), initial=0.0) > _REST:
        speeds = told
    speed = np.nan_to_num(np.abs(speeds)).max(axis=1, initial=0.0)
    largest = float(speed.max(initial=0.0))
    moving = np.isfinite(curves.scale)
    if largest > _REST:
        moving = moving | (speed > _MOVING * largest)
    times = curves.times[moving]
    if not len(times) or times.max() <= times.min():
        times = curves.times
    return float(times.min()), float(times.max())


def command_begin(curves: Curves) -> float:
    """Return when the tip's command began [s], from which the report counts time.

    Two recordings of one command lie above each other so. Without a command it is the motion.
    """
    commanded = curves.times[np.isfinite(curves.scale)]
    return float(commanded.min()) if len(commanded) else motion_interval(curves)[0]


def shown_interval(curves: Curves) -> tuple[float, float]:
    """Return the motion's interval [s] with a margin on either side, within the recording."""
    begin, end = motion_interval(curves)
    margin = max(_MARGIN * (end - begin), _LEAST_MARGIN)
    return (max(begin - margin, float(curves.times.min())),
            min(end + margin, float(curves.times.max())))


def shown_together(several: Sequence[Curves]) -> tuple[float, float]:
    """Return what of several recordings is shown, from the begin of the command of each [s]."""
    shown = np.array([np.array(shown_interval(curves)) - command_begin(curves)
                      for curves in several])
    return float(shown[:, 0].min()), float(shown[:, 1].max())


def at_rest(velocities: Array, largest: Array) -> bool:
    """Return whether joints with velocities (n,) are at rest, beside their largest ones (n,)."""
    return bool((np.abs(velocities) <= np.maximum(_REST, _MOVING * largest)).all())
