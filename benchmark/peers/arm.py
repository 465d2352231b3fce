"""What the peers need to know of an arm, in the words of their libraries."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses

Array = npt.NDArray[np.float64]


def in_joint(robot: Robot, capsule: Capsule) -> tuple[int, Array, Array]:
    """Return a capsule's joint and its ends in that joint's frame."""
    frame = robot.model.frames[robot.model.getFrameId(capsule.frame)]
    return (int(frame.parentJoint), frame.placement.act(np.array(capsule.start)),
            frame.placement.act(np.array(capsule.end)))


def costs(robot: Robot) -> tuple[list[float], list[float]]:
    """Return the weights of a tip's position and orientation, 1 for what is controlled."""
    cost = robot.full_twist(np.ones(robot.m))[:6]
    return cost[:3].tolist(), cost[3:].tolist()


def poses_of(target: Pose | Poses) -> tuple[Pose, ...]:
    """Return the pose of each tip."""
    return target.each if isinstance(target, Poses) else (target,)
