"""A planner's parameters as a ROS parameter file that needs no other file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import yaml

from redundant_planner.core.parameters import ros_name, spec_of
from redundant_planner.core.robot import model
from redundant_planner.io.link_shapes import capsule_entry
from redundant_planner.io.parameter_files import RobotParameters


def parameter_file_text(
    parameters: RobotParameters, robot: model.Robot, static: Mapping[str, Mapping[str, Any]],
    *settings: Any,
) -> str:
    """Return a ROS parameter file that needs no other file: the URDF and all capsules are in it.

    Args:
        parameters: as the robot was built with.
        robot: the robot.
        static: entries of the static obstacles.
        settings: further parameter dataclasses.
    """
    values: dict[str, Any] = {}
    for group in (parameters, *settings):
        values |= {ros_name(entry): getattr(group, entry.name) for entry in fields(group)
                   if spec_of(entry).node}
    values |= {'urdf': '', 'robot_description': robot.urdf,
               'capsules': [c.name for c in robot.capsules],
               'capsule': {c.name: capsule_entry(c) for c in robot.capsules},
               'static_obstacle': {name: dict(entry) for name, entry in static.items()}}
    values = {key: list(value) if isinstance(value, tuple) else value
              for key, value in values.items()}
    # In C where there is such: the planner does this between two ticks.
    dumper = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
    return str(yaml.dump({'/**': {'ros__parameters': values}}, Dumper=dumper, sort_keys=False))
