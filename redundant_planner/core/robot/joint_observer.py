"""Where the commands so far take the arm, from encoders that are late and noisy.

The planner starts from the commanded posture, not from the measured one: encoder noise would go
into the next command, and a posture measured behind the drives' delay is where the arm was. What
is measured is compared with what was to be expected by then.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, OutMatrix, OutVector, Vector

Array = npt.NDArray[np.float64]

# How fast the posture follows an arm that is elsewhere than expected [1/s]. Beyond so far from
# there, and further by what a joint makes in so long, the posture follows at once [rad, m; s].
_RATE = 2.0
_FURTHEST, _LATEST = 0.01, 0.1
# Time over which errors count as noise [s].
_NOISE_TIME = 0.1
# Slower joints do not tell a direction [rad/s, m/s].
_SLOW = 1e-3

# Rows of the observer's state.
_COMMANDED, _EXPECTED, _SPEED, _OFFSET, _BEHIND, _WAY, _STRAYED, _TOLD = range(8)


class JointObserver:
    """Follows the commands of one arm with a model of its drives.

    A drive is a first-order lag behind a dead time: τ v̇ + v = u(t − θ).
    """

    def __init__(self, n: int, lag: float, dead_time: float) -> None:
        """Begin without a measurement; lag τ and dead time θ [s]."""
        self.lag, self.dead_time = lag, dead_time
        self._state = np.zeros((8, n))
        self._late = np.zeros((1, n))
        self._dt, self._told = math.nan, 0.0
        self.reset()

    def reset(self) -> None:
        """Take the next measurement as it is: the arm stands there."""
        self._known, self._told = False, 0.0
        self._state[_STRAYED] = 0.0

    @property
    def ahead(self) -> Array:
        """Where the arm will be by its commands at the end of the latest (n,) [rad, m]."""
        state = self._state
        return state[_COMMANDED] + state[_OFFSET] + self._told * state[_TOLD]

    @property
    def strayed(self) -> Array:
        """How far the arm is from its way, noise left out (n,) [rad, m].

        What it is behind on the way does not count: it will be past that soon.
        """
        return self._state[_STRAYED]

    def sense(self, measured: Array, dt: float) -> Array:
        """Take a measured posture (n,); return the posture to plan from [rad, m].

        Args:
            measured: now; finite.
            dt: time to the next tick [s].
        """
        if dt != self._dt:
            self._take_ticks_of(dt)
        if not self._known:
            self._known = True
            self._state[:], self._late[:] = 0.0, 0.0
            self._state[_COMMANDED] = self._state[_EXPECTED] = measured
            return measured
        told, self._told = self._told, 0.0
        posture = np.empty(len(measured))
        _sense(self._state, self._late, measured, self.lag, self.dead_time, told, dt, posture)
        return posture

    def commanded(self, dq: Array, dt: float) -> None:
        """Take the command (n,) that holds for the next dt [rad/s, m/s; s]."""
        if dt != self._dt:
            self._take_ticks_of(dt)
        elif self._told > 0.0:
            _obey(self._state, self._late, self.lag, self.dead_time, self._told)
        self._state[_TOLD], self._told = dq, dt

    def went_on(self, ticks: int) -> float:
        """Note that the latest command has held for some ticks more; return how long [s]."""
        if self._told == 0.0:
            return 0.0
        for _ in range(ticks):
            _obey(self._state, self._late, self.lag, self.dead_time, self._told)
        return ticks * self._told

    def _take_ticks_of(self, dt: float) -> None:
        """Hold the commands that are under way as those of ticks of dt [s]."""
        if self._told > 0.0:
            _obey(self._state, self._late, self.lag, self.dead_time, self._told)
        count, self._told = math.floor(self.dead_time / dt) + 2, 0.0
        if math.isnan(self._dt):
            self._late = np.tile(self._state[_SPEED], (count, 1))
        else:
            self._late = _means_over(dt, count, self._late, self._dt)
        self._dt = dt


def _means_over(dt: float, count: int, late: Array, held: float) -> Array:
    """Return the means (count, n) over ticks of dt [s] of commands (k, n), the oldest first.

    Args:
        dt, count: of the ticks, of which the last ends where the last command does.
        late: the commands; before them all the first of them held.
        held: how long each of them did [s].
    """
    ages, since = held * np.arange(len(late) + 1), dt * np.arange(count + 1)
    ways = np.vstack((np.zeros_like(late[:1]), held * np.cumsum(late[::-1], axis=0)))
    way = np.array([np.interp(since, ages, column) for column in ways.T]).T
    way += np.outer(np.maximum(since - ages[-1], 0.0), late[0])
    return np.ascontiguousarray(np.diff(way, axis=0)[::-1] / dt)


@compiled
def _obey(
    state: OutMatrix, late: OutMatrix, lag: float, dead_time: float, dt: float,
) -> None:
    """Go on by a tick of dt [s]: the drive obeys what was commanded a dead time ago.

    Args:
        state: of the observer.
        late: (d + 2, n) the commands of the dead time, the oldest first.
        lag, dead_time: of the drive [s].
        dt: how long the latest command has been holding [s].
    """
    ticks = len(late) - 2
    part = min(max(dead_time / dt - ticks, 0.0), 1.0)
    kept = math.exp(-dt / lag) if lag > 0.0 else 0.0
    for i in range(state.shape[1]):
        dq = state[_TOLD, i]
        for tick in range(ticks + 1):
            late[tick, i] = late[tick + 1, i]
        late[ticks + 1, i] = dq
        # Within the tick it obeys one command for a part of the time, then the next.
        wanted = part * late[0, i] + (1.0 - part) * late[1, i]
        state[_COMMANDED, i] += dq * dt
        state[_EXPECTED, i] += wanted * dt + (state[_SPEED, i] - wanted) * lag * (1.0 - kept)
        state[_SPEED, i] = wanted + (state[_SPEED, i] - wanted) * kept


@compiled
def _sense(
    state: OutMatrix, late: OutMatrix, measured: Vector, lag: float, dead_time: float,
    told: float, dt: float, posture: OutVector,
) -> None:
    """Write the posture (n,) to plan from.

    Args:
        state: of the observer.
        late, lag, dead_time: see `_obey`.
        measured: (n,) now.
        told: for how long the latest command has been holding [s]; 0 for none since the last time.
        dt: time to the next tick [s].
        posture: what is written.
    """
    n = len(measured)
    if told > 0.0:
        _obey(state, late, lag, dead_time, told)
    share, slower = 1.0 - math.exp(-_RATE * dt), 1.0 - math.exp(-dt / _NOISE_TIME)
    along, squared = 0.0, 0.0
    for i in range(n):
        error = measured[i] - state[_EXPECTED, i] - state[_OFFSET, i]
        most = _FURTHEST + _LATEST * abs(state[_SPEED, i])
        kept = min(max((1.0 - share) * error, -most), most)
        state[_OFFSET, i] += error - kept
        # Both averaged alike: of a drive that is later than thought they have one direction.
        state[_BEHIND, i] += slower * (kept - state[_BEHIND, i])
        state[_WAY, i] += slower * (state[_SPEED, i] - state[_WAY, i])
        along += state[_BEHIND, i] * state[_WAY, i]
        squared += state[_WAY, i] * state[_WAY, i]
        posture[i] = state[_COMMANDED, i] + state[_OFFSET, i]
    late_by = along / squared if squared > _SLOW * _SLOW else 0.0
    for i in range(n):
        state[_STRAYED, i] = state[_BEHIND, i] - late_by * state[_WAY, i]
