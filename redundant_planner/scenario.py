"""Scenarios: a robot, where it starts, the twist over time and the obstacles, in one YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from redundant_planner.core.errors import known, PlannerError, ScenarioError
from redundant_planner.core.horizon import Preview
from redundant_planner.core.obstacles import Obstacle
from redundant_planner.core.robot import Robot
from redundant_planner.resources import resolve
from redundant_planner.robot_parameters import load_robot, obstacle_of

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
        obstacles: the ellipsoids, in the base frame.
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
        return load_robot(self.robot_file, **changes)

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
        content = yaml.safe_load(path.read_text())
    except (OSError, yaml.YAMLError) as error:
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
            raise ScenarioError(f"interpolation is '{interpolation}'; it must be 'hold' or "
                                "'linear'")
        times, twists = _profile(content['twist'])
        return Scenario(
            name=path.stem,
            robot_file=resolve(content['robot'], path.parent),
            start={str(k): float(v) for k, v in content['start'].items()},
            times=times, twists=twists, linear=interpolation == 'linear',
            obstacles=tuple(obstacle_of(str(entry.get('name', f'obstacle{i}')), entry)
                            for i, entry in enumerate(content.get('obstacles') or ())))
    except (PlannerError, TypeError, ValueError, AttributeError) as error:
        raise ScenarioError(f"scenario '{path}': {error}") from None


def _profile(entries: list[dict[str, Any]]) -> tuple[Array, Array]:
    times = np.array([float(entry['time']) for entry in entries])
    if len(times) < 2 or times[0] != 0.0 or not (np.diff(times) > 0.0).all():
        raise ScenarioError('twist takes two or more entries with ascending times, the first at '
                            f'0 and the last ending the motion; its times are {times.tolist()}')
    twists = np.array([[*entry.get('linear', (0.0, 0.0, 0.0)),
                        *entry.get('angular', (0.0, 0.0, 0.0))] for entry in entries], float)
    if twists.shape != (len(times), 6) or not np.isfinite(twists).all():
        raise ScenarioError('every twist takes three finite numbers in linear and in angular')
    return times, twists
