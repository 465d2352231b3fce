"""A ROS node inside the tests that talks to real processes, and waits on conditions."""

from __future__ import annotations

from contextlib import contextmanager
import os
from pathlib import Path
import tempfile
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from forked_nodes import Forked, ForkedProcesses
from geometry_msgs.msg import Twist
import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from ros_domains import next_domain
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from redundant_planner.nodes.messages import twist_to_message
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
keep_off_shared_memory()
# A test of live processes that fails is tried again, twice at most, if the machine stood still
# meanwhile or was busy with other work, as conftest.py measures; the summary lists it. On a quiet
# machine a failure counts at once.
LIVE = pytest.mark.flaky(reruns=2, reruns_delay=1, condition='config.was_hindered()')
# How long a test waits before it fails; a machine that does other things too may stand still
# for a second at any moment, so what is true `at once` is waited for all the same.
PATIENCE = 120.0


class Station:
    """Publishes commands, collects what the nodes say."""

    def __init__(self, node, executor):
        self.node, self._executor, self._clients = node, executor, {}
        self.states: list[JointState] = []
        self.commands: list[JointState] = []
        self.statuses: list[DiagnosticStatus] = []
        self.twist = node.create_publisher(Twist, 'cmd_vel', 10)
        self.joint_states = node.create_publisher(JointState, 'joint_states', 10)
        self.obstacles = node.create_publisher(MarkerArray, 'obstacles', 10)
        node.create_subscription(JointState, 'joint_states', self.states.append, 100)
        node.create_subscription(JointState, 'joint_command', self.commands.append, 100)
        node.create_subscription(
            DiagnosticArray, '/diagnostics', lambda m: self.statuses.extend(m.status), 10)

    def spin(self, timeout=0.01):
        self._executor.spin_once(timeout_sec=timeout)

    def wait_for(self, condition, what='condition', patience=PATIENCE, meanwhile=lambda: None):
        """Spin until a condition holds, and do something else between the messages."""
        deadline = time.monotonic() + patience
        while not condition():
            assert time.monotonic() < deadline, (
                f'waited {patience} s in vain: {what}; last diagnostics: {self.statuses[-1:]}')
            meanwhile()
            self.spin(0.001)

    def driver(self, twist, rate=100.0):
        """Return a function that publishes a twist at a rate, called as often as one likes."""
        message = twist_to_message(twist)
        last = -np.inf

        def publish():
            nonlocal last
            if time.monotonic() >= last + 1.0 / rate:
                last = time.monotonic()
                self.twist.publish(message)

        return publish

    def drive_until(self, twist, condition, what, rate=100.0):
        """Publish a twist at a rate until a condition holds, then nothing more."""
        self.wait_for(condition, what, meanwhile=self.driver(twist, rate))

    def drive(self, twist, seconds, rate=100.0):
        """Publish a twist at a rate for a while, then nothing more."""
        end = time.monotonic() + seconds
        self.drive_until(twist, lambda: time.monotonic() > end, 'the end', rate)

    def drive_until_silent(self, twist):
        """Drive on until no command has come for a while."""
        deadline = time.monotonic() + PATIENCE
        while self.commands:
            assert time.monotonic() < deadline, 'the planner goes on publishing'
            self.commands.clear()
            self.drive(twist, 0.2)

    def call(self, kind, name, request, meanwhile=lambda: None):
        """Call a service of the planner's, and do something else between the messages."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, f'/planner_node/{name}')
        client = self._clients[name]
        self.wait_for(client.service_is_ready, name, meanwhile=meanwhile)
        # A server that has not discovered the client's side yet answers into the void: ask again.
        futures = []
        begin = time.monotonic()

        def ask():
            meanwhile()
            if len(futures) <= (time.monotonic() - begin) / 3.0:
                futures.append(client.call_async(request))

        self.wait_for(lambda: any(f.done() for f in futures), f'answer of {name}', meanwhile=ask)
        return next(f.result() for f in futures if f.done())

    def state(self, names):
        """The latest positions of the named joints; others may have heard of them before us."""
        self.wait_for(lambda: self.states, 'joint_states')
        message = self.states[-1]
        return np.array([message.position[message.name.index(name)] for name in names])

    def moves(self):
        """Return whether the latest command moves the arm."""
        return bool(self.commands) and np.any(self.commands[-1].velocity)

    def stops(self):
        """Return whether the latest command is a stop."""
        return bool(self.commands) and not np.any(self.commands[-1].velocity)

    def at_rest(self):
        recent = self.commands[-20:]
        return len(recent) == 20 and not any(np.any(m.velocity) for m in recent)


@contextmanager
def station(kind=ForkedProcesses):
    """Yield a Station and a kind of Processes on a ROS domain of their own."""
    domain = next_domain()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('station', context=context)
    executor = best_executor(context)
    executor.add_node(node)
    try:
        with kind(domain) as processes:
            yield Station(node, executor), processes
    finally:
        # An executor that is not shut down keeps its context, and that all that is on the network.
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def run_node(node, *arguments):
    """Run a node that is expected to end by itself; return (status, stderr)."""
    environment = dict(os.environ, ROS_DOMAIN_ID=str(next_domain()))
    with tempfile.NamedTemporaryFile() as errors:
        child = Forked(node, ['--ros-args', *arguments], environment, Path(errors.name))
        try:
            status = child.wait(PATIENCE)
        finally:
            child.kill()
        return status, Path(errors.name).read_text()


def every(seconds, what):
    """Call something no more often than that."""
    last = [-np.inf]

    def call():
        if time.monotonic() > last[0] + seconds:
            last[0] = time.monotonic()
            what()

    return call


def children_of(marker: str) -> list[str]:
    """Command lines of live processes of this package that carry a marker in their environment."""
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        try:
            if marker.encode() in (process / 'environ').read_bytes():
                found.append((process / 'cmdline').read_text())
        except OSError:
            continue
    return found
