"""The robot that a bag is of, from its planner's configuration, its URDF or a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from redundant_planner.core.errors import PlannerError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.bag_reader import Bag, Event
from redundant_planner.io.likely_tips import likely_tip
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.recorded_configuration import configuration_of
from redundant_planner.io.resources import resolve
from redundant_planner.io.robot_files import build_robot, load_robot, robot_of_values
from redundant_planner.io.software_version import version_of

# Radius of the straight links that stand for shapes that are not known [m].
_UNKNOWN_RADIUS = 0.05


class RobotOfBag(NamedTuple):
    """The robot of a bag, and what is known of its planner.

    Attributes:
        robot: None if nothing says which.
        values: the planner's parameters.
        software: version of the planner, empty if it is not recorded.
    """

    robot: Robot | None
    values: dict[str, Any]
    software: str


def robot_of_bag(
    bag: Bag, params: Path | None, urdf: str, tip: str, notes: list[str],
) -> RobotOfBag:
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
    software = version_of(configuration)

    def found(robot: Robot | None) -> RobotOfBag:
        return RobotOfBag(robot, values, software)

    if params is not None:
        return found(load_robot(params, **({'urdf': urdf} if urdf else {})))
    if urdf:
        file = resolve(urdf)
        return found(_robot_of_urdf(file.read_text(), tip, file, notes))
    try:
        if values:
            return found(robot_of_values(values))
        if description:
            return found(_robot_of_urdf(description, tip, None, notes))
    except Exception as error:  # a bag may hold anything, and is analysed all the same
        if tip and isinstance(error, PlannerError):
            raise
        notes.append(f'no robot: the recorded one is unusable ({error}); give --urdf or --params '
                     'for the tool and the clearance')
        return found(None)
    notes.append('no robot: neither configuration nor robot_description was recorded; give --urdf '
                 'or --params for the tool and the clearance')
    return found(None)


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
