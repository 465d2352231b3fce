"""Joints beside the planner's chain that are locked where they are found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from redundant_planner.core.robot.simulated_arm import joint_ranges
from redundant_planner.io.parameter_files import OTHERS_MEASURED, RobotParameters
from redundant_planner.io.robot_files import build_robot


def joints_to_measure(parameters: RobotParameters, urdf: str) -> tuple[str, ...]:
    """Return the joints that are locked where they are found; none if that is not wanted.

    Those are the movable joints of the URDF that are neither in the chain nor locked by name.

    Raises:
        RobotError, ParameterError: as `build_robot`.
    """
    if OTHERS_MEASURED not in parameters.locked_joints:
        return ()
    chain = build_robot(replace(parameters, capsules=(), link_shapes='straight'), urdf, {})
    return tuple(name for name in joint_ranges(urdf).names
                 if name not in chain.joint_names and name not in parameters.locked)


def locked_at(parameters: RobotParameters, positions: Mapping[str, float]) -> RobotParameters:
    """Return the parameters with measured joints locked: name → position [rad, m]."""
    return replace(parameters, locked_joints=tuple(
        f'{name}={position!r}' for name, position in {**parameters.locked, **positions}.items()))
