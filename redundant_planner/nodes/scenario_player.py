"""scenario_player: publishes a scenario's obstacles and its twist over time, then ends."""

from __future__ import annotations

from dataclasses import dataclass
import time

from geometry_msgs.msg import Twist
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.parameters import check, parameter
from redundant_planner.nodes import messages, process
from redundant_planner.nodes.ros_parameters import declare
from redundant_planner.resources import resolve
from redundant_planner.scenario import load_scenario


@dataclass(frozen=True)
class PlayerParameters:
    """What scenario_player needs.

    Raises:
        ParameterError: a value has the wrong type or range.
    """

    scenario: str = parameter(
        '', description='Scenario file: a path, file:// or package:// location. Required.')
    urdf: str = parameter(
        '', description="URDF file to use instead of the scenario's robot file's.")
    rate: int = parameter(
        200, low=1, high=1000, unit='Hz', description='Rate of cmd_vel.')
    subscribers: int = parameter(
        1, low=1, high=100,
        description='The motion starts once this many nodes listen on its topics: 2 where a '
                    'recorder must not miss the beginning.')
    preview: bool = parameter(
        True, description='Whether the whole twist is announced on cmd_vel_preview before the '
                          'motion, for planners that look ahead.')
    settle: float = parameter(
        1.0, low=0.0, high=60.0, unit='s',
        description='How long the twist stays zero before the motion, while the middleware gets '
                    'used to the new node, and after it.')

    def __post_init__(self) -> None:
        """Check every value."""
        check(self)


class ScenarioPlayer(process.EndableNode):
    """Plays one scenario once the planner listens and commands the arm."""

    def __init__(self) -> None:
        """Read the scenario.

        Raises:
            PlannerError: the scenario is unusable.
        """
        super().__init__('scenario_player')
        settings = declare(self, PlayerParameters)
        if not settings.scenario:
            raise ParameterError("parameter 'scenario' is empty; give a scenario file")
        self._scenario = load_scenario(resolve(settings.scenario))
        changes = {'urdf': settings.urdf} if settings.urdf else {}
        self._base = self._scenario.load_robot(**changes).base_frame
        self._settle = settings.settle
        self._subscribers = settings.subscribers
        self._preview = (self.create_publisher(MultiDOFJointTrajectory, 'cmd_vel_preview', 1)
                         if settings.preview else None)
        self._begin: float | None = None
        self._ready = False
        self._twist = self.create_publisher(Twist, 'cmd_vel', 10)
        self._obstacles = self.create_publisher(MarkerArray, 'obstacles', 10)
        self.create_subscription(JointState, 'joint_command', self._on_joint_command, 10)
        self.create_timer(1.0 / settings.rate, self._tick,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_joint_command(self, message: JointState) -> None:
        self._ready = True

    def _tick(self) -> None:
        if self.guard.count:
            # Without cmd_vel the planner stops; to go on would be another scenario.
            self.get_logger().error(f'the scenario ends here: {self.guard.last}')
            self.status = 1
            self.end()
            return
        if self._begin is None:
            topics = [self._twist, self._obstacles] + ([self._preview] if self._preview else [])
            listeners = min(topic.get_subscription_count() for topic in topics)
            if not self._ready or listeners < self._subscribers:
                return
            self._obstacles.publish(messages.markers_of(self._scenario.obstacles, self._base))
            self._announce()
            self._begin = time.monotonic() + self._settle
        elapsed = time.monotonic() - self._begin
        twist = self._scenario.twist_at(elapsed) if elapsed >= 0.0 else np.zeros(6)
        self._twist.publish(messages.twist_to_message(twist))
        if elapsed > self._scenario.duration + self._settle:
            self.get_logger().info(f"scenario '{self._scenario.name}' is over")
            self.end()

    def _announce(self) -> None:
        if self._preview is None:
            return
        message = messages.preview_to_message(self._scenario.preview())
        message.header.stamp = (self.get_clock().now() + Duration(seconds=self._settle)).to_msg()
        message.header.frame_id = self._base
        self._preview.publish(message)


def main(args: list[str] | None = None) -> int:
    """Run scenario_player."""
    return process.run(ScenarioPlayer, 'scenario_player', args)


if __name__ == '__main__':
    raise SystemExit(main())
