"""A second arm that follows the same commands by another method, offline."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PAPER_METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, pose_error
from redundant_planner.core.target.goal import Target
from redundant_planner.paper.method import PaperPlanner
from redundant_planner.playground.measures import nearest_pair, Tally

Array = npt.NDArray[np.float64]

# What the page calls the methods → parameters that make them.
METHODS_TO_COMPARE: dict[str, dict[str, Any]] = {
    'least norm: J⁺ẋ alone': {'method': 'paper_gradient_projection', 'criteria_k_fixed': 0.0},
    "the paper's, to the letter": {'method': 'paper'},
    'gradient projection': {'method': 'gradient_projection'},
    'dynamic factor': {'method': 'dynamic_factor'},
    'variational': {'method': 'variational'},
}
# Period of its planner, and how many ticks it makes up for at once [s].
_PERIOD, _MOST_TICKS = 0.01, 20
# A method that knows no targets goes to a pose in a line: its speed for each metre and radian that
# are left [1/s], and at most [m/s, rad/s].
_GAIN, _FASTEST = 2.0, 0.25


class Ghost:
    """The arm that is not there.

    Attributes:
        q: (n,) where it is [rad, m].
        tally: what it has done.
    """

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, method: str, q: Array, now: float,
    ) -> None:
        """Begin where the real arm is.

        Args:
            robot: the arm.
            parameters: of its planner.
            method: one of `METHODS_TO_COMPARE`.
            q: (n,) where it is.
            now: [s].

        Raises:
            ParameterError: the method cannot have these parameters.
        """
        changes = METHODS_TO_COMPARE[method]
        kind = PaperPlanner if changes['method'] in PAPER_METHODS else Planner
        self.q, self.tally = q, Tally(q)
        self._robot, self._time = robot, now
        self._planner = kind(robot, replace(parameters, **changes))

    def follow(self, twist: Array, target: Target | None, scene: Scene, now: float) -> None:
        """Go on to a time [s] with a command: a twist (6,), or a target.

        Without a planner's stop it goes on through everything: what another method would do.
        """
        ticks = int((now - self._time) / _PERIOD)
        self._time += ticks * _PERIOD
        for _ in range(min(ticks, _MOST_TICKS)):
            if isinstance(self._planner, PaperPlanner):
                result = self._planner.step(
                    self.q, twist if target is None else self._towards(target), scene, _PERIOD)
            else:
                result = self._planner.step(self.q, twist, scene, _PERIOD, target=target)
            self.q = self.q + _PERIOD * result.dq
        if ticks:
            near = nearest_pair(self._robot, self._robot.kinematics(self.q), scene)
            self.tally.take(self.q, np.inf if near is None else near.distance)

    def _towards(self, target: Target) -> Array:
        """Return a twist (6,) to a pose; none to joint positions, which are no task of the tip."""
        if not isinstance(target, Pose):
            return np.zeros(6)
        arm = self._robot.kinematics(self.q)
        tip = Pose(arm.tip_position, arm.tip_rotation)
        twist = _GAIN * pose_error(target, tip, self._robot.in_tool)
        return twist * min(1.0, _FASTEST / max(float(np.linalg.norm(twist)), 1e-9))
