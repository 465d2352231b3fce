"""From where the arm is, and how it moves, to a curve that goes on: without a jump.

The difference between the two fades away along the curve: gently, so that a policy that changes its
mind does not shake the arm, but no longer than `_GENTLE_TIME`, unless the limits ask for that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.smooth_curve import Fading, Motion, SmoothCurve

Array = npt.NDArray[np.float64]

# Shares of the acceleration limits: that a gentle handover takes, besides what the curve does, and
# that both together may take in any; of the velocity limits likewise.
_GENTLE, _MOST, _FASTEST = 0.04, 0.85, 0.95
# The shortest handover, and how long a gentle one is at most [s].
_SHORTEST, _GENTLE_TIME = 0.04, 0.8
# Durations are tried in turn, each so many times the one before, up to the longest [s].
_LONGER, _LONGEST = 1.2, 60.0
# Moments of a handover that are looked at.
_LOOKS = np.linspace(0.0, 1.0, 21)
# A curve that ends before the difference is gone comes to rest for so long at its end [s].
_BRAKING = 0.2


def handover(
    difference: Motion, curve: Callable[[Array], Motion], limits: Limits, least: float,
    joints: Array | None = None,
) -> Fading:
    """Return the difference between the arm and a curve, as it fades away.

    Args:
        difference: (c,) the arm's motion minus the curve's, now.
        curve: the motion of the joints (N, n) at times (N,) from now, without the difference.
        limits: of the joints.
        least: how long it takes at least [s].
        joints: (n, c) what a change of the coordinates asks of the joints; None for the joints'
            own coordinates.
    """
    if all(not part.any() for part in difference):
        return Fading.of(difference, max(least, _SHORTEST))
    long_enough = max(least, _GENTLE_TIME)
    duration, fading = max(least, _SHORTEST), None
    while True:
        fading = Fading.of(difference, duration)
        times = duration * _LOOKS
        alone, along = fading.at(times), curve(times)
        rate, bend = alone.rate, alone.bend
        if joints is not None:
            rate, bend = rate @ joints.T, bend @ joints.T
        # As the difference begins and ends is given; what it does in between is not.
        gentle = (np.abs(bend[1:]) <= _GENTLE * limits.acceleration_max).all()
        possible = (
            (np.abs(rate + along.rate) <= _FASTEST * limits.velocity_max).all()
            and (np.abs(bend + along.bend)[1:] <= _MOST * limits.acceleration_max).all())
        if (possible and (gentle or duration >= long_enough)) or duration >= _LONGEST:
            return fading
        if duration >= long_enough and (
                np.abs(rate) <= 0.5 * limits.velocity_max).all() and (
                np.abs(bend) <= 0.5 * limits.acceleration_max).all():
            return fading  # the curve itself asks for too much: its pace gives way
        duration *= _LONGER


def rested(curve: SmoothCurve, begin: float, fading: Fading) -> SmoothCurve:
    """Return a curve that comes to rest smoothly where a difference outlasts it.

    Args:
        curve: which.
        begin: where on it the difference begins [s].
        fading: the difference.
    """
    if begin + fading.duration <= curve.end:
        return curve
    return curve.coming_to_rest(min(_BRAKING, 0.5 * (curve.end - begin)))
