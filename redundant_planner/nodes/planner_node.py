"""planner_node: cmd_vel, joint_states and obstacles in, joint_command out at a fixed rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
import time
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.mobile_base import BASE_CMD_VEL
from redundant_planner.io.node_parameters import (
    JOINT_COMMAND,
    JOINT_TRAJECTORY,
    PlannerNodeParameters,
    POSITION_COMMANDS,
)
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.payload import Payload
from redundant_planner.io.tip_topics import OBJECT
from redundant_planner.nodes import runtime
from redundant_planner.nodes.chores import Chores
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.command_output import CommandOutput, NEVER_ENDING
from redundant_planner.nodes.command_pacer import wake_up_in_time
from redundant_planner.nodes.control_loop import ControlLoop
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.inboxes import inboxes_of
from redundant_planner.nodes.last_word import LastWord
from redundant_planner.nodes.loop_clock import loop_clock
from redundant_planner.nodes.messages import NANOSECONDS
from redundant_planner.nodes.obstacle_input import ObstacleInput
from redundant_planner.nodes.reports import Reports
from redundant_planner.nodes.ros_parameters import on_change, STATIC_OBSTACLE
from redundant_planner.nodes.second_process import Brief
from redundant_planner.nodes.settings import Settings
from redundant_planner.nodes.startup import Startup
from redundant_planner.nodes.throttled_log import ThrottledLog
from redundant_planner.nodes.tick_phase import delay_to_middle
from redundant_planner.nodes.tip_commands import TipCommands
from redundant_planner.nodes.topic_watch import TopicWatch
from redundant_planner.nodes.transforms import transform_lookup
from redundant_planner.paper.method import PaperPlanner, planner_of

# How often the node looks for other publishers on its topics [s].
_LOOK_AROUND = 0.5
# How long changed parameters wait for others, so that one message has them all [s].
_CONFIGURATION_PAUSE = 0.25
# Period of /diagnostics and of ~/markers [s].
_REPORT_PERIOD = 0.2
# Period of ~/target while there is a target, and of the pose of what tips hold together [s].
_PROGRESS_PERIOD = 0.05
# Period of ~/body while somebody listens [s].
_BODY_PERIOD = 0.02


class PlannerNode(EndableNode):
    """Connects topics, services and parameters to the control loop, once the robot is known.

    A tick that is due comes first: `go_first` runs it ahead of any other callback.
    """

    def __init__(self, last_word: LastWord | None = None) -> None:
        """Read all parameters; the loop starts once the robot is known.

        Args:
            last_word: stops the arm should this process die; None to go without.

        Raises:
            PlannerError: a parameter is wrong.
        """
        # First, as rclpy's constructor already calls `go_first`.
        self.loop: ControlLoop | None = None
        self._reports: Reports | None = None
        self._topic_watch: TopicWatch | None = None
        self._ticked_ahead = False  # whether a tick has run before the timer asked for it
        super().__init__('planner_node')
        self._last_word = last_word or LastWord.absent('not asked for')
        self._warn = ThrottledLog(self.get_logger().warning)
        self._chores = Chores(self.guard)
        self._settings = Settings.declared(self)
        self._settings.obstacles()  # refused now rather than when the robot is known
        self._startup: Startup | None = Startup(
            self, self._settings.robot, self._settings.capsules, self._warn, self._start)
        self._startup.begin()

    def _start(self, robot: Robot, parameters: RobotParameters) -> None:
        """Begin to plan for a robot that was built with these parameters."""
        planner = planner_of(robot, self._settings.planner)
        self._settings = replace(self._settings, robot=parameters)
        self._last_word.brief(self._brief(robot))
        loop = self._make_loop(planner)
        self._connect(loop)
        self._topic_watch = TopicWatch(self, loop, self._last_word, self._warn)
        self._reports = self._add_chores(loop)
        self._reports.publish_configuration()
        on_change(self, lambda: (self._settings.planner, self._settings.node), self._apply,
                  'static_obstacle', STATIC_OBSTACLE)
        self._run(loop)
        self.get_logger().info(
            f"planning for '{robot.name}' from {robot.base_frame} to {' and '.join(robot.tips)} "
            f'at {self._settings.node.rate} Hz; joints: {", ".join(robot.joint_names)}')

    def _brief(self, robot: Robot) -> Brief:
        """Return what the second process must know to stop the arm in this node's place."""
        settings = self._settings.node
        outputs = [name for name in settings.outputs if name in NEVER_ENDING]
        return Brief(
            self.get_name(), self.get_namespace(),
            self._topics((JOINT_COMMAND, BASE_CMD_VEL, *outputs)),
            outputs, robot.joint_names, robot.position_min.tolist(),
            robot.position_max.tolist(), robot.acceleration_max.tolist(),
            robot.jerk_max.tolist(), 1.0 / settings.rate, settings.thread_priority)

    def _topics(self, outputs: Sequence[str]) -> dict[str, str]:
        """Return output → topic that it is published on."""
        return {name: self.resolve_topic_name(name) for name in outputs}

    def _make_loop(self, planner: Planner | PaperPlanner) -> ControlLoop:
        """Return the loop with its inputs and its output."""
        robot, settings, clock = planner.robot, self._settings.node, loop_clock(self)
        period = 1.0 / settings.rate
        transform = transform_lookup(self, robot.base_frame)
        topics = settings.obstacle_topics
        tracker = ObstacleSources.of(
            len(topics), self._settings.obstacles(), sorted({robot.base_frame, ''}),
            transform=transform, estimate_velocity=settings.estimate_obstacle_velocity)

        def commands_of(tip: str) -> CommandInput:
            return CommandInput({robot.base_frame: 'base', tip: 'tool'}, robot.command_frame,
                                clock.now, clock.ros_time, self._warn, transform)

        command = commands_of(robot.tip_frame) if len(robot.tips) == 1 else TipCommands(
            {tip: commands_of(tip) for tip in robot.tips}, commands_of(OBJECT),
            commands_of(robot.tip_frame), self._warn)
        command.timeout = settings.incoming_command_timeout
        # Latched: a recorder that comes late still gets the beginning.
        history = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        ticks = (self.create_publisher(Float64MultiArray, '~/ticks', history)
                 if settings.publish_ticks else None)
        return ControlLoop(
            planner, settings, clock=clock, command=command,
            obstacles=ObstacleInput(topics, tracker, period, self.guard, self._warn),
            attached=Payload(robot),
            output=CommandOutput(
                self, robot.joint_names, settings.outputs, period, robot.position_min,
                robot.position_max),
            last_word=self._last_word, guard=self.guard, warn=self._warn, publish_tick=None
            if ticks is None else lambda row: ticks.publish(Float64MultiArray(data=row)))

    def _connect(self, loop: ControlLoop) -> None:
        """Subscribe to the inputs and offer the services."""
        # Each tick fetches these: they do not age while other callbacks run.
        loop.inboxes = inboxes_of(
            self, loop, self._warn, on_base=bool(self._settings.robot.base),
            stamped=self._settings.node.enable_stamped_cmd_vel)
        if isinstance(loop.command, CommandInput):
            self.create_subscription(
                MultiDOFJointTrajectory, 'cmd_vel_preview', loop.command.on_preview, 1, raw=True)
        for i, topic in enumerate(self._settings.node.obstacle_topics):
            self.create_subscription(
                MarkerArray, topic, partial(loop.obstacles.on_message, topic=i), 10, raw=True)
        self.create_subscription(
            MarkerArray, 'attached', loop.attached.on_message, 10, raw=True)
        self.create_subscription(JointState, '~/posture', self._on_posture, 10)
        assert self._startup is not None
        self._startup.listen_for_commands(
            lambda raw: loop.supervisor.heard_a_command(loop.clock.now()))

        def on_pause(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
            response.success, response.message = True, loop.supervisor.pause(bool(request.data))
            return response

        def on_reset(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = True, loop.supervisor.reset()
            return response

        def on_couple(request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
            response.success, response.message = loop.coupling.ask(
                bool(request.data), loop.velocity, loop.supervisor.posture)
            return response

        self.create_service(SetBool, '~/pause', on_pause)
        self.create_service(SetBool, '~/couple', on_couple)
        self.create_service(Trigger, '~/reset', on_reset)

    def _add_chores(self, loop: ControlLoop) -> Reports:
        """Plan the work between ticks; return the reports, which are a part of it."""
        reports = Reports(self, loop, lambda: self._settings)
        self._chores.add(_LOOK_AROUND, self._look_around)
        self._chores.add(_CONFIGURATION_PAUSE, reports.publish_configuration)
        self._chores.add(_BODY_PERIOD, reports.publish_body)
        self._chores.add(_REPORT_PERIOD, reports.publish_diagnostics)
        self._chores.add(_REPORT_PERIOD, reports.publish_markers)
        self._chores.add(_PROGRESS_PERIOD, reports.publish_progress)
        self._chores.add(_PROGRESS_PERIOD, reports.publish_object)
        return reports

    def _run(self, loop: ControlLoop) -> None:
        """Start the loop's timer."""
        settings = self._settings.node
        wake_up_in_time()
        self.loop = loop
        self._timer = self.create_timer(
            1.0 / settings.rate, self._on_timer, clock=loop.clock.timers)
        if loop.clock.simulated:
            self.create_timer(1.0 / settings.rate, self._while_time_stands,
                              clock=Clock(clock_type=ClockType.STEADY_TIME))
        if not loop.clock.simulated and not runtime.request_priority(settings.thread_priority):
            self.get_logger().info(
                'no real-time priority: the system does not grant it (see README, timing)')

    def _on_posture(self, message: JointState) -> None:
        """Set posture.preferred; a message without names takes all of it back."""
        if len(message.name) != len(message.position):
            self._warn(f'posture ignored: it has {len(message.name)} names and '
                       f'{len(message.position)} positions; it takes one for each')
            return
        entries = [f'{name}={position!r}'
                   for name, position in zip(message.name, message.position)]
        answer, = self.set_parameters([Parameter(
            'posture.preferred', Parameter.Type.STRING_ARRAY, entries)])
        if not answer.successful:
            self._warn(f'posture ignored: {answer.reason}')

    def _apply(
        self, planner: PlannerParameters, node: PlannerNodeParameters,
        entries: Mapping[tuple[str, str], Any],
    ) -> None:
        """Take new settings; raises PlannerError before anything has changed."""
        assert self.loop is not None
        settings = self._settings.changed(planner, node, entries)
        static = settings.obstacles()
        self.loop.planner.parameters = planner
        self.loop.settings = node
        self.loop.command.timeout = node.incoming_command_timeout
        self.loop.obstacles.tracker.keep(
            static, estimate_velocity=node.estimate_obstacle_velocity)
        self._settings = settings

    def go_first(self) -> None:
        """Run the tick if it is due: no queue of other callbacks delays it by more than one."""
        if self.loop is not None and self.loop.pacer.is_due(time.monotonic()):
            self._ticked_ahead = True
            self._tick(self.loop)

    def _on_timer(self) -> None:
        """Run the tick, unless `go_first` has."""
        assert self.loop is not None
        ahead, self._ticked_ahead = self._ticked_ahead, False
        if not ahead or self.loop.pacer.is_due(time.monotonic()):
            self._tick(self.loop)

    def _tick(self, loop: ControlLoop) -> None:
        """Run a tick, then work that could wait."""
        busy = loop.tick()
        if self._startup is not None and not loop.supervisor.listening:
            self.guard.call('the end of the start', self._startup.close)
            self._startup = None
        if loop.supervisor.first_motion_within(loop.now, 2.0 / self._settings.node.rate):
            self.guard.call('looking around', self._look_around)
        self._chores.do_one(loop.now, busy)

    def _while_time_stands(self) -> None:
        """Brake by the system's clock after the loop's own was refused."""
        if self.loop is not None and self.loop.brake_without_time():
            self._chores.do_one(time.monotonic())

    def refuse_time(self, reason: str) -> None:
        """Stop the arm: without time there are no ticks."""
        if self.loop is None:
            self._warn(reason)
        else:
            self.loop.refuse_time(reason)

    def _look_around(self) -> None:
        """See who publishes on this node's topics, who listens, and if its last word is sure."""
        assert self.loop is not None and self._topic_watch is not None
        if self.loop.at_rest:
            self._move_ticks(self.loop)
        self._topic_watch.look()

    def _move_ticks(self, loop: ControlLoop) -> None:
        """Have commands fall half way between measurements, where a controller takes positions.

        Only at rest: in motion one period would be longer.
        """
        outputs = set(self._settings.node.outputs)
        if loop.clock.simulated or not outputs.intersection((POSITION_COMMANDS, JOINT_TRAJECTORY)):
            return
        clocks_apart = time.time() - time.monotonic()
        delay = delay_to_middle(
            [ns / NANOSECONDS - clocks_apart for ns in loop.joints.sent_ns], loop.pacer.due,
            1.0 / self._settings.node.rate)
        if delay > 0.0:
            loop.pacer.move(delay)
            self._timer.reset()

    def finish(self) -> None:
        """Bring the arm to rest; if that fails, the other process does."""
        if self._reports is not None:
            self.guard.call('publishing the configuration', self._reports.publish_configuration)
        try:
            if self.loop is not None:
                self.loop.finish()
        except Exception:
            self._last_word.hand_over()
            raise
        self._last_word.end()


def main(args: list[str] | None = None) -> int:
    """Run planner_node."""
    last_word = LastWord.stand_by(args)
    return runtime.run(lambda: PlannerNode(last_word), 'planner_node', args)


if __name__ == '__main__':
    raise SystemExit(main())
