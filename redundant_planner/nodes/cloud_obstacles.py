"""cloud_obstacles: points of a depth camera and joint_states in, voxels on `obstacles` out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import time
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rclpy.clock import Clock, ClockType
from rclpy.qos import qos_profile_sensor_data, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import known, ObstacleError, StateError
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.cloud_layout import cloud_layout, CloudLayout, points_of
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.marker_writer import cube_list_bytes
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.payload import Payload
from redundant_planner.io.perception_parameters import CloudParameters
from redundant_planner.io.robot_files import with_more_capsules
from redundant_planner.nodes import runtime
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.messages import NANOSECONDS
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.ros_parameters import CAPSULE, declare, declare_entries, on_change
from redundant_planner.nodes.startup import Startup
from redundant_planner.nodes.throttled_log import ThrottledLog
from redundant_planner.nodes.transforms import transform_lookup
from redundant_planner.perception.cloud_filter import CloudFilter, MOST_VOXELS, SensorPose
from redundant_planner.perception.posture_buffer import Fit, Posture, PosturesInParts

Array = npt.NDArray[np.float64]

# The namespace of the marker.
NAMESPACE = 'cloud'
# How long a cloud waits for the joint_states and the transform of its stamp [s].
_PATIENCE = 0.2
# How often a waiting cloud looks for them [s].
_LOOK_UP = 0.005
# How long no cloud may come before that is worth a word, and how often it is said [s].
_SILENCE, _REMINDER = 1.0, 5.0
# Joint states that may wait: a second of them at the highest rate.
_JOINT_STATES = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


class _Cloud(NamedTuple):
    """A message that waits.

    Attributes:
        raw: its bytes.
        layout: what they say of themselves.
        came_at: when it came, by the system's clock [s].
    """

    raw: bytes
    layout: CloudLayout
    came_at: float


class CloudObstacles(EndableNode):
    """Connects topics and parameters to the filter, once the robot is known."""

    def __init__(self) -> None:
        """Read all parameters; clouds count once the robot is known.

        Raises:
            PlannerError: a parameter is wrong.
        """
        super().__init__('cloud_obstacles')
        self._warn = ThrottledLog(self.get_logger().warning)
        robot = declare(self, RobotParameters)
        self._settings = declare(self, CloudParameters)
        self._self_capsules = declare_entries(
            self, 'self_capsule', self._settings.self_capsules, CAPSULE)
        # The cloud that is worked on, and the newest one behind it: older ones are dropped.
        self._waiting: _Cloud | None = None
        self._next: _Cloud | None = None
        self._points = np.empty((3, 0))
        self._startup: Startup | None = Startup(
            self, robot, declare_entries(self, 'capsule', robot.capsules, CAPSULE), self._warn,
            self._start)
        self._startup.begin()

    def _start(self, robot: Robot, parameters: RobotParameters) -> None:
        """Begin to see for a robot that was built with these parameters."""
        own = with_more_capsules(robot, parameters, self._self_capsules)
        self._own, self._payload = own, Payload(own)
        self._filter = CloudFilter(own, self._settings)
        self._base = robot.base_frame
        self._transform = transform_lookup(self, robot.base_frame)
        self._postures = PosturesInParts(robot.velocity_max)
        self._reader = JointReader(robot.joint_names, Seams.of(robot))
        self._joints = PolledSubscription(self, JointState, 'joint_states', _JOINT_STATES)
        self._obstacles = self.create_publisher(MarkerArray, 'obstacles', 10)
        self._heard_at = time.monotonic()
        newest = QoSProfile(depth=1, reliability=qos_profile_sensor_data.reliability)
        self.create_subscription(PointCloud2, 'points', self._on_cloud, newest, raw=True)
        self.create_subscription(MarkerArray, 'attached', self._on_attached, 10, raw=True)
        self.create_service(Trigger, '~/clear', self._on_clear)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_UP, self._work, clock=steady)
        self.create_timer(_REMINDER, self._look_around, clock=steady)
        on_change(self, lambda: (self._filter.parameters,), self._apply, 'self_capsule', {})
        self.get_logger().info(
            f"seeing obstacles for '{robot.name}' in {robot.base_frame}, in voxels of "
            f'{self._settings.voxel_size} m; joints: {", ".join(robot.joint_names)}')

    def _apply(
        self, parameters: CloudParameters, entries: Mapping[tuple[str, str], Any],
    ) -> None:
        """Take new parameters."""
        self._filter.parameters = parameters

    def _on_clear(
        self, request: Trigger.Request, response: Trigger.Response,
    ) -> Trigger.Response:
        """Forget all voxels; what the next cloud shows comes back."""
        count = len(self._filter.memory.keys)
        self._filter.memory.clear()
        response.success, response.message = True, f'forgot {count} voxels'
        return response

    def _on_attached(self, raw: bytes) -> None:
        """Take what the hand holds out of the clouds to come, as the arm itself."""
        for problem in self._payload.tracker.update(raw, time.monotonic()):
            self._warn(f'attached {problem}; ignored')
        self._hold()

    def _hold(self) -> None:
        self._payload.tracker.expire(time.monotonic())
        things = self._payload.changed()
        if things is not None:
            try:
                self._filter.hold(self._own.holding(things))
            except ObstacleError as error:
                self._warn(f'what the arm holds stays as it was: {error}')

    def _on_cloud(self, raw: bytes) -> None:
        """Keep a cloud until the posture of its stamp is known; refuse one that is damaged."""
        self._heard_at = time.monotonic()
        try:
            layout = cloud_layout(raw)
            if layout.stamp_ns <= 0:
                raise StateError(f'its stamp is {layout.stamp_ns / NANOSECONDS:g} s; it must say '
                                 'when it was taken, as the arm is taken out as it was then')
        except StateError as error:
            self._warn(f'points ignored: {error}')
            return
        cloud = _Cloud(raw, layout, self._heard_at)
        if self._waiting is None:
            self._waiting = cloud
        else:
            self._next = cloud
        self._work()

    def _work(self) -> None:
        """Work on the clouds that wait, as far as posture and transform of their stamps go."""
        if self._startup is not None:
            self._startup.close()
            self._startup = None
        while self._waiting is not None:
            cloud = self._waiting
            self._read_joint_states()
            stamp = cloud.layout.stamp_ns / NANOSECONDS
            posture = self._postures.at(stamp)
            pose = None
            try:
                if posture.fit is not Fit.KNOWN:
                    raise StateError(_why(posture, self._reader.missing, self._own.n))
                pose = self._pose(cloud.layout)
            except (StateError, ObstacleError) as error:
                final = posture.fit in (Fit.TOO_OLD, Fit.GAP) or (
                    posture.fit is Fit.KNOWN and self._transform is None)
                if not final and time.monotonic() - cloud.came_at < _PATIENCE:
                    return
                self._warn(f'points ignored: {error}')
            # First, so that a cloud that fails is not tried again.
            self._waiting, self._next = self._next, None
            self._hold()
            if pose is not None:
                self._see(cloud, pose, posture, stamp)

    def _read_joint_states(self) -> None:
        """Take in the measurements that have come."""
        for raw, published_ns in self._joints.fetch_stamped():
            try:
                which = self._reader.read(raw)
                stamp_ns, dq = self._reader.stamp_ns(raw), self._reader.velocities(raw)
            except StateError as error:
                self._warn(f'joint_states ignored: {error}')
                continue
            if not len(which):
                continue
            # Without a stamp it counts as measured when it was published.
            stamp = (stamp_ns or published_ns) / NANOSECONDS
            if self._postures.add(stamp, which, self._reader.posture[which], dq):
                self._warn('the clock of joint_states was set back: earlier ones no longer count')

    def _pose(self, layout: CloudLayout) -> SensorPose:
        """Return where a cloud's frame was at its stamp.

        Raises:
            ObstacleError: nobody knows.
        """
        p, frame = self._filter.parameters, layout.frame
        if frame == self._base:
            return SensorPose(np.zeros(3), np.eye(3), False)
        if p.sensor_pose and p.sensor_frame in ('', frame):
            return SensorPose(np.array(p.sensor_pose[:3]),
                              rotations(np.array([p.sensor_pose[3:]]))[0], True)
        known = (f"sensor_pose is that of '{p.sensor_frame}'" if p.sensor_pose
                 else 'sensor_pose is not set')
        if self._transform is None:
            raise ObstacleError(f"they are in frame '{frame}', and nobody knows where that is: "
                                f"{known}, and tf2_ros is not installed; '{self._base}' needs "
                                'neither')
        try:
            origin, axes = self._transform(frame, layout.stamp_ns)
        except ObstacleError as error:
            raise ObstacleError(f"they are in frame '{frame}'; {known}, and {error}") from None
        return SensorPose(origin, axes, True)

    def _see(self, cloud: _Cloud, pose: SensorPose, posture: Posture, stamp: float) -> None:
        """Turn a cloud into voxels, and publish them."""
        layout, parameters = cloud.layout, self._filter.parameters
        count = layout.height * layout.width
        if self._points.shape[1] != count:
            self._points = np.empty((3, count))
        points = points_of(cloud.raw, layout, self._points)
        centers = self._filter.see(points, pose, posture, stamp)
        self._obstacles.publish(cube_list_bytes(
            NAMESPACE, self._base, layout.stamp_ns, parameters.voxel_size, centers))
        if self._filter.left_out:
            self._warn(f'too many voxels: the {MOST_VOXELS} nearest to the arm count, and '
                       f'{self._filter.left_out} more do not; use a larger voxel_size or a '
                       'crop_box')

    def _look_around(self) -> None:
        """Say that no clouds come; the voxels stay, as nobody knows of anything else."""
        silent = time.monotonic() - self._heard_at
        if silent > _SILENCE:
            count = len(self._filter.memory.keys)
            self._warn(f'no points for {silent:.0f} s: the {count} voxels stay as last seen')


def _why(posture: Posture, missing: Sequence[str], n: int) -> str:
    """Return why no posture fits a cloud's stamp; some of n joints may never have come."""
    if missing:
        whose = f' of {known(missing)}' if len(missing) < n else ''
        return f'no joint_states{whose} have come; without them the arm would see itself'
    away = f'{posture.away:.3g} s'
    return {
        Fit.TOO_EARLY_TO_SAY: f'their stamp is {away} later than the newest joint_states; do the '
                              'clocks of camera and arm agree?',
        Fit.TOO_OLD: f'their stamp is {away} earlier than the oldest joint_states that are kept; '
                     'do the clocks of camera and arm agree?',
        Fit.GAP: f'no joint_states came for {away} around their stamp; where the arm was then is '
                 'not known',
    }[posture.fit]


def main(args: list[str] | None = None) -> int:
    """Run cloud_obstacles."""
    return runtime.run(CloudObstacles, 'cloud_obstacles', args)


if __name__ == '__main__':
    raise SystemExit(main())
