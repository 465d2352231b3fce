"""Moves the tip of a running planner a little, to and fro, and listens to what the arm does."""

from __future__ import annotations

import signal
import sys
import time

from geometry_msgs.msg import Twist
import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState

from redundant_planner.analysis.drive_fit import Motion
from redundant_planner.core.errors import StateError
from redundant_planner.core.parameters import AXES
from redundant_planner.io.joint_chunks import ChosenJoints, JointBatch
from redundant_planner.io.left_out import LeftOut
from redundant_planner.nodes.messages import NANOSECONDS, twist_to_message
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory, spin_once

Array = npt.NDArray[np.float64]

# How often the twist is published [1/s], and how long the planner and the arm are waited for [s].
_RATE = 100.0
_PATIENCE = 5.0
# How long the arm is listened to after the motion, and times to and fro in a second.
_AFTER = 1.0
_SWINGS = 1.0


def swing(distance: float, duration: float, time_: float) -> float:
    """Return the velocity of a motion to and fro that begins and ends at rest [m/s].

    Its way is a sine whose size grows and fades.

    Args:
        distance: to either side at most [m].
        duration: of the whole [s].
        time_: since its beginning [s].
    """
    if not 0.0 <= time_ <= duration:
        return 0.0
    swings = max(round(_SWINGS * duration), 1)
    turning, fading = 2.0 * np.pi * swings / duration, np.pi / duration
    return float(distance * (
        turning * np.cos(turning * time_) * np.sin(fading * time_) ** 2
        + np.sin(turning * time_) * fading * np.sin(2.0 * fading * time_)))


class _Listener:
    """A node that commands the planner, and notes commands and joint states."""

    def __init__(self) -> None:
        self.node = Node('identify_delay', enable_rosout=False, start_parameter_services=False)
        self.names: tuple[str, ...] = ()
        self.commands: list[tuple[int, Array]] = []  # stamps [ns]
        self.states: list[bytes] = []
        self.node.create_subscription(
            JointState, 'joint_command', self._on_command, qos_profile_sensor_data)
        self.node.create_subscription(
            JointState, 'joint_states', self.states.append, qos_profile_sensor_data, raw=True)
        self.executor = best_executor(self.node.context)
        self.executor.add_node(self.node)

    def _on_command(self, message: JointState) -> None:
        self.names = self.names or tuple(message.name)
        if tuple(message.name) == self.names and len(message.velocity) == len(self.names):
            stamp = message.header.stamp
            self.commands.append((
                stamp.sec * NANOSECONDS + stamp.nanosec, np.array(message.velocity)))

    def wait(self, seconds: float) -> None:
        """Listen for so long."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            spin_once(self.executor, min(left, 0.01))

    def motion(self) -> Motion:
        """Return what was noted.

        Raises:
            StateError: the planner commanded nothing, or joint states lack its joints.
        """
        if not self.commands:
            raise StateError('the planner commanded nothing; /diagnostics says why')
        origin = self.commands[0][0]
        left_out = LeftOut()
        batch, joints = JointBatch('joint_states', left_out), ChosenJoints(
            'joint_states', self.names, left_out)
        for raw in self.states:
            batch.add(0.0, raw)
        chunks = [joints.of(chunk) for chunk in batch.chunk(origin)] + [joints.rest()]
        found = [chunk for chunk in chunks if chunk is not None]
        if not found:
            raise StateError(f'joint_states never had all of {list(self.names)}')
        return Motion(np.array([1e-9 * (at - origin) for at, _ in self.commands]),
                      np.array([dq for _, dq in self.commands]),
                      np.concatenate([chunk.stamps for chunk in found]),
                      np.concatenate([chunk.positions for chunk in found]))


def ask_and_move(
    axis: str, distance: float, duration: float, sure: bool, ros_args: list[str],
) -> tuple[Motion, tuple[str, ...]]:
    """Ask, move the tip to and fro, and return what was commanded and measured.

    Args:
        axis: of the twist, see `AXES`.
        distance: to either side at most [m, rad].
        duration: [s].
        sure: whether to move without asking.
        ros_args: for rclpy.

    Raises:
        StateError: there is no planner or no arm, somebody else commands it, or nobody agreed.
    """
    if not 0.0 < distance <= 0.2 or not 1.0 <= duration <= 60.0:
        raise StateError(f'--distance is {distance:g} and --duration {duration:g}; they must lie '
                         'in (0, 0.2] and [1, 60]')
    print(f'The tip will move {distance:g} {"m" if axis.startswith("v") else "rad"} to either '
          f'side along {axis}, for {duration:g} s. Ctrl-C stops it.', flush=True)
    if not sure and (not sys.stdin.isatty() or input('Move? [y/N] ').strip().lower() != 'y'):
        raise StateError('nobody agreed to the motion; --yes moves without asking')
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    keep_off_shared_memory()
    rclpy.init(args=['identify_delay', *ros_args],
               signal_handler_options=SignalHandlerOptions.NO)
    try:
        return _move(axis, distance, duration)
    finally:
        rclpy.try_shutdown()


def _move(axis: str, distance: float, duration: float) -> tuple[Motion, tuple[str, ...]]:
    listener = _Listener()
    node = listener.node
    until = time.monotonic() + _PATIENCE
    # Whether the planner listens, before this node's own publisher would count as a second one.
    while not (node.count_subscribers('cmd_vel') and listener.states):
        if time.monotonic() > until:
            missing = 'joint_states' if not listener.states else 'planner on cmd_vel'
            raise StateError(f'no {missing} within {_PATIENCE:g} s; start the planner and the arm '
                             'first, in the same ROS domain and namespace')
        listener.wait(0.1)
    if node.count_publishers('cmd_vel'):
        raise StateError('somebody else publishes cmd_vel; stop that first')
    publisher = node.create_publisher(Twist, 'cmd_vel', 10)
    twist = np.zeros(6)
    try:
        begin = time.monotonic()
        while publisher.get_subscription_count() == 0 and time.monotonic() < begin + _PATIENCE:
            listener.wait(0.05)
        if publisher.get_subscription_count() == 0:
            raise StateError('who listens to cmd_vel does not take a Twist; the planner must run '
                             'without enable_stamped_cmd_vel')
        begin = time.monotonic()
        while (now := time.monotonic() - begin) <= duration:
            twist[AXES.index(axis)] = swing(distance, duration, now)
            publisher.publish(twist_to_message(twist))
            listener.wait(1.0 / _RATE)
    finally:
        publisher.publish(twist_to_message(np.zeros(6)))
        listener.wait(_AFTER)
    motion = listener.motion()
    node.destroy_node()
    return motion, listener.names
