"""fake_hardware_node: integrates joint_command and publishes joint_states."""

from __future__ import annotations

from collections import deque

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import numpy as np
import numpy.typing as npt
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from redundant_planner.core.errors import ParameterError, StateError
from redundant_planner.core.robot.simulated_arm import joint_ranges, SimulatedArm
from redundant_planner.io.joint_turns import wrapped
from redundant_planner.io.mobile_base import BASE_CMD_VEL, BASE_JOINTS, ODOM, on_base, world_rates
from redundant_planner.io.node_parameters import ClockParameters, FakeHardwareParameters
from redundant_planner.io.parameter_files import RobotParameters, urdf_text
from redundant_planner.nodes import messages, runtime
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.hardware_time import HardwareTime
from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.nodes.ros_parameters import declare, refuse_unknown_parameters

Array = npt.NDArray[np.float64]

# What it says as the first command comes.
HEARS_COMMANDS = 'hears joint_command'
# How long a base goes on without a command [s].
_BASE_TIMEOUT = 0.2


class FakeHardwareNode(EndableNode):
    """Stands in for an arm: obeys velocities within the URDF's limits and publishes its state."""

    def __init__(self) -> None:
        """Read the URDF and stand at the start posture.

        Raises:
            PlannerError: a parameter or the URDF is wrong.
        """
        super().__init__('fake_hardware_node')
        robot = declare(self, RobotParameters)
        settings = declare(self, FakeHardwareParameters)
        clock = declare(self, ClockParameters)
        refuse_unknown_parameters(self)
        urdf = urdf_text(robot)
        if not urdf:
            raise ParameterError("parameter 'urdf' is empty; give the URDF to simulate")
        moving = on_base(urdf, robot)
        self._arm = SimulatedArm(
            joint_ranges(moving), dict(zip(settings.initial_joints, settings.initial_positions)),
            command_timeout=settings.command_timeout)
        self._noise = settings.noise
        self._random = np.random.default_rng(0)
        self._lag, self._wraps = settings.lag, settings.wrap_continuous
        self._delayed: deque[tuple[float, Array]] = deque()
        self._hears = False  # whether a command has come

        self._publisher = self.create_publisher(JointState, 'joint_states', 10)
        # A base says where it is by odom, and has a driver of its own.
        names = self._arm.ranges.names
        self._base = [names.index(name) for name in BASE_JOINTS] if robot.base else []
        self._own = [i for i in range(len(names)) if i not in self._base]
        self._base_twist, self._base_heard = np.zeros(3), -np.inf
        self._writer = JointWriter([names[i] for i in self._own])
        if self._base:
            self._odom = self.create_publisher(Odometry, ODOM, 10)
            self.create_subscription(
                Twist, BASE_CMD_VEL, self._on_base_command, qos_profile_sensor_data)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = self.create_publisher(String, 'robot_description', latched)
        self._description.publish(String(data=urdf))
        self.create_subscription(
            JointState, 'joint_command', self._on_command, qos_profile_sensor_data)
        self._time = HardwareTime(self, settings.rate, clock, self._tick)
        if not self._time.simulated:  # nobody is late by simulated time
            runtime.request_priority(settings.thread_priority)
        self.get_logger().info(
            f'simulating {", ".join(self._arm.ranges.names)} at {settings.rate} Hz')
        if not settings.initial_joints:
            self.get_logger().info(
                'every joint starts at 0, or at the limit nearest to it, where many arms are '
                'singular and do not move: show_robot writes a better start (initial_joints and '
                'initial_positions) into the parameter file')

    def _on_command(self, message: JointState) -> None:
        if not self._hears:
            self._hears = True
            self.get_logger().info(HEARS_COMMANDS)
        ranges = self._arm.ranges
        try:
            known = [name for name in ranges.names if name in message.name]
            unknown = [name for name in message.name if name not in ranges.names]
            if unknown:
                raise StateError(f'this arm has no joints {unknown}')
            dq = np.zeros(len(ranges.names))
            dq[[ranges.names.index(name) for name in known]] = messages.velocities_from_message(
                message, known)
            if self._base:
                fresh = self._time.now() - self._base_heard <= _BASE_TIMEOUT
                dq[self._base] = world_rates(
                    self._base_twist * fresh, float(self._arm.q[self._base[2]]))
        except StateError as error:
            self.get_logger().warning(
                f'joint_command ignored: {error}', throttle_duration_sec=1.0)
            return
        now = self._time.now()
        self._delayed.append((now + self._lag, dq))
        self._obey(now)
        self._time.commanded(message.header.stamp)

    def _on_base_command(self, message: Twist) -> None:
        self._base_twist = np.array((message.linear.x, message.linear.y, message.angular.z))
        self._base_heard = self._time.now()

    def _obey(self, now: float) -> None:
        """Pass on the commands whose dead time is over, each at its own moment."""
        while self._delayed and self._delayed[0][0] <= now:
            self._arm.command(*self._delayed.popleft())

    def _tick(self) -> None:
        now = self._time.now()
        self._obey(now)
        self._arm.advance(now)
        q = self._arm.q
        if self._noise > 0.0:
            q = q + self._random.normal(0.0, self._noise, q.shape)
        if self._wraps:
            q = wrapped(q, self._arm.ranges.position_max)
        stamp_ns, dq = self._time.stamp_ns(), self._arm.dq
        self._publisher.publish(self._writer.message(stamp_ns, q[self._own], dq[self._own]))
        if self._base:
            self._odom.publish(messages.odometry_of(stamp_ns, q[self._base], dq[self._base]))


def main(args: list[str] | None = None) -> int:
    """Run fake_hardware_node."""
    return runtime.run(FakeHardwareNode, 'fake_hardware_node', args)


if __name__ == '__main__':
    raise SystemExit(main())
