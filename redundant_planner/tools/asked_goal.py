"""The goal that a command line asks for: a pose of the tip, or positions of joints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import known, StateError
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.goal import checked_goal

Array = npt.NDArray[np.float64]


def target_of(
    tip: Pose, position: list[float] | None, rpy: list[float] | None, relative: bool,
) -> Pose:
    """Return the pose to go to, in the base frame.

    Args:
        tip: where it is now.
        position: x, y, z [m]; None to stay there.
        rpy: roll, pitch, yaw [rad]; None to keep the orientation.
        relative: whether both are given from where the tip is, in its axes.

    Raises:
        StateError: a number is not finite.
    """
    for name, values in (('--position', position), ('--rpy', rpy)):
        if not np.isfinite(values or 0.0).all():
            raise StateError(f'{name} is {values}; it takes three finite numbers')
    turn = None if rpy is None else np.asarray(pin.rpy.rpyToMatrix(*rpy))
    if relative:
        return se3.composed(tip, Pose(
            np.array(position or np.zeros(3), dtype=float), np.eye(3) if turn is None else turn))
    return Pose(tip.position if position is None else np.array(position, dtype=float),
                tip.rotation if turn is None else turn)


def joint_target_of(robot: Robot, q: Array, entries: list[str], relative: bool) -> Array:
    """Return the joint positions (n,) to go to.

    Args:
        robot: the arm.
        q: (n,) where it is now; joints that are not named stay there.
        entries: of the command line, 'joint=position' [rad, m].
        relative: whether the positions count from `q`.

    Raises:
        StateError: an entry is none, names no joint of the arm or one twice, or asks for more than
            its limits allow.
    """
    target = np.clip(q, robot.position_min, robot.position_max)
    named: set[str] = set()
    for entry in entries:
        name, _, text = entry.partition('=')
        try:
            value = float(text)
        except ValueError:
            raise StateError(f"--joints has '{entry}'; it takes joint=position, "
                             f"as '{robot.joint_names[0]}=0.5'") from None
        if name not in robot.joint_names:
            raise StateError(f"--joints has '{entry}'; the joints are {known(robot.joint_names)}")
        if name in named:
            raise StateError(f"--joints names '{name}' twice")
        named.add(name)
        j = robot.joint_names.index(name)
        target[j] = value + (q[j] if relative else 0.0)
    return np.asarray(checked_goal(target, robot))
