"""How fast the tip may be where on its way, so that the joints can still brake in time.

A way is measured by the time s that the tip takes for the rest of it at its highest speed. On it
the tip moves at a share f of that speed: ds/dt = −f. A posture q(s) on the way then has the joint
velocities −f q'(s), and the accelerations q'' f² − q' df/dt. Limits of the joints bound f and its
rate of change (the phase plane of Bobrow, Dubowsky and Gibson 1985), backwards from the end, where
f is 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Shares of the acceleration limits: for braking along the way, for its bends, and for both at
# once. The rest is for motion in the null space, and for what the postures on the way are wrong
# by.
_BRAKING, _BENDING, _BOTH = 0.8, 0.5, 0.9
# Joints that move no more than this per second at full speed do not count [rad/s, m/s].
_LEAST_RATE = 1e-9


class Profile(NamedTuple):
    """Speed along a way.

    Attributes:
        left: (K + 1,) what is left of the way at its nodes, descending to 0 [s].
        speed: (K + 1,) the highest share f of full speed there.
        fastest: (K,) between them.
        braking: (K,) how fast f may fall between them [1/s].
        rising: (K,) how fast it may rise, where nothing is lost if it cannot [1/s].
    """

    left: Array
    speed: Array
    fastest: Array
    braking: Array
    rising: Array

    def speed_at(self, left: float, dt: float) -> float:
        """Return the highest f for the next dt, where so much is left [s].

        In a tick f is constant. From f on, ticks that each lose `braking` dt end a way of
        f²/(2 braking) + f dt/2 at rest.
        """
        i = self._segment(left)
        braking = float(self.braking[i])
        room = max(left - self.left[i + 1], 0.0) + self.speed[i + 1] ** 2 / (2.0 * braking)
        step = braking * dt
        f = step * (math.sqrt(0.25 + 2.0 * room * braking / step**2) - 0.5)
        return min(f, float(self.fastest[i]), left / dt)

    def times(self, speed: float) -> tuple[Array, Array]:
        """Return when the tip is at the nodes (K + 1,) [s], and its f there.

        Args:
            speed: f at the first node.
        """
        f = self.speed.copy()
        f[0] = speed
        spans = -np.diff(self.left)
        for i, span in enumerate(spans):
            f[i + 1] = min(f[i + 1], math.sqrt(
                f[i] ** 2 + 2.0 * _BRAKING * self.rising[i] * span))
        # From rest to rest within one stretch the tip accelerates and brakes.
        mean = 0.5 * (f[:-1] + f[1:])
        slow = np.sqrt(spans * self.braking / 4.0)
        return np.concatenate((np.zeros(1), np.cumsum(spans / np.maximum(mean, slow)))), f

    def _segment(self, left: float) -> int:
        """Return the stretch between two nodes where so much is left."""
        count = len(self.braking)
        return min(max(int((1.0 - left / self.left[0]) * count), 0), count - 1)


def profile_of(
    postures: Array, length: float, velocity_max: Array, acceleration_max: Array,
) -> Profile:
    """Return how fast the tip may be along a way.

    Args:
        postures: (K + 1, n) at nodes with equal pieces of the way between them [rad, m].
        length: of the way, positive [s].
        velocity_max, acceleration_max: (n,) of the joints.
    """
    count = len(postures) - 1
    left, step = np.linspace(length, 0.0, count + 1), length / count
    moves = np.diff(postures, axis=0) / step
    rates = np.maximum(np.abs(moves), _LEAST_RATE)
    fastest = np.minimum((velocity_max / rates).min(axis=1), 1.0)
    rising = (acceleration_max / rates).min(axis=1)
    turns = np.diff(moves, axis=0) / step
    bends = np.maximum(np.abs(turns), _LEAST_RATE)
    speed = np.ones(count + 1)
    speed[1:-1] = np.sqrt(_BENDING * (acceleration_max / bends).min(axis=1))
    speed[0] = speed[1]
    speed[:-1] = np.minimum(speed[:-1], fastest)
    speed[1:] = np.minimum(speed[1:], fastest)
    speed[-1] = 0.0
    # A joint that the way itself slows down brakes for that, too: q' b + |q''| f² is what it does.
    turns = np.vstack((turns[:1], turns, turns[-1:]))
    slowing = np.maximum(-np.sign(moves) * turns[:-1], -np.sign(moves) * turns[1:])
    slowing = np.maximum(slowing, 0.0)
    braking = np.empty(count)
    for i in reversed(range(count)):
        # With the f of its beginning, which is higher than that of its end.
        ratio, bend = acceleration_max / rates[i], slowing[i] / rates[i]
        squared = np.minimum(
            speed[i + 1] ** 2 + 2.0 * step * _BRAKING * ratio,
            (speed[i + 1] ** 2 + 2.0 * step * _BOTH * ratio) / (1.0 + 2.0 * step * bend))
        speed[i] = min(speed[i], math.sqrt(squared.min()))
        braking[i] = np.minimum(
            _BRAKING * ratio, _BOTH * ratio - speed[i] ** 2 * bend).min()
    return Profile(left, speed, fastest, braking, rising)
