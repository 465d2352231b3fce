"""Publishes joint_command, and the same command for ros2_control's controllers."""

from __future__ import annotations

import array
from collections.abc import Sequence

from builtin_interfaces.msg import Time
import numpy as np
import numpy.typing as npt
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from redundant_planner.io.node_parameters import JOINT_TRAJECTORY, POSITION_COMMANDS
from redundant_planner.nodes.joint_messages import JointWriter

Array = npt.NDArray[np.float64]


# A trajectory reaches its point after so many periods: the next one comes before it ends, so the
# controller never stands still in between.
TRAJECTORY_PERIODS = 2


def trajectory_point(positions: Array, velocities: Array, period: float) -> Array:
    """Return where a command leads in `TRAJECTORY_PERIODS` (n,) [rad, m].

    joint_trajectory_controller refuses a last point with a velocity, so there is none: positions,
    which are due at the end of this period, are carried on by another one.

    Args:
        positions, velocities: (n,) of the command [rad, m; per s].
        period: between commands [s].
    """
    return positions + (TRAJECTORY_PERIODS - 1) * period * velocities


class CommandOutput:
    """Publishes each command on joint_command and on the other outputs."""

    def __init__(
        self, node: Node, joint_names: Sequence[str], outputs: Sequence[str], period: float,
    ) -> None:
        """Create the publishers.

        Args:
            node: to create them on.
            joint_names: the n joints.
            outputs: out of `OUTPUTS`; each is the name of its topic.
            period: between commands [s].
        """
        self._publisher = node.create_publisher(JointState, 'joint_command', 10)
        self._writer = JointWriter(joint_names)
        self._others = {
            name: node.create_publisher(
                JointTrajectory if name == JOINT_TRAJECTORY else Float64MultiArray, name, 10)
            for name in outputs}
        self._publishers = [self._publisher, *self._others.values()]
        self._trajectory = JointTrajectory(joint_names=list(joint_names))
        self._period = period
        self._reach = Duration(seconds=TRAJECTORY_PERIODS * period).to_msg()

    def publish(self, stamp_ns: int, positions: Array, velocities: Array) -> None:
        """Publish a command, (n,) each [rad, m; per s]."""
        self._publisher.publish(self._writer.message(stamp_ns, positions, velocities))
        if not self._others:
            return
        # rclpy checks lists number by number, arrays not at all.
        position, velocity = (
            array.array('d', values.tobytes()) for values in (positions, velocities))
        for name, publisher in self._others.items():
            if name == JOINT_TRAJECTORY:
                # Without a stamp the trajectory begins on arrival.
                self._trajectory.header.stamp = Time()
                self._trajectory.points = [JointTrajectoryPoint(
                    positions=array.array('d', trajectory_point(
                        positions, velocities, self._period).tobytes()),
                    time_from_start=self._reach)]
                publisher.publish(self._trajectory)
            else:
                publisher.publish(Float64MultiArray(
                    data=position if name == POSITION_COMMANDS else velocity))

    def listeners(self) -> int:
        """Return how many subscriptions to all outputs have found their publishers."""
        return sum(int(publisher.get_subscription_count()) for publisher in self._publishers)

    def unheard(self) -> list[str]:
        """Return the topics that nobody listens to; joint_command counts if there is no other."""
        return [str(publisher.topic_name)
                for publisher in list(self._others.values()) or [self._publisher]
                if not publisher.get_subscription_count()]

    def wait_until_heard(self, seconds: float) -> None:
        """Wait until reliable listeners have acknowledged the last command, or the time is up."""
        for publisher in self._publishers:
            publisher.wait_for_all_acked(Duration(seconds=seconds))
