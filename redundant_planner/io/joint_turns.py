"""Measured positions that leap by a whole turn where a driver wraps them.

Most drivers give joints that turn without end within [−π, π], some also joints with limits. The
arm has not moved by a turn between two measurements, so a leap of about one is the driver's.
"""

from __future__ import annotations

from typing import NamedTuple, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:  # a simulated arm that wraps needs no mathematics
    from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

_TURN = 2.0 * np.pi  # [rad]

# How far a leap of a joint with limits may be from a whole turn: what it moves between two
# measurements [rad].
_MOVED = 0.5
# A joint that is measured this far beyond its limits is a whole turn from there, if it is within
# them then. Nearer ones are beyond their limits, as noise and play take them [rad].
_BEYOND = 0.1
# Positions that change by less than this have not leapt by a turn [rad, m].
_NO_LEAP = 3.0


class Seams(NamedTuple):
    """Which of n joints may be measured whole turns from where they are.

    Attributes:
        slack: (n,) how far a leap may be from whole turns to count as such: π, so that every one
            does, for joints that turn without end; less than 0, so that none does, for those
            that slide [rad].
        position_min, position_max: (n,) limits [rad, m], infinite where there are none.
    """

    slack: Array
    position_min: Array
    position_max: Array

    @classmethod
    def of(cls, robot: Robot) -> Seams:
        """Return those of a robot."""
        turns = robot.chain.motion[:, 3:].any(axis=1)
        return cls(np.where(np.isinf(robot.position_max), np.pi, np.where(turns, _MOVED, -1.0)),
                   robot.position_min, robot.position_max)

    @classmethod
    def unknown(cls, n: int) -> Seams:
        """Return those of n joints of which nothing is known."""
        return cls(np.full(n, _MOVED), np.full(n, -np.inf), np.full(n, np.inf))

    def leap(self, change: Array) -> Array:
        """Return the whole turns (…, n) in what measurements changed by (…, n) [rad]."""
        turns = _TURN * np.rint(change / _TURN)
        return np.where(np.abs(change - turns) <= self.slack, turns, 0.0)

    def at_first(self, q: Array) -> Array:
        """Return the whole turns (n,) from where joints are to where they are first measured.

        Args:
            q: (n,) measured; NaN for joints that are not.
        """
        turned = np.zeros(len(q))
        beyond = (q < self.position_min - _BEYOND) | (q > self.position_max + _BEYOND)
        for j in np.flatnonzero(beyond & (self.slack > 0.0)):
            for turn in (_TURN, -_TURN):
                if self.position_min[j] <= q[j] - turn <= self.position_max[j]:
                    turned[j] = turn
        return turned


class Unwrapping:
    """Makes measured positions of n joints continuous.

    Attributes:
        turned: (n,) by how much the latest positions were measured further than returned, whole
            turns [rad]; another array after each leap.
        measured: (n,) the latest positions as they came; NaN for joints that none came of.
    """

    def __init__(self, seams: Seams) -> None:
        """Begin without a measurement: the first one counts as it is."""
        self._seams = seams
        n = len(seams.slack)
        self.turned: Array = np.zeros(n)
        self._has_turned = False
        self.measured = np.full(n, np.nan)  # the latest, as it came

    def posture(self, measured: Array) -> Array:
        """Return a posture (n,) as the arm takes it, from measured positions (n,); see `rows`."""
        if np.abs(measured - self.measured).max() < _NO_LEAP:  # NaN is not
            self.measured = measured
            return measured - self.turned if self._has_turned else measured
        return np.asarray(self.rows(measured[None])[0])

    def rows(self, measured: Array) -> Array:
        """Return successive postures (k, n) as an arm takes them; NaN where a joint is unknown.

        Args:
            measured: (k, n) [rad, m]. NaN only before the first position of a joint.
        """
        before = np.vstack((self.measured, measured[:-1]))
        first = np.isnan(before) & ~np.isnan(measured)
        turned = np.zeros(measured.shape)
        for i in np.flatnonzero(first.any(axis=1)):
            turned[i] = np.where(first[i], self._seams.at_first(measured[i]), 0.0)
        turned += np.where(np.isnan(before), 0.0, self._seams.leap(measured - before))
        turned = self.turned + np.cumsum(np.nan_to_num(turned), axis=0)
        self.measured, self.turned = measured[-1].copy(), turned[-1].copy()
        self._has_turned = bool(self.turned.any())
        return np.asarray(measured - turned)


def wrapped(q: Array, position_max: Array) -> Array:
    """Return positions (n,) as drivers give them: without limits within (−π, π] [rad, m]."""
    turns = np.where(np.isinf(position_max), np.ceil((q - np.pi) / _TURN), 0.0)
    return np.asarray(q - _TURN * turns)
