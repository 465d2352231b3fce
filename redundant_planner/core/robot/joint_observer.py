"""Where the commands so far take the arm, from encoders that are late and noisy.

The planner starts from the commanded posture, not from the measured one: encoder noise would go
into the next command, and a posture measured behind the drives' delay is where the arm was. What
is measured is compared with what was to be expected by then.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, OutMatrix, Vector

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
_COMMANDED, _EXPECTED, _SPEED, _OFFSET, _STRAYED, _WAY = range(6)


class JointObserver:
    """Follows the commands of one arm with a model of its drives.

    A drive is a first-order lag behind a dead time: τ v̇ + v = u(t − θ).

    Attributes:
        strayed: (n,) how far the arm is from its way, noise left out [rad, m]: not what it is
            behind on the way, which it will be past soon.
    """

    def __init__(self, n: int, lag: float, dead_time: float) -> None:
        """Begin without a measurement; lag τ and dead time θ [s]."""
        self.lag, self.dead_time = lag, dead_time
        self._state = np.zeros((6, n))
        self._late = np.zeros((1, n))
        self._dt = math.nan
        self.reset()

    def reset(self) -> None:
        """Take the next measurement as it is: the arm stands there."""
        self._known = False
        self.strayed = np.zeros(self._state.shape[1])

    def sense(self, measured: Array, dt: float) -> Array:
        """Take a measured posture (n,); return the posture to plan from [rad, m].

        Args:
            measured: now.
            dt: time to the next tick [s].
        """
        if dt != self._dt:
            self._dt = dt
            self._late = np.tile(
                self._state[_SPEED], (math.floor(self.dead_time / dt) + 2, 1))
        if not self._known:
            self._known = True
            self._state[:] = 0.0
            self._state[_COMMANDED] = self._state[_EXPECTED] = measured
            self._late[:] = 0.0
        posture, self.strayed = _sense(self._state, measured, dt)
        return posture

    def commanded(self, dq: Array, dt: float) -> None:
        """Take the command (n,) that holds for the next dt [rad/s, m/s; s]."""
        _command(self._state, self._late, dq, self.lag, self.dead_time, dt)


@compiled
def _sense(state: OutMatrix, measured: Vector, dt: float) -> tuple[Array, Array]:
    """Return the posture to plan from, and how far the arm has strayed, (n,) each."""
    n = len(measured)
    offset, strayed, way = state[_OFFSET], state[_STRAYED], state[_WAY]
    share, slower = 1.0 - math.exp(-_RATE * dt), 1.0 - math.exp(-dt / _NOISE_TIME)
    along, squared = 0.0, 0.0
    for i in range(n):
        error = measured[i] - state[_EXPECTED, i] - offset[i]
        most = _FURTHEST + _LATEST * abs(state[_SPEED, i])
        kept = min(max((1.0 - share) * error, -most), most)
        offset[i] += error - kept
        # Both averaged alike: of a drive that is later than thought they have one direction.
        strayed[i] += slower * (kept - strayed[i])
        way[i] += slower * (state[_SPEED, i] - way[i])
        along += strayed[i] * way[i]
        squared += way[i] * way[i]
    aside = strayed.copy()
    if squared > _SLOW * _SLOW:
        for i in range(n):
            aside[i] -= along / squared * way[i]
    return state[_COMMANDED] + offset, aside


@compiled
def _command(
    state: OutMatrix, late: OutMatrix, dq: Vector, lag: float, dead_time: float, dt: float,
) -> None:
    """Go on by a tick: the drive obeys what was commanded a dead time ago.

    Args:
        state: of the observer.
        late: (d + 2, n) the commands of the dead time, the oldest first.
        dq: (n,) the new command.
        lag, dead_time, dt: [s].
    """
    ticks = len(late) - 2
    part = min(max(dead_time / dt - ticks, 0.0), 1.0)
    kept = math.exp(-dt / lag) if lag > 0.0 else 0.0
    for i in range(len(dq)):
        for tick in range(ticks + 1):
            late[tick, i] = late[tick + 1, i]
        late[ticks + 1, i] = dq[i]
        # Within the tick it obeys one command for a part of the time, then the next.
        wanted = part * late[0, i] + (1.0 - part) * late[1, i]
        state[_COMMANDED, i] += dq[i] * dt
        state[_EXPECTED, i] += wanted * dt + (state[_SPEED, i] - wanted) * lag * (1.0 - kept)
        state[_SPEED, i] = wanted + (state[_SPEED, i] - wanted) * kept
