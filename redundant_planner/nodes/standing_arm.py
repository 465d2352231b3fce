"""Whether something else moves an arm that is told to stay where it is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.nodes.supervisor import MOVED_BY_OTHERS

Array = npt.NDArray[np.float64]

# Slower commands are rest: they correct where the arm stands [rad/s, m/s].
_STILL = 0.01
# A motion has ended, and a load has made the arm sag, after so long a rest; after so many lags of
# a drive that is known to be slow besides [s].
_SETTLES, _LAGS = 1.0, 5.0
# Measurements are averaged over this [s].
_AVERAGED = 0.2
# Motion that no command explains is forgotten in this time [s]: a gain that is off by some per
# cent does not count.
_FORGETTING = 3.0
# An arm was moved that has moved by this much more than its commands explain [rad, m].
_MOVED = 1.5e-3
# At least by this much it must have moved that way at all: what its play swallows of corrections
# moves nothing, and what they do then is no surprise [rad, m].
_NOTICED = 5e-4


class StandingArm:
    """Compares where an arm came to stand with where it stands.

    An arm sags as its motion ends. What moves it later, while nobody commands it, is something
    else: following it keeps the arm from coming back once its own controller is active again.
    """

    def __init__(self, period: float) -> None:
        """Begin with an arm in motion.

        Args:
            period: of the commands [s].
        """
        self._period, self._settles = period, _SETTLES
        self._mean = self._away = np.zeros(0)
        self._stood_at: Array | None = None
        self.leave()

    def begin(self, lag: float, dead_time: float) -> None:
        """Begin anew with an arm in motion.

        Args:
            lag, dead_time: of its drives, as far as they are known [s].
        """
        self._settles = _SETTLES + _LAGS * lag + dead_time
        self.leave()

    def leave(self) -> None:
        """Note that the arm is commanded to move."""
        self._since, self._stood_at = np.inf, None

    def is_moved(self, now: float, told: Array, measured: Array) -> bool:
        """Take a tick in which nobody commands the arm; return whether something else moves it.

        Args:
            now: [s].
            told: (n,) the velocities commanded last [rad/s, m/s].
            measured: (n,) where it is [rad, m].
        """
        if self._since == np.inf or np.abs(told).max() > _STILL:
            self._since, self._stood_at, self._mean = now, None, measured
            return False
        before = self._mean
        self._mean = before + (measured - before) * (self._period / _AVERAGED)
        if now - self._since < self._settles:
            return False
        if self._stood_at is None:
            self._stood_at, self._away = self._mean, np.zeros(len(measured))
            return False
        self._away = (self._away * (1.0 - self._period / _FORGETTING)
                      + self._mean - before - told * self._period)
        moved_that_way = np.sign(self._away) * (self._mean - self._stood_at) > _NOTICED
        # Fast motion is not averaged away.
        at_once = np.abs(measured - self._mean) > MOVED_BY_OTHERS
        return bool((at_once | (np.abs(self._away) > _MOVED) & moved_that_way).any())
