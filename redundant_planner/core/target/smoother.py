"""A signal from samples that are noisy, late, irregular or wrong, at a fixed lag behind them.

Samples that come in bursts are first kept until the latest of a burst would be there, so that
they go on evenly. Then two steps. A cubic through the last samples, whose weights fade with their
age (Brookner 1998), says where the signal was one lag ago: mostly between two samples, where noise
does little. It changes with each sample. What is followed comes from it by a critically damped
filter of third order that knows the cubic's derivatives: it has no lag of its own, and its
acceleration is continuous whatever the samples do. The noisier the samples, the more of them are
averaged, the slower the filter, and the longer the lag, by up to 30 %.
"""

from __future__ import annotations

from collections import deque
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# The lag is at least so many times the gap between two samples: then it lies between two of them,
# and the one behind is not the last that is known.
_GAPS = 1.4
# Without a lag, weights fade and the filter is as fast as with this one [s].
_SCALE = 0.08
# How fast weights fade, as a share of the lag, less a share of the gap: few samples are passed
# through, many are averaged.
_MEMORY, _LESS_MEMORY = 0.75, 0.55
# How fast the filter is, over the lag.
_BANDWIDTH = 3.5
# At this much noise in samples of this rate, in gates (1 mm of a position at 30 Hz), weights fade
# slower by so many lags, the filter is slower by such a share, and the lag is longer by such a
# share; with less noise, by less. It is known from fourth differences of samples that are evenly
# apart, whose variance is 70 times its own, averaged over some samples.
_NOISE, _NOISE_RATE, _EVENLY = 0.012, 30.0, 1.5
_MORE_MEMORY, _SLOWER, _LONGER = 1.2, 0.75, 0.3
_DIFFERENCES, _VARIANCE, _SAMPLES = np.array((1.0, -4.0, 6.0, -4.0, 1.0)), 70.0, 20.0
# Numbers of the cubic.
_ORDER = 4
# Samples of a lower weight do not count, nor more than so many.
_FADED, _MOST = 2e-3, 128
# So many gaps after the last sample, and this long, the signal is taken to have ended there [s].
_MISSED, _COASTS = 2.0, 0.1
# Over what time gaps and delays are looked at, and how fast the lag may change [s, s/s].
_KNOWN, _PACE = 1.5, 0.2
# A sample counts as wrong beyond this multiple of what the last ones were off by, of so many. As
# long as there are fewer it may be off by a gate more for each squared multiple of this time [s].
_USUAL, _RECENT, _QUICK = 4.0, 8, 0.1
# What is this near to a sample that stands, in gates, stands there.
_AT_REST = 1e-6
# No lag is shorter, for the sake of divisions [s].
_INSTANT = 1e-6


class Estimate(NamedTuple):
    """What is known of the signal at one moment.

    Attributes:
        value: (k,).
        velocity, acceleration, jerk: (k,) its derivatives [1/s, 1/s², 1/s³].
    """

    value: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    def after(self, dt: float) -> Estimate:
        """Return it a little later, the jerk kept."""
        return Estimate(
            self.value + dt * (self.velocity + dt * (self.acceleration / 2 + dt * self.jerk / 6)),
            self.velocity + dt * (self.acceleration + dt * self.jerk / 2),
            self.acceleration + dt * self.jerk, self.jerk)


class Sample(NamedTuple):
    """A sample (k,), and the time that it is of [s]."""

    time: float
    value: Array


class _Usual:
    """The largest of the last numbers but one: what is usual, for one alone is an exception."""

    def __init__(self) -> None:
        self._noted: deque[tuple[float, float]] = deque()
        self.value = 0.0

    @property
    def is_new(self) -> bool:
        return len(self._noted) <= 2

    def note(self, number: float, now: float) -> None:
        self._noted.append((now, number))
        while self._noted[0][0] < now - _KNOWN:
            self._noted.popleft()
        numbers = sorted(number for _, number in self._noted)
        self.value = numbers[-2] if len(numbers) > 2 else numbers[-1]


class Smoother:
    """A signal of some numbers, from its samples.

    Times are of one clock, in s. The same samples and calls give the same numbers.
    """

    def __init__(self, lag: float, gate: Array, first: Sample, now: float) -> None:
        """Begin with a sample.

        Args:
            lag: behind the samples, where they come often enough for it [s]; 0 for none: what has
                not come yet is guessed then.
            gate: (k,) how far a sample may always be from what is expected.
            first: the sample.
            now: the time now [s].
        """
        self._gate, self._now = gate, now
        self.lag = lag
        self._waiting: deque[Sample] = deque()
        self._latest = first.time
        self._delays, self._gaps = _Usual(), _Usual()
        self._delay = 0.0
        self._behind = lag
        self._added = 0.0
        self._begin(first)
        self._then = self._fit  # what was given last, at `_now`

    @property
    def lag(self) -> float:
        """Behind the samples, where they come often enough for it [s]; it may be changed."""
        return self._lag

    @lag.setter
    def lag(self, lag: float) -> None:
        self._lag, self._scale = lag, lag or _SCALE

    @property
    def gap(self) -> float:
        """The usual time between two samples [s]; 0 if it is not known."""
        return self._gaps.value

    def take(self, sample: Sample, now: float) -> None:
        """Take a sample; one that is no later than those before does not count.

        Args:
            sample: the sample.
            now: when it came [s].
        """
        if sample.time > self._latest:
            self._latest = sample.time
            self._waiting.append(sample)
            self._delays.note(max(now - sample.time, 0.0), now)

    def at(self, now: float) -> Estimate:
        """Return the signal as it is followed at a time, no earlier than in the last call [s]."""
        dt, self._now = now - self._now, now
        delay = self._delays.value if self._lag > 0.0 else 0.0
        pace = math.inf if self._gaps.is_new else _PACE * dt
        self._delay += _bounded(delay - self._delay, pace)
        while self._waiting and self._waiting[0].time <= now - self._delay:
            self._use(self._waiting.popleft())
        before = self._behind
        # Slowly: a lag that changes is a signal that is too fast or too slow.
        self._added += (_LONGER * self._noisy - self._added) * min(dt / _KNOWN, 1.0)
        wished = self._lag and max(
            (1.0 + self._added) * self._lag, self._delay + _GAPS * self._gaps.value)
        self._behind += _bounded(wished - before, pace)
        rate = (1.0 - _SLOWER * self._noisy) * _BANDWIDTH / max(
            self._scale, _GAPS * self._gaps.value)
        reference = self._reference(now - self._behind)
        # The filter's error is that against the reference of now at the time of then.
        moved = dt - (self._behind - before)
        self._then = _drawn(self._then, reference.after(-moved), reference, rate, dt)
        if not reference.velocity.any() and all(
                (np.abs(a - b) < _AT_REST * self._gate).all() for a, b in zip(
                    self._then, reference)):
            self._then = reference
        return self._then

    def _begin(self, first: Sample) -> None:
        """Begin anew with a sample."""
        self._used: deque[Sample] = deque([first], maxlen=_MOST)
        self._variance, self._noisy = 0.0, 0.0
        self._off: deque[float] = deque(maxlen=_RECENT)
        self._doubtful: Sample | None = None
        self._refit()

    def _use(self, sample: Sample) -> None:
        """Use a sample, unless it is far from where the signal should be.

        If the next one is, too, the signal has gone there: then everything begins anew with these
        two.
        """
        since = sample.time - self._used[-1].time
        off = float((np.abs(sample.value - self._fit.after(since).value) / self._gate).max())
        most = _USUAL * max(self._off, default=0.0)
        if len(self._off) < _RECENT:
            most = max(most, (since / _QUICK) ** 2)
        if off <= 1.0 + most:
            self._gaps.note(since, self._now)
            self._off.append(off)
        elif self._doubtful is None:
            self._doubtful = sample
            return
        else:
            self._begin(self._doubtful)
        self._doubtful = None
        self._used.append(sample)
        self._note_noise()
        self._refit()

    def _reference(self, time: float) -> Estimate:
        """Return the cubic at a time; before and long after the samples one of them stands."""
        first, last = self._used[0], self._used[-1]
        since = time - last.time
        coasts = max(_MISSED * self._gaps.value - (self._behind - self._delay), _COASTS)
        if first.time <= time and since <= coasts:
            return self._fit.after(since)
        still = np.zeros(len(last.value))
        return Estimate((first if time < first.time else last).value, still, still, still)

    def _note_noise(self) -> None:
        """Estimate how noisy the samples are, where there are more than just pass through."""
        count = len(_DIFFERENCES)
        if len(self._used) < count:
            return
        times = np.array([self._used[i].time for i in range(-count, 0)])
        if np.diff(times).max() > _EVENLY * self._gaps.value:
            return
        last = np.array([self._used[i].value for i in range(-count, 0)])
        found = float(((_DIFFERENCES @ last / self._gate) ** 2).mean()) / _VARIANCE
        self._variance += (found - self._variance) / min(
            _SAMPLES, float(len(self._used) - count + 1))
        gap = max(self._gaps.value, _INSTANT)
        noise = self._variance * gap * _NOISE_RATE / _NOISE**2
        self._noisy = min(max(self._scale / gap - _GAPS, 0.0), 1.0) * min(noise, 1.0)

    def _refit(self) -> None:
        """Find the cubic through the samples used, at the newest one: of noisy ones, more."""
        times = np.array([sample.time for sample in self._used]) - self._used[-1].time
        values = np.array([sample.value for sample in self._used])
        spacing = -times[0] / max(len(times) - 1, 1)
        memory = max(_MEMORY * max(self._scale, _GAPS * spacing) - _LESS_MEMORY * spacing,
                     _INSTANT) + self._noisy * _MORE_MEMORY * self._scale
        self._fit = _cubic(times, values, memory)


def _cubic(times: Array, values: Array, memory: float) -> Estimate:
    """Return the cubic through values (m, k) at times (m,) that end at 0, there.

    Args:
        times, values: of samples.
        memory: in which their weights fade [s].
    """
    order = min(len(times), _ORDER)
    count = max(int((times > memory * math.log(_FADED)).sum()), order)
    powers = np.vander(times[-count:] / memory, order, increasing=True)
    weighted = np.exp(times[-count:] / memory)[:, None] * powers
    found = np.zeros((_ORDER, values.shape[1]))
    found[:order] = np.linalg.lstsq(
        weighted.T @ powers, weighted.T @ values[-count:], rcond=None)[0]
    return Estimate(found[0], found[1] / memory, 2.0 * found[2] / memory**2,
                    6.0 * found[3] / memory**3)


def _bounded(number: float, most: float) -> float:
    return min(max(number, -most), most)


def _drawn(
    then: Estimate, reference: Estimate, now: Estimate, rate: float, dt: float,
) -> Estimate:
    """Return what a critically damped filter of third order makes of its reference, exactly.

    Args:
        then: what it gave, `dt` ago.
        reference: of that time.
        now: the reference of now.
        rate: at which errors fade [1/s].
        dt: [s].
    """
    error, speed, bend = (a - b for a, b in zip(then[:3], reference))
    # (c₀ + c₁ t + c₂ t²) e^(−rate t)
    first = speed + rate * error
    second = 0.5 * (bend + 2.0 * rate * speed + rate * rate * error)
    kept = math.exp(-rate * dt)
    value = error + dt * (first + dt * second)
    slope = first + 2.0 * dt * second
    return Estimate(
        now.value + kept * value, now.velocity + kept * (slope - rate * value),
        now.acceleration + kept * (2.0 * second - rate * (2.0 * slope - rate * value)), now.jerk)
