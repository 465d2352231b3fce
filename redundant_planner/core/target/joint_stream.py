"""After a stream of joint positions: as fast as it moves, and towards where it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.target.joint_motion import JointMotion
from redundant_planner.core.target.moving_target import MovingTarget, Sighting
from redundant_planner.core.target.patience import Patience

Array = npt.NDArray[np.float64]

# How far a sample may always be from where it is expected [rad, m].
_GATE = 0.15
# A stream that goes on after a silence is taken up if no joint is further away [rad, m].
_NEAR = 1.0
# In what time the joints make good what they are behind [s].
_CLOSING_TIME = 0.08
# Shares of the acceleration limits: for braking where the stream is, and in all.
_BRAKING, _ALL = 0.5, 0.9
# A joint that is less far behind gets on [s at full speed].
_CLOSE_BEHIND = 0.05
# This near to a stream that stands, the arm stands [s at full speed].
_OVER = 1e-7
# Nothing is nearer, for the sake of divisions [rad, m].
_TINY = 1e-12


class JointStream:
    """A stream of joint positions, and how the arm comes after it.

    Attributes:
        patience: how long it has not come nearer.
    """

    def __init__(self, limits: Limits, position_max: Array, lag: float) -> None:
        """Prepare for an arm.

        Args:
            limits: of its joints.
            position_max: (n,) infinite for joints that turn without end.
            lag: behind the stream [s].
        """
        self._limits, self._position_max = limits, position_max
        self._target = MovingTarget(lag, np.full(len(position_max), _GATE))
        self.reset()

    def reset(self) -> None:
        """Forget the stream."""
        self._target.reset()
        self._given: Array | None = None
        self.patience = Patience()

    def go_on_from(self, other: JointStream) -> None:
        """Take over what another one knows of the stream."""
        self._target.go_on_from(other._target)
        self._given = other._given

    @property
    def moves(self) -> bool:
        """Whether the targets are a stream, or were one until it fell silent."""
        return self._target.moves

    def wait(self, seconds: float) -> None:
        """Let time go by: the stream has gone on meanwhile."""
        self._target.wait(seconds)

    def sense(self, news: Sequence[Sighting], start: Start) -> None:
        """Take the targets (n,) that came since the last tick."""
        q, turns = start.arm.q, self._position_max
        numbers: list[tuple[Array, float | None]] = []
        for target, age in news:
            self._given = nearest_turn(
                np.asarray(target), q if self._given is None else self._given, turns)
            numbers.append((self._given, age))
        self._target.sense(
            numbers, start.dt, lambda n: bool((np.abs(n - q) <= _NEAR).all()))

    def motion(self, start: Start, delay: float) -> JointMotion:
        """Return what the joints shall do in a tick, `delay` [s] before the commands do it."""
        assert self._target.estimate is not None
        limits, dt = self._limits, start.dt
        estimate = self._target.estimate.after(delay)
        away = np.clip(estimate.value, limits.positions[1], limits.positions[0]) - start.arm.q
        distance = np.maximum(np.abs(away), _TINY)
        # From where it is each joint can still brake.
        brakes = np.sqrt(2.0 * _BRAKING * limits.acceleration_max / distance)
        wanted = estimate.after(0.5 * dt).velocity + min(1.0 / _CLOSING_TIME, brakes.min()) * away
        leap = wanted - start.previous
        most = float((np.abs(leap) / limits.acceleration_max).max())
        behind = float((distance / limits.velocity_max).max())
        self.patience.note(behind, dt)
        if behind < _CLOSE_BEHIND:
            self.patience = Patience()
        if behind < _OVER and not estimate.velocity.any():
            wanted = np.zeros_like(away)
        elif most > _ALL * dt:
            wanted = start.previous + _ALL * dt / most * leap
        return JointMotion(wanted, np.zeros_like(wanted))
