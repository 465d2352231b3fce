"""Back to the commanded path after an evasion, by a free way where the tip is stuck on its way."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import RobotConstants
from redundant_planner.core.redundancy.reference import followed_poses
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.core.target.goal import TipGoals

Array = npt.NDArray[np.float64]

# A tip this near to its path is back on it [m, rad].
_BACK = 1e-3
# It is stuck if it has not come nearer by as much in so long [m, rad], [s].
_NEARER, _PATIENCE = 2e-3, 0.3
# Without a way for so long, or at rest on one, the path goes on from where the tip is [s]. A tip
# this slow is at rest [m/s, rad/s].
_IN_VAIN, _AT_REST = 5.0, 1e-3


class ComingBack:
    """Whether the arm has left its path, and how it gets back to it."""

    def __init__(self, robot: Robot, constants: RobotConstants) -> None:
        """Prepare for an arm."""
        self._robot, self._constants = robot, constants
        self.reset()

    def reset(self) -> None:
        """The arm is on its path, wherever that is."""
        self._home: Poses | None = None  # where the path has got to
        self._goes = False  # by a free way
        self._nearest = np.inf
        self._waited = 0.0

    @property
    def is_away(self) -> bool:
        """Whether the arm has left its path, and is not back yet."""
        return self._home is not None

    @property
    def target(self) -> Pose | TipGoals | None:
        """Where a free way shall lead; None where the tip gets back by itself, or is there."""
        if self._home is None or not self._goes:
            return None
        tips = len(self._robot.tips)
        return TipGoals(self._home, (None,) * tips) if tips > 1 else self._home.first

    def missed(self, followed: Array, seconds: float) -> None:
        """Note that ticks did not take place, in which the path was followed as before (m,)."""
        if self._home is not None and not self._goes:
            self._home = followed_poses(
                self._home, followed, self._constants.rows, self._constants.in_tool, seconds)

    def note(
        self, reference: Poses, tips: Poses, followed: Array, dt: float, *, leaving: bool,
        lost: bool,
    ) -> bool:
        """Note how a tick went.

        Args:
            reference: where the tips should have been.
            tips: where they were.
            followed: (m,) the part of the path that was followed.
            dt: [s].
            leaving: whether the arm evades something.
            lost: whether no free way is known.

        Returns:
            Whether the path goes on from where the tip is: there is no way back.
        """
        if self._home is None:
            if not leaving:
                return False
            self._home = reference
        if not self._goes:
            self._home = followed_poses(
                self._home, followed, self._constants.rows, self._constants.in_tool, dt)
        off = float(np.abs(self._robot.task_rows(
            se3.poses_error(self._home, tips, self._robot.in_tool))).max())
        if off < _BACK and not leaving:
            self.reset()
        elif self._goes:
            at_rest = np.abs(followed).max() < _AT_REST
            self._waited = self._waited + dt if lost or at_rest else 0.0
            if self._waited > _IN_VAIN:
                self.reset()
                return True
        elif leaving or off < self._nearest - _NEARER:
            self._nearest, self._waited = off, 0.0
        else:
            self._waited += dt
            self._goes = self._waited > _PATIENCE
            self._waited *= not self._goes
        return False
