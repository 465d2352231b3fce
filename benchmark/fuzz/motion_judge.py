"""Whether commanded velocities keep the limits of an arm's joints, whatever the ticks' lengths."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from benchmark.fuzz.tally import Tally
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Round-off that no limit is exceeded by: a share of it, and of a velocity or position.
_SHARE, _ROUND_OFF = 1e-6, 1e-9


class MotionJudge:
    """Carries velocities out to the letter, and holds them to the robot's limits.

    A velocity v that is commanded for dt takes the joints from q to q + v dt. It has to keep, of
    each joint:

    - the range, the margin not counted: q + v dt lies within the limits, or, of a joint that was
      found beyond one, no further beyond it than q;
    - the velocity limit: |v| ≤ v_max;
    - the acceleration limit: |v − u| ≤ a_max dt, with the velocity u that was commanded before;
    - the jerk limit: |v − 2u + w| ≤ j_max dt², with w before u. Only where the planner says that
      it keeps jerk, and dt has been the same for as long as its mean takes to forget: the smallest
      whole number of ticks in the time max 2 a_max / j_max.

    Attributes:
        q: (n,) where the joints are.
        velocity: (n,) what was commanded last.
    """

    def __init__(self, robot: Robot, q: Array) -> None:
        """Begin at rest."""
        self._robot, self.q = robot, q
        self._reversal = float((2.0 * robot.acceleration_max / robot.jerk_max).max())
        self.begin(np.zeros(robot.n))

    def begin(self, velocity: Array) -> None:
        """Begin anew with what is commanded here; what was commanded before does not count."""
        self.velocity, self._before = velocity, velocity
        self._dt, self._steady = math.nan, 0

    def carry_out(self, velocity: Array, dt: float, tally: Tally, *, jerk_kept: bool) -> bool:
        """Move for a tick; return whether every limit was kept, and count where not.

        Args:
            velocity: (n,) commanded [rad/s, m/s].
            dt: for how long [s].
            tally: counts.
            jerk_kept: whether the jerk limits were said to hold.
        """
        robot, u, w, before = self._robot, self.velocity, self._before, self.q
        self._steady = self._steady + 1 if jerk_kept and dt == self._dt else 0
        self._dt = dt
        self.q, self.velocity, self._before = before + dt * velocity, velocity, u
        high = np.maximum(robot.position_max, before)
        low = np.minimum(robot.position_min, before)
        beyond = {
            'position': np.maximum(self.q - high, low - self.q) - _ROUND_OFF,
            'velocity': np.abs(velocity) - (1.0 + _SHARE) * robot.velocity_max,
            'acceleration': np.abs(velocity - u) - (
                (1.0 + _SHARE) * robot.acceleration_max * dt + _ROUND_OFF)}
        if self._steady > math.ceil(self._reversal / dt) + 2:
            beyond['jerk'] = np.abs(velocity - 2.0 * u + w) - (
                (1.0 + _SHARE) * robot.jerk_max * dt * dt + _ROUND_OFF)
        for limit, excess in beyond.items():
            if excess.max() > 0.0:
                j = int(excess.argmax())
                tally.exceeded(limit, (
                    f"'{robot.name}', n = {robot.n}, joint '{robot.joint_names[j]}': "
                    f'{excess[j]:.3g} beyond; from {u[j]:.9g} to {velocity[j]:.9g} at '
                    f'{before[j]:.9g}, in a tick of {dt:.6g} s; limits '
                    f'{robot.position_min[j]:.6g} to {robot.position_max[j]:.6g}, '
                    f'{robot.velocity_max[j]:.6g}, {robot.acceleration_max[j]:.6g}, '
                    f'{robot.jerk_max[j]:.6g}\n'))
                return False
        return True
