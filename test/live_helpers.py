"""A ROS node inside the tests that talks to real processes, and waits on conditions."""

from __future__ import annotations

from contextlib import contextmanager
import itertools
import os
import subprocess
import sys
import time

from geometry_msgs.msg import Twist
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from redundant_planner.analysis.live import Processes
from redundant_planner.nodes.messages import twist_to_message
from redundant_planner.nodes.process import best_executor, keep_off_shared_memory

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
keep_off_shared_memory()
PATIENCE = 30.0
_domains = itertools.count(110 + os.getpid() % 20 * 5)


class Station:
    """Publishes commands, collects what the nodes say."""

    def __init__(self, node, executor):
        self.node, self._executor = node, executor
        self.states: list[JointState] = []
        self.commands: list[JointState] = []
        self.twist = node.create_publisher(Twist, 'cmd_vel', 10)
        self.joint_states = node.create_publisher(JointState, 'joint_states', 10)
        self.obstacles = node.create_publisher(MarkerArray, 'obstacles', 10)
        node.create_subscription(JointState, 'joint_states', self.states.append, 100)
        node.create_subscription(JointState, 'joint_command', self.commands.append, 100)

    def spin(self, timeout=0.01):
        self._executor.spin_once(timeout_sec=timeout)

    def wait_for(self, condition, what='condition', patience=PATIENCE):
        deadline = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < deadline, f'waited {patience} s in vain: {what}'
            self.spin()

    def drive(self, twist, seconds, rate=100.0):
        """Publish a twist at a rate for a while, then nothing more."""
        message = twist_to_message(twist)
        begin = time.monotonic()
        sent = 0
        while time.monotonic() - begin < seconds:
            if time.monotonic() - begin >= sent / rate:
                self.twist.publish(message)
                sent += 1
            self.spin(0.001)

    def state(self, names):
        """The latest positions of the named joints; others may have heard of them before us."""
        self.wait_for(lambda: self.states, 'joint_states')
        message = self.states[-1]
        return np.array([message.position[message.name.index(name)] for name in names])

    def at_rest(self):
        recent = self.commands[-20:]
        return len(recent) == 20 and not any(np.any(m.velocity) for m in recent)


@contextmanager
def station():
    """Yield a Station and a Processes on a ROS domain of their own."""
    domain = next(_domains) % 230
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('station', context=context)
    executor = best_executor(context)
    executor.add_node(node)
    try:
        with Processes(domain) as processes:
            yield Station(node, executor), processes
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def run_node(node, *arguments, timeout=30):
    """Run a node that is expected to end by itself; return (status, stderr)."""
    environment = dict(os.environ, ROS_DOMAIN_ID='231')
    done = subprocess.run(
        [sys.executable, '-m', f'redundant_planner.nodes.{node}', '--ros-args', *arguments],
        env=environment, capture_output=True, text=True, timeout=timeout, check=False)
    return done.returncode, done.stderr
