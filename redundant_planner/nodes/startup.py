"""What planner_node waits for before it can plan: the URDF, and joints to lock where they are."""

from __future__ import annotations

from collections.abc import Callable
import time

import numpy as np
from rclpy.qos import qos_profile_sensor_data
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from redundant_planner.core.errors import known, PlannerError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.measured_joints import joints_to_measure, locked_at
from redundant_planner.io.parameter_files import RobotParameters, urdf_text
from redundant_planner.io.robot_files import build_robot
from redundant_planner.nodes.description_topic import DescriptionTopic
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.ros_parameters import refuse_unknown_parameters
from redundant_planner.nodes.settings import Entries

# After a robot could not be built from measured joints, how long until the next attempt [s].
_RETRY = 1.0
# Publishers of joint_states find their way to this node within this, one after the other [s].
_FOUND_WITHIN = 1.0


class Startup:
    """Builds the robot once everything for it is known; its node drops it afterwards.

    It logs the problems of the start: unknown parameters, links without a shape, missing joints.
    """

    def __init__(
        self, node: EndableNode, parameters: RobotParameters, capsules: Entries,
        warn: Callable[[str], None], start: Callable[[Robot, RobotParameters], None],
    ) -> None:
        """Prepare; `begin` does the work.

        Args:
            node: to subscribe on.
            parameters: of the robot.
            capsules: entries of the links' shapes.
            warn: takes a sentence that may come again and again.
            start: called once, with the robot and the parameters that it was built with.
        """
        self._node = node
        self._parameters = parameters
        self._capsules = capsules
        self._warn = warn
        self._start = start
        self._listening: list[Subscription] = []
        self._started = False
        self._urdf = ''
        # Joints that are locked where they are found → position [rad, m].
        self._wanted: set[str] = set()
        self._measured: dict[str, float] = {}
        self._retry_at = -np.inf
        self._heard_at = np.inf  # when joint_states came first [s]

    def begin(self) -> None:
        """Start at once if the parameters say everything, or wait for the rest.

        Raises:
            PlannerError: the parameters cannot be used.
        """
        refuse_unknown_parameters(self._node)
        urdf = urdf_text(self._parameters)
        if urdf:
            self._on_urdf(urdf)
            return
        DescriptionTopic(self._node, self._on_urdf, lambda: self._started)

    def listen_for_commands(self, heard: Callable[[bytes], None]) -> None:
        """Call `heard` for each joint_command until `close`: this node is silent so far."""
        self._listening.append(self._node.create_subscription(
            JointState, 'joint_command', heard, qos_profile_sensor_data, raw=True))

    def close(self) -> None:
        """Drop all subscriptions."""
        while self._listening:
            self._node.destroy_subscription(self._listening.pop())

    def _on_urdf(self, urdf: str) -> None:
        """Build the robot, or wait until all joints that are to be locked were measured.

        Another URDF while it waits takes the place of the one before.
        """
        self._wanted = set(joints_to_measure(self._parameters, urdf))
        if not self._wanted:
            self._build(urdf)
            return
        is_waiting, self._urdf = bool(self._urdf), urdf
        if is_waiting:
            return
        self._listening.append(self._node.create_subscription(
            JointState, 'joint_states', self._on_joint_states, qos_profile_sensor_data))

    def _on_joint_states(self, message: JointState) -> None:
        if self._started or time.monotonic() < self._retry_at:
            return
        self._measured |= {
            name: position for name, position in zip(message.name, message.position)
            if name in self._wanted and np.isfinite(position)}
        missing = sorted(self._wanted - set(self._measured))
        now = time.monotonic()
        self._heard_at = min(self._heard_at, now)
        if missing and now < self._heard_at + _FOUND_WITHIN:
            return  # another publisher may have them
        if missing:
            self._warn('joint_states lacks joints that locked_joints waits for: '
                       f'{known(missing)}')
            return
        wanted, self._parameters = self._parameters, locked_at(self._parameters, self._measured)
        self._node.get_logger().info('locked where measured: ' + ', '.join(
            f'{name} at {position:g}' for name, position in self._measured.items()))
        try:
            self._build(self._urdf)
        except PlannerError as error:
            # A joint that stands elsewhere a moment later may do.
            self._parameters, self._retry_at = wanted, time.monotonic() + _RETRY
            self._node.get_logger().error(str(error))

    def _build(self, urdf: str) -> None:
        logger = self._node.get_logger()
        robot = build_robot(self._parameters, urdf, self._capsules, say=logger.info,
                            warn=logger.warning)
        self._start(robot, self._parameters)
        self._started = True
