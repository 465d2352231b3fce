"""Where an arm shall go: a pose of the tip, or positions of all joints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import StateError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import checked_pose, Pose

Array = npt.NDArray[np.float64]

# A pose in the base frame, or joint positions (n,) [rad, m].
Target = Pose | Array


def checked_target(target: Target, robot: Robot) -> Target:
    """Return a target as arrays of numbers.

    Raises:
        StateError: it is neither a pose nor n joint positions, or a joint cannot go there.
    """
    if isinstance(target, tuple):
        return checked_pose(target)
    q = robot.checked_posture(target)
    beyond = (q < robot.position_min) | (q > robot.position_max)
    if beyond.any():
        raise StateError('; '.join(
            f"the target of joint '{robot.joint_names[j]}' is {q[j]:.6g}; it must be "
            f'{robot.position_min[j]:.6g} to {robot.position_max[j]:.6g}'
            for j in np.flatnonzero(beyond)))
    return q
