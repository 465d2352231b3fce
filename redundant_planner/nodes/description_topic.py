"""The URDF on robot_description: it may come late, again, or changed."""

from __future__ import annotations

from collections.abc import Callable
import time

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

from redundant_planner.core.errors import PlannerError
from redundant_planner.nodes.endable_node import EndableNode

# How often a node says that it still waits [s].
_REMINDER = 5.0


class DescriptionTopic:
    """Hands on the first usable URDF, and says when another one comes later.

    It lives as long as its node.
    """

    def __init__(
        self, node: EndableNode, take: Callable[[str], None], is_done: Callable[[], bool],
    ) -> None:
        """Listen from now on.

        Args:
            node: to subscribe on.
            take: takes a URDF that has not come before; may raise PlannerError.
            is_done: whether a URDF has been taken for good.
        """
        self._node, self._take, self._is_done = node, take, is_done
        self._topic = node.resolve_topic_name('robot_description')
        self._latest, self._taken, self._since = '', '', time.monotonic()
        node.create_subscription(
            String, 'robot_description', self._on_message,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        node.get_logger().info(f'waiting for a URDF on the topic {self._topic}')
        self._reminder = node.create_timer(
            _REMINDER, self._remind, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_message(self, message: String) -> None:
        """Take a URDF, or say what is wrong with it; a bad one leaves the node waiting."""
        if message.data == self._latest:
            return
        self._latest = message.data
        logger = self._node.get_logger()
        if self._is_done():
            if message.data != self._taken:
                logger.warning(
                    f'{self._topic} has changed, and {self._node.get_name()} goes on with the '
                    'URDF that it began with: restart it to take the new one')
            return
        try:
            self._take(message.data)
            self._taken = message.data
        except PlannerError as error:
            logger.error(f'{self._topic}: {error}')

    def _remind(self) -> None:
        """Say that nothing has come yet."""
        if self._taken or self._is_done():
            self._node.destroy_timer(self._reminder)
            return
        why = ('what came cannot be used' if self._latest else
               'its publisher has sent none (it must be transient local)'
               if self._node.count_publishers(self._topic) else 'nobody publishes there')
        self._node.get_logger().warning(
            f'waiting for a URDF on the topic {self._topic} for '
            f'{time.monotonic() - self._since:.0f} s: {why}')
