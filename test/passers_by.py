"""Other people's nodes, which join, listen to an arm, and leave, hang or are killed."""

from __future__ import annotations

import os
import signal
import time

from diagnostic_msgs.msg import DiagnosticArray
from forked_nodes import FORKS
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

# What the package chooses for its own processes is not for these.
_CHOSEN = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE',
           'FASTDDS_BUILTIN_TRANSPORTS')


class PasserBy:
    """One such node, in a process of its own, with the middleware's own transports."""

    def __init__(self, domain_id: int, discovery_range: str, hangs_after: float = float('inf')):
        """Start it; its process stops so many seconds after it has joined."""
        self._leave = FORKS.Event()
        self._heard = FORKS.Value('i', 0)
        self._process = FORKS.Process(target=_live, daemon=True, args=(
            domain_id, discovery_range, hangs_after, self._leave, self._heard))
        self._process.start()

    @property
    def heard(self) -> int:
        """How many messages of joint_command it has heard."""
        return self._heard.value

    def leave(self) -> None:
        """Have it say goodbye."""
        self._leave.set()

    def kill(self) -> None:
        """End it without a word."""
        self._process.kill()
        self._process.join()


def _live(domain_id: int, discovery_range: str, hangs_after: float, leave, heard) -> None:
    for name in _CHOSEN:
        os.environ.pop(name, None)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = discovery_range
    rclpy.init(domain_id=domain_id)
    node = Node(f'passer_by_{os.getpid()}')

    def count(message: bytes) -> None:
        heard.value += 1

    node.create_subscription(JointState, 'joint_command', count, 10, raw=True)
    for kind, topic in ((JointState, 'joint_states'), (DiagnosticArray, '/diagnostics')):
        node.create_subscription(kind, topic, lambda message: None, 10, raw=True)
    speaker = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    joined = time.monotonic()
    while not leave.is_set():
        if time.monotonic() > joined + hangs_after:
            os.kill(os.getpid(), signal.SIGSTOP)
        speaker.publish(DiagnosticArray())
        rclpy.spin_once(node, timeout_sec=0.02)
    node.destroy_node()
    rclpy.shutdown()
