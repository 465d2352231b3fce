"""depth_camera: publishes what a depth camera would see of obstacles and arm, for tests."""

from __future__ import annotations

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, PointCloud2
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import known, StateError
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.cloud_writer import cloud_bytes
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.perception_parameters import CameraParameters
from redundant_planner.nodes import runtime
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.loop_clock import loop_clock
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.ros_parameters import CAPSULE, declare, declare_entries
from redundant_planner.nodes.startup import Startup
from redundant_planner.nodes.throttled_log import ThrottledLog
from redundant_planner.perception.depth_camera import arm_bodies, bodies_of, DepthCamera, together


class DepthCameraNode(EndableNode):
    """Draws the arm where joint_states says that it is, and the markers of camera_obstacles."""

    def __init__(self) -> None:
        """Read all parameters; the camera sees once the robot is known.

        Raises:
            PlannerError: a parameter is wrong.
        """
        super().__init__('depth_camera')
        self._warn = ThrottledLog(self.get_logger().warning)
        robot = declare(self, RobotParameters)
        self._settings = p = declare(self, CameraParameters)
        self._camera = DepthCamera(
            p.image_width, p.image_height, p.field_of_view, p.camera_range, p.camera_noise)
        self._origin = np.array(p.camera_pose[:3])
        self._axes = rotations(np.array([p.camera_pose[3:]]))[0]
        self._random = np.random.default_rng(0)
        # The latest posture, and its stamp [ns].
        self._seen: tuple[np.ndarray, int] | None = None
        self._startup: Startup | None = Startup(
            self, robot, declare_entries(self, 'capsule', robot.capsules, CAPSULE), self._warn,
            self._start)
        self._startup.begin()

    def _start(self, robot: Robot, parameters: RobotParameters) -> None:
        """Begin to see a robot that was built with these parameters."""
        self._robot = robot
        self._radii = np.array([capsule.radius for capsule in robot.capsules])
        self._reader = JointReader(robot.joint_names, Seams.of(robot))
        self._time = loop_clock(self)
        self._tracker = ObstacleTracker((), sorted({robot.base_frame, ''}))
        self._joints = PolledSubscription(self, JointState, 'joint_states')
        self._points = self.create_publisher(PointCloud2, 'points', QoSProfile(depth=1))
        self.create_subscription(
            MarkerArray, 'camera_obstacles', self._on_obstacles, 10, raw=True)
        self.create_timer(1.0 / self._settings.camera_rate, self._tick,
                          clock=self._time.timers)
        self.get_logger().info(
            f"a camera sees '{robot.name}' at {self._settings.camera_rate} Hz, "
            f'{self._camera.width} × {self._camera.height} points')

    def _on_obstacles(self, raw: bytes) -> None:
        for problem in self._tracker.update(raw, self._time.now()):
            self._warn(f'camera_obstacles: {problem}; ignored')

    def _tick(self) -> None:
        """Publish a cloud of the world at the stamp of the latest posture."""
        if self._startup is not None:
            self._startup.close()
            self._startup = None
        for raw, published_ns in self._joints.fetch_stamped():
            try:
                if len(self._reader.read(raw)) and not self._reader.missing:
                    self._seen = (self._reader.posture,
                                  self._reader.stamp_ns(raw) or published_ns)
            except StateError as error:
                self._warn(f'joint_states ignored: {error}')
        if self._seen is None:
            self._warn(f'waiting for joint_states of {known(self._reader.missing)}: the camera '
                       'shows the arm where it is')
            return
        q, stamp_ns = self._seen
        self._tracker.expire(self._time.now())
        arm = self._robot.kinematics(q)
        bodies = together(arm_bodies(arm.segment_start, arm.segment_end, self._radii),
                          bodies_of(self._tracker.scene))
        self._points.publish(cloud_bytes(
            self._camera.points(self._origin, self._axes, bodies, self._random),
            self._settings.camera_frame, stamp_ns))


def main(args: list[str] | None = None) -> int:
    """Run depth_camera."""
    return runtime.run(DepthCameraNode, 'depth_camera', args)


if __name__ == '__main__':
    raise SystemExit(main())
