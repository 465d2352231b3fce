"""Several tips that hold one object, or each go their own way: what is wanted, and what it means.

The operator says what is wanted at any time; the planner couples its tips between two ticks.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.io.tip_topics import OBJECT
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.tip_commands import TipCommands
from redundant_planner.paper.method import PaperPlanner

Array = npt.NDArray[np.float64]

# An arm this slow stands still, as to what its hands begin to hold [rad/s, m/s].
_STANDS_STILL = 1e-3


class TipCoupling:
    """Whether the tips of a robot hold one object together."""

    def __init__(self, robot: Robot, command: CommandInput | TipCommands) -> None:
        """Begin with tips that each go their own way.

        Args:
            robot: the arm, or the body with several tips.
            command: the inputs, which know what is wanted.
        """
        self._robot, self._command = robot, command

    @property
    def wanted(self) -> bool:
        """Whether the operator wants the tips to hold one object."""
        return isinstance(self._command, TipCommands) and self._command.coupled

    def ask(self, wanted: bool, velocity: Array, posture: Array | None) -> tuple[bool, str]:
        """Have the tips hold one object, or no longer.

        Args:
            wanted: which of both.
            velocity: (n,) commanded now [rad/s, m/s].
            posture: (n,) measured [rad, m]; None if unknown.

        Returns:
            Whether that can be, and a sentence about it.
        """
        robot, command = self._robot, self._command
        if not isinstance(command, TipCommands):
            return False, f"'{robot.name}' has one tip; to couple takes two (parameter 'tips')"
        if np.abs(velocity).max() > _STANDS_STILL:
            return False, 'the arm moves; couple and let go while it stands still'
        if wanted and posture is None:
            return False, 'nothing was heard on joint_states yet'
        if wanted and robot.m < 6 * len(robot.tips):
            return False, 'to couple takes all six axes of each tip'
        command.forget()
        command.coupled = wanted
        return True, (f'{" and ".join(robot.tips)} hold one object: move it by {OBJECT}/cmd_vel '
                      f'and {OBJECT}/target_pose' if wanted else 'each tip moves on its own')

    def apply(self, planner: Planner | PaperPlanner, posture: Array) -> None:
        """Couple a planner's tips where they are, or let go, as it is wanted.

        Args:
            planner: between two of its ticks.
            posture: (n,) measured [rad, m].
        """
        if not isinstance(planner, Planner) or self.wanted == (planner.coupling is not None):
            return
        if self.wanted:
            planner.couple(q=posture)
        else:
            planner.uncouple()

    @property
    def no_twist(self) -> Array:
        """A twist of zero, (6,) for what is moved as one, or (t, 6) for t tips."""
        tips = len(self._robot.tips)
        return np.zeros(6) if tips == 1 or self.wanted else np.zeros((tips, 6))

    def places(self, planner: Planner | PaperPlanner, tips: Poses) -> Poses:
        """Return where what the operator moves is: the tips, or what they hold.

        Args:
            planner: of the robot.
            tips: where its tips are.
        """
        if not self.wanted or not isinstance(planner, Planner):
            return tips
        coupling = planner.coupling or Coupling.of(tips)
        return Poses.of(coupling.object_pose(tips.first))

    def object_pose(self, planner: Planner | PaperPlanner, posture: Array | None) -> Pose | None:
        """Return where what the tips hold is in the base frame; None while they hold nothing.

        Args:
            planner: of the robot.
            posture: (n,) measured [rad, m]; None if unknown.
        """
        if not isinstance(planner, Planner) or planner.coupling is None or posture is None:
            return None
        return planner.coupling.object_pose(self._robot.kinematics(posture).tips.first)
