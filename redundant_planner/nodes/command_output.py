"""Publishes joint_command, and the same command for ros2_control's controllers."""

from __future__ import annotations

import array
from collections.abc import Sequence
import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
import numpy as np
import numpy.typing as npt
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from redundant_planner.core.safety.following import LAG
from redundant_planner.io.mobile_base import BASE_CMD_VEL, BASE_JOINTS, own_twist
from redundant_planner.io.node_parameters import (
    JOINT_COMMAND,
    JOINT_TRAJECTORY,
    POSITION_COMMANDS,
    VELOCITY_COMMANDS,
)
from redundant_planner.nodes.joint_messages import JointWriter

Array = npt.NDArray[np.float64]

# Where a command may move an arm for ever, so that a planner which dies owes a stop. The other
# outputs are positions: the arm has reached the last one, or will, and stands there.
NEVER_ENDING = (JOINT_COMMAND, VELOCITY_COMMANDS, BASE_CMD_VEL)
# joint_trajectory_controller interpolates from where the arm is and asks one period ahead. A point
# that is due after so many periods, and lies where the arm would be by then, leads it there at an
# even speed, and on for a period if the next message is late.
_REACH = 2
# How long after the first motion an output may be without a listener: nodes find each other [s].
FOUND_WITHIN = 2.0


class CommandOutput:
    """Publishes each command on joint_command and on the other outputs.

    Attributes:
        moved_at: when a motion was first commanded, by the system's monotonic clock; infinite
            before [s].
        lag: by how much more than its own a drive may lag that gets them [s].
        goes_on: for how many periods an arm goes on by a command that none follows: those that
            take velocities for ever, others until their last position.
    """

    def __init__(
        self, node: Node, joint_names: Sequence[str], outputs: Sequence[str], period: float,
        position_min: Array, position_max: Array,
    ) -> None:
        """Create the publishers.

        Args:
            node: to create them on.
            joint_names: the n joints.
            outputs: out of `OUTPUTS`; each is the name of its topic.
            period: between commands [s].
            position_min, position_max: (n,) which no trajectory leads beyond [rad, m].
        """
        self.moved_at = np.inf
        # A trajectory that begins where the arm is asks for a part of the way that is left.
        self.lag = (_REACH - 1) * LAG if JOINT_TRAJECTORY in outputs else 0.0
        self.goes_on = 0.0 if POSITION_COMMANDS in outputs else (
            _REACH - 1.0 if JOINT_TRAJECTORY in outputs else np.inf)
        self._heard: set[str] = set()  # outputs that have had a listener
        self._publisher = node.create_publisher(JointState, JOINT_COMMAND, 10)
        self._writer = JointWriter(joint_names)
        # A base has a controller of its own.
        self._base = node.create_publisher(Twist, BASE_CMD_VEL, 10) if (
            tuple(joint_names[:len(BASE_JOINTS)]) == BASE_JOINTS) else None
        self._first = 0 if self._base is None else len(BASE_JOINTS)
        self._others = {
            name: node.create_publisher(
                JointTrajectory if name == JOINT_TRAJECTORY else Float64MultiArray, name, 10)
            for name in outputs}
        self._period = period
        self._min, self._max = position_min[self._first:], position_max[self._first:]
        # Without a stamp a trajectory begins on arrival.
        self._trajectory = JointTrajectory(joint_names=list(joint_names[self._first:]))
        self._trajectory.header.stamp = Time()
        self._due = Duration(seconds=_REACH * period).to_msg()

    def publish(
        self, stamp_ns: int, positions: Array, velocities: Array, turned: Array | float = 0.0,
    ) -> None:
        """Publish a command, (n,) each.

        Args:
            stamp_ns: of the message [ns].
            positions: where the arm should be one period from now [rad, m].
            velocities: [rad/s, m/s].
            turned: by how much the arm's driver counts further than `positions` [rad]: it is told
                positions near those that it measures, so that none goes the long way round.
        """
        counted = positions + turned
        self._publisher.publish(self._writer.message(stamp_ns, counted, velocities))
        if self._base is not None:
            self._base.publish(_twist_of(own_twist(velocities[:3], float(positions[2]))))
        if self.moved_at == np.inf and velocities.any():
            self.moved_at = time.monotonic()
        arm = slice(self._first, None)
        for name, publisher in self._others.items():
            if name == JOINT_TRAJECTORY:
                publisher.publish(self._trajectory_to(
                    positions[arm], velocities[arm], (counted - positions)[arm]))
            else:
                publisher.publish(Float64MultiArray(data=_numbers(
                    (counted if name == POSITION_COMMANDS else velocities)[arm])))

    def _trajectory_to(
        self, positions: Array, velocities: Array, turned: Array | float,
    ) -> JointTrajectory:
        """Return the trajectory that carries a command on until its point is due.

        The point has no velocities: joint_trajectory_controller refuses a last point that moves.
        """
        reached = positions + (_REACH - 1) * self._period * velocities
        # An arm outside its range is not pulled back by this either.
        reached = np.clip(reached, np.minimum(self._min, positions),
                          np.maximum(self._max, positions))
        self._trajectory.points = [JointTrajectoryPoint(
            positions=_numbers(reached + turned), time_from_start=self._due)]
        return self._trajectory

    def listeners(self) -> dict[str, int]:
        """Return how many subscriptions have found the publisher of each output."""
        return {name: int(publisher.get_subscription_count())
                for name, publisher in self._all().items()}

    def _all(self) -> dict[str, Publisher]:
        base = {} if self._base is None else {BASE_CMD_VEL: self._base}
        return {JOINT_COMMAND: self._publisher, **self._others, **base}

    def unheard(self, patience: float = FOUND_WITHIN) -> str:
        """Return the sentence about outputs that nobody hears; empty if there are none.

        joint_command counts where there is no other: who listens to a controller's topic need not
        listen to that as well.

        Args:
            patience: how long after the first motion an output may still be without its first
                listener [s].
        """
        moving_for = time.monotonic() - self.moved_at
        if moving_for < 0.0:
            return ''
        listeners = self.listeners()
        self._heard.update(name for name, count in listeners.items() if count)
        return '; '.join(
            self._sentence(name) for name in (
                *(self._others or (JOINT_COMMAND,)), *([BASE_CMD_VEL] if self._base else ()))
            if not listeners[name] and (name in self._heard or moving_for >= patience))

    def _sentence(self, name: str) -> str:
        publisher = self._all()[name]
        listener = 'driver' if name == JOINT_COMMAND else 'controller'
        left = ' any more' if name in self._heard else ''
        return (f'nobody listens to {name} on {publisher.topic_name}{left}: load the {listener}, '
                f"or remap {name} to the {listener}'s topic")

    def wait_until_heard(self, seconds: float) -> None:
        """Wait until reliable listeners have acknowledged the last command, or the time is up."""
        deadline = time.monotonic() + seconds
        for publisher in self._all().values():
            publisher.wait_for_all_acked(
                Duration(seconds=max(deadline - time.monotonic(), 0.0)))


def _twist_of(twist: Array) -> Twist:
    message = Twist()
    message.linear.x, message.linear.y, message.angular.z = map(float, twist)
    return message


def _numbers(values: Array) -> array.array[float]:
    """Return an array that rclpy takes as it is; it checks lists number by number."""
    return array.array('d', values.tobytes())
