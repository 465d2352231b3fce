"""The topics that each tick of the loop fetches, and who takes their messages."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from redundant_planner.core.planner import Planner
from redundant_planner.io.tip_topics import OBJECT
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.control_loop import ControlLoop
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.tip_commands import TipCommands

# A subscription that each tick fetches, and who takes its messages.
Inbox = tuple[PolledSubscription, Callable[[bytes], None]]
# Joint states that a tick may find: the newest of several publishers, however often each speaks.
_JOINT_STATES = QoSProfile(depth=20, reliability=ReliabilityPolicy.BEST_EFFORT)
# Targets and chunks that a tick may find. They are sent once and meant to be heard, unlike a
# stream of twists; or in bursts, as a headset's of half a second.
_TARGETS, _CHUNKS = QoSProfile(depth=50), QoSProfile(depth=10)


def inboxes_of(
    node: Node, loop: ControlLoop, warn: Callable[[str], None], *, on_base: bool, stamped: bool,
) -> list[Inbox]:
    """Subscribe to what measures the arm and what moves it.

    Args:
        node: to subscribe on.
        loop: takes the messages.
        warn: takes a sentence about messages that the method has no use for.
        on_base: whether a base carries the arm, whose place comes by odometry.
        stamped: whether twists come with a stamp.
    """
    command, robot, supervisor = loop.command, loop.planner.robot, loop.supervisor

    def if_it_goes_there(topic: str, take: Callable[[bytes], None]) -> Callable[[bytes], None]:
        """Return who takes the messages of a topic with targets."""
        def on_message(raw: bytes) -> None:
            if isinstance(loop.planner, Planner):
                take(raw)
            else:
                warn(f"{topic} ignored: method '{loop.planner.parameters.method}' follows twists "
                     'only')

        return on_message

    def on_joint_target(raw: bytes) -> None:
        command.on_joint_target(raw, robot, supervisor.posture)

    def on_trajectory(raw: bytes) -> None:
        command.on_trajectory(raw, robot, supervisor.posture)

    inboxes: list[Inbox] = [
        (PolledSubscription(node, JointState, 'joint_states', _JOINT_STATES),
         loop.joints.on_joint_states),
        (PolledSubscription(node, JointState, 'target_joints', _TARGETS),
         if_it_goes_there('target_joints', on_joint_target)),
        (PolledSubscription(node, JointTrajectory, 'target_trajectory', _CHUNKS),
         if_it_goes_there('target_trajectory', on_trajectory))]
    if isinstance(command, TipCommands):
        inboxes += _tip_inboxes(node, command, stamped=stamped)
    else:
        inboxes += [
            (PolledSubscription(node, TwistStamped if stamped else Twist, 'cmd_vel'),
             command.on_twist_stamped if stamped else command.on_twist),
            (PolledSubscription(node, PoseStamped, 'target_pose', _TARGETS),
             if_it_goes_there('target_pose', command.on_target)),
            (PolledSubscription(node, Path, 'target_path', _CHUNKS),
             if_it_goes_there('target_path', command.on_path))]
    if on_base:
        inboxes.append((PolledSubscription(node, Odometry, 'odom', _JOINT_STATES),
                        loop.joints.on_odometry))
    return inboxes


def _tip_inboxes(node: Node, command: TipCommands, *, stamped: bool) -> list[Inbox]:
    """Subscribe to what moves each of several tips, and what they hold."""
    on_twist = CommandInput.on_twist_stamped if stamped else CommandInput.on_twist
    inboxes: list[Inbox] = []
    for tip in (*command.tips, OBJECT):
        twist, target, path = f'{tip}/cmd_vel', f'{tip}/target_pose', f'{tip}/target_path'
        inboxes += [
            (PolledSubscription(node, TwistStamped if stamped else Twist, twist),
             command.on_tip(tip, twist, on_twist)),
            (PolledSubscription(node, PoseStamped, target, _TARGETS),
             command.on_tip(tip, target, CommandInput.on_target)),
            (PolledSubscription(node, Path, path, _CHUNKS),
             command.on_tip(tip, path, CommandInput.on_path))]
    return inboxes
