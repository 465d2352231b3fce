"""mujoco_hardware_node: an arm with mass among obstacles obeys joint_command, by MuJoCo."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
import sys
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import numpy.typing as npt
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import known, ParameterError, StateError
from redundant_planner.core.robot.turns import nearest_turn
from redundant_planner.io.joint_turns import wrapped
from redundant_planner.io.node_parameters import ClockParameters
from redundant_planner.io.obstacle_bounds import checked
from redundant_planner.io.obstacle_entries import obstacle_of
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.io.parameter_files import RobotParameters, urdf_text
from redundant_planner.io.physics_parameters import (
    MujocoHardwareParameters,
    PhysicsParameters,
    POSITION_SERVO,
)
from redundant_planner.nodes import messages, physics_report, runtime
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.hardware_time import HardwareTime
from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.nodes.obstacle_input import ObstacleInput
from redundant_planner.nodes.ros_parameters import (
    CAPSULE,
    declare,
    declare_entries,
    refuse_unknown_parameters,
    STATIC_OBSTACLE,
)
from redundant_planner.nodes.throttled_log import ThrottledLog
from redundant_planner.nodes.transforms import transform_lookup
from redundant_planner.physics import PhysicsError, require_mujoco
from redundant_planner.physics.film import check_file, choose_gl, Film

Array = npt.NDArray[np.float64]

# Period of /diagnostics [s], and of the viewer's pictures.
_REPORT_PERIOD, _VIEW_PERIOD = 0.2, 1.0 / 30.0
# Against real time the arm does not catch up with more than this [s].
_LONGEST_STANDSTILL = 0.25


class Options(NamedTuple):
    """The command line beside ROS arguments.

    Attributes:
        viewer: whether to open MuJoCo's own viewer.
        record: the film to write; None for none.
    """

    viewer: bool
    record: Path | None


class MujocoHardwareNode(EndableNode):
    """Stands in for an arm: its drives obey as far as torque, inertia and contacts let them."""

    def __init__(self, options: Options) -> None:
        """Build the arm and stand at the start posture.

        Raises:
            PlannerError: a parameter or the URDF is wrong, or MuJoCo is not installed.
        """
        film_refused = _prepare_film(options)
        require_mujoco()
        # Not at the top: without MuJoCo this node has to say so.
        from redundant_planner.io.robot_files import build_robot
        from redundant_planner.physics.arm import PhysicsArm
        super().__init__('mujoco_hardware_node')
        logger = self.get_logger()
        self._warn = ThrottledLog(logger.warning)
        robot_parameters = declare(self, RobotParameters)
        physics = declare(self, PhysicsParameters)
        self._settings = settings = declare(self, MujocoHardwareParameters)
        clock = declare(self, ClockParameters)
        capsules = declare_entries(self, 'capsule', robot_parameters.capsules, CAPSULE)
        static = declare_entries(
            self, 'static_obstacle', settings.static_obstacles, STATIC_OBSTACLE)
        refuse_unknown_parameters(self)
        urdf = urdf_text(robot_parameters)
        if not urdf:
            raise ParameterError("parameter 'urdf' is empty; give the URDF to simulate")
        robot = build_robot(robot_parameters, urdf, capsules, say=logger.info, warn=logger.warning)
        self._arm = PhysicsArm(robot, physics, dict(
            zip(settings.initial_joints, settings.initial_positions)))
        for sentence in (*self._arm.remarks, *film_refused):
            logger.warning(sentence)
        self._takes_positions = physics.servo == POSITION_SERVO
        self._random = np.random.default_rng(0)
        self._obstacles = ObstacleInput(
            ['obstacles'], ObstacleSources([ObstacleTracker(
                checked(obstacle_of(name, entry) for name, entry in static.items()),
                sorted({robot.base_frame, ''}),
                transform=transform_lookup(self, robot.base_frame))]),
            1.0 / settings.rate, self.guard, self._warn)
        self._film = (Film(options.record, self._arm.model)
                      if options.record is not None and not film_refused else None)
        self._viewer = self._opened_viewer() if options.viewer else None
        self._viewed_at = self._reported_at = -np.inf
        self._reported_steps = 0
        self._said_contacts: tuple[tuple[int, bool], ...] = ()
        self._real_time_factor = 0.0
        self._connect(urdf)
        self._time = HardwareTime(self, settings.rate, clock, self._go_on)
        if not self._time.simulated:  # nobody is late by simulated time
            runtime.request_priority(settings.thread_priority)
        logger.info(f'simulating {", ".join(self._arm.ranges.names)} at {physics.physics_rate} Hz')

    def _connect(self, urdf: str) -> None:
        """Create publishers and subscriptions."""
        self._states = self.create_publisher(JointState, 'joint_states', 10)
        self._writer = JointWriter(self._arm.ranges.names, effort=True)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = self.create_publisher(String, 'robot_description', latched)
        self._description.publish(String(data=urdf))
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._contacts = self.create_publisher(DiagnosticArray, '~/contacts', latched)
        self.create_subscription(
            JointState, 'joint_command', self._on_command, qos_profile_sensor_data)
        self.create_subscription(
            MarkerArray, 'obstacles', self._obstacles.on_message, 10, raw=True)

    def _on_command(self, message: JointState) -> None:
        names = self._arm.ranges.names
        try:
            unknown = [name for name in message.name if name not in names]
            if unknown:
                raise StateError(f'this arm has no joints {known(unknown)}')
            commanded = [names.index(name) for name in message.name]
            velocities, positions = np.zeros(len(names)), np.full(len(names), np.nan)
            velocities[commanded] = messages.velocities_from_message(message, message.name)
            if message.position and self._takes_positions:
                positions[commanded] = messages.values_of(
                    message.name, message.position, message.name, 'position')
        except StateError as error:
            self._warn(f'joint_command ignored: {error}')
            return
        # Its planner may count other turns of a joint without limits.
        positions = nearest_turn(positions, self._arm.q, self._arm.ranges.position_max)
        self._arm.command(self._time.now(), velocities, positions)
        self._time.commanded(message.header.stamp)

    def _go_on(self) -> None:
        """Simulate up to now among the obstacles known by now; publish the state."""
        now, arm = self._time.now(), self._arm
        if not self._time.simulated:
            arm.skip_to(now - _LONGEST_STANDSTILL)
        self._obstacles.read(now)
        self._obstacles.tracker.expire(now)
        arm.surround(self._obstacles.scene)
        arm.advance(now)
        q = arm.q
        if self._settings.noise > 0.0:
            q = q + self._random.normal(0.0, self._settings.noise, q.shape)
        if self._settings.wrap_continuous:
            q = wrapped(q, arm.ranges.position_max)
        self._states.publish(self._writer.message(
            self._time.stamp_ns(), q, arm.dq, arm.torques))
        if self._film is not None:
            self._film.note(arm.data)
        self._say_contacts()
        self._report_and_show(time.monotonic())

    def _say_contacts(self) -> None:
        """Publish ~/contacts and say it in the log when somebody begins or ends to touch."""
        contacts = self._arm.contacts.contacts
        state = tuple((contact.times, contact.touching) for contact in contacts)
        if state == self._said_contacts:
            return
        self._said_contacts = state
        self._contacts.publish(physics_report.contacts_message(self._arm, self._time.stamp()))
        for contact in contacts:
            if contact.touching:
                self._warn(f'contact of {contact.link} with {contact.other}: at '
                           f'{contact.last:.3f} s')

    def _report_and_show(self, now: float) -> None:
        """Publish /diagnostics and renew the viewer's picture, each at its pace in real time."""
        since = now - self._reported_at
        if since >= _REPORT_PERIOD:
            steps = self._arm.steps
            self._real_time_factor = (steps - self._reported_steps) * self._arm.step / since
            self._reported_at, self._reported_steps = now, steps
            self._diagnostics.publish(physics_report.state_message(
                self.get_fully_qualified_name(), self._arm, self._time.stamp(),
                self._real_time_factor, self._time.missed))
        if self._viewer is not None and now >= self._viewed_at + _VIEW_PERIOD:
            self._viewed_at = now
            if self._viewer.is_running():
                self._viewer.sync()
            else:
                self._viewer = None

    def _opened_viewer(self) -> Any:
        """Return MuJoCo's viewer; None where it cannot open, with the reason in the log."""
        if sys.platform == 'linux' and not (
                os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')):
            self.get_logger().warning('no viewer: there is no display')
            return None
        try:
            from mujoco import viewer
            return viewer.launch_passive(self._arm.model, self._arm.data)
        except Exception as error:
            self.get_logger().warning(f'no viewer: {error}')
            return None

    def finish(self) -> None:
        """Write the film, close the viewer."""
        if self._viewer is not None:
            self._viewer.close()
        if self._film is None:
            return
        try:
            count = self._film.write()
            self.get_logger().info(f'film of {count} pictures written')
        except PhysicsError as error:
            self.get_logger().warning(f'no film: {error}')


def _prepare_film(options: Options) -> tuple[str, ...]:
    """Choose an OpenGL for the film; return why there will be none, if so."""
    if options.record is None:
        return ()
    try:
        check_file(options.record)
        choose_gl()
    except PhysicsError as error:
        return (f'no film: {error}',)
    return ()


def parsed(args: list[str] | None) -> Options:
    """Return the options of a command line, which may have ROS arguments."""
    parser = argparse.ArgumentParser(prog='mujoco_hardware_node', description=__doc__)
    parser.add_argument('--viewer', action='store_true',
                        help="open MuJoCo's viewer, where there is a display")
    parser.add_argument('--record', type=Path, metavar='FILE',
                        help='write a film (.gif, or .mp4 with ffmpeg) when the node ends')
    line = remove_ros_args(args=sys.argv if args is None else ['', *args])
    found = parser.parse_args(line[1:])
    return Options(found.viewer, found.record)


def main(args: list[str] | None = None) -> int:
    """Run mujoco_hardware_node."""
    options = parsed(args)
    return runtime.run(lambda: MujocoHardwareNode(options), 'mujoco_hardware_node', args)


if __name__ == '__main__':
    raise SystemExit(main())
