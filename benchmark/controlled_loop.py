"""The planner's loop in front of simulated controllers, by a clock of its own: no ROS, no waiting.

What runs is planner_node's `ControlLoop` with the bytes of real messages, and its `CommandOutput`;
only the topics between them are left out. A manager's cycle and the loop's tick alternate, each at
its rate, and nothing depends on how long a tick takes.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rclpy.clock import Clock
from rclpy.serialization import serialize_message

from benchmark.ros2_control import Broadcaster, Manager, OUTPUTS, Point, Settings, VELOCITY
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.payload import Payload
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.command_output import CommandOutput
from redundant_planner.nodes.control_loop import ControlLoop
from redundant_planner.nodes.guard import Guard
from redundant_planner.nodes.joint_messages import JointReader, JointWriter
from redundant_planner.nodes.last_word import LastWord
from redundant_planner.nodes.loop_clock import LoopClock
from redundant_planner.nodes.messages import seconds_of, twist_to_message
from redundant_planner.nodes.obstacle_input import ObstacleInput
from redundant_planner.nodes.state_report import status_of
from redundant_planner.paper.method import planner_of

Array = npt.NDArray[np.float64]

# The loop's clock when the first cycle runs [s].
_BEGIN = 1000.0
# A cycle and a tick that are due at times this near are due at the same time [s].
_ROUND_OFF = 1e-9


class Commands(NamedTuple):
    """What the loop has published, a row for each command.

    Attributes:
        times: by the loop's clock [s].
        positions, velocities: (ticks, n) of joint_command [rad, m; per s].
        planned: (ticks, n) the posture that was planned from, carried on by the command [rad, m].
    """

    times: Array
    positions: Array
    velocities: Array
    planned: Array


class Motion(NamedTuple):
    """What the arm has done, a row for each cycle of the manager.

    Attributes:
        times: by the loop's clock [s].
        positions, velocities: (cycles, n) of the links [rad, m; per s].
        written: (cycles, n) the command interface.
    """

    times: Array
    positions: Array
    velocities: Array
    written: Array


@dataclass
class _Publisher:
    """What `CommandOutput` takes for a publisher; `take` gets the messages."""

    topic_name: str
    take: Callable[[Any], None]
    heard: bool = True

    def publish(self, message: Any) -> None:
        """Hand a message over, as fast as light."""
        self.take(message)

    def get_subscription_count(self) -> int:
        """Return whether somebody listens."""
        return int(self.heard)

    def wait_for_all_acked(self, timeout: Any) -> bool:
        """Return whether all has arrived."""
        return True


class _Inbox:
    """What the loop takes for a subscription; of several messages it holds the last."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self._message: bytes | None = None

    def put(self, raw: bytes) -> None:
        self._message = raw

    def fetch_stamped(self) -> list[tuple[bytes, int]]:
        """Return the message that came since the last call, if one did, and when it was sent."""
        message, self._message = self._message, None
        return [] if message is None else [(message, 0)]


class ControlledLoop:
    """An arm behind a controller, and the loop that commands it.

    Attributes:
        manager: its `settings` may be changed at any time.
        loop: the planner's.
        now: [s].
        warnings: time and sentence of all that was said.
        sender: called before each tick, to send something.
        sleeps_until: no tick runs before that time, as the process was stopped [s].
    """

    def __init__(
        self, robot: Robot, start: Array, controller: str = VELOCITY, *,
        parameters: PlannerParameters | None = None, obstacles: Sequence[Obstacle] = (),
        joints: Sequence[str] = (), rate: int = 250, manager_rate: float = 0.0,
        phase: float = 0.5, follow_tolerance: float = 0.02, settings: Settings | None = None,
    ) -> None:
        """Stand still, with the planner listening.

        Args:
            robot: the arm.
            start: (n,) [rad, m].
            controller: VELOCITY, POSITION or TRAJECTORY.
            parameters: of the planner.
            obstacles: static ones.
            joints: the controller's parameter; the planner's order if left out.
            rate: of the planner [Hz].
            manager_rate: of the manager [Hz]; the planner's if 0.
            phase: how long after a cycle a tick begins, as a share of the period.
            follow_tolerance: [rad, m].
            settings: of controller and hardware.
        """
        self.robot = robot
        period = 1.0 / rate
        self.manager = Manager(
            robot.joint_names, start.tolist(), controller, list(joints) or robot.joint_names,
            1.0 / (manager_rate or rate), settings or Settings())
        self.now = _BEGIN
        self.warnings: list[tuple[float, str]] = []
        self.sender: Callable[[], None] = lambda: None
        self.sleeps_until = -np.inf
        self._period, self._phase = period, phase
        self._tick_due, self._cycle_due = _BEGIN + phase * period, _BEGIN
        self._broadcaster = Broadcaster(self.manager)
        self._writer = JointWriter(robot.joint_names)
        self._states, self._twists, self._targets = (
            _Inbox(topic) for topic in ('joint_states', 'cmd_vel', 'target_joints'))
        self._reader = JointReader(robot.joint_names)
        self._commands: list[tuple[float, Array, Array, Array]] = []
        self._motion: list[tuple[float, Array, Array, Array]] = []
        node: Any = SimpleNamespace(create_publisher=self._publisher)
        guard = Guard(self._fault)
        loop_settings = PlannerNodeParameters(
            rate=rate, follow_tolerance=follow_tolerance, outputs=(OUTPUTS[controller],))
        clock = LoopClock(
            lambda: self.now, lambda: round(1e9 * self.now), lambda: self.now, Clock(), True)
        command = CommandInput(
            {robot.base_frame: 'base', robot.tip_frame: 'tool'}, robot.command_frame, clock.now,
            clock.ros_time, self._warn)
        command.timeout = loop_settings.incoming_command_timeout
        sources = ObstacleSources.of(
            1, obstacles, (robot.base_frame, ''), transform=None, estimate_velocity=False)
        self.loop = ControlLoop(
            planner_of(robot, parameters or PlannerParameters()), loop_settings, clock=clock,
            command=command,
            obstacles=ObstacleInput(['obstacles'], sources, period, guard, self._warn),
            attached=Payload(robot),
            output=CommandOutput(node, robot.joint_names, loop_settings.outputs, period,
                                 robot.position_min, robot.position_max),
            last_word=LastWord.absent('simulated'), guard=guard, warn=self._warn,
            publish_tick=None)
        inboxes: list[Any] = [(self._states, self.loop.joints.on_joint_states),
                              (self._twists, command.on_twist),
                              (self._targets, lambda raw: command.on_joint_target(
                                  raw, robot, self.loop.supervisor.posture))]
        self.loop.inboxes = inboxes

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let time pass; return whether it ended before, as `until` came true after a tick."""
        end = self.now + seconds
        while min(self._tick_due, self._cycle_due) < end - _ROUND_OFF:
            if self._cycle_due <= self._tick_due + _ROUND_OFF:
                self.now, self._cycle_due = self._cycle_due, self._cycle_due + self.manager.period
                self._cycle()
            else:
                self.now, self._tick_due = self._tick_due, self._tick_due + self._period
                if self.now >= self.sleeps_until:
                    self._tick()
                    if until():
                        return True
        self.now = end
        return False

    def drive(self, twist: Array | None) -> None:
        """Have a twist (6,) sent before each tick from now on; None to let go of the stick."""
        raw = None if twist is None else serialize_message(twist_to_message(twist))
        self.sender = lambda: None if raw is None else self._twists.put(raw)

    def go_to(self, positions: Array) -> None:
        """Send a target for all joints (n,) [rad, m]."""
        self._targets.put(
            self._writer.message(round(1e9 * self.now), positions, np.zeros(self.robot.n)))

    @property
    def error(self) -> str:
        """What /diagnostics says as an error; empty if it says none."""
        status = status_of('planner', self.robot, self.loop.state, self.loop.supervisor.posture,
                           self.loop.planner.parameters.method, 0.0, 0, ())
        return str(status.message) if status.level == status.ERROR else ''

    def commands(self, since: float = -np.inf) -> Commands:
        """Return all commands since a time [s]."""
        return Commands(*_columns(self._commands, since))

    def motion(self, since: float = -np.inf) -> Motion:
        """Return all cycles since a time [s]."""
        return Motion(*_columns(self._motion, since))

    def _cycle(self) -> None:
        manager = self.manager
        manager.cycle()
        self._motion.append((self.now, manager.q.copy(), manager.dq.copy(),
                             manager.written.copy()))
        for at, positions, velocities in self._broadcaster.cycle(self.now):
            self._states.put(self._writer.message(round(1e9 * at), positions, velocities))

    def _tick(self) -> None:
        self.sender()
        self.loop.tick()

    def _publisher(self, kind: type, topic: str, depth: int) -> _Publisher:
        return _Publisher(topic, {
            'joint_command': self._on_command,
            'joint_trajectory': self._on_trajectory}.get(topic, self._on_values))

    def _on_command(self, raw: bytes) -> None:
        assert isinstance(self.loop.planner, Planner)
        self._reader.read(raw)
        velocities = self._reader.velocities(raw)
        assert velocities is not None
        self._commands.append(
            (self.now, self._reader.posture, velocities, self.loop.planner.posture_ahead))

    def _on_values(self, message: Any) -> None:
        self.manager.forward(message.data)

    def _on_trajectory(self, message: Any) -> None:
        self.manager.trajectory(message.joint_names, [
            Point(seconds_of(point.time_from_start), point.positions, point.velocities)
            for point in message.points])

    def _warn(self, sentence: str) -> None:
        self.warnings.append((self.now, sentence))

    def _fault(self, text: str) -> None:
        """End the run: an exception within a tick is never meant."""
        raise AssertionError(text)


def _columns(rows: Sequence[tuple[Any, ...]], since: float) -> list[Array]:
    """Return the columns of the rows since a time [s], which stands first in each."""
    first = bisect_left(rows, since, key=itemgetter(0))
    return [np.array(column) for column in zip(*rows[first:])] or [np.empty(0)] * 4
