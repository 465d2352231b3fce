"""The user's own barriers as rows of the filter (docs/safety.md).

With v the velocity of the tick before and r = Σ |∂h/∂q_j| a_j (c + dt²), what the mean of planned
velocities and a tick cut off corners, a barrier h ≥ 0 asks for two rows:

    ∇h·q̇ + min(0, (h(q + dt v) − h(q))/dt − ∇h·v) ≥ −rate · (h − r)
    ∇h_r·q̇ ≥ −(max(0, h_r − r) − (1 − dt²/T²) ∇h_r·(q_r − q)) / (½ T' + dt),  q_r = q + ½ T v

The first one's second term is ½ dt vᵀ(∂²h/∂q²) v, where h bends down. The second one keeps h
where the arm comes to rest, with the stopping time T' of the next velocity: at r or more, or where
it is. Braking in proportion, T' = T − dt, always does that: it moves q_r by no more than the last
tick's share dt²/T² of the way.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.own_rules import Barrier, measured
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.barriers import Barriers, OWN, OWN_AT_REST
from redundant_planner.core.safety.limits import barrier_rate, Limits, stopping_time
from redundant_planner.core.step_result import OwnValue

Array = npt.NDArray[np.float64]

# What is left of the room that is kept for round-off and corners comes back by no more null-space
# motion than that [rad/s, m/s].
_SLOWLY_BACK = 1e-3
# A barrier has no rows while h is more than so many times what the fastest joints could ask for:
# that saves two more postures.
_FAR = 3.0


class OwnRows(NamedTuple):
    """What the user's barriers ask of a tick.

    Attributes:
        barriers: their rows.
        values: what each barrier came to.
        broken: names of barriers that are not finite numbers here or ahead: then the arm brakes.
    """

    barriers: Barriers
    values: tuple[OwnValue, ...]
    broken: tuple[str, ...]


class OwnBarriers:
    """The user's barriers of one arm.

    Attributes:
        barriers, names: all of them.
    """

    def __init__(
        self, robot: Robot, barriers: Sequence[Barrier], sizes: Sequence[float],
    ) -> None:
        """Take barriers that have been checked, and how large their gradients are."""
        self._robot, self.barriers = robot, tuple(barriers)
        self.names = tuple(barrier.name for barrier in barriers)
        # In rows all have gradients of about 1, whatever the unit of h.
        self._units = [size if size > 0.0 else 1.0 for size in sizes]

    def rows(
        self, start: Start, limits: Limits, gain: float, scaling: Array, corner: float,
        strayed: Array,
    ) -> OwnRows | None:
        """Return the rows of a tick; None without any.

        Args:
            start: of the tick.
            limits: of the joints.
            gain: largest share of h that may be used up per second [1/s].
            scaling: (n,) 1 / square root of the joint weights.
            corner: see `Smoothing` [s²].
            strayed: (n,) how far the arm is from where it is thought to be [rad, m].
        """
        if not self.barriers:
            return None
        arm, previous, dt = start.arm, start.previous, start.dt
        stop = stopping_time(previous, limits.acceleration_max)
        moves, rest = stop > 0.0, 0.5 * stop * previous
        next_arm: Kinematics | None = None
        arm_at_rest: Kinematics | None = None
        fastest = np.minimum(
            np.abs(previous) + limits.acceleration_max * dt, limits.velocity_max)
        uses_up = _FAR / barrier_rate(gain, stop + dt, dt) * fastest
        # Joint motion that corners cut off at most, those within a tick too.
        room = limits.acceleration_max * (corner + dt * dt) + strayed
        still = 1.0 - (dt / max(stop, dt)) ** 2  # the share of that way that braking goes
        values, broken, rows = [], [], []
        for i, (barrier, unit) in enumerate(zip(self.barriers, self._units)):
            here = measured(barrier, arm)
            values.append(OwnValue(barrier.name, math.nan if here is None else here.value))
            if here is None:
                broken.append(barrier.name)
                continue
            slopes = np.abs(here.gradient)
            if here.value > float(slopes @ (uses_up + room)):
                continue
            if next_arm is None:
                next_arm = self._robot.kinematics_at(arm.q + dt * previous) if moves else arm
                arm_at_rest = self._robot.kinematics_at(arm.q + rest) if stop > dt else None
            then = measured(barrier, next_arm) if moves else here
            if then is None:
                broken.append(barrier.name)
                continue
            gradient, kept = here.gradient / unit, float(slopes @ room) / unit
            # What a straight way of this tick's length bends h by.
            bent = (then.value - here.value) / (unit * dt) - float(gradient @ previous)
            value = here.value / unit - kept
            if value < 0.0:
                value = max(value, -_SLOWLY_BACK / gain * _null_motion(arm, scaling, gradient))
            rows.append(_Row(gradient, min(bent, 0.0), value, i, OWN))
            if arm_at_rest is None:
                continue
            end = measured(barrier, arm_at_rest)
            if end is None:
                broken.append(barrier.name)
                continue
            gradient = end.gradient / unit
            value = max(end.value / unit - kept, 0.0) - still * float(gradient @ rest)
            rows.append(_Row(gradient, 0.0, value, i, OWN_AT_REST))
        return OwnRows(_barriers(rows, len(arm.q)), tuple(values), tuple(broken))

    def rooms(self, postures: Array) -> Array:
        """Return h (N, b) at postures (N, n), in units of its gradient; −inf for no number."""
        rooms = np.full((len(postures), len(self.barriers)), -np.inf)
        for at, q in enumerate(postures):
            arm = self._robot.kinematics_at(q)
            for i, (barrier, unit) in enumerate(zip(self.barriers, self._units)):
                found = measured(barrier, arm)
                if found is not None:
                    rooms[at, i] = found.value / unit
        return rooms


class _Row(NamedTuple):
    """A row: see `Barriers`."""

    gradient: Array
    time_derivative: float
    value: float
    first: int
    kind: int


def _barriers(rows: list[_Row], n: int) -> Barriers:
    """Return rows (b) of n joints as barriers."""
    return Barriers(
        np.array([row.gradient for row in rows]).reshape(-1, n),
        np.array([row.time_derivative for row in rows], dtype=float),
        np.array([row.value for row in rows], dtype=float), np.zeros(len(rows)),
        np.array([row.kind for row in rows], dtype=np.intp),
        np.array([row.first for row in rows], dtype=np.intp),
        np.full(len(rows), -1))


def _null_motion(arm: Kinematics, scaling: Array, gradient: Array) -> float:
    """Return how much of a gradient (n,) null-space motion can follow."""
    parts = null_space.decompose(arm.jacobian * scaling)
    return float(np.linalg.norm(null_space.project(parts, scaling * gradient)))
