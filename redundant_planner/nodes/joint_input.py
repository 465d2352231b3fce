"""Where the arm is, by the messages that say so."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.joint_turns import Seams
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.messages import base_states
from redundant_planner.nodes.supervisor import Supervisor

Array = npt.NDArray[np.float64]

# Messages whose times are remembered.
_TIMES = 200


class JointInput:
    """Reads joint positions, and tells the supervisor.

    Attributes:
        sent_ns: when the latest joint_states were sent, by the system's clock [ns]; the loop says
            so.
    """

    def __init__(
        self, robot: Robot, supervisor: Supervisor, now: Callable[[], float],
        warn: Callable[[str], None],
    ) -> None:
        """Begin without a measurement.

        Args:
            robot: the arm.
            supervisor: is told.
            now: returns when the tick began that reads the messages [s].
            warn: takes a sentence about a message that was refused.
        """
        self.sent_ns: deque[int] = deque(maxlen=_TIMES)
        self._reader = JointReader(robot.joint_names, Seams.of(robot))
        self._supervisor, self._now, self._warn = supervisor, now, warn

    @property
    def turned(self) -> Array | float:
        """By how much the arm's driver counts further than the supervisor's posture [rad]."""
        return self._reader.turned

    def on_joint_states(self, raw: bytes) -> None:
        """Take a serialised JointState."""
        try:
            which = self._reader.read(raw)
        except StateError as error:
            self._warn(f'joint_states ignored: {error}')
            return
        if len(which):
            self._supervisor.measured(self._reader.posture, self._now(), which)
        else:
            self._supervisor.heard_others(self._reader.others)

    def on_odometry(self, raw: bytes) -> None:
        """Take a serialised Odometry: the positions of the base's joints."""
        try:
            self.on_joint_states(base_states(raw))
        except StateError as error:
            self._warn(f'odom ignored: {error}')
