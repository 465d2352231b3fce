"""Sends targets to a planner, and hears what it says of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import contextlib
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
import numpy as np
import numpy.typing as npt
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool

from redundant_planner.core.errors import known, StateError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.goal import Goal
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.recorded_configuration import configuration_of
from redundant_planner.io.robot_files import robot_of_values
from redundant_planner.io.tip_topics import OBJECT, OBJECT_POSE, topic_of
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.pose_messages import pose_of_message, pose_to_message
from redundant_planner.nodes.runtime import best_executor, spin_once
from redundant_planner.nodes.supervisor import PAUSED_ALREADY
from redundant_planner.nodes.target_text import goal_of_text, TARGET, text_of_tip

Array = npt.NDArray[np.float64]

# How long planner and arm are waited for [s], and the arm for coming to rest.
_PATIENCE, _STOPPING = 10.0, 3.0
# Slower than this is at rest, see docs/interface.md [rad/s, m/s].
_AT_REST = 2e-3
# Those who remap the planner's topics have to tell this too.
_REMAPPED = 'if the planner has it remapped, repeat that here: --ros-args -r'
# Targets that differ by less are one, as their numbers are rounded [m, rad].
_SAME = 1e-5


class Word(NamedTuple):
    """What the planner said last of its target.

    Attributes:
        state: of the arm, one of `TargetState` or `DOES_NOT_FOLLOW`.
        values: key → value of the status; none without a target.
        is_of_sent: whether it is of the target that was sent.
        heard: when it came, by the monotonic clock [s].
    """

    state: str
    values: Mapping[str, str]
    is_of_sent: bool
    heard: float


class TargetClient:
    """A node that sends targets to a planner, and hears what becomes of them.

    Attributes:
        word: what the planner says since it has spoken of the target that was sent; None before.
        held: where the object is that several tips hold; None before it was heard.
    """

    def __init__(self, planner: str, tip: str = '') -> None:
        """Look for a planner's topics.

        Args:
            planner: name of its node.
            tip: that targets are for, or `OBJECT`; empty for the only one.
        """
        self.word: Word | None = None
        self.held: Pose | None = None
        self._node = Node('go_to', enable_rosout=False, start_parameter_services=False)
        self._configuration = ''
        self._robot: Robot | None = None
        self._reader: JointReader | None = None
        self._speeds = np.zeros(0)  # of each joint, NaN where it was not heard since [rad/s, m/s]
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._joint_target = self._node.create_publisher(JointState, 'target_joints', 1)
        self._pause = self._node.create_client(SetBool, f'{planner}/pause')
        self._node.create_subscription(
            String, f'{planner}/configuration', self._on_configuration, latched)
        self._node.create_subscription(
            DiagnosticArray, f'{planner}/target', self._on_status, latched)
        self._node.create_subscription(
            JointState, 'joint_states', self._on_state, qos_profile_sensor_data, raw=True)
        self._executor = best_executor(self._node.context)
        self._executor.add_node(self._node)
        self._planner = planner
        self._tip = tip
        self._target: Publisher | None = None
        self._sent: Goal | None = None
        self._is_interrupted = False

    def _on_configuration(self, message: String) -> None:
        self._configuration = message.data

    def _on_state(self, raw: bytes) -> None:
        if self._reader is None:
            return
        with contextlib.suppress(StateError):
            which = self._reader.read(raw)
            dq = self._reader.velocities(raw)
            self._speeds[which] = 0.0 if dq is None else np.abs(dq)

    def _on_object(self, message: PoseStamped) -> None:
        self.held = pose_of_message(message)

    def _on_status(self, message: DiagnosticArray) -> None:
        """Keep what is said of the target that was sent, and of nothing earlier."""
        if self._sent is None or not message.status:
            return
        values = {value.key: value.value for value in message.status[0].values}
        is_of_sent = self._names_sent(values.get(TARGET, ''))
        if is_of_sent or self.word is not None:
            self.word = Word(message.status[0].message, values, is_of_sent, time.monotonic())

    def _names_sent(self, text: str) -> bool:
        """Return whether what ~/target calls a target is the one that was sent."""
        robot, sent = self._robot, self._sent
        assert robot is not None, 'a target is sent to a robot'
        if len(robot.tips) > 1 and isinstance(sent, Pose) and self._tip != OBJECT:
            text = text_of_tip(text, self._tip)
        named = goal_of_text(text, robot.joint_names)
        if isinstance(sent, Pose) and isinstance(named, Pose):
            return _is_same(named.position, sent.position) and _is_same(
                named.rotation, sent.rotation)
        return (isinstance(sent, np.ndarray) and isinstance(named, np.ndarray)
                and _is_same(named, sent))

    def interrupt(self) -> None:
        """Have `spin` raise KeyboardInterrupt: raised within a callback it would be logged."""
        self._is_interrupted = True

    def spin(self) -> None:
        """Listen for a moment.

        Raises:
            KeyboardInterrupt: `interrupt` was called.
        """
        self._listen()
        if self._is_interrupted:
            raise KeyboardInterrupt

    def _listen(self, seconds: float = 0.02) -> None:
        """Listen for a while [s]."""
        spin_once(self._executor, seconds)

    def _wait_for(
        self, condition: Callable[[], object], what: str | Callable[[], str], topic: str = '',
    ) -> None:
        """Listen until something holds.

        Args:
            condition: that it waits for.
            what: it is.
            topic: that it comes on, if that may have another name for the planner.

        Raises:
            StateError: it takes too long.
        """
        until = time.monotonic() + _PATIENCE
        while not condition():
            if time.monotonic() > until:
                lacking = what if isinstance(what, str) else what()
                raise StateError(
                    f'no {lacking} within {_PATIENCE:g} s; is {self._planner} running, in the '
                    'same ROS domain and namespace? --planner names another' if not topic else
                    f'no {lacking} on {self._node.resolve_topic_name(topic)} within '
                    f'{_PATIENCE:g} s; {_REMAPPED} {topic}:=…')
            self.spin()

    def arm(self, *, joints: bool) -> tuple[Robot, Array]:
        """Return the planner's robot, and its posture (n,) now.

        Args:
            joints: whether targets will be of the joints, and not of a tip.

        Raises:
            PlannerError: the planner, its tip or the arm is not there.
        """
        self._wait_for(lambda: self._configuration, 'configuration of a planner')
        notes: list[str] = []
        values = configuration_of(self._configuration, notes)
        if not values:
            raise StateError(f"the planner's configuration is unusable: {'; '.join(notes)}")
        robot = self._robot = robot_of_values(values)
        self._find_listener(robot, joints=joints)
        reader = self._reader = JointReader(robot.joint_names, Seams.of(robot))
        self._speeds = np.zeros(robot.n)
        self._wait_for(lambda: not reader.missing,
                       lambda: f'joint_states of {known(reader.missing)}', 'joint_states')
        if self._tip == OBJECT and not joints:
            self._wait_for(lambda: self.held is not None,
                           'pose of what the tips hold, which takes ~/couple,', OBJECT_POSE)
        return robot, reader.posture

    def _find_listener(self, robot: Robot, *, joints: bool) -> None:
        """Make sure that the planner hears targets.

        Raises:
            StateError: it does not, or has no such tip.
        """
        topic, publisher = 'target_joints', self._joint_target
        if len(robot.tips) > 1:
            self._node.create_subscription(PoseStamped, OBJECT_POSE, self._on_object, 1)
        if not joints:
            topic = topic_of(self._tip, 'target_pose', robot.tips)
            publisher = self._target = self._node.create_publisher(PoseStamped, topic, 1)
        self._wait_for(publisher.get_subscription_count, 'listener', topic)

    def send(self, target: Goal) -> None:
        """Publish a target; `arm` comes first."""
        robot, self._sent = self._robot, target
        assert robot is not None, 'a target is sent to a robot'
        if isinstance(target, Pose):
            assert self._target is not None, 'a planner that was asked for a tip has it'
            self._target.publish(pose_to_message(target, robot.base_frame))
        else:
            self._joint_target.publish(
                JointState(name=list(robot.joint_names), position=target.tolist()))

    def wait_for_word(self) -> Word:
        """Listen until the planner speaks of the target; return what it says.

        Until then the target may not have been heard: a publisher that is gone takes its message
        along.

        Raises:
            StateError: it does not, or never will: what the tips hold does not let them move.
        """
        self._wait_for(self._has_word, 'word of the target on ~/target')
        assert self.word is not None
        return self.word

    def _has_word(self) -> bool:
        if self.held is not None and self._tip != OBJECT:
            raise StateError(f'the tips hold one object together: move it with --tip {OBJECT}, '
                             'or let go (~/couple with false)')
        return self.word is not None

    def stop(self) -> str:
        """Bring the arm to rest, unless no target was sent; return what keeps it from that.

        A pause lets go of the target. One that somebody else began goes on.
        """
        if self._sent is None:
            return ''
        until = time.monotonic() + _STOPPING
        answer = self._ask_for_pause(True, until) if self._pause.wait_for_service(1.0) else None
        if answer is None:
            return f'{self._planner} does not answer'
        rests = False
        self._speeds[:] = np.nan
        while not rests and time.monotonic() < until:
            self._listen(0.1)
            rests = bool((self._speeds < _AT_REST).all())
        if answer != PAUSED_ALREADY and self._ask_for_pause(False, until + 1.0) is None:
            return f'{self._planner} stays paused: it does not answer any more'
        return '' if rests else f'it does not come to rest within {_STOPPING:g} s'

    def _ask_for_pause(self, paused: bool, until: float) -> str | None:
        """Have the planner pause or go on; return its answer, None if none comes in time [s]."""
        answer = self._pause.call_async(SetBool.Request(data=paused))
        while not answer.done() and time.monotonic() < until:
            self._listen()
        return str(answer.result().message) if answer.done() else None


def _is_same(one: Array, other: Array) -> bool:
    return bool(np.abs(one - other).max() < _SAME)
