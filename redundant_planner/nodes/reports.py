"""What planner_node publishes about itself: /diagnostics, ~/target, ~/body, ~/markers and more."""

from __future__ import annotations

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.target.goal import Target, TipTargets
from redundant_planner.io.software_version import with_version
from redundant_planner.io.tip_topics import OBJECT_POSE
from redundant_planner.nodes.body_writer import BodyWriter
from redundant_planner.nodes.control_loop import ControlLoop
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.pose_messages import pose_to_message
from redundant_planner.nodes.robot_markers import RobotMarkers
from redundant_planner.nodes.settings import Settings
from redundant_planner.nodes.state_report import diagnostics, progress_status, status_of
from redundant_planner.paper.method import PaperPlanner


class Reports:
    """Publishes the loop's state; each method is a chore for a moment between two ticks."""

    def __init__(
        self, node: EndableNode, loop: ControlLoop, settings: Callable[[], Settings],
    ) -> None:
        """Create the publishers.

        Args:
            node: to create them on.
            loop: to report on.
            settings: returns the settings in use.
        """
        self._node, self._loop, self._settings = node, loop, settings
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._markers = node.create_publisher(MarkerArray, '~/markers', 1)
        # Without what it will hold: the configuration says what it was built of.
        self._robot = loop.planner.robot
        self._robot_markers = RobotMarkers(self._robot)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._configuration = node.create_publisher(String, '~/configuration', latched)
        self._published: Settings | None = None
        self._target = node.create_publisher(DiagnosticArray, '~/target', latched)
        self._body = node.create_publisher(MarkerArray, '~/body', 1)
        self._body_writer = self._body_of(self._robot)
        self._known_target: Target | TipTargets | None = None
        self._object = (node.create_publisher(PoseStamped, OBJECT_POSE, 1)
                        if len(self._robot.tips) > 1 else None)

    def publish_configuration(self) -> None:
        """Publish all parameters if they have changed, so that a bag explains itself."""
        settings = self._settings()
        if settings is not self._published:
            self._published = settings
            self._configuration.publish(
                String(data=with_version(settings.file_text(self._robot))))

    def publish_diagnostics(self) -> None:
        """Publish the state of the loop."""
        loop, guard, state = self._loop, self._node.guard, self._loop.state
        now = loop.clock.now()
        state.joint_state_age = float(loop.supervisor.measurement_ages(now).max())
        state.command_age = loop.command.age()
        state.obstacle_age = now - loop.obstacles.read_at
        state.faults, state.last_fault = guard.count, guard.last
        state.blind = loop.obstacles.blind(now)
        planner = loop.planner
        status = status_of(
            self._node.get_fully_qualified_name(), planner.robot, state,
            loop.supervisor.posture, planner.parameters.method, _margin_of(planner),
            len(loop.obstacles.scene.names), loop.held)
        self._diagnostics.publish(diagnostics(status, self._node.get_clock().now().to_msg()))
        state.tick_times.clear()

    def publish_progress(self) -> None:
        """Publish how far the arm has come to its target, and once that it has none any more."""
        state, target = self._loop.state, self._loop.command.known_target
        if target is None and self._known_target is None:
            return
        # A target that an arm lets go of because it does not follow is still talked about.
        told = target
        if target is None and state.astray and state.hold == state.astray:
            told = self._known_target
        self._known_target = told
        self._target.publish(diagnostics(
            progress_status(
                self._node.get_fully_qualified_name(), self._robot, told, state.result,
                state.astray if target is None else ''),
            self._node.get_clock().now().to_msg()))

    def publish_object(self) -> None:
        """Publish where what the tips hold together is, while they do."""
        if self._object is None:
            return
        loop = self._loop
        pose = loop.coupling.object_pose(loop.planner, loop.supervisor.posture)
        if pose is not None:
            message = pose_to_message(pose, self._robot.base_frame)
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._object.publish(message)

    def publish_body(self) -> None:
        """Publish where the arm's links are and how fast they move, if somebody listens."""
        loop = self._loop
        posture, robot = loop.supervisor.posture, loop.planner.robot
        if posture is None or not self._body.get_subscription_count():
            return
        if robot is not self._body_writer.robot:
            self._body_writer = self._body_of(robot)
        self._body.publish(self._body_writer.message(
            loop.clock.stamp_ns(), robot.kinematics(posture), loop.velocity))

    def _body_of(self, robot: Robot) -> BodyWriter:
        space = self._node.get_namespace().strip('/')
        return BodyWriter(robot, space or robot.name)

    def publish_markers(self) -> None:
        """Publish the planner's view of the world, if somebody listens."""
        posture, planner = self._loop.supervisor.posture, self._loop.planner
        if posture is None or not self._markers.get_subscription_count():
            return
        result, reference = self._loop.state.result, planner.reference
        self._markers.publish(self._robot_markers.message(
            planner.robot, planner.robot.kinematics(posture), self._loop.obstacles.scene,
            result.nearest if result is not None else None,
            reference.position if reference is not None else None))


def _margin_of(planner: Planner | PaperPlanner) -> float:
    """Return the margin that a planner's distances are beyond [m]; the paper's method has none."""
    return planner.margin if isinstance(planner, Planner) else 0.0
