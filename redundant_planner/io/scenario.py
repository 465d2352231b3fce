"""Scenarios: a robot, where it starts, the twist over time and the obstacles, in one YAML file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, PlannerError, ScenarioError, shown
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.numbers import floats_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.urdf import LARGEST, read_urdf
from redundant_planner.io.obstacle_entries import obstacle_of
from redundant_planner.io.parameter_files import check_keys, read_robot_parameters, urdf_text
from redundant_planner.io.resources import read_text, resolve, yaml_content

if TYPE_CHECKING:
    from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

_KEYS = ('robot', 'start', 'twist', 'obstacles', 'interpolation', 'description')


@dataclass(frozen=True)
class Scenario:
    """One motion to play or simulate.

    Attributes:
        name: the file's name without suffix.
        robot_file: the robot's ROS parameter file.
        start: joint name → start position [rad, m].
        times: (k,) ascending from 0 [s]; the last one ends the motion.
        twists: (k, 6) [m/s, rad/s] in the robot's command frame.
        linear: whether the twist is interpolated between the times or held until the next.
        obstacles: in the base frame.
    """

    name: str
    robot_file: Path
    start: dict[str, float]
    times: Array
    twists: Array
    linear: bool
    obstacles: tuple[Obstacle, ...]

    @property
    def duration(self) -> float:
        """How long the motion takes [s]."""
        return float(self.times[-1])

    def twist_at(self, time: float) -> Array:
        """Return the commanded twist (6,), zero before the start and from the end on."""
        if not 0.0 <= time < self.duration:
            return np.zeros(6)
        if self.linear:
            return np.array([np.interp(time, self.times, axis) for axis in self.twists.T])
        return self.twists[int(np.searchsorted(self.times, time, side='right')) - 1].copy()

    def preview(self) -> Preview:
        """Return the whole profile as what will be commanded."""
        if self.linear:
            return Preview(self.times, self.twists)
        return Preview(np.repeat(self.times, 2)[1:-1], np.repeat(self.twists[:-1], 2, axis=0))

    def load_robot(self, **changes: Any) -> Robot:
        """Build the scenario's robot; `changes` replace fields of RobotParameters.

        Raises:
            PlannerError: the robot file is unusable.
        """
        # Not at the top: playing a scenario takes no robot, and none of the mathematics.
        from redundant_planner.io.robot_files import load_robot
        return load_robot(self.robot_file, **changes)

    def base_frame(self, urdf: str = '') -> str:
        """Return the link that twists and obstacles refer to.

        Args:
            urdf: location that replaces the robot file's; none if empty.

        Raises:
            PlannerError: the robot file is unusable.
        """
        parameters, _ = read_robot_parameters(self.robot_file)
        if parameters.base_frame:
            return parameters.base_frame
        changed = replace(parameters, urdf=urdf) if urdf else parameters
        return read_urdf(urdf_text(changed, self.robot_file.parent)).root

    def start_posture(self, robot: Robot) -> Array:
        """Return the start positions (n,) in the robot's joint order.

        Raises:
            ScenarioError: a chain joint has no start position.
        """
        missing = [name for name in robot.joint_names if name not in self.start]
        if missing:
            raise ScenarioError(f"scenario '{self.name}' gives no start for {known(missing)}")
        return np.array([self.start[name] for name in robot.joint_names])


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file.

    Raises:
        ScenarioError: naming what the file lacks or has wrong.
    """
    try:
        content = yaml_content(read_text(path), 'it')
    except PlannerError as error:
        raise ScenarioError(f"scenario '{path}' cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise ScenarioError(f"scenario '{path}' is not a mapping with {known(_KEYS)}")
    unknown = [key for key in content if key not in _KEYS]
    missing = [key for key in ('robot', 'start', 'twist') if key not in content]
    if unknown or missing:
        raise ScenarioError(
            f"scenario '{path}' " + (f'has {known(unknown)}' if unknown else
                                     f'lacks {known(missing)}') + f'; it takes {known(_KEYS)}')
    try:
        interpolation = content.get('interpolation', 'hold')
        if interpolation not in ('hold', 'linear'):
            raise ScenarioError(f"interpolation is {shown(interpolation)}; it must be 'hold' or "
                                "'linear'")
        if not isinstance(content['robot'], str):
            raise ScenarioError(f'robot is {shown(content["robot"])}; it takes the location of a '
                                'parameter file')
        times, twists = _profile(content['twist'])
        return Scenario(
            name=path.stem,
            robot_file=resolve(content['robot'], path.parent),
            start=_start(content['start']),
            times=times, twists=twists, linear=interpolation == 'linear',
            obstacles=_obstacles(content.get('obstacles')))
    except PlannerError as error:
        raise ScenarioError(f"scenario '{path}': {error}") from None


def _start(entries: Any) -> dict[str, float]:
    if not isinstance(entries, dict):
        raise ScenarioError(f'start is {shown(entries)}; it takes a position for each joint')
    return {str(name): _number(value, f"the start of joint '{name}'")
            for name, value in entries.items()}


def _profile(entries: Any) -> tuple[Array, Array]:
    if not isinstance(entries, list) or len(entries) < 2:
        raise ScenarioError(f'twist is {shown(entries)}; it takes two or more entries')
    twists = np.zeros((len(entries), 6))
    for i, entry in enumerate(entries):
        check_keys('an entry of twist', entry, ('time',), ('linear', 'angular'))
        for part, key in ((slice(0, 3), 'linear'), (slice(3, 6), 'angular')):
            if key in entry:
                values = floats_of(entry[key])
                if values.shape != (3,) or not np.isfinite(values).all():
                    raise ScenarioError(f'{key} of an entry of twist is {shown(entry[key])}; it '
                                        'takes three finite numbers')
                twists[i, part] = values
    times = np.array([_number(entry['time'], 'the time of an entry of twist')
                      for entry in entries])
    if times[0] != 0.0 or not (np.diff(times) > 0.0).all():
        raise ScenarioError('twist takes entries with ascending times, the first at 0 and the '
                            f'last ending the motion; its times are {shown(times.tolist())}')
    return times, twists


def _obstacles(entries: Any) -> tuple[Obstacle, ...]:
    if entries is None:
        return ()
    if not isinstance(entries, list):
        raise ScenarioError(f'obstacles are {shown(entries)}; they must be a list')
    named = [str(entry.get('name', f'obstacle{i}')) if isinstance(entry, dict) else f'obstacle{i}'
             for i, entry in enumerate(entries)]
    return tuple(obstacle_of(name, entry) for name, entry in zip(named, entries))


def _number(value: Any, what: str) -> float:
    number = floats_of(value)
    if number.shape != () or not abs(number) <= LARGEST:
        raise ScenarioError(f'{what} is {shown(value)}; it takes a number within ±{LARGEST:g}')
    return float(number)
