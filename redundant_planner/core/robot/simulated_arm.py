"""All joints of a URDF, and an arm of them that obeys velocity commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, RobotError
from redundant_planner.core.robot.urdf import MOVABLE, read_urdf

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class JointRanges:
    """The movable joints of a URDF, in the order in which they are written there.

    Attributes:
        names: joint names.
        position_min, position_max: [rad, m], infinite for continuous joints.
        velocity_max: [rad/s, m/s], infinite where the URDF gives none.
    """

    names: tuple[str, ...]
    position_min: Array
    position_max: Array
    velocity_max: Array


def joint_ranges(urdf: str) -> JointRanges:
    """Read the ranges of all independent movable joints.

    Raises:
        RobotError: the text is not a URDF, has no movable joint, or a joint lacks its limits.
    """
    joints = [joint for joint in read_urdf(urdf).joints
              if joint.kind in MOVABLE and joint.mimic is None]
    if not joints:
        raise RobotError('the URDF has no movable joint')
    return JointRanges(
        tuple(joint.name for joint in joints), np.array([joint.lower for joint in joints]),
        np.array([joint.upper for joint in joints]),
        np.array([joint.velocity or np.inf for joint in joints]))


class SimulatedArm:
    """An ideal velocity-controlled arm: it does what it is told, within the URDF's limits.

    Time comes in with every call, so it can run against a clock or offline.
    """

    def __init__(
        self, ranges: JointRanges, start: dict[str, float], *, command_timeout: float,
    ) -> None:
        """Stand still at the start posture; joints not named in it stand at 0 or at a limit.

        Args:
            ranges: the joints.
            start: joint name → position [rad, m].
            command_timeout: a command acts for this long unless it is renewed [s].

        Raises:
            RobotError: a joint is unknown or starts outside its limits.
        """
        self.ranges = ranges
        self._timeout = command_timeout
        self._q = np.minimum(np.maximum(np.zeros(len(ranges.names)), ranges.position_min),
                             ranges.position_max)
        for name, position in start.items():
            if name not in ranges.names:
                raise RobotError(f"initial position of unknown joint '{name}'; the URDF has "
                                 f'{known(ranges.names)}')
            i = ranges.names.index(name)
            if not ranges.position_min[i] <= position <= ranges.position_max[i]:
                raise RobotError(
                    f"initial position of joint '{name}' is {position}; its limits are "
                    f'[{ranges.position_min[i]}, {ranges.position_max[i]}]')
            self._q[i] = position
        self._dq = np.zeros_like(self._q)
        self._now = -np.inf
        self._expires = -np.inf

    @property
    def q(self) -> Array:
        """Positions at the last advance [rad, m]."""
        return self._q.copy()

    @property
    def dq(self) -> Array:
        """Velocities at the last advance [rad/s, m/s]."""
        return self._dq.copy()

    def command(self, now: float, dq: Array) -> None:
        """Move at `dq` (n,) from `now` on, as fast as the limits allow."""
        self.advance(now)
        self._dq = np.clip(dq, -self.ranges.velocity_max, self.ranges.velocity_max)
        self._expires = now + self._timeout

    def advance(self, now: float) -> None:
        """Integrate up to `now` [s]; a clock that goes backwards moves nothing."""
        moving = max(min(now, self._expires) - self._now, 0.0) if np.isfinite(self._now) else 0.0
        target = self._q + self._dq * moving
        self._q = np.clip(target, self.ranges.position_min, self.ranges.position_max)
        stopped = (self._q != target) | (now >= self._expires)
        self._dq = np.where(stopped, 0.0, self._dq)
        self._now = now
