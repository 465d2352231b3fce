"""The page's side of ROS: what a planner and its arm say, and what they are told."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
import numpy as np
import numpy.typing as npt
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import PlannerError, StateError
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.goal import Goal
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.io.recorded_configuration import (
    configuration_of,
    obstacle_topics,
    recorded_obstacles,
    recorded_walls,
)
from redundant_planner.io.robot_files import robot_of_values
from redundant_planner.io.tip_topics import OBJECT, OBJECT_POSE, topic_of
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.messages import twist_from_bytes, twist_to_message
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.pose_messages import pose_of_message, pose_to_message
from redundant_planner.nodes.target_text import goal_of_text, TARGET, text_of_tip

Array = npt.NDArray[np.float64]

# An arm that has been silent for this long is not there [s].
_SILENCE = 1.0
# Joint states that may wait for a look at them: the latest of several publishers.
_STATES = 20
# A command that has been silent for this long is none [s].
_SILENCE_OF_TWIST = 0.2
# What tips hold together is let go of once nothing is said of it for this long [s].
_SILENCE_OF_OBJECT = 0.5
# Commands, and messages of a topic of obstacles, that may wait for a look at them. Of commands a
# look takes no more, however late it comes.
_COMMANDS, _OBSTACLES = 100, 500
# How long one look reads messages of a topic of obstacles, of those that wait [s]. Reading all of
# them would let more pile up meanwhile than before, and the page would stand still.
_READING = 0.005
# Periods that are looked at together, and how many of the latest they are.
_PERIODS = 500
# How the topic with the shape of another arm ends.
_BODY = '/body'
# What makes a robot, and not how it is moved.
_OF_ROBOT = ('robot_description', 'tip_frame', 'tips', 'base_frame', 'mount_frame', 'mount_pose',
             'capsules', 'capsule', 'axes', 'command_frame', 'locked_joints')


@dataclass
class Motion:
    """What the arm does, as the topics say.

    Attributes:
        measured: (n,) positions [rad, m].
        commanded: (n,) velocities [rad/s, m/s].
        accelerations: (n,) of the commands [rad/s², m/s²].
        periods: between the latest commands, by their stamps [s].
        command_stamp: of the latest one [ns], 0 before the first.
        heard: when joint_states came last, by the monotonic clock [s].
    """

    measured: Array
    commanded: Array
    accelerations: Array
    periods: deque[float] = field(default_factory=lambda: deque(maxlen=_PERIODS))
    command_stamp: int = 0
    heard: float = -np.inf


class PlannerClient:
    """One planner and its arm, in one namespace.

    Attributes:
        namespace: theirs, '' or as '/left'.
        robot: the arm; None until its planner has said what it is.
        parameters: of the planner.
        motion: what the arm does; None until it has been heard.
        scene: what the planner keeps clear of, as it hears it.
        status: what the planner says of itself in /diagnostics: name → value, and 'message'.
        target: what it says on ~/target, alike; empty without a target.
        reference: (k, 3) where the tip should have been lately [m].
        obstacle_topic: where it hears of obstacles; empty while that is not known.
        trouble: why the arm cannot be shown; empty if it can.
    """

    def __init__(
        self, executor: Executor, namespace: str, planner: str, *, drives: bool,
    ) -> None:
        """Listen to a planner.

        Args:
            executor: that spins.
            namespace: of planner and arm, '' or as '/left'.
            planner: name of its node.
            drives: whether it is ever told anything; else there is no publisher.
        """
        self.namespace = namespace
        self.robot: Robot | None = None
        self.parameters = PlannerParameters()
        self.motion: Motion | None = None
        self.status: dict[str, str] = {}
        self.target: dict[str, str] = {}
        self.trouble = self.obstacle_topic = ''
        self.reference = np.zeros((0, 3))
        self._name = f'{namespace}/{planner}'
        self._node = node = Node(
            'playground', context=executor.context, namespace=namespace, enable_rosout=False,
            start_parameter_services=False)
        self._executor = executor
        self._made_of: dict[str, Any] = {}
        self._reader = self._commands_reader = JointReader(())
        self._sources = ObstacleSources.of(1, (), (), transform=None, estimate_velocity=False)
        self._inboxes: dict[str, tuple[PolledSubscription, deque[bytes]]] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(
            String, f'{planner}/configuration', self._on_configuration, latched)
        node.create_subscription(DiagnosticArray, f'{planner}/target', self._on_target, latched)
        node.create_subscription(MarkerArray, f'{planner}/markers', self._on_markers, 1)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)
        self._states, self._commands, self._heard_twists = (
            PolledSubscription(node, kind, topic, QoSProfile(
                depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT))
            for kind, topic, depth in ((JointState, 'joint_states', _STATES),
                                       (JointState, 'joint_command', _COMMANDS),
                                       (Twist, 'cmd_vel', 1)))
        self._twist, self._twist_at = np.zeros(6), -np.inf
        self._twists: dict[str, Publisher] = {}
        self._targets: dict[str, Publisher] = {}
        self._object: Pose | None = None
        self._object_at = -np.inf
        self._drives = drives
        if drives:
            self._publish_for('', ())
            self._couple = node.create_client(SetBool, f'{planner}/couple')
            self._pause = node.create_client(SetBool, f'{planner}/pause')
            self._reset = node.create_client(Trigger, f'{planner}/reset')
        executor.add_node(node)

    @property
    def scene(self) -> Scene:
        """What the planner keeps clear of; the same object while nothing changes."""
        return self._sources.scene

    @property
    def is_there(self) -> bool:
        """Whether the arm is known and speaks."""
        return (self.robot is not None and self.motion is not None
                and time.monotonic() - self.motion.heard < _SILENCE)

    def look(self) -> None:
        """Take in what has come on the fast topics."""
        robot = self.robot
        if robot is None:
            return
        states, commands = self._states.fetch(), self._commands.fetch()
        try:
            heard = [len(self._reader.read(raw)) for raw in states]
            if any(heard) and not self._reader.missing:
                q = self._reader.posture
                if self.motion is None:
                    self.motion = Motion(q, np.zeros(robot.n), np.zeros(robot.n))
                self.motion.measured, self.motion.heard = q, time.monotonic()
            if self.motion is not None and len(commands) == _COMMANDS:
                self.motion.command_stamp = 0  # those before may be lost, and no period is known
            for raw in commands if self.motion is not None else ():
                self._take_command(raw)
            for raw in self._heard_twists.fetch():
                self._twist, self._twist_at = twist_from_bytes(raw), time.monotonic()
        except StateError as error:
            self.trouble = str(error)
        self._read_obstacles(time.monotonic())

    def _read_obstacles(self, now: float) -> None:
        for i, (inbox, waiting) in enumerate(self._inboxes.values()):
            waiting.extend(inbox.fetch())
            enough = time.perf_counter() + _READING
            while waiting:
                self._sources.update(waiting.popleft(), now, i)
                if time.perf_counter() > enough:
                    break
        self._sources.expire(now)

    @property
    def commanded_twist(self) -> Array:
        """What cmd_vel says (6,), zero after it has fallen silent."""
        silent = time.monotonic() - self._twist_at > _SILENCE_OF_TWIST
        return np.zeros(6) if silent else self._twist

    @property
    def commanded_target(self) -> Goal | None:
        """Where the arm is on its way to; None without a target."""
        if self.robot is None:
            return None
        return goal_of_text(self.target.get(TARGET, ''), self.robot.joint_names)

    def _take_command(self, raw: bytes) -> None:
        motion = self.motion
        which, dq = self._commands_reader.read(raw), self._commands_reader.velocities(raw)
        if motion is None or dq is None or len(which) < len(motion.commanded):
            return
        stamp = self._commands_reader.stamp_ns(raw)
        period = 1e-9 * (stamp - motion.command_stamp)
        if motion.command_stamp and 0.0 < period < _SILENCE:
            motion.periods.append(period)
            motion.accelerations = (dq - motion.commanded) / period
        motion.commanded, motion.command_stamp = dq, stamp

    def _on_configuration(self, message: String) -> None:
        """Take the planner's parameters, and make the robot anew if it is another."""
        notes: list[str] = []
        values = configuration_of(message.data, notes)
        try:
            if not values:
                raise StateError('; '.join(notes) or 'the configuration is empty')
            self.parameters = settings_of(PlannerParameters, values)
            made_of = {key: values.get(key) for key in _OF_ROBOT}
            if self.robot is None or made_of != self._made_of:
                robot = robot_of_values(values)
                self._made_of, self.robot, self.motion = made_of, robot, None
                self._hear_tips(robot.tips)
                self._reader, self._commands_reader = (
                    JointReader(robot.joint_names, Seams.of(robot)),
                    JointReader(robot.joint_names))
            self._listen_to_obstacles(values, notes)
            self.trouble = ''
        except PlannerError as error:
            self.trouble = f'the configuration of {self._name} is unusable: {error}'

    def _listen_to_obstacles(self, values: dict[str, Any], notes: list[str]) -> None:
        assert self.robot is not None
        static = [*recorded_obstacles(values, notes), *recorded_walls(values, notes)]
        topics = [self._node.resolve_topic_name(topic) for topic in (
            values.get('obstacle_topics') or obstacle_topics(values))]
        self.obstacle_topic = next((t for t in topics if not t.endswith(_BODY)), '')
        for topic in topics:
            if topic not in self._inboxes:
                # Each message of another arm's says all, so the latest is enough.
                depth = 1 if topic.endswith(_BODY) else _OBSTACLES
                self._inboxes[topic] = (
                    PolledSubscription(self._node, MarkerArray, topic, QoSProfile(depth=depth)),
                    deque(maxlen=depth))
        self._sources = ObstacleSources.of(
            len(self._inboxes), static, (self.robot.base_frame, ''), transform=None,
            estimate_velocity=False)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f'/{self._name.strip("/")}: planner':
                self.status = {'message': status.message,
                               **{value.key: value.value for value in status.values}}

    def _on_markers(self, message: MarkerArray) -> None:
        for marker in message.markers:
            if marker.ns == 'reference':
                self.reference = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3)

    def _on_target(self, message: DiagnosticArray) -> None:
        for status in message.status[:1]:
            values = {value.key: value.value for value in status.values}
            self.target = {'message': status.message, **values} if values else {}

    def _publish_for(self, tip: str, tips: Sequence[str]) -> None:
        self._twists[tip] = self._node.create_publisher(
            Twist, topic_of(tip, 'cmd_vel', tips or ('',)), 1)
        self._targets[tip] = self._node.create_publisher(
            PoseStamped, topic_of(tip, 'target_pose', tips or ('',)), 1)

    def _hear_tips(self, tips: Sequence[str]) -> None:
        """Hear of what several tips hold together, and be able to move it and each of them."""
        if len(tips) < 2 or OBJECT in self._twists:
            return
        self._node.create_subscription(PoseStamped, OBJECT_POSE, self._on_object, 1)
        for tip in (*tips, OBJECT) if self._drives else ():
            self._publish_for(tip, tips)

    def _on_object(self, message: PoseStamped) -> None:
        self._object, self._object_at = pose_of_message(message), time.monotonic()

    @property
    def tips(self) -> tuple[str, ...]:
        """The tips of a body with several; none where there is one, or none is known."""
        return self.robot.tips if self.robot is not None and len(self.robot.tips) > 1 else ()

    def places(self, arm: Kinematics) -> dict[str, Pose]:
        """Return what can be moved → where it is: '' for the only tip, or the tips' object."""
        if not self.tips:
            return {'': arm.tips.first}
        if self._object is not None and time.monotonic() - self._object_at < _SILENCE_OF_OBJECT:
            return {OBJECT: self._object}
        return dict(zip(self.tips, arm.tips.each))

    def is_aimed(self, tip: str) -> bool:
        """Return whether a tip, or what the tips hold, has a target."""
        text = self.target.get(TARGET, '')
        return bool(text_of_tip(text, tip) if tip in self.tips else text)

    def couple(self, together: bool) -> None:
        """Have several tips hold one object, or let go."""
        if self._twists:
            self._couple.call_async(SetBool.Request(data=together)).add_done_callback(
                self._on_coupled)

    def _on_coupled(self, answer: Future) -> None:
        result = answer.result()
        self.trouble = '' if result.success else str(result.message)

    def send_twist(self, twist: Array, tip: str = '') -> None:
        """Command a twist (6,) in the planner's command frame [m/s, rad/s].

        A twist of zero stops all tips: it ends their targets.

        Args:
            twist: (6,).
            tip: of a body with several, or `OBJECT`.
        """
        for name, publisher in self._twists.items():
            if bool(name) == bool(self.tips) and (name == tip or not twist.any()):
                publisher.publish(twist_to_message(twist))

    def send_target(self, pose: Pose, tip: str = '') -> None:
        """Send a tip, or what the tips hold, to a pose in the base frame."""
        if tip in self._targets and self.robot is not None:
            self._targets[tip].publish(pose_to_message(pose, self.robot.base_frame))

    def pause(self, paused: bool) -> None:
        """Have the planner come to rest and be silent, or go on."""
        if self._twists:
            self._pause.call_async(SetBool.Request(data=paused))

    def reset(self) -> None:
        """Have the planner forget where the path was leading."""
        if self._twists:
            self._reset.call_async(Trigger.Request())

    def close(self) -> None:
        """Listen no more."""
        self._executor.remove_node(self._node)
        self._node.destroy_node()
