"""ros2_control, simulated: a manager, its broadcaster, one controller and the hardware behind.

ros2_control is not on PyPI. `Manager` follows the rules of controller_manager 4.46 and of the
controllers 4.42 as they were measured; it knows no ROS and no clock, so that tests can run it
cycle by cycle. `main` puts it on topics, and `StandIn` starts that as a process of a live test:

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

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
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

from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.nodes.messages import seconds_of
from redundant_planner.nodes.runtime import best_executor

VELOCITY, POSITION, TRAJECTORY = 'velocity', 'position', 'trajectory'
# The planner's output for each controller, and the topic that the controller listens to.
OUTPUTS = {VELOCITY: 'velocity_commands', POSITION: 'position_commands',
           TRAJECTORY: 'joint_trajectory'}
CONTROLLERS = {VELOCITY: '/forward_velocity_controller/commands',
               POSITION: '/forward_position_controller/commands',
               TRAJECTORY: '/joint_trajectory_controller/joint_trajectory'}
PANDA_JOINTS = tuple(f'panda_joint{i}' for i in range(1, 8))
# joint_trajectory_controller takes a velocity up to this for zero [rad/s, m/s].
_ZERO = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Settings:
    """What a test may change while the arm moves; joints by name, all others as they should be.

    Attributes:
        active: whether the controller is.
        allow_nonzero_velocity_at_trajectory_end: of joint_trajectory_controller.
        frozen: the hardware stands and says so, as a simulator that does not go on.
        dead: the readings stay what they were, whatever the arm does; stamps are fresh.
        stuck: joints that do not move.
        gain: joint → how far it moves for each unit that it is told to.
        moved: joint → how fast another controller moves it meanwhile [rad/s, m/s].
        pushed: joint → how fast somebody pushes it; a position drive brings it back [rad/s, m/s].
        lag: of the drives, of first order [s].
        dead_time: from the manager's write to the drives' reaction [s].
        backlash: between drive and link [rad, m].
        noise: standard deviation of the measured positions [rad, m].
        states_rate: of joint_states [Hz]; 0 for each cycle.
        states_delay: how late joint_states come, their stamps being true [s].
    """

    active: bool = True
    allow_nonzero_velocity_at_trajectory_end: bool = False
    frozen: bool = False
    dead: bool = False
    stuck: Sequence[str] = ()
    gain: Mapping[str, float] = field(default_factory=dict)
    moved: Mapping[str, float] = field(default_factory=dict)
    pushed: Mapping[str, float] = field(default_factory=dict)
    lag: float = 0.0
    dead_time: float = 0.0
    backlash: float = 0.0
    noise: float = 0.0
    states_rate: float = 0.0
    states_delay: float = 0.0


class Point(NamedTuple):
    """A point of a trajectory: [s], and for the joints that it names [rad, m; per s]."""

    time: float
    positions: Sequence[float]
    velocities: Sequence[float] = ()


class Manager:
    """One cycle after the other: read the hardware, update the controller, write.

    Attributes:
        names: joints of the hardware, in the order of its URDF.
        settings: assign new ones at any time.
        q, dq: (n,) where the links are and how fast they moved in the last cycle [rad, m; per s].
        measured, measured_velocities: (n,) what the broadcaster says of them.
        written: (n,) the command interface, positions or velocities.
        refused: messages that the controller did not take, and `error` why not the last one.
    """

    def __init__(
        self, names: Sequence[str], start: Sequence[float], controller: str,
        joints: Sequence[str], period: float, settings: Settings,
    ) -> None:
        """Stand still.

        Args:
            names: of the hardware's n joints.
            start: n positions [rad, m].
            controller: VELOCITY or POSITION (forward_command_controller) or TRAJECTORY.
            joints: the controller's parameter; the others stay where they are.
            period: of the manager [s].
            settings: at the start.
        """
        self.names, self.period = tuple(names), period
        self.controller, self._joints = controller, list(joints)
        self._index = [self.names.index(name) for name in joints]
        self.settings = settings
        self.q = np.array(start, dtype=float)
        self.dq = np.zeros_like(self.q)
        self.measured, self.measured_velocities = self.q.copy(), self.dq.copy()
        self.written = self.dq.copy() if controller == VELOCITY else self.q.copy()
        self.refused, self.error = 0, ''
        self._motor = self.q.copy()  # on the drive's side of the backlash
        self._motor_velocity = self.dq.copy()
        self._aimed = self.q.copy()  # where a position drive pulls to
        self._obeyed = self.written.copy()
        self._on_the_way: deque[tuple[int, np.ndarray]] = deque()
        self._cycles = 0
        self._random = np.random.default_rng(0)
        self._was_active = settings.active
        self._message: np.ndarray | None = None  # of a forward_command_controller
        self._points: list[Point] = []
        self._from: Point | None = None  # where the trajectory began, None before it was sampled
        self._begun = 0

    def forward(self, values: Sequence[float]) -> None:
        """Take a message of a forward_command_controller."""
        if len(values) != len(self._index):
            self._refuse(f'command size ({len(values)}) does not match number of interfaces '
                         f'({len(self._index)})')
        elif self.settings.active:
            self._message = np.array(values)

    def trajectory(self, joints: Sequence[str], points: Sequence[Point]) -> None:
        """Take a trajectory that starts now, if the controller would."""
        if not self.settings.active:
            return
        if set(joints) != set(self._joints) or len(joints) != len(self._joints):
            self._refuse("joints on incoming trajectory don't match the controller's joints")
        elif not points or any(
                later.time <= point.time for point, later in pairwise(points)):
            self._refuse('time between points is not strictly increasing')
        elif any(len(point.positions) != len(joints)
                 or len(point.velocities) not in (0, len(joints)) for point in points):
            self._refuse('mismatch between joint_names and positions or velocities')
        elif (not self.settings.allow_nonzero_velocity_at_trajectory_end
              and np.any(np.abs(points[-1].velocities) > _ZERO)):
            self._refuse('velocity of last trajectory point is not zero')
        else:
            order = [list(joints).index(name) for name in self._joints]
            self._points = [Point(point.time, np.array(point.positions)[order],
                                  np.array(point.velocities)[order] if len(point.velocities)
                                  else ()) for point in points]
            self._from = None

    def cycle(self) -> None:
        """Read, update, write."""
        self._cycles += 1
        self._read()
        if self.settings.active and not self._was_active:
            # forward_command_controller waits for the next message; the other one holds.
            self._message = None
            self._points = [Point(0.0, self.measured[self._index])]
            self._from = None
        self._was_active = self.settings.active
        if self.settings.active:
            if self.controller != TRAJECTORY:
                if self._message is not None:
                    self.written[self._index] = self._message
            else:
                self.written[self._index] = self._sampled()
        delay = round(self.settings.dead_time / self.period)
        self._on_the_way.append((self._cycles + 1 + delay, self.written.copy()))

    def _refuse(self, why: str) -> None:
        self.refused, self.error = self.refused + 1, why

    def _sampled(self) -> np.ndarray:
        """Return where the trajectory is one period from now, as the controller's command."""
        if self._from is None:
            self._begun = self._cycles
            self._from = Point(0.0, self.measured[self._index],
                               self.measured_velocities[self._index])
        now = (self._cycles - self._begun + 1) * self.period
        points = [self._from, *self._points]
        for before, after in pairwise(points):
            if now < after.time:
                return _between(before, after, now)
        return np.asarray(points[-1].positions)

    def _read(self) -> None:
        """Have a period pass for the hardware, and measure it."""
        settings, period = self.settings, self.period
        told_before = self._obeyed
        while self._on_the_way and self._on_the_way[0][0] <= self._cycles:
            self._obeyed = self._on_the_way.popleft()[1]
        gain, moved, pushed = self._each(settings.gain, 1.0), self._each(settings.moved), \
            self._each(settings.pushed)
        share = 1.0 - np.exp(-period / settings.lag) if settings.lag > 0.0 else 1.0
        if self.controller == VELOCITY:
            self._motor_velocity += (gain * self._obeyed - self._motor_velocity) * share
            motor = self._motor + (self._motor_velocity + moved) * period
        else:
            self._aimed += gain * (self._obeyed - told_before) + moved * period
            motor = self._motor + (self._aimed - self._motor) * share
        motor = motor + pushed * period
        still = np.array([settings.frozen or name in settings.stuck for name in self.names])
        self._motor = np.where(still, self._motor, motor)
        if self.controller != VELOCITY:
            # Whoever else moves the arm writes the same interface.
            self.written += moved * period
            self._obeyed = self._obeyed + moved * period
        half = 0.5 * settings.backlash
        q = np.clip(self.q, self._motor - half, self._motor + half)
        self.q, self.dq = q, (q - self.q) / period
        if not settings.dead:
            noise = (self._random.normal(0.0, settings.noise, len(q)) if settings.noise > 0.0
                     else 0.0)
            self.measured, self.measured_velocities = q + noise, self.dq.copy()

    def _each(self, values: Mapping[str, float], otherwise: float = 0.0) -> np.ndarray:
        return np.array([values.get(name, otherwise) for name in self.names])


def _between(before: Point, after: Point, now: float) -> np.ndarray:
    """Interpolate as joint_trajectory_controller does: cubic if both points have velocities."""
    whole, since = after.time - before.time, now - before.time
    p, q = np.asarray(before.positions), np.asarray(after.positions)
    if not len(before.velocities) or not len(after.velocities):
        return p + (q - p) * (since / whole)
    v, w = np.asarray(before.velocities) * whole, np.asarray(after.velocities) * whole
    s = since / whole
    return p + s * (v + s * (3.0 * (q - p) - 2.0 * v - w + s * (2.0 * (p - q) + v + w)))


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
        self._late: deque[tuple[float, bytes]] = deque()
        self._states_due = 0.0
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
        settings = manager.settings
        if settings.states_rate <= 0.0 or now >= self._states_due:
            if settings.states_rate > 0.0:
                self._states_due = max(self._states_due + 1.0 / settings.states_rate, now)
            self._late.append((now + settings.states_delay, self._writer.message(
                self.get_clock().now().nanoseconds, manager.measured,
                manager.measured_velocities)))
        while self._late and self._late[0][0] <= now:
            self._states.publish(self._late.popleft()[1])


def main() -> None:
    """Run the manager at its rate; a cycle that is late is made up for at once."""
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
