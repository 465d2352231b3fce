"""Velocity-level redundancy resolution for robot arms among obstacles.

These names are the public API; `examples/` shows them in use:

    robot = Robot.from_urdf('my_robot.urdf', 'tool0')
    planner = Planner(robot, PlannerParameters())
    result = planner.step(q, twist, Scene.of(obstacles), dt)

Importing the package loads nothing else, and never ROS: a name loads its module when it is used
first. So a node without mathematics starts at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from redundant_planner.core.errors import (
        ObstacleError,
        ParameterError,
        PlannerError,
        RobotError,
        ScenarioError,
        StateError,
    )
    from redundant_planner.core.horizon.preview import Preview
    from redundant_planner.core.obstacles.obstacle import Obstacle
    from redundant_planner.core.obstacles.scene import Scene
    from redundant_planner.core.own_rules import Barrier, Criterion
    from redundant_planner.core.parameters import PlannerParameters
    from redundant_planner.core.planner import Planner
    from redundant_planner.core.robot.capsules import Capsule
    from redundant_planner.core.robot.kinematics import Kinematics
    from redundant_planner.core.robot.se3 import Pose
    from redundant_planner.core.step_result import StepResult, TipResult
    from redundant_planner.core.target.chunk import Chunk
    from redundant_planner.core.target.moving_target import Sighting
    from redundant_planner.core.target.progress import Progress, TargetState
    from redundant_planner.io.robot_files import Robot
    from redundant_planner.simulation import Motion, simulate

__version__ = '0.3.0'

__all__ = [
    'Barrier',
    'Capsule',
    'Chunk',
    'Criterion',
    'Kinematics',
    'Motion',
    'Obstacle',
    'ObstacleError',
    'ParameterError',
    'Planner',
    'PlannerError',
    'PlannerParameters',
    'Pose',
    'Preview',
    'Progress',
    'Robot',
    'RobotError',
    'ScenarioError',
    'Scene',
    'Sighting',
    'StateError',
    'StepResult',
    'TargetState',
    'TipResult',
    'simulate',
]

_MODULES = {
    'core.errors': ('ObstacleError', 'ParameterError', 'PlannerError', 'RobotError',
                    'ScenarioError', 'StateError'),
    'core.horizon.preview': ('Preview',),
    'core.obstacles.obstacle': ('Obstacle',),
    'core.obstacles.scene': ('Scene',),
    'core.own_rules': ('Barrier', 'Criterion'),
    'core.parameters': ('PlannerParameters',),
    'core.planner': ('Planner',),
    'core.robot.capsules': ('Capsule',),
    'core.robot.kinematics': ('Kinematics',),
    'core.robot.se3': ('Pose',),
    'core.step_result': ('StepResult', 'TipResult'),
    'core.target.chunk': ('Chunk',),
    'core.target.moving_target': ('Sighting',),
    'core.target.progress': ('Progress', 'TargetState'),
    'io.robot_files': ('Robot',),
    'simulation': ('Motion', 'simulate'),
}


def __getattr__(name: str) -> object:
    """Load a public name when it is used first (PEP 562)."""
    for module, names in _MODULES.items():
        if name in names:
            value = getattr(import_module(f'{__name__}.{module}'), name)
            globals()[name] = value
            return value
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
