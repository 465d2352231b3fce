"""How fast time may pass along a way whose pace is given, so that the joints can follow.

At a share f of the given pace, ds/dt = f, a posture q(s) has the velocities q' f and the
accelerations q'' f² + q' df/dt. With x = f² and u = df/dt these limits are linear in both, and
dx/ds = 2u. Backwards from rest at the end, the largest x at each node from which the next one can
be reached within the limits is the highest pace (TOPP-RA, Pham and Pham 2018). A motion within
the limits keeps its own pace, f = 1.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.target.highest_pace import fill_pace

Array = npt.NDArray[np.float64]

# A joint slower than this at the given pace does not bound df/dt [rad/s, m/s].
_STILL = 1e-9
# A pace that falls to nothing between two nodes is passed at this share [-].
_SLOWEST = 1e-3


class Pace(NamedTuple):
    """How fast time may pass along a way.

    Attributes:
        begin: where on the way the first node is [s].
        step: from node to node [s].
        squared: (N + 1,) the highest f² at the nodes.
        rates, bends: (N + 1, n) q' and q'' there.
        acceleration_max: (n,) of the joints.
    """

    begin: float
    step: float
    squared: Array
    rates: Array
    bends: Array
    acceleration_max: Array

    @property
    def end(self) -> float:
        """Where the last node is [s]."""
        return self.begin + self.step * (len(self.squared) - 1)

    def share_at(self, s: float, before: float, dt: float) -> float:
        """Return the f for the next dt.

        In a tick f is constant: ticks that each lose b dt cover f²/(2b) + f dt/2 until rest.

        Args:
            s: where on the way [s].
            before: f in the last tick.
            dt: [s].
        """
        along = (s - self.begin) / self.step
        i = min(max(int(along), 0), len(self.squared) - 2)
        part = min(max(along - i, 0.0), 1.0)
        x = (1.0 - part) * self.squared[i] + part * self.squared[i + 1]
        lost = max(0.5 * (self.squared[i] - self.squared[i + 1]) / self.step, 0.0) * dt
        share = math.sqrt(x + 0.25 * lost**2) - 0.5 * lost
        return max(min(share, self._reachable(i, before, dt), (self.end - s) / dt), 0.0)

    def _reachable(self, i: int, before: float, dt: float) -> float:
        """Return the highest f after another one within the limits at a node."""
        rates, bends = np.maximum(np.abs(self.rates[i]), _STILL), self.bends[i]
        bending = np.sign(self.rates[i]) * bends * before**2
        change = float(((self.acceleration_max - bending) / rates).min()) * dt
        if change >= 0.0:
            return before + change
        # Too fast for the bend: never slower than what it allows in the long run.
        steady = float((self.acceleration_max / np.maximum(np.abs(bends), _STILL)).min())
        return max(before + change, min(before, math.sqrt(steady)))

    def times(self, share: float = 1.0) -> Array:
        """Return when the nodes are passed (N + 1,), from the first on [s].

        That is at the highest pace, up to which the arm gets as fast as its rates q' let it.

        Args:
            share: f at the first node.
        """
        rising = 2.0 * self.step * (self.acceleration_max / np.maximum(
            np.abs(self.rates[:-1]), _STILL)).min(axis=1)
        # The nodes that are reached at less: squares there are those before and what is gained.
        gained = share * share + np.concatenate((np.zeros(1), np.cumsum(rising)))
        f = np.sqrt(np.minimum(self.squared, gained + np.minimum.accumulate(
            np.minimum(self.squared - gained, 0.0))))
        mean = np.maximum(0.5 * (f[1:] + f[:-1]), _SLOWEST)
        return np.concatenate((np.zeros(1), np.cumsum(self.step / mean)))

    def passed(self, times: Array, s: float) -> float:
        """Return how long after the first node a place s is passed [s], by `times`."""
        return float(np.interp((s - self.begin) / self.step, np.arange(len(times)), times))


def pace_along(
    nodes: Array, begin: float, step: float, fastest: Array, velocity_max: Array,
    acceleration_max: Array,
) -> Pace:
    """Return how fast time may pass along a way that ends at rest.

    Args:
        nodes: (N + 1, n) postures with equal steps of time at the given pace, three at least.
        begin, step: see `Pace`.
        fastest: (N + 1,) the highest f that others allow.
        velocity_max, acceleration_max: (n,) of the joints.
    """
    squared, rates, bends = np.empty(len(nodes)), np.empty(nodes.shape), np.empty(nodes.shape)
    fill_pace(nodes, step, fastest, velocity_max, acceleration_max, squared, rates, bends)
    return Pace(begin, step, squared, rates, bends, acceleration_max)
