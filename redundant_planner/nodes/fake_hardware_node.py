"""fake_hardware_node: integrates joint_command and publishes joint_states."""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from redundant_planner.core.errors import ParameterError, StateError
from redundant_planner.core.robot.simulated_arm import joint_ranges, SimulatedArm
from redundant_planner.io.joint_turns import wrapped
from redundant_planner.io.node_parameters import ClockParameters, FakeHardwareParameters
from redundant_planner.io.parameter_files import RobotParameters, urdf_text
from redundant_planner.nodes import messages, runtime
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.hardware_time import HardwareTime
from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.nodes.ros_parameters import declare, refuse_unknown_parameters

Array = npt.NDArray[np.float64]


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
        self._arm = SimulatedArm(
            joint_ranges(urdf), dict(zip(settings.initial_joints, settings.initial_positions)),
            command_timeout=settings.command_timeout)
        self._noise = settings.noise
        self._random = np.random.default_rng(0)
        self._lag, self._wraps = settings.lag, settings.wrap_continuous
        self._delayed: deque[tuple[float, Array]] = deque()

        self._publisher = self.create_publisher(JointState, 'joint_states', 10)
        self._writer = JointWriter(self._arm.ranges.names)
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
        ranges = self._arm.ranges
        try:
            known = [name for name in ranges.names if name in message.name]
            unknown = [name for name in message.name if name not in ranges.names]
            if unknown:
                raise StateError(f'this arm has no joints {unknown}')
            dq = np.zeros(len(ranges.names))
            dq[[ranges.names.index(name) for name in known]] = messages.velocities_from_message(
                message, known)
        except StateError as error:
            self.get_logger().warning(
                f'joint_command ignored: {error}', throttle_duration_sec=1.0)
            return
        now = self._time.now()
        self._delayed.append((now + self._lag, dq))
        self._obey(now)
        self._time.commanded(message.header.stamp)

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
        self._publisher.publish(self._writer.message(self._time.stamp_ns(), q, self._arm.dq))


def main(args: list[str] | None = None) -> int:
    """Run fake_hardware_node."""
    return runtime.run(FakeHardwareNode, 'fake_hardware_node', args)


if __name__ == '__main__':
    raise SystemExit(main())
