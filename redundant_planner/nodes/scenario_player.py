"""scenario_player: publishes a scenario's obstacles and its twist over time, then ends."""

from __future__ import annotations

import math

from geometry_msgs.msg import Twist
import numpy as np
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import ParameterError
from redundant_planner.io.node_parameters import PlayerParameters
from redundant_planner.io.resources import resolve
from redundant_planner.io.scenario import load_scenario
from redundant_planner.nodes import messages, runtime
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.loop_clock import loop_clock
from redundant_planner.nodes.ros_parameters import declare, refuse_unknown_parameters

# How often obstacles and preview are published before the motion [s].
_ANNOUNCEMENTS = 0.2


class ScenarioPlayer(EndableNode):
    """Plays one scenario once the planner listens and commands the arm."""

    def __init__(self) -> None:
        """Read the scenario.

        Raises:
            PlannerError: the scenario is unusable.
        """
        super().__init__('scenario_player')
        settings = declare(self, PlayerParameters)
        refuse_unknown_parameters(self)
        if not settings.scenario:
            raise ParameterError("parameter 'scenario' is empty; give a scenario file")
        self._scenario = load_scenario(resolve(settings.scenario))
        self._base = self._scenario.base_frame(settings.urdf)
        self._settle = settings.settle
        self._subscribers = settings.subscribers
        self._preview = (self.create_publisher(MultiDOFJointTrajectory, 'cmd_vel_preview', 1)
                         if settings.preview else None)
        self._begin: float | None = None
        self._announced = -math.inf
        self._ready = False
        self._twist = self.create_publisher(Twist, 'cmd_vel', 10)
        self._obstacles = self.create_publisher(MarkerArray, 'obstacles', 10)
        self.create_subscription(JointState, 'joint_command', self._on_joint_command, 10)
        self._pace = loop_clock(self)
        if not self._pace.simulated:
            runtime.request_priority(settings.thread_priority)
        self.create_timer(1.0 / settings.rate, self._tick, clock=self._pace.timers)

    def _on_joint_command(self, message: JointState) -> None:
        self._ready = True

    def _tick(self) -> None:
        if self.guard.count:
            # The planner stops without cmd_vel; going on would play another scenario.
            self.get_logger().error(f'the scenario ends here: {self.guard.last}')
            self.status = 1
            self.end()
            return
        if self._begin is None:
            topics = [self._twist, self._obstacles] + ([self._preview] if self._preview else [])
            listeners = min(topic.get_subscription_count() for topic in topics)
            if not self._ready or listeners < self._subscribers:
                return
            self._begin = self._pace.now() + self._settle
        elapsed = self._pace.now() - self._begin
        self._announce(elapsed)
        twist = self._scenario.twist_at(elapsed) if elapsed >= 0.0 else np.zeros(6)
        self._twist.publish(messages.twist_to_message(twist))
        if elapsed > self._scenario.duration + self._settle:
            self.get_logger().info(f"scenario '{self._scenario.name}' is over")
            self.end()

    def _announce(self, elapsed: float) -> None:
        """Publish what is there and what comes, several times before the motion.

        A listener that is known to this node need not know this node yet, and misses what is
        published until then.
        """
        if elapsed > max(0.0, _ANNOUNCEMENTS - self._settle) or (
                elapsed < self._announced + _ANNOUNCEMENTS):
            return
        self._announced = elapsed
        self._obstacles.publish(messages.markers_of(self._scenario.obstacles, self._base))
        if self._preview is None:
            return
        message = messages.preview_to_message(self._scenario.preview())
        message.header.stamp = (self.get_clock().now() - Duration(seconds=elapsed)).to_msg()
        message.header.frame_id = self._base
        self._preview.publish(message)


def main(args: list[str] | None = None) -> int:
    """Run scenario_player."""
    return runtime.run(ScenarioPlayer, 'scenario_player', args)


if __name__ == '__main__':
    raise SystemExit(main())
