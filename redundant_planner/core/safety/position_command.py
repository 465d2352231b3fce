"""Where a velocity command leads: the posture to command to arms that take positions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, OutVector, Vector
from redundant_planner.core.safety.limits import Limits

Array = npt.NDArray[np.float64]

# Positions this near are the same [rad, m].
_SAME = 1e-9

class PositionCommand:
    """The integral of the velocity commands, held near the posture that is planned from.

    It starts at the measured posture and then follows the commands alone: adding q̇ dt to every
    measurement instead would leave a position-controlled arm standing behind its own lag. Where
    it leads further ahead of the planned posture than the drive explains, as after a push or with
    a joint that stands, it comes back within the limits of velocity and acceleration, and stops
    in time for the end of a joint's range.
    """

    def __init__(self, limits: Limits) -> None:
        """Begin without a posture; its steps keep these limits, the margin not counted."""
        self._limits = limits
        self._no_lead = np.zeros(len(limits.velocity_max))
        self.reset()

    def reset(self) -> None:
        """Start from the measured posture at the next advance."""
        self._q: Array | None = None
        self._dq = self._no_lead

    def start(self, measured: Array, tolerance: float) -> None:
        """Go on from a standing arm: from the last posture if the arm is there.

        Args:
            measured: (n,) [rad, m].
            tolerance: by which the arm may be elsewhere, as its load sags [rad, m].
        """
        if self._q is None or float(np.abs(self._q - measured).max()) > tolerance:
            self._q = measured
        self._dq = self._no_lead

    def is_at(self, posture: Array) -> bool:
        """Return whether the last posture is this one (n,) [rad, m]."""
        return self._q is None or bool((np.abs(self._q - posture) <= _SAME).all())

    def advance(
        self, dq: Array, dt: float, planned: Array | None = None, lead: Array | None = None,
    ) -> Array:
        """Return the positions (n,) to command for velocities `dq` held for `dt`.

        Args:
            dq: (n,) [rad/s, m/s].
            dt: [s].
            planned: (n,) where the arm will be by the commands, this one included [rad, m]; None
                if that is not known: the velocities alone count.
            lead: (n,) how far from there positions may be [rad, m]; None without `planned`.
        """
        if planned is None or lead is None:
            planned, lead = self._no_lead, self._no_lead + np.inf
        # The command may take the other half of the acceleration.
        return self._advanced(dq, dt, planned, lead, share=0.5)

    def come_back(self, posture: Array, dt: float) -> Array:
        """Return the positions (n,) to command on the fastest way to a posture (n,) [rad, m].

        Args:
            posture: (n,) where nothing moves [rad, m].
            dt: [s].
        """
        return self._advanced(self._no_lead, dt, posture, self._no_lead, share=1.0)

    def _advanced(
        self, dq: Array, dt: float, planned: Array, lead: Array, *, share: float,
    ) -> Array:
        assert self._q is not None, 'it starts from a posture'
        before, self._q, self._dq = self._q, self._q.copy(), self._dq.copy()
        _advance(self._q, self._dq, before, dq, planned, lead, self._limits, dt, share)
        return self._q.copy()


@compiled
def _stoppable(distance: float, acceleration: float, dt: float) -> float:
    """Return the largest speed of a tick after which a joint can stop within a distance.

    v dt + v² / (2 a) ≤ d: braking by a dt in each tick keeps that from tick to tick.
    """
    gain = acceleration * dt
    return np.sqrt(gain * gain + 2.0 * acceleration * distance) - gain


@compiled
def _advance(
    q: OutVector, speed: OutVector, before: Vector, dq: Vector, planned: Vector, lead: Vector,
    limits: Limits, dt: float, share: float,
) -> None:
    """Write the next positions (n,) and their velocities, which were those of the last tick.

    They come back to where they may be with a share of the acceleration.
    """
    for i in range(len(q)):
        most = limits.acceleration_max[i]
        # An arm found outside its range is not pulled: only its velocity command moves it.
        low = min(limits.positions[1, i] - limits.margin, before[i])
        high = max(limits.positions[0, i] + limits.margin, before[i])
        # Where the velocities lead, and the nearest place to that where it may be.
        goes = before[i] + dq[i] * dt
        to = min(max(goes, planned[i] - lead[i]), planned[i] + lead[i])
        to = min(max(to, low), high)
        wanted = dq[i]
        if to != goes:
            back = _stoppable(abs(to - goes), share * most, dt)
            wanted += back if to > goes else -back
        wanted = min(max(wanted, speed[i] - most * dt), speed[i] + most * dt)
        wanted = min(max(wanted, -limits.velocity_max[i]), limits.velocity_max[i])
        wanted = min(max(wanted, -_stoppable(before[i] - low, most, dt)),
                     _stoppable(high - before[i], most, dt))
        there = before[i] + wanted * dt
        if to != goes and abs(there - to) < _SAME:
            there = to
        q[i], speed[i] = there, (there - before[i]) / dt


def integrated(q: Array, dq: Array, dt: float, low: Array, high: Array) -> Array:
    """Return where velocities (n,) lead from positions (n,) within a range in dt [s].

    Joints outside their range stay there, or come in.
    """
    return np.clip(q + dq * dt, np.minimum(low, q), np.maximum(high, q))


def has_jumped(
    before: Array, after: Array, velocity_max: Array, elapsed: float | Array,
    tolerance: float,
) -> bool:
    """Return whether an arm was moved, or restarted elsewhere, rather than having moved.

    Args:
        before, after: (n,) successive measurements [rad, m].
        velocity_max: (n,) [rad/s, m/s].
        elapsed: time between them, of each joint (n,) if they differ [s].
        tolerance: [rad, m], for noise and late messages.
    """
    return bool((np.abs(after - before) > velocity_max * elapsed + tolerance).any())
