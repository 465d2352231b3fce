"""The controllers of `benchmark.ros2_control` on topics, as a process of a live test.

    with station() as (ros, processes):
        arm = StandIn(ros, processes, tmp_path, 'position', active=False)
        processes.start('planner_node', [ROBOTS / 'panda.yaml'], {
            'urdf': PANDA_URDF, 'outputs': [arm.output]}, remap=arm.remap)
        arm.wait_until_heard()               # planner and controller have found each other
        ros.drive(twist, 5.0)                # commands that nobody takes
        arm.set(active=True)                 # returns once a cycle has begun with it
        mark = arm.now()
        ros.drive(twist, 1.0)
        cycles = arm.cycles(since=mark)      # what each joint did in each cycle
        assert np.abs(cycles.velocities).max() < 0.05 and not cycles.refused[-1]

Everything in `Settings` can be given to `StandIn` and changed later by `arm.set(...)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
import json
import os
from pathlib import Path
import time
from typing import NamedTuple

from conftest import PANDA_READY
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from benchmark.ros2_control import (
    Broadcaster,
    CONTROLLERS,
    Manager,
    OUTPUTS,
    Point,
    Settings,
    TRAJECTORY,
    VELOCITY,
)
from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.nodes.messages import seconds_of
from redundant_planner.nodes.runtime import best_executor

PANDA_JOINTS = tuple(f'panda_joint{i}' for i in range(1, 8))


class _ManagerNode(Node):
    """`Manager` on topics; it writes a row of each cycle to a file."""

    def __init__(self) -> None:
        super().__init__('controller_manager')
        given = json.loads(self.declare_parameter('given', '').value)
        self.manager = Manager(
            given['names'], given['start'], given['controller'], given['joints'],
            1.0 / given['rate'], Settings(**given['settings']))
        self._changes = 0
        self._record = os.open(given['record'], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._writer = JointWriter(self.manager.names)
        self._broadcaster = Broadcaster(self.manager)
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._states = self.create_publisher(JointState, 'joint_states', latched)
        self.create_subscription(String, '~/set', self._on_settings, latched)
        if given['controller'] == TRAJECTORY:
            self.create_subscription(
                JointTrajectory, CONTROLLERS[TRAJECTORY], self._on_trajectory, 10)
        else:
            self.create_subscription(
                Float64MultiArray, CONTROLLERS[given['controller']],
                lambda message: self._on_values(message.data), qos_profile_sensor_data)

    def _on_settings(self, message: String) -> None:
        self.manager.settings = Settings(**json.loads(message.data))
        self._changes += 1

    def _on_values(self, values: Sequence[float]) -> None:
        before = self.manager.refused
        self.manager.forward(values)
        self._say_refusal(before)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        before = self.manager.refused
        self.manager.trajectory(message.joint_names, [
            Point(seconds_of(point.time_from_start), point.positions, point.velocities)
            for point in message.points])
        self._say_refusal(before)

    def _say_refusal(self, before: int) -> None:
        if self.manager.refused > before:
            self.get_logger().error(self.manager.error, throttle_duration_sec=1.0)

    def cycle(self) -> None:
        manager = self.manager
        manager.cycle()
        now = time.monotonic()
        os.write(self._record, np.concatenate((
            [now, self._changes, manager.refused], manager.q, manager.dq,
            manager.written)).tobytes())
        for at, positions, velocities in self._broadcaster.cycle(now):
            stamp_ns = self.get_clock().now().nanoseconds - round(1e9 * (now - at))
            self._states.publish(self._writer.message(stamp_ns, positions, velocities))


def main() -> None:
    """Run the manager at its rate; it skips cycles that it has missed, as controller_manager does.

    The hardware has gone on meanwhile.
    """
    rclpy.init()
    node = _ManagerNode()
    executor = best_executor(rclpy.get_default_context())
    executor.add_node(node)
    due = time.monotonic()
    try:
        while rclpy.ok():
            due += node.manager.period
            while (left := due - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left)
            missed = int((time.monotonic() - due) / node.manager.period)
            node.manager.go_on_alone(missed)
            due += missed * node.manager.period
            node.cycle()
    except (ExternalShutdownException, KeyboardInterrupt):
        pass


class Cycles(NamedTuple):
    """What the arm did, a row for each cycle of the manager.

    Attributes:
        times: by `time.monotonic` [s].
        positions, velocities: (cycles, n) of the links, not what was measured [rad, m; per s].
        written: (cycles, n) the command interface.
        refused: messages that the controller had refused until then.
    """

    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    written: np.ndarray
    refused: np.ndarray


class StandIn:
    """The process, as a live test sees it.

    Attributes:
        output: name of the planner's output that the controller listens to.
        remap: from there to the controller's topic, for `processes.start`.
        names: joints of the hardware, the columns of `cycles`.
        process: to be stopped and killed.
    """

    def __init__(
        self, ros, processes, folder: Path, controller: str = VELOCITY, *,
        names: Sequence[str] = PANDA_JOINTS, start: Sequence[float] = tuple(PANDA_READY),
        joints: Sequence[str] = PANDA_JOINTS, rate: float = 250.0, **settings,
    ) -> None:
        """Start it.

        Args:
            ros, processes: of `live_helpers.station`.
            folder: for its record.
            controller: VELOCITY, POSITION or TRAJECTORY.
            names, start: of the hardware's joints in the order of its URDF, a gripper's included.
            joints: the controller's parameter; in another order than the planner's they are
                swapped.
            rate: of the manager [Hz].
            settings: of `Settings`.
        """
        self.output, self.names = OUTPUTS[controller], tuple(names)
        self.remap = {self.output: CONTROLLERS[controller]}
        self._ros, self._settings = ros, Settings(**settings)
        self._record = folder / f'{controller}_cycles_{time.monotonic_ns()}'
        self._topic = ros.node.resolve_topic_name(CONTROLLERS[controller])
        self._changes = 0
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = ros.node.create_publisher(String, '/controller_manager/set', latched)
        given = json.dumps({
            'names': list(names), 'start': list(start), 'controller': controller,
            'joints': list(joints), 'rate': rate, 'record': str(self._record),
            'settings': asdict(self._settings)})
        # Quoted once more, as a parameter that looks like YAML would be read as such.
        self.process = processes.start(
            Path(__file__).stem, values={'given': json.dumps(given)})

    def wait_until_heard(self) -> None:
        """Wait until the planner commands, and the controller and the arm have been found."""
        self._ros.wait_for(lambda: self._ros.commands and self._ros.states, 'the first commands')
        self._ros.wait_for(
            lambda: self._ros.node.count_subscribers(self._topic)
            and self._ros.node.count_publishers(self._topic)
            and self._ros.twist.get_subscription_count(), 'planner and controller')

    def set(self, **changes) -> None:
        """Change settings; return once a cycle has begun with them."""
        self._settings = replace(self._settings, **changes)
        self._changes += 1
        self._publisher.publish(String(data=json.dumps(asdict(self._settings))))
        self._ros.wait_for(lambda: self._rows()[-1:, 1] == self._changes, f'{changes}')

    def now(self) -> float:
        """Return the time that `cycles` takes [s]."""
        return time.monotonic()

    def cycles(self, since: float = -np.inf) -> Cycles:
        """Return all cycles since a time [s]."""
        rows, n = self._rows(), len(self.names)
        rows = rows[rows[:, 0] >= since]
        return Cycles(rows[:, 0], *(rows[:, 3 + i * n:3 + (i + 1) * n] for i in range(3)),
                      rows[:, 2])

    def _rows(self) -> np.ndarray:
        width = 3 + 3 * len(self.names)
        if not self._record.exists():
            return np.empty((0, width))
        numbers = np.fromfile(self._record)
        return numbers[:len(numbers) // width * width].reshape(-1, width)
