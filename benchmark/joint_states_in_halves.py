"""A relay that says an arm's joint states as two drivers do, each of half of the joints.

    python benchmark/joint_states_in_halves.py

It takes what the arm says on `whole`, and publishes `joint_states` from two nodes. Runs as a child
process of `benchmark.drivers`.
"""

from __future__ import annotations

import contextlib

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from redundant_planner.nodes.runtime import best_executor

WHOLE = 'whole'


class _Half(Node):
    """Publishes the first half of the joints, or the second."""

    def __init__(self, *, first: bool) -> None:
        super().__init__(f'driver_{1 if first else 2}')
        self._first = first
        self._publisher = self.create_publisher(JointState, 'joint_states', 10)
        self.create_subscription(JointState, WHOLE, self._pass_on, 10)

    def _pass_on(self, message: JointState) -> None:
        middle = len(message.name) // 2
        half = slice(None, middle) if self._first else slice(middle, None)
        self._publisher.publish(JointState(
            header=message.header, name=message.name[half], position=message.position[half],
            velocity=message.velocity[half]))


if __name__ == '__main__':
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = best_executor(rclpy.get_default_context())
    nodes = [_Half(first=True), _Half(first=False)]  # the executor alone would not keep them
    for node in nodes:
        executor.add_node(node)
    with contextlib.suppress(KeyboardInterrupt):
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
