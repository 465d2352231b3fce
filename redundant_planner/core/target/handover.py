"""From where the arm is, and how it moves, to a curve that goes on: without a jump.

The difference between the two fades away along the curve: gently, so that a policy that changes
its mind does not shake the arm. It takes longer than `_GENTLE_TIME`, or swings out further than
`_SWING`, only where the limits ask for that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.smooth_curve import Fading, Motion, SmoothCurve

Array = npt.NDArray[np.float64]

# Shares of the acceleration limits: that a gentle handover takes, besides what the curve does, and
# that both together may take in any; of the velocity limits likewise. Half of either is the
# difference's where the curve itself asks for too much.
_GENTLE, _MOST, _FASTEST, _HALF = 0.04, 0.85, 0.95, 0.5
# The shortest handover, and how long a gentle one is at most [s].
_SHORTEST, _GENTLE_TIME = 0.04, 1.2
# How far joints may swing out beyond the largest difference there is, for the sake of gentleness
# [rad, m].
_SWING = 0.05
# Durations are tried in turn, each so many times the one before, up to the longest [s].
_LONGER, _LONGEST = 1.2, 60.0
# Moments of a handover that are looked at.
_LOOKS = np.linspace(0.0, 1.0, 21)
# A curve that ends before the difference is gone comes to rest for so long at its end [s].
_BRAKING = 0.2
# An arm whose coordinates change no faster is at rest: its acceleration may jump [rad/s, m/s].
_AT_REST = 1e-3
# A curve that is too fast begins at the share of its pace that the arm moves at; for what the arm
# moves by beside it, no less than this counts.
_LEAST_SHARE = 0.5


def handover(
    moving: Motion, now: Motion, curve: Callable[[Array], Motion], limits: Limits, least: float,
    joints: Array | None = None,
) -> tuple[Fading, float]:
    """Return the difference between the arm and a curve, as it fades away.

    Args:
        moving: (c,) the arm's motion.
        now: (c,) the curve's.
        curve: the motion of the joints (N, n) at times (N,) from now, without the difference.
        limits: of the joints.
        least: how long it takes at least [s].
        joints: (n, c) what a change of the coordinates asks of the joints; None for the joints'
            own coordinates.

    Returns:
        The difference, and at which share of the curve's pace the arm begins.
    """
    place, rate, bend = (arm - ours for arm, ours in zip(moving, now))
    if np.abs(moving.rate).max() < _AT_REST:
        bend = np.zeros_like(bend)
    whole = Motion(place, rate, bend)
    if not any(part.any() for part in whole):
        return Fading.of(whole, max(least, _SHORTEST)), 1.0
    velocity, acceleration = limits.velocity_max, limits.acceleration_max
    long_enough, before = max(least, _GENTLE_TIME), None
    for fading, alone in _tries(whole, least, joints):
        along = curve(fading.duration * _LOOKS)
        # As the difference begins is given; what it does later is not.
        possible = bool(
            (np.abs(alone.rate + along.rate) <= _FASTEST * velocity).all()
            and (np.abs(alone.bend + along.bend)[1:] <= _MOST * acceleration).all())
        gentle = bool((np.abs(alone.bend[1:]) <= _GENTLE * acceleration).all())
        away = np.abs(alone.position)
        if before is not None and away.max() > away[0].max() + _SWING:
            return before, 1.0
        if possible and (gentle or fading.duration >= long_enough):
            return fading, 1.0
        before = fading if possible else None
        if fading.duration >= long_enough and _is_easy(alone, limits):
            break  # the curve itself asks for too much
    squared = float(now.rate @ now.rate)
    share = min(max(float(moving.rate @ now.rate) / squared, 0.0), 1.0) if squared else 1.0
    beside = (moving.rate - share * now.rate) / max(share, _LEAST_SHARE)
    tries = list(_tries(Motion(place, beside, np.zeros_like(bend)), least, joints))
    return next((fading for fading, alone in tries if _is_easy(alone, limits)),
                tries[-1][0]), share


def _tries(
    difference: Motion, least: float, joints: Array | None,
) -> Iterator[tuple[Fading, Motion]]:
    """Yield ever longer handovers, and what they alone ask of the joints at `_LOOKS`."""
    duration = max(least, _SHORTEST)
    while duration < _LONGEST or duration == least:
        fading = Fading.of(difference, duration)
        alone = fading.at(duration * _LOOKS)
        yield fading, alone if joints is None else Motion(*(part @ joints.T for part in alone))
        duration *= _LONGER


def _is_easy(alone: Motion, limits: Limits) -> bool:
    """Return whether a difference leaves half of the limits for the curve."""
    return bool((np.abs(alone.rate) <= _HALF * limits.velocity_max).all()
                and (np.abs(alone.bend) <= _HALF * limits.acceleration_max).all())


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
