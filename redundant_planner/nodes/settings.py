"""All parameters of planner_node, as they are at the moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from rclpy.node import Node

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.workspace import walls
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.obstacle_bounds import checked
from redundant_planner.io.obstacle_entries import obstacle_of
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.parameter_writer import parameter_file_text
from redundant_planner.nodes.ros_parameters import (
    CAPSULE,
    declare,
    declare_entries,
    STATIC_OBSTACLE,
)

Entries = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Settings:
    """A node's parameters in their groups.

    Attributes:
        robot, planner, node: the robot, the mathematics, the loop.
        capsules, static_obstacles: name → key → value, as given.
    """

    robot: RobotParameters
    planner: PlannerParameters
    node: PlannerNodeParameters
    capsules: Entries
    static_obstacles: Entries

    @classmethod
    def declared(cls, node: Node) -> Settings:
        """Declare all parameters on a node and return their values.

        Raises:
            ParameterError: a value does not fit.
        """
        robot = declare(node, RobotParameters)
        planner = declare(node, PlannerParameters)
        loop = declare(node, PlannerNodeParameters)
        return cls(
            robot, planner, loop, declare_entries(node, 'capsule', robot.capsules, CAPSULE),
            declare_entries(node, 'static_obstacle', loop.static_obstacles, STATIC_OBSTACLE,
                            runtime=True))

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return the static obstacles, and the walls of the workspace.

        Raises:
            ObstacleError, ParameterError: naming one that cannot be used.
        """
        return checked((
            *(obstacle_of(name, entry) for name, entry in self.static_obstacles.items()),
            *walls(self.node.workspace)))

    def changed(
        self, planner: PlannerParameters, node: PlannerNodeParameters,
        entries: Mapping[tuple[str, str], Any],
    ) -> Settings:
        """Return settings with new groups and changed static obstacles, (name, key) → value."""
        static = {name: dict(entry) for name, entry in self.static_obstacles.items()}
        for (name, key), value in entries.items():
            static[name][key] = value
        return replace(self, planner=planner, node=node, static_obstacles=static)

    def file_text(self, robot: Robot) -> str:
        """Return a parameter file with all of this and the robot's URDF and shapes in it."""
        return parameter_file_text(
            self.robot, robot, self.static_obstacles, self.planner, self.node)
