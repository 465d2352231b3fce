"""The way to a target: free, in a line, or first the one and then the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.horizon.least_norm_path import path_joints
from redundant_planner.core.horizon.preview import PreviewAhead
from redundant_planner.core.obstacles.inflation import InflatedObstacles
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.redundancy.command import SLOWEST
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.stages import Filtered
from redundant_planner.core.target.free_space import FreeSpace
from redundant_planner.core.target.free_way import FreeWay, JointMotion, Stretch
from redundant_planner.core.target.progress import Progress, TargetState
from redundant_planner.core.target.straight_way import StraightWay

Array = npt.NDArray[np.float64]


class Aim(NamedTuple):
    """What a tick shall do about its target.

    Attributes:
        twist: (6,) of the tip, in command axes [m/s, rad/s].
        ahead: the twists to come, None where they are not known.
        joints: what the joints shall do, None where the tip's twist counts.
    """

    twist: Array
    ahead: PreviewAhead | None
    joints: JointMotion | None


class Way:
    """The way of one arm to its target."""

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, limits: Limits,
        constants: RobotConstants, gains: Gains,
    ) -> None:
        """Prepare for an arm; the other arguments are made of the parameters."""
        self._robot, self._constants = robot, constants
        self._joints = path_joints(constants, gains, limits)
        full_speed = np.maximum(
            (parameters.limits_linear_speed, parameters.limits_angular_speed), SLOWEST)
        self._line = StraightWay(robot, limits, self._joints, full_speed)
        self._free = None if parameters.target_path == 'straight' else FreeWay(
            robot, limits, constants.scaling, full_speed, parameters.feedback_gain)
        self._space: tuple[InflatedObstacles, FreeSpace] | None = None

    def reset(self) -> None:
        """Forget the target."""
        self._line.reset()
        if self._free is not None:
            self._free.reset()

    def aim(
        self, start: Start, target: Pose, followed: Array, delay: float,
        obstacles: Callable[[], InflatedObstacles],
    ) -> Aim:
        """Return what to do in a tick.

        Args:
            start: of the tick.
            target: in the base frame.
            followed: (6,) the twist of the last tick as far as it was followed, in command axes.
            delay: of the commands behind what is planned [s].
            obstacles: returns those now, for links with their margin; the same object while
                nothing changes.
        """
        line, free = self._line, self._free
        target = line.sense(target, start.dt)
        if free is not None and line.follows_stream:
            free.reset()
        elif free is not None:
            joints = free.motion(
                start, target, lambda: self._space_among(obstacles()), stuck=line.is_stuck)
            if joints is not None:
                line.begin()
                twist = start.arm.jacobian @ joints.velocity
                return Aim(self._robot.full_twist(twist), None, joints)
        return Aim(*line.command(start, target, followed, delay), None)

    def went_on(self, result: Filtered, dt: float) -> None:
        """Note what a tick made of what the joints should do."""
        if self._free is not None:
            self._free.went_on(result.scale, result.residual, dt)

    def progress(self, target: Pose, tip: Pose) -> Progress:
        """Return how far the tip has come."""
        found = self._line.progress(target, tip)
        if self._free is None or found.state is TargetState.REACHED:
            return found
        free = self._free
        if free.out_of_reach:
            if found.state is not TargetState.MOVING:
                return found._replace(state=TargetState.OUT_OF_REACH)
        elif free.in_vain or (free.stretch is Stretch.THINKING and free.tried_line):
            return found._replace(state=TargetState.BLOCKED)
        elif free.stretch is not Stretch.LINE:
            return found._replace(
                state=(TargetState.THINKING if free.stretch is Stretch.THINKING
                       else TargetState.MOVING), seconds=free.seconds)
        return found

    def _space_among(self, obstacles: InflatedObstacles) -> FreeSpace:
        """Return where the arm may be, the same object for obstacles that are the same."""
        known = self._space is not None and (
            self._space[0] is obstacles or all(map(np.array_equal, self._space[0], obstacles)))
        if self._space is None or not known:
            self._space = obstacles, FreeSpace(
                self._robot, self._constants, self._joints, obstacles)
        return self._space[1]
