"""planning_scene_obstacles: MoveIt's planning scene in, `obstacles` and `attached` out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
import time
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import known, ObstacleError, PlannerError, StateError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.marker_writer import cube_list_bytes
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.perception_parameters import SceneParameters
from redundant_planner.nodes import runtime
from redundant_planner.nodes.allowed_contacts_setter import AllowedContactsSetter
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.marker_topic import MarkerTopic, pose_numbers
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.ros_parameters import CAPSULE, declare, declare_entries
from redundant_planner.nodes.startup import Startup
from redundant_planner.nodes.throttled_log import ThrottledLog
from redundant_planner.nodes.transforms import transform_lookup
from redundant_planner.perception.own_shape import reach_of
from redundant_planner.perception.planning_scene import (
    OCTOMAP,
    with_attached,
    with_object,
    with_scene,
)
from redundant_planner.perception.scene_contacts import allowed_contacts
from redundant_planner.perception.scene_markers import obstacle_ids, scene_markers
from redundant_planner.perception.scene_records import PlanningScene, Surroundings
from redundant_planner.perception.scene_shapes import placement

Array = npt.NDArray[np.float64]

# The topics that move_group listens to itself, and the one on which it says what came of them.
_MONITORED = 'monitored_planning_scene'
# How long a message waits for the frames that it names [s], and how often it looks for them.
_PATIENCE, _LOOK_UP = 1.0, 0.05
# How often everything is published again, for planners that start late [s].
_PERIOD = 1.0
# How long a request for the whole scene may take before it is made again [s].
_ANSWER = 5.0
# How long there may be no scene before that is worth a word, and how often it is said [s].
_REMINDER = 5.0
# Sentences about a scene that are remembered, so that each is said once.
_MOST_SENTENCES = 10_000
_RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
_JOINT_STATES = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
# Everything that is read of a scene: moveit_msgs/PlanningSceneComponents' ROBOT_STATE,
# ROBOT_STATE_ATTACHED_OBJECTS, WORLD_OBJECT_NAMES, WORLD_OBJECT_GEOMETRY, OCTOMAP, TRANSFORMS,
# ALLOWED_COLLISION_MATRIX and LINK_PADDING_AND_SCALING.
_COMPONENTS = 2 | 4 | 8 | 16 | 32 | 64 | 128 | 256

# How a message changes a scene: `with_scene` and its kin.
_Apply = Callable[[PlanningScene, Any, Surroundings], tuple[PlanningScene, list[str]]]


class MoveitMessages(NamedTuple):
    """The classes of moveit_msgs that are needed.

    Attributes:
        scene, object, attached: of the messages PlanningScene, CollisionObject and
            AttachedCollisionObject.
        get_scene: of the service GetPlanningScene.
    """

    scene: type[Any]
    object: type[Any]
    attached: type[Any]
    get_scene: type[Any]


class _Waiting(NamedTuple):
    """A message that has come.

    Attributes:
        apply: what it does.
        message: it itself.
        came_at: when, by the system's clock [s].
    """

    apply: _Apply
    message: Any
    came_at: float


def moveit_messages() -> MoveitMessages:
    """Return the classes of moveit_msgs.

    Raises:
        PlannerError: it is not installed.
    """
    try:
        from moveit_msgs.msg import (
            AttachedCollisionObject,
            CollisionObject,
            PlanningScene as SceneMessage,
        )
        from moveit_msgs.srv import GetPlanningScene
    except ImportError as error:
        raise PlannerError(
            f'moveit_msgs cannot be imported ({error}): install it with '
            '`sudo apt install ros-jazzy-moveit-msgs`, and `source /opt/ros/jazzy/setup.bash`; '
            'PyPI does not have it') from None
    return MoveitMessages(
        SceneMessage, CollisionObject, AttachedCollisionObject, GetPlanningScene)


class PlanningSceneObstacles(EndableNode):
    """Connects topics and parameters to the scene, once the robot is known."""

    def __init__(self, messages: MoveitMessages | None = None) -> None:
        """Read all parameters; scenes count once the robot is known.

        Args:
            messages: the classes of moveit_msgs; those that are installed if None.

        Raises:
            PlannerError: moveit_msgs is not installed, or a parameter is wrong.
        """
        self._messages = moveit_messages() if messages is None else messages
        super().__init__('planning_scene_obstacles')
        self._warn = ThrottledLog(self.get_logger().warning)
        self._once = ThrottledLog(self.get_logger().warning, math.inf, _MOST_SENTENCES)
        robot = declare(self, RobotParameters)
        self._settings = declare(self, SceneParameters)
        self._scene = PlanningScene()
        self._waiting: deque[_Waiting] = deque()
        # Whether a frame was asked for that may yet become known.
        self._missing = False
        self._heard = False
        self._asked_at: float | None = None
        self._was_ready = False
        self._startup: Startup | None = Startup(
            self, robot, declare_entries(self, 'capsule', robot.capsules, CAPSULE), self._warn,
            self._start)
        self._startup.begin()

    def _start(self, robot: Robot, parameters: RobotParameters) -> None:
        """Begin to listen for a robot that was built with these parameters."""
        self._robot = robot
        self._moving = frozenset(robot.moving_links)
        self._at_rest = frozenset(robot.links_at_rest)
        center, reach = reach_of(robot)
        self._around = Surroundings(
            self._frame, center, reach + self._settings.scene_reach_margin)
        self._transform = transform_lookup(self, robot.base_frame)
        self._reader = JointReader(robot.joint_names)
        self._joints = PolledSubscription(self, JointState, 'joint_states', _JOINT_STATES)
        self._markers = MarkerTopic(self.create_publisher(MarkerArray, 'obstacles', 10))
        self._attached = MarkerTopic(self.create_publisher(MarkerArray, 'attached', 10))
        planner = self._settings.scene_planner
        self._setter = AllowedContactsSetter(self, planner, self._once) if planner else None
        self._contacts = self._settings.allowed_contacts
        m = self._messages
        self.create_subscription(m.scene, _MONITORED, self._on_monitored, _RELIABLE)
        for topic, kind, apply in (('planning_scene', m.scene, with_scene),
                                   ('collision_object', m.object, with_object),
                                   ('attached_collision_object', m.attached, with_attached)):
            self.create_subscription(kind, topic, self._listener(apply), _RELIABLE)
        self._whole = self.create_client(m.get_scene, 'get_planning_scene')
        self.create_service(Trigger, '~/clear', self._on_clear)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_UP, self._work, clock=steady)
        self.create_timer(_PERIOD, self._look_around, clock=steady)
        self.create_timer(_REMINDER, self._remind, clock=steady)
        self.get_logger().info(
            f"the planning scene becomes obstacles for '{robot.name}' in {robot.base_frame}; "
            f'held is what is attached to {known(robot.links_of_tip)}')

    def _on_monitored(self, message: Any) -> None:
        self._take(with_scene, message)

    def _listener(self, apply: _Apply) -> Callable[[Any], None]:
        """Return a callback of a topic that move_group listens to, too.

        While somebody publishes what came of it, that counts alone: an object that is appended
        would come twice.
        """
        def take(message: Any) -> None:
            if not self.count_publishers(self.resolve_topic_name(_MONITORED)):
                self._take(apply, message)

        return take

    def _take(self, apply: _Apply, message: Any) -> None:
        self._heard = True
        self._waiting.append(_Waiting(apply, message, time.monotonic()))
        self._work()

    def _work(self) -> None:
        """Apply the messages that wait, in their order, as far as their frames are known."""
        if self._startup is not None:
            self._startup.close()
            self._startup = None
        scene = self._scene
        while self._waiting:
            # First, so that a message that fails is not tried again.
            waiting = self._waiting.popleft()
            self._missing = False
            result = self.guard.call(
                'a planning scene', waiting.apply, scene, waiting.message, self._around)
            if result is None:
                continue
            after, problems = result
            if self._missing and time.monotonic() - waiting.came_at < _PATIENCE:
                self._waiting.appendleft(waiting)
                break
            scene = after
            for problem in problems:
                self._once(problem)
        if scene is not self._scene:
            self._scene = scene
            self._show()

    def _show(self) -> None:
        """Publish the scene as it is now."""
        markers = scene_markers(self._scene, self._robot, self._around)
        ids = obstacle_ids(self._scene, self._robot)
        contacts = allowed_contacts(
            self._scene.matrix, [*ids, *((OCTOMAP,) if markers.cubes else ())],
            self._scene.held, self._robot)
        for remark in (*markers.remarks, *contacts.remarks):
            self._once(remark)
        self._contacts = tuple(dict.fromkeys(
            (*self._settings.allowed_contacts, *contacts.entries)))
        base = self._robot.base_frame
        lists = {}
        if self._scene.voxels is not None:
            pose = pose_numbers(self._scene.voxels.pose)
            lists = {(OCTOMAP, number): cube_list_bytes(
                OCTOMAP, base, 0, edge, centers, number=number, pose=pose)
                for number, (edge, centers) in enumerate(sorted(markers.cubes.items()))}
        # What is taken into the hand is there before it is no obstacle any more, and the other
        # way round: the planner hides an obstacle that it holds.
        self._attached.add({link: list(held) for link, held in markers.held.items()}, {})
        self._markers.add({base: list(markers.obstacles)}, lists)
        self._attached.remove()
        self._markers.remove()

    def _look_around(self) -> None:
        """Publish everything again, and ask for the whole scene where it is told anew."""
        self._read_joint_states()
        self._attached.repeat()
        self._markers.repeat()
        if self._setter is not None and self._heard:
            self._setter.update(self._contacts)
        ready, now = self._whole.service_is_ready(), time.monotonic()
        late = self._asked_at is not None and now - self._asked_at > _ANSWER
        if ready and (not self._was_ready or late):
            self._asked_at = now
            self._whole.call_async(self._request()).add_done_callback(
                lambda future: self.guard.call('the whole scene', self._on_whole, future))
        self._was_ready = ready
        if not ready:
            self._asked_at = None

    def _request(self) -> Any:
        """Return a request for the whole scene."""
        request = self._messages.get_scene.Request()
        request.components.components = _COMPONENTS
        return request

    def _on_whole(self, future: Future) -> None:
        self._asked_at = None
        response = future.result()
        if response is not None:
            self._take(with_scene, response.scene)

    def _remind(self) -> None:
        if not self._heard:
            self._warn('no planning scene yet: nobody offers get_planning_scene, and nothing came '
                       f'on {_MONITORED}, planning_scene, collision_object or '
                       'attached_collision_object; is move_group running, in this namespace?')

    def _on_clear(
        self, request: Trigger.Request, response: Trigger.Response,
    ) -> Trigger.Response:
        """Have planners forget all other markers of both topics."""
        self._attached.clear()
        self._markers.clear()
        response.success = True
        response.message = f'{len(self._scene.objects)} objects, {len(self._scene.held)} attached'
        return response

    def _read_joint_states(self) -> None:
        """Take in the latest measurements."""
        for raw in self._joints.fetch():
            try:
                self._reader.read(raw)
            except StateError as error:
                self._warn(f'joint_states ignored: {error}')

    def _frame(self, name: str) -> Array:
        """Return the pose (4, 4) of a frame in the base frame as it is now.

        Raises:
            ObstacleError: nobody knows it.
        """
        robot = self._robot
        corners = np.vstack((np.zeros(3), np.eye(3)))
        if name in ('', robot.base_frame):
            return np.eye(4)
        if name in self._at_rest:
            corners = robot.in_link(robot.base_frame, name, corners)
        elif name in self._moving:
            self._read_joint_states()
            if self._reader.missing:
                self._missing = True
                raise ObstacleError(
                    f'no joint_states of {known(self._reader.missing)} have come, and it moves')
            corners = robot.in_base(self._reader.posture, name, corners)
        elif self._transform is None:
            raise ObstacleError("tf2_ros is not installed, and without it only "
                                f"'{robot.base_frame}' and the arm's own links are known")
        else:
            try:
                return placement(*self._transform(name))
            except ObstacleError:
                self._missing = True
                raise
        return placement(corners[0], (corners[1:] - corners[0]).T)


def main(args: list[str] | None = None) -> int:
    """Run planning_scene_obstacles."""
    return runtime.run(PlanningSceneObstacles, 'planning_scene_obstacles', args)


if __name__ == '__main__':
    raise SystemExit(main())
