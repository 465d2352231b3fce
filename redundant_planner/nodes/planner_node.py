"""planner_node: cmd_vel, joint_states and obstacles in, joint_command out at a fixed rate."""

from __future__ import annotations

import time

from geometry_msgs.msg import Twist
import numpy as np
import numpy.typing as npt
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import PlannerError, StateError
from redundant_planner.core.horizon import Preview, TwistAhead
from redundant_planner.core.joint_motion import has_jumped, PositionCommand
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner, StepResult
from redundant_planner.core.robot import Robot
from redundant_planner.nodes import messages, process
from redundant_planner.nodes.messages import NANOSECONDS
from redundant_planner.nodes.obstacle_book import ObstacleBook
from redundant_planner.nodes.ros_parameters import (
    declare,
    declare_entries,
    on_change,
    PlannerNodeParameters,
)
from redundant_planner.resources import resolve
from redundant_planner.robot_parameters import build_robot, obstacle_of, RobotParameters

Array = npt.NDArray[np.float64]

# Warnings that a stream of bad messages would repeat are said this often at most [s].
_WARN_PERIOD = 1.0
# The stop at the end: how often it is said, with what pauses [s], and how long an
# acknowledgement may take [s].
_LAST_WORDS = 3
_PAUSE = 0.01
_ACKNOWLEDGED = 0.3


class PlannerNode(process.EndableNode):
    """Runs `Planner.step` on the latest inputs at a fixed rate."""

    def __init__(self) -> None:
        """Read all parameters; the loop starts once the robot is known.

        Raises:
            PlannerError: a parameter is wrong.
        """
        super().__init__('planner_node')
        self._robot_parameters = declare(self, RobotParameters)
        self._planner_parameters = declare(self, PlannerParameters)
        self._settings = declare(self, PlannerNodeParameters)
        self._capsules = declare_entries(
            self, 'capsule', self._robot_parameters.capsules,
            {'frame': 'text', 'start': 3, 'end': 3, 'radius': 1})
        static = declare_entries(
            self, 'static_obstacle', self._settings.static_obstacles,
            {'center': 3, 'semi_axes': 3, 'orientation': 4})
        self._static = [obstacle_of(name, entry) for name, entry in static.items()]

        self._planner: Planner | None = None
        self._q: Array | None = None
        self._q_time = 0.0
        self._twist: Array = np.zeros(6)
        self._twist_time = -np.inf
        self._preview: Preview | None = None
        self._preview_start = 0.0
        self._reason = ''
        self._period = 1.0 / self._settings.rate

        self._publisher = self.create_publisher(JointState, 'joint_command', 10)
        urdf = self._robot_parameters.robot_description
        if self._robot_parameters.urdf:
            urdf = resolve(self._robot_parameters.urdf).read_text()
        if urdf:
            self._start(urdf)
        else:
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._description = self.create_subscription(
                String, 'robot_description', self._on_robot_description, latched)
            self.get_logger().info('waiting for a URDF on the topic robot_description')

    def _on_robot_description(self, message: String) -> None:
        if self._planner is not None:
            return
        try:
            self._start(message.data)
        except PlannerError as error:
            self.get_logger().error(f'robot_description: {error}')

    def _start(self, urdf: str) -> None:
        robot = build_robot(self._robot_parameters, urdf, self._capsules)
        self._planner = Planner(robot, self._planner_parameters)
        self._position_command = PositionCommand(
            robot.position_min, robot.position_max, self._settings.position_tolerance)
        frames = {robot.base_frame, ''}
        self._obstacles = ObstacleBook(self._static, sorted(frames))
        self.create_subscription(Twist, 'cmd_vel', self._on_twist, qos_profile_sensor_data)
        self.create_subscription(
            MultiDOFJointTrajectory, 'cmd_vel_preview', self._on_preview, 1)
        self.create_subscription(
            JointState, 'joint_states', self._on_joint_state, qos_profile_sensor_data)
        self.create_subscription(MarkerArray, 'obstacles', self._on_obstacles, 10)
        on_change(self, lambda: (self._planner_parameters, self._settings), self._apply)
        self.create_timer(
            self._period, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if not process.request_priority(self._settings.thread_priority):
            self.get_logger().info(
                'no real-time priority: the system does not grant it (see README, timing)')
        self.get_logger().info(
            f"planning for '{robot.name}' from {robot.base_frame} to {robot.tip_frame} at "
            f'{self._settings.rate} Hz; joints: {", ".join(robot.joint_names)}')

    @property
    def robot(self) -> Robot:
        """The robot; known once the loop runs."""
        assert self._planner is not None
        return self._planner.robot

    def _apply(self, planner: PlannerParameters, settings: PlannerNodeParameters) -> None:
        assert self._planner is not None
        self._planner.parameters = planner
        self._planner_parameters, self._settings = planner, settings

    def _on_twist(self, message: Twist) -> None:
        try:
            self._twist = messages.twist_from_message(message)
            self._twist_time = time.monotonic()
        except StateError as error:
            self._warn(f'cmd_vel ignored: {error}')

    def _on_preview(self, message: MultiDOFJointTrajectory) -> None:
        try:
            self._preview = messages.preview_from_message(message)
        except StateError as error:
            self._warn(f'cmd_vel_preview ignored: {error}')
            return
        stamp = message.header.stamp
        age = 0.0
        if stamp.sec or stamp.nanosec:
            age = (self.get_clock().now() - Time.from_msg(stamp)).nanoseconds / NANOSECONDS
        self._preview_start = time.monotonic() - age

    def _ahead(self, now: float) -> TwistAhead | None:
        """Return what will be commanded from now on; None once the preview is over."""
        preview, elapsed = self._preview, now - self._preview_start
        if preview is None or elapsed > preview.times[-1]:
            return None
        return lambda times: preview.at(times + elapsed)

    def _on_joint_state(self, message: JointState) -> None:
        try:
            q = messages.positions_from_message(message, self.robot.joint_names)
        except StateError as error:
            self._warn(f'joint_states ignored: {error}')
            return
        now = time.monotonic()
        if self._q is not None and has_jumped(
                self._q, q, self.robot.velocity_max, now - self._q_time,
                self._settings.position_tolerance):
            self._warn('joint_states jumped: the motion starts again from where the arm is')
            self._start_again()
        self._q, self._q_time = q, now

    def _on_obstacles(self, message: MarkerArray) -> None:
        for problem in self._obstacles.update(message, time.monotonic()):
            self._warn(f'{problem}; ignored')

    def _tick(self) -> None:
        if self._q is None:
            return
        now = time.monotonic()
        if now - self._q_time > self._settings.joint_state_timeout:
            self._lose_state()
            return
        fresh = now - self._twist_time <= self._settings.incoming_command_timeout
        self._obstacles.expire(now)
        assert self._planner is not None
        result = self._planner.step(
            self._q, self._twist if fresh else np.zeros(6), self._obstacles.scene, self._period,
            self._ahead(now) if fresh else None)
        self._publish(result.dq)
        self._report(result)

    def _lose_state(self) -> None:
        """Stop and forget everything: whatever comes next starts from a new measurement."""
        self._warn(f'no usable joint_states for {self._settings.joint_state_timeout:g} s: stopped')
        self._publish(np.zeros(self.robot.n))
        self._q = None
        self._start_again()

    def _start_again(self) -> None:
        self._twist_time = -np.inf
        self._preview = None
        self._position_command.reset()
        assert self._planner is not None
        self._planner.reset()

    def _publish(self, dq: Array) -> None:
        assert self._q is not None
        message = JointState()
        message.header.stamp = self.get_clock().now().to_msg()
        message.name = list(self.robot.joint_names)
        message.position = self._position_command.advance(self._q, dq, self._period).tolist()
        message.velocity = dq.tolist()
        self._publisher.publish(message)

    def _report(self, result: StepResult) -> None:
        """Say once when something begins or ceases to hold the arm back."""
        if result.reason and not self._reason:
            self._warn(result.reason)
        self._reason = result.reason

    def finish(self) -> None:
        """Leave the arm with a stop as its last command, and with time to hear it.

        Destroyed at once, a publisher takes messages with it that are still on their way;
        best-effort listeners do not acknowledge and are told more than once.
        """
        if self._q is None:
            return
        for _ in range(_LAST_WORDS):
            self._publish(np.zeros(self.robot.n))
            time.sleep(_PAUSE)
        self._publisher.wait_for_all_acked(Duration(seconds=_ACKNOWLEDGED))

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=_WARN_PERIOD)


def main(args: list[str] | None = None) -> int:
    """Run planner_node."""
    return process.run(PlannerNode, 'planner_node', args)


if __name__ == '__main__':
    raise SystemExit(main())
