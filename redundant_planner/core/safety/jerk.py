"""Jerk: what is commanded is the mean of the velocities planned last (docs/safety.md).

With planned accelerations within ±a, the mean over a window W has a jerk of 2a/W at most, and it
keeps every limit of position, velocity and acceleration that the planned motion keeps.
"""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.kernels import compiled, Matrix, OutMatrix, OutVector, Vector
from redundant_planner.core.safety.limits import braked, can_stop, Limits

Array = npt.NDArray[np.float64]

# A window takes as many ticks as there are in up to a second [s].
_SHORTEST_TICK, _LONGEST_TICK = 1e-4, 10.0
# A window of so many ticks, and round-off: no tick more for that.
_ROUND_OFF = 1e-6


def check_tick(dt: float) -> None:
    """Raise a StateError if a tick is shorter or longer than the planner takes [s]."""
    if not dt >= _SHORTEST_TICK:
        raise StateError(f'dt is {dt}; it must be {_SHORTEST_TICK:g} s or longer')
    if dt > _LONGEST_TICK:
        raise StateError(f'dt is {dt}; it must be {_LONGEST_TICK:g} s or shorter')


def reversal_time(acceleration_max: Array, jerk_max: Array) -> float:
    """Return how long the slowest joint takes to turn its acceleration round: max 2 a/j [s].

    Args:
        acceleration_max, jerk_max: (n,) [rad/s², rad/s³; m], the latter may be infinite.
    """
    return float((2.0 * acceleration_max / jerk_max).max())


def window_of(reversal: float, dt: float) -> int:
    """Return the smallest number of ticks of dt [s] whose mean keeps the jerk limits."""
    return max(math.ceil(reversal / dt - _ROUND_OFF), 1)


class MeanVelocity:
    """The mean of the joint velocities that were planned last, in ticks of one length."""

    def __init__(self, ticks: int, velocity: Array, change: Array | None = None) -> None:
        """Begin with a mean that is `velocity` and has been changing steadily.

        Args:
            ticks: of the window.
            velocity: (n,) the mean.
            change: (n,) what it changed by in the last tick; None for not at all.
        """
        since = np.arange(ticks) - 0.5 * (ticks - 1)
        steady = np.zeros(len(velocity)) if change is None else change
        self._planned = velocity + np.outer(since, steady)
        self._next = 0
        self.latest = self._planned[-1].copy()
        self.ticks = ticks

    def delay(self, dt: float) -> float:
        """Return how long commands take to follow what is planned [s]."""
        return 0.5 * (self.ticks - 1) * dt

    def corner(self, dt: float) -> float:
        """Return how far off the planned way the mean is, for each unit of acceleration [s²]."""
        return (self.ticks * self.ticks - 1) * dt * dt / 24.0

    def take(self, planned: Array, dt: float) -> Array:
        """Take a planned velocity (n,); return the mean, which is the caller's to keep."""
        self.latest = planned
        if self.ticks == 1:
            return planned.copy()
        mean, at = np.empty(len(planned)), self._next
        self._next = (at + 1) % self.ticks
        _take(self._planned, at, planned, mean)
        return mean

    def stops_at(self, posture: Array, dt: float) -> Array:
        """Return where joints at a posture (n,) get to if 0 is planned from now on [rad, m]."""
        if self.ticks == 1:
            return posture
        stop = np.empty(len(posture))
        _stop(self._planned, self._next, posture, dt, stop)
        return stop


class FadingMean:
    """A mean of planned velocities u in which they fade with age, in ticks of any length.

    v_k = v_{k-1} + dt/(dt + τ) (u_k − v_{k-1}). Then, whatever the sequence of dt, u = v + τ v̇,
    and joints at q come to rest at q + τ v if 0 is planned from now on. The acceleration
    v̇_k = v̇_{k-1} + dt/(dt + τ) (u̇_k − v̇_{k-1}) is within ±a as u̇ is, and changes by less than
    2a dt/τ. With τ ≥ 4a/j that is within ±j times the way from the middle of one tick to that of
    the next, which is more than dt/2. The delay is four times that of a window.
    """

    def __init__(self, delay: float, velocity: Array, acceleration: Array) -> None:
        """Begin with a mean (n,) [rad/s, m/s], and how fast it changes [per s]; delay τ [s]."""
        self._delay, self._mean = delay, velocity
        self.latest = velocity + delay * acceleration

    def delay(self, dt: float) -> float:
        """Return τ, whatever the tick [s]."""
        return self._delay

    def corner(self, dt: float) -> float:
        """Return how far off the planned way the mean is, for each unit of acceleration [s²]."""
        return 0.5 * self._delay * self._delay

    def take(self, planned: Array, dt: float) -> Array:
        """Take the velocity (n,) planned for dt [s]; return the mean, the caller's to keep."""
        self.latest = planned
        self._mean = self._mean + (planned - self._mean) * (dt / (dt + self._delay))
        return self._mean.copy()

    def stops_at(self, posture: Array, dt: float) -> Array:
        """Return where joints at a posture (n,) get to if 0 is planned from now on [rad, m]."""
        return posture + self._delay * self._mean


class Smoothing:
    """Makes commands of planned velocities, so that they keep the jerk limits.

    A `MeanVelocity` does while all ticks take equally long, a `FadingMean` where they do not.

    Attributes:
        sent: (n,) what was commanded last.
    """

    def __init__(self, n: int, reversal: float) -> None:
        """Prepare for n joints, the slowest of which needs `reversal` [s], see `reversal_time`."""
        self._n, self._reversal = n, reversal
        self.reset()

    def reset(self) -> None:
        """Stand still."""
        self.sent = self._before = np.zeros(self._n)
        self._mean: MeanVelocity | FadingMean = MeanVelocity(1, self.sent)
        # Of the last tick: its length, how many in a row took as long, and a window of such ticks.
        self._dt, self._alike, self._ticks = math.inf, 0, 1

    @property
    def latest(self) -> Array:
        """The velocity (n,) that was planned last."""
        return self._mean.latest

    @property
    def delay(self) -> float:
        """How long commands take to follow what is planned [s]."""
        return self._mean.delay(self._dt)

    @property
    def corner(self) -> float:
        """How far off the planned way commands are, for each unit of acceleration [s²]."""
        return self._mean.corner(self._dt)

    @property
    def keeps_jerk(self) -> bool:
        """Whether commands keep the jerk limits."""
        mean = self._mean
        return (mean.ticks >= self._ticks if isinstance(mean, MeanVelocity)
                else mean.delay(self._dt) >= 2.0 * self._reversal)

    def begin(self, posture: Array, limits: Limits, dt: float, *, at_once: bool) -> Array:
        """Begin a tick; return where joints get to if 0 is planned from now on (n,) [rad, m].

        Args:
            posture: (n,) where they are.
            limits: of the joints.
            dt: length of the tick [s].
            at_once: whether what is planned is commanded at once, whatever the jerk.
        """
        held = self._dt
        self._count(dt)
        ticks, mean = 1 if at_once else self._ticks, self._mean
        fits = (mean.ticks == ticks and (self._alike > 1 or ticks == 1)
                if isinstance(mean, MeanVelocity)
                else not at_once and self.keeps_jerk and self._alike <= ticks)
        if not fits:
            for other in self._others(ticks, held):
                # The present acceleration fades in its time: not into a joint limit.
                if (isinstance(other, MeanVelocity) and other.ticks == 1) or _stays_inside(
                        other, posture, limits, dt):
                    self._mean = other
                    break
        return self._mean.stops_at(posture, dt)

    def take(self, planned: Array) -> Array:
        """Take the velocity (n,) planned for the tick; return what is to be commanded (n,)."""
        self._before, self.sent = self.sent, self._mean.take(planned, self._dt)
        return self.sent

    def take_over(self, sent: Array, dt: float) -> None:
        """Note that something else (n,) was commanded for a tick of dt [s]."""
        self._count(dt)
        self._before, self.sent = self.sent, sent
        self._mean = MeanVelocity(1, sent)

    def _count(self, dt: float) -> None:
        """Note the length of a tick [s]."""
        if dt != self._dt:
            self._dt, self._alike, self._ticks = dt, 0, window_of(self._reversal, dt)
        self._alike += 1

    def _others(self, ticks: int, held: float) -> Iterator[MeanVelocity | FadingMean]:
        """Yield means that go on from the last command and its acceleration, the best first.

        Args:
            ticks: of a window.
            held: how long the last command has been holding [s].
        """
        mean, change = self._mean, self.sent - self._before
        window = isinstance(mean, MeanVelocity)
        if ticks == 1 or self._alike > (1 if window else ticks) or not (
                self.sent.any() or self._before.any()):
            yield MeanVelocity(ticks, self.sent, change * (self._dt / held))
        if not window or self._alike == 1:
            yield FadingMean(2.0 * self._reversal, self.sent, change / held)
        if window and self._alike == 1:
            # Less delay leaves more room: jerk gives way before the limits of positions do.
            yield FadingMean(mean.delay(held), self.sent, change / held)
            yield MeanVelocity(1, self.sent)


def _stays_inside(
    mean: MeanVelocity | FadingMean, posture: Array, limits: Limits, dt: float,
) -> bool:
    """Return whether joints at a posture (n,) come to rest within their range, or no further out.

    Both if 0 is planned from now on, and if the arm brakes from the velocity planned last.
    """
    stop, (high, low) = mean.stops_at(posture, dt), limits.positions
    return bool((stop <= np.maximum(high, posture)).all()
                and (stop >= np.minimum(low, posture)).all()
                and can_stop(stop, mean.latest, limits, dt))


@compiled
def _take(planned: OutMatrix, at: int, velocity: Vector, mean: OutVector) -> None:
    """Put a velocity (n,) into a window (k, n), and write the mean of that."""
    ticks, n = planned.shape
    for i in range(n):
        planned[at, i], mean[i] = velocity[i], 0.0
    for tick in range(ticks):
        for i in range(n):
            mean[i] += planned[tick, i]
    for i in range(n):
        mean[i] /= ticks


@compiled
def _stop(planned: Matrix, first: int, posture: Vector, dt: float, stop: OutVector) -> None:
    """Write the posture plus Σ over the window of each velocity's share not in the mean yet."""
    ticks, n = planned.shape
    stop[:] = 0.0
    for age in range(ticks):
        row = (first + age) % ticks
        for i in range(n):
            stop[i] += planned[row, i] * age
    for i in range(n):
        stop[i] = posture[i] + stop[i] * (dt / ticks)


class SmoothStop:
    """Brings joints to rest from whatever was commanded last, as an S-curve."""

    def __init__(self, acceleration_max: Array, jerk_max: Array, dt: float) -> None:
        """Prepare for joints with these limits (n,) [rad/s², rad/s³; m], and ticks of dt [s]."""
        self._acceleration_max, self._dt = acceleration_max, dt
        self._ticks = window_of(reversal_time(acceleration_max, jerk_max), dt)
        self._last = self._before = np.zeros(len(acceleration_max))
        self._mean: MeanVelocity | None = None

    def moving(self, dq: Array) -> None:
        """Note what (n,) was commanded; the stop begins from there."""
        self._before, self._last, self._mean = self._last, dq, None

    def next(self) -> Array:
        """Return the next command (n,) of the stop; exactly 0 at its end."""
        if self._mean is None:
            self._mean = MeanVelocity(self._ticks, self._last, self._last - self._before)
        self._before = self._last
        self._last = self._mean.take(
            braked(self._mean.latest, self._acceleration_max, self._dt), self._dt)
        return self._last
