"""The robot that a bag is of, from its planner's configuration, its URDF or a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from redundant_planner.core.errors import PlannerError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.bag_reader import Bag, Event
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.recorded_configuration import configuration_of
from redundant_planner.io.resources import resolve
from redundant_planner.io.robot_files import build_robot, likely_tip, load_robot, robot_of_values

# Radius of the straight links that stand for shapes that are not known [m].
_UNKNOWN_RADIUS = 0.05


def robot_of_bag(
    bag: Bag, params: Path | None, urdf: str, tip: str, notes: list[str],
) -> tuple[Robot | None, dict[str, Any]]:
    """Return the robot of a bag and all parameter values that are known of its planner.

    Args:
        bag: open for reading.
        params, urdf, tip: as for `analyse`.
        notes: takes a sentence where something had to be guessed.

    Raises:
        PlannerError: what was given cannot be used.
    """
    configuration = description = ''
    for item in bag.read(('configuration', 'robot_description')):
        if isinstance(item, Event):
            if item.topic == 'configuration':
                configuration = item.message.data
            else:
                description = item.message.data
    values = configuration_of(configuration, notes) if configuration else {}
    if params is not None:
        return load_robot(params, **({'urdf': urdf} if urdf else {})), values
    if urdf:
        file = resolve(urdf)
        return _robot_of_urdf(file.read_text(), tip, file, notes), values
    try:
        if values:
            return robot_of_values(values), values
        if description:
            return _robot_of_urdf(description, tip, None, notes), values
    except Exception as error:  # a bag may hold anything, and is analysed all the same
        if tip and isinstance(error, PlannerError):
            raise
        notes.append(f'no robot: the recorded one is unusable ({error}); give --urdf or --params '
                     'for the tool and the clearance')
        return None, values
    notes.append('no robot: neither configuration nor robot_description was recorded; give --urdf '
                 'or --params for the tool and the clearance')
    return None, values


def _robot_of_urdf(text: str, tip: str, file: Path | None, notes: list[str]) -> Robot:
    parameters = RobotParameters(
        urdf=str(file) if file is not None else '', robot_description=text,
        tip_frame=tip or likely_tip(text))
    if not tip:
        notes.append(f"tip_frame '{parameters.tip_frame}' is a guess; --tip names another")
    try:
        return build_robot(parameters, text, {})
    except PlannerError as error:
        notes.append(f'link shapes are straight and {_UNKNOWN_RADIUS} m thick: {error}')
        return build_robot(replace(parameters, link_shapes='straight', velocity_max=(
            1.0,) if 'velocity_max' in str(error) else (), link_radius=_UNKNOWN_RADIUS), text, {})
