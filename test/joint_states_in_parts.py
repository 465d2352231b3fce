"""A process that says what an arm says on `whole` in parts, beside joint states of others.

As two drivers, a gripper's, and one whose joints have a prefix would. It needs a core's attention:
in the test's own process, states would come late.
"""

from __future__ import annotations

import contextlib

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String

PREFIX = '2024_'


class Parts(Node):
    """Publishes all but the last two joints, and these half as often, in the other order."""

    def __init__(self):
        """Listen; names on `silent` are left out from then on, with spaces between them."""
        super().__init__('parts')
        self._count, self._silent = 0, ()
        self._one, self._other = (self.create_publisher(JointState, 'joint_states', 10)
                                  for _ in range(2))
        self.create_subscription(JointState, 'whole', self._pass_on, 10)
        self.create_subscription(String, 'silent', self._be_silent, QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def _be_silent(self, message):
        self._silent = message.data.split()

    def _pass_on(self, message):
        self._count += 1
        names = list(message.name)
        doubles = [PREFIX + name for name in names]
        self._say(self._one, message, names[:-2], ['finger', *doubles])
        if self._count % 2:
            self._say(self._other, message, names[:-3:-1], [])
        if self._count % 5 == 0:
            self._say(self._other, message, [], ['finger'])
            self._say(self._other, message, [], doubles)

    def _say(self, publisher, message, names, others):
        names = [name for name in names if name not in self._silent]
        if names or others:
            at = [message.name.index(name) for name in names]
            publisher.publish(JointState(
                header=message.header, name=[*names, *others],
                position=[*(message.position[i] for i in at), *[9.0] * len(others)],
                velocity=[*(message.velocity[i] for i in at), *[0.0] * len(others)]))


if __name__ == '__main__':
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(Parts())
