"""planner_node: cmd_vel, joint_states and obstacles in, joint_command out at a fixed rate."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, TwistStamped
import numpy as np
import numpy.typing as npt
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from redundant_planner.core.errors import known, PlannerError, StateError
from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.safety.limits import braked
from redundant_planner.core.safety.stopping import has_jumped, PositionCommand
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.obstacle_tracker import checked, ObstacleTracker
from redundant_planner.io.parameter_files import obstacle_of, RobotParameters, urdf_text
from redundant_planner.io.recorded_tick import RecordedTick, TickKind
from redundant_planner.io.robot_files import (
    build_robot,
    joints_to_measure,
    locked_at,
    parameter_file_text,
)
from redundant_planner.nodes import runtime
from redundant_planner.nodes.command_input import CommandInput, sender_names
from redundant_planner.nodes.command_output import CommandOutput
from redundant_planner.nodes.command_pacer import CommandPacer, wake_up_in_time
from redundant_planner.nodes.guard import line_of
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.last_word import (
    ACKNOWLEDGED,
    Brief,
    LastWord,
    PAUSE,
    READY,
    STARTING,
    STOPS,
    SUFFIX,
)
from redundant_planner.nodes.messages import NANOSECONDS
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.ros_parameters import (
    CAPSULE,
    declare,
    declare_entries,
    on_change,
    STATIC_OBSTACLE,
    unknown_parameters,
)
from redundant_planner.nodes.state_report import diagnostics, LoopState, RobotMarkers, status_of
from redundant_planner.nodes.transforms import transform_lookup
from redundant_planner.paper.method import PaperPlanner, planner_of

Array = npt.NDArray[np.float64]

# Warnings that a stream of bad messages would repeat are said this often at most [s].
_WARN_PERIOD = 1.0
_KINDS = 100
# How often the node looks for rivals on its topics, and for how long before it first moves [s].
_LOOK_AROUND = 0.5
_FIRST_LOOK = 1.0
# An arm that moves further than that while the node looks around is somebody else's [rad, m].
_MOVED = 5e-3
# A tick that comes this much after the one before it must not go on where that left off [s].
_GAP = 1.0
# Of messages about obstacles, one is taken in after each tick, and more in this share of the
# period; so many may wait, as many as a subscriber of that depth would keep.
_OBSTACLE_SHARE = 0.1
_OBSTACLE_MESSAGES = 100
# How long changed parameters wait for others to be published with [s].
_CONFIGURATION_PAUSE = 0.25
# Period of /diagnostics and of ~/markers [s].
_REPORT_PERIOD = 0.2
# Positions that jump by more than this beyond what the arm can travel, or that are further than
# this from what was commanded, start everything again from the measured posture [rad, m].
_JUMP = 0.1


class PlannerNode(runtime.EndableNode):
    """Runs `Planner.step` on the latest inputs at a fixed rate.

    Whatever is not needed for the command of a tick is done after that command is out. A tick
    that is due comes first, whatever else has arrived.
    """

    _runs = False  # whether the loop has started

    def __init__(self, last_word: LastWord | None = None) -> None:
        """Read all parameters; the loop starts once the robot is known.

        Args:
            last_word: stops the arm should this process die; None to go without.

        Raises:
            PlannerError: a parameter is wrong.
        """
        super().__init__('planner_node')
        self._last_word = last_word or LastWord.absent('not asked for')
        self._robot_parameters = declare(self, RobotParameters)
        self._planner_parameters = declare(self, PlannerParameters)
        self._settings = declare(self, PlannerNodeParameters)
        self._capsules = declare_entries(
            self, 'capsule', self._robot_parameters.capsules, CAPSULE)
        self._static = declare_entries(
            self, 'static_obstacle', self._settings.static_obstacles, STATIC_OBSTACLE,
            runtime=True)
        for sentence in unknown_parameters(self):
            self.get_logger().warning(sentence)
        static = [obstacle_of(name, entry) for name, entry in self._static.items()]

        # The system's own clocks, rclpy's take a hundred times as long to read.
        self._loop_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._now: Callable[[], float] = time.monotonic
        self._stamp: Callable[[], int] = time.time_ns
        if self.get_parameter('use_sim_time').value:
            clock = self._loop_clock = self.get_clock()
            self._now = lambda: float(clock.now().nanoseconds / NANOSECONDS)
            self._stamp = lambda: int(clock.now().nanoseconds)
        self._planner: Planner | PaperPlanner | None = None
        self._state = LoopState()
        self._q: Array | None = None
        self._q_time = -np.inf
        # The last command; None while the arm rests and the node is silent.
        self._dq: Array | None = None
        self._restart = ''
        self._failure = ''  # what broke the loop, until a reset
        self._reset_asked = False
        self._paused = False
        self._ready = np.inf
        self._found: Array = np.empty(0)  # where the arm was while nobody moved it
        self._last_tick = -np.inf
        self._rivals: dict[str, list[str]] = {}
        self._raw_obstacles: deque[bytes] = deque()
        self._obstacle_time = -np.inf
        self._applied = 0
        self._reason = ''
        self._said: dict[str, float] = {}
        self._period = 1.0 / self._settings.rate
        self._beat = CommandPacer(self._period)
        self._ahead = False  # whether a tick has run before the timer asked for it
        self._out = False  # whether this tick's command is out
        self._no_time = ''  # why the loop's clock stands still

        # What is listened to only until the first command.
        self._at_first: list[Subscription] = []
        urdf = urdf_text(self._robot_parameters)
        if urdf:
            self._begin(urdf, static)
        else:
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._description = self.create_subscription(
                String, 'robot_description',
                lambda message: self._on_robot_description(message, static), latched)
            self.get_logger().info('waiting for a URDF on the topic robot_description')

    def _on_robot_description(self, message: String, static: list[Any]) -> None:
        if self._planner is not None or self._at_first:
            return
        try:
            self._begin(message.data, static)
        except PlannerError as error:
            self.get_logger().error(f'robot_description: {error}')

    def _begin(self, urdf: str, static: list[Any]) -> None:
        """Start, once the joints that are to be held where they are have been seen."""
        missing = set(joints_to_measure(self._robot_parameters, urdf))
        if not missing:
            self._start(urdf, static)
            return
        seen: dict[str, float] = {}

        def look(message: JointState) -> None:
            if self._planner is not None:
                return
            seen.update((name, position) for name, position in zip(message.name, message.position)
                        if name in missing and np.isfinite(position))
            if len(seen) < len(missing):
                self._warn('joint_states lacks joints that lock_where_measured waits for: '
                           f'{known(sorted(missing - set(seen)))}')
                return
            self._robot_parameters = locked_at(self._robot_parameters, seen)
            self.get_logger().info('held where they are: ' + ', '.join(
                f'{name} at {position:g}' for name, position in seen.items()))
            try:
                self._start(urdf, static)
            except PlannerError as error:
                self.get_logger().error(str(error))

        self._at_first.append(self.create_subscription(
            JointState, 'joint_states', look, qos_profile_sensor_data))

    def _start(self, urdf: str, static: list[Any]) -> None:
        robot = build_robot(
            self._robot_parameters, urdf, self._capsules, say=self.get_logger().info,
            warn=self.get_logger().warning)
        self._planner = planner_of(robot, self._planner_parameters)
        self._position_command = PositionCommand(
            robot.position_min, robot.position_max, _JUMP)
        self._obstacles = ObstacleTracker(
            static, sorted({robot.base_frame, ''}),
            transform=transform_lookup(self, robot.base_frame),
            estimate_velocity=self._settings.estimate_obstacle_velocity)
        self._command = CommandInput(
            {robot.base_frame: 'base', robot.tip_frame: 'tool'}, robot.command_frame, self._now,
            lambda: self.get_clock().now().nanoseconds / NANOSECONDS, self._warn)
        self._command.timeout = self._settings.incoming_command_timeout
        self._joints = JointReader(robot.joint_names)
        self._output = CommandOutput(
            self, robot.joint_names, self._settings.outputs, self._period)
        self._last_word.brief(self._brief(robot))
        self._subscribe()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._configuration = self.create_publisher(String, '~/configuration', latched)
        self._unpublished = True  # whether parameters have changed since the last publication
        self._publish_configuration()
        # Latched, too: a recorder that comes late still gets the beginning.
        history = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._ticks = (self.create_publisher(Float64MultiArray, '~/ticks', history)
                       if self._settings.publish_ticks else None)
        # Before it speaks itself, whatever it hears on its own topic is somebody else's.
        self._at_first.append(self.create_subscription(
            JointState, 'joint_command', self._on_foreign_command, qos_profile_sensor_data,
            raw=True))
        self._report_state()
        on_change(self, lambda: (self._planner_parameters, self._settings), self._apply,
                  'static_obstacle', STATIC_OBSTACLE)
        wake_up_in_time()
        self._runs = True
        self.create_timer(self._period, self._on_timer, clock=self._loop_clock)
        if self._now is not time.monotonic:
            self.create_timer(self._period, self._while_time_stands,
                              clock=Clock(clock_type=ClockType.STEADY_TIME))
        if not runtime.request_priority(self._settings.thread_priority):
            self.get_logger().info(
                'no real-time priority: the system does not grant it (see README, timing)')
        self.get_logger().info(
            f"planning for '{robot.name}' from {robot.base_frame} to {robot.tip_frame} at "
            f'{self._settings.rate} Hz; joints: {", ".join(robot.joint_names)}')

    def _brief(self, robot: Robot) -> Brief:
        """Return what somebody must know who speaks in this node's place."""
        outputs = self._settings.outputs
        return Brief(
            self.get_name(), self.get_namespace(),
            {name: self.resolve_topic_name(name) for name in ('joint_command', *outputs)},
            outputs, robot.joint_names, robot.position_min.tolist(), robot.position_max.tolist(),
            robot.acceleration_max.tolist(), self._period, self._settings.thread_priority)

    def _subscribe(self) -> None:
        command, stamped = self._command, self._settings.enable_stamped_cmd_vel
        # Fetched by the tick: other callbacks that wait do not make them old.
        self._inboxes: list[tuple[PolledSubscription, Callable[[bytes], None]]] = [
            (PolledSubscription(self, JointState, 'joint_states'), self._on_joint_state),
            (PolledSubscription(self, TwistStamped if stamped else Twist, 'cmd_vel'),
             command.on_twist_stamped if stamped else command.on_twist)]
        self.create_subscription(
            MultiDOFJointTrajectory, 'cmd_vel_preview', command.on_preview, 1, raw=True)
        self.create_subscription(
            MarkerArray, 'obstacles', self._on_obstacles, 10, raw=True)
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.create_service(Trigger, '~/reset', self._on_reset)

    def _report_state(self) -> None:
        """Begin to report; each report has its own moment in the ticks to come."""
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._markers = self.create_publisher(MarkerArray, '~/markers', 1)
        self._robot_markers = RobotMarkers(self.robot)
        self._chores: list[tuple[float, Callable[[], None]]] = [
            (_LOOK_AROUND, self._look_around),
            (_CONFIGURATION_PAUSE, self._publish_configuration),
            (_REPORT_PERIOD, self._publish_diagnostics),
            (_REPORT_PERIOD, self._publish_markers)]
        self._due = [0.0] * len(self._chores)

    @property
    def robot(self) -> Robot:
        """The robot; known once the loop runs."""
        assert self._planner is not None
        return self._planner.robot

    def _apply(
        self, planner: PlannerParameters, settings: PlannerNodeParameters,
        others: dict[tuple[str, str], Any],
    ) -> None:
        """Take new settings; raises PlannerError before anything has changed."""
        assert self._planner is not None
        entries = {name: dict(entry) for name, entry in self._static.items()}
        for (name, key), value in others.items():
            entries[name][key] = value
        static = checked(obstacle_of(name, entry) for name, entry in entries.items())
        self._planner.parameters = planner
        self._static, self._obstacles.static = entries, static
        self._obstacles.estimate_velocity = settings.estimate_obstacle_velocity
        self._command.timeout = settings.incoming_command_timeout
        self._planner_parameters, self._settings = planner, settings
        self._unpublished = True

    def _publish_configuration(self) -> None:
        """Say all parameters where they have changed, so that a bag explains itself."""
        if not self._unpublished:
            return
        self._unpublished = False
        self._configuration.publish(String(data=parameter_file_text(
            self._robot_parameters, self.robot, self._static, self._planner_parameters,
            self._settings)))

    def _on_joint_state(self, message: bytes) -> None:
        now = self._tick_time
        try:
            q = self._joints.positions(message)
        except StateError as error:
            self._warn(f'joint_states ignored: {error}')
            return
        if self._q is None:
            # Others are found at about the same time as the arm.
            self._ready, self._found = now + _FIRST_LOOK, q
        elif now < self._ready and np.abs(q - self._found).max() > _MOVED:
            # Somebody else moves it, whom the middleware has perhaps not shown to us yet.
            self._ready, self._found = now + _FIRST_LOOK, q
        elif has_jumped(
                self._q, q, self.robot.velocity_max, now - self._q_time,
                _JUMP):
            self._restart = 'joint_states jumped: the motion starts again from where the arm is'
        self._q, self._q_time = q, now

    def _on_obstacles(self, message: bytes) -> None:
        """Keep a message until a tick's command is out."""
        if len(self._raw_obstacles) == _OBSTACLE_MESSAGES:
            self._raw_obstacles.popleft()
            self._applied += 1
            self._warn('obstacles come faster than they can be taken in: the oldest message of '
                       f'{_OBSTACLE_MESSAGES} was dropped')
        self._raw_obstacles.append(message)

    def _on_foreign_command(self, message: bytes) -> None:
        if self._at_first:
            self._ready = self._now() + _FIRST_LOOK

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._paused = bool(request.data)
        response.success = True
        response.message = ('paused: the arm comes to rest and is left to others' if self._paused
                            else 'resumed from where the arm is')
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._restart = 'reset: the motion starts again from where the arm is'
        self._reset_asked = bool(self._failure)
        response.success, response.message = True, self._restart
        return response

    def go_first(self) -> None:
        """Run the tick if it is due: no queue of other callbacks delays it by more than one."""
        if self._runs and self._beat.is_due(time.monotonic()):
            self._ahead = True
            self._tick()

    def _on_timer(self) -> None:
        """Run the tick, unless `go_first` has."""
        ahead, self._ahead = self._ahead, False
        if not ahead or self._beat.is_due(time.monotonic()):
            self._tick()

    def _tick(self) -> None:
        """Command the arm once; an exception that nobody foresaw brings it to rest."""
        begin = time.perf_counter()
        messages = [(inbox.topic, take, message) for inbox, take in self._inboxes
                    for message in self.guard.call(f'reading {inbox.topic}', inbox.fetch) or ()]
        now = self._tick_time = self._now()
        if self._now is time.monotonic:  # simulated time does not pass while a callback waits
            self._beat.begin(now)
        self._out, self._no_time = False, ''
        for topic, take, message in messages:
            try:
                take(message)
            except Exception as error:
                self.guard.caught(f'reading {topic}', error)
        try:
            if self._reset_asked and self._dq is None:
                self._start_anew()
            if not self._failure:
                self._plan_or_hold(now)
        except Exception as error:
            self.guard.caught('the tick', error)
            self._failure = f'fault in the tick: {line_of(error)}; ~/reset goes on from there'
        if self._failure:
            self.guard.call('braking', self._brake_after_failure)
        self._last_tick = now
        elapsed = time.perf_counter() - begin - self._beat.waited
        self._state.tick_times.append(elapsed)
        self._state.overruns += elapsed > self._period
        self._after_the_tick()

    def _plan_or_hold(self, now: float) -> None:
        hold = self._reason_to_hold(now)
        if hold:
            self._come_to_rest()
        else:
            self._move(now)
        self._state.hold = hold

    def _brake_after_failure(self) -> None:
        """Slow down from the last command; a later tick tries again where this one fails."""
        self._state.hold, self._state.fault = self._failure, True
        if not self._out:
            self._come_to_rest()

    def _start_anew(self) -> None:
        """Forget all about the motion, be it what broke the loop: a reset, at rest."""
        self._reset_asked = False
        self._planner = planner_of(self.robot, self._planner_parameters)
        self._position_command.reset()
        self._command.forget()
        self._command.forget_preview()
        self._failure = self._reason = ''
        self._state.result = None

    def _while_time_stands(self) -> None:
        """Bring the arm to rest, by the system's clock, where the loop's own has been refused."""
        if self._no_time:
            self._state.hold, self._state.fault = self._no_time, True
            self._come_to_rest()
            self._do_chores(time.monotonic())

    def refuse_time(self, reason: str) -> None:
        """Stop: without time there are no ticks."""
        self._warn(reason)
        self._no_time = reason

    def _reason_to_hold(self, now: float) -> str:
        """Say why the arm must rest; empty if it may move."""
        self._state.fault = True
        if self._q is None or now < self._ready:
            self._state.fault = False
            return 'waiting for joint_states' if self._q is None else (
                'looking whether somebody else commands this arm')
        while self._at_first:
            self.destroy_subscription(self._at_first.pop())
        timeout = self._settings.joint_state_timeout
        if now - self._q_time > timeout:
            self._warn(f'no usable joint_states for {timeout:g} s: stopped')
            return f'no usable joint_states for {now - self._q_time:.1f} s'
        if np.isfinite(self._last_tick) and not 0.0 <= now - self._last_tick <= _GAP:
            self._restart = (f'the clock jumped by {now - self._last_tick:.3f} s: the motion '
                             'starts again')
            self._command.forget_preview()
        if self._restart and self._dq is not None:
            self._warn(self._restart)
            return self._restart
        self._restart = ''
        rivals = self._rivals.get('joint_command', ())
        if len(rivals) > 1:
            self._warn(f'joint_command has {len(rivals)} publishers: {", ".join(rivals)}; '
                       'stopped until only one is left')
            return f'joint_command has {len(rivals)} publishers: {", ".join(rivals)}'
        self._state.fault = False
        return 'paused' if self._paused else ''

    def _come_to_rest(self) -> None:
        """Brake as the acceleration limits allow; at rest, forget where the motion was going."""
        if self._dq is None:
            return
        dq = braked(self._dq, self.robot.acceleration_max, self._period)
        self._publish(dq, known=False)
        if not dq.any():
            self._dq = None
            self._command.forget()
        self._record_tick(TickKind.BRAKING, np.zeros(6), None)

    def _move(self, now: float) -> None:
        planner, q = self._planner, self._q
        assert planner is not None and q is not None
        kind = TickKind.GOING_ON
        if self._dq is None:
            kind = TickKind.STARTING
            planner.reset()
            self._position_command.reset()
        rivals = self._rivals.get('cmd_vel', ())
        self._state.trouble = ''
        timeout = self._settings.incoming_command_timeout
        twist, ahead = self._command.twist(timeout), self._command.ahead(timeout)
        if len(rivals) > 1:
            twist, ahead = np.zeros(6), None
            self._state.trouble = (f'cmd_vel has {len(rivals)} publishers, which are not mixed: '
                                   f'{", ".join(rivals)}; stop all but one, or use twist_mux')
            self._warn(self._state.trouble)
        elif twist.any():
            twist = self._in_command_frame(twist, q)
        self._obstacles.expire(now)
        result = planner.step(q, twist, self._obstacles.scene, self._period, ahead)
        if not np.isfinite(result.dq).all():
            raise ArithmeticError(f'the planner asked for the velocities {result.dq.tolist()}')
        self._publish(result.dq)
        self._record_tick(kind, twist, ahead)
        if result.reason and not self._reason:
            self._warn(result.reason)
        self._reason = result.reason
        self._state.result = result

    def _in_command_frame(self, twist: Array, q: Array) -> Array:
        if self._command.frame == self.robot.command_frame:
            return twist
        rotation = self.robot.kinematics(q).tip_rotation
        return se3.turned(twist, rotation if self._command.frame == 'tool' else rotation.T)

    def _publish(self, dq: Array, *, known: bool = True) -> None:
        assert self._q is not None
        positions = self._position_command.advance(self._q, dq, self._period, known=known)
        self._beat.wait()
        self._stamp_ns = self._stamp()
        self._last_word.note(self._stamp_ns, positions, dq)
        self._output.publish(self._stamp_ns, positions, dq)
        self._dq, self._out = dq, True

    def _record_tick(self, kind: TickKind, twist: Array, ahead: TwistAhead | None) -> None:
        if self._ticks is None:
            return
        assert self._q is not None
        elapsed = self._command.preview_elapsed() if ahead is not None else np.nan
        self._ticks.publish(Float64MultiArray(data=RecordedTick(
            self._stamp_ns, self._tick_time, kind, self._applied, self._command.previews,
            elapsed, twist, self._q).numbers()))

    def _after_the_tick(self) -> None:
        """Take in obstacles, and do at most one of the chores that are due.

        Where obstacles came in, chores wait for another tick, but not for ever.
        """
        now, busy = self._tick_time, bool(self._raw_obstacles)
        if busy:
            self.guard.call('taking in obstacles', self._take_in_obstacles)
        if now < self._ready <= now + 2.0 * self._period:
            self.guard.call('looking around', self._look_around)
        self._do_chores(now, busy)

    def _do_chores(self, now: float, busy: bool = False) -> None:
        for i, (period, chore) in enumerate(self._chores):
            patience = period if busy else 0.0
            if now >= self._due[i] + patience or self._due[i] > now + period:
                self._due[i] = now + period
                self.guard.call('the work after a tick', chore)
                return

    def _take_in_obstacles(self) -> None:
        """Take in the messages that have waited longest, one at least, as time allows."""
        now = self._obstacle_time = self._tick_time
        enough = time.perf_counter() + _OBSTACLE_SHARE * self._period
        while self._raw_obstacles:
            self._applied += 1
            message = self._raw_obstacles.popleft()
            try:
                for problem in self._obstacles.update(message, now):
                    self._warn(f'{problem}; ignored')
            except Exception as error:
                self.guard.caught("a message on 'obstacles'", error)
            if time.perf_counter() > enough:
                break
        assert self._planner is not None
        self._planner.prepare(self._obstacles.scene)

    def _look_around(self) -> None:
        """See who else commands this arm."""
        for topic in ('cmd_vel', 'joint_command'):
            name = self.resolve_topic_name(topic)
            self._rivals[topic] = sender_names([
                publisher for publisher in self.get_publishers_info_by_topic(name)
                if not publisher.node_name.endswith(SUFFIX)])
        before = self._state.last_word
        self._state.last_word = self._last_word.state(self._output.listeners())
        if self._state.last_word not in (before, READY, STARTING):
            self._warn(f'without a last word: {self._state.last_word}; if this process died in '
                       'motion, its last command would stand')

    def _publish_diagnostics(self) -> None:
        state, now = self._state, self._now()
        state.joint_state_age = now - self._q_time
        state.command_age = self._command.age()
        state.obstacle_age = now - self._obstacle_time
        state.faults, state.last_fault = self.guard.count, self.guard.last
        status = status_of(
            self.get_fully_qualified_name(), self.robot, state, self._q,
            self._planner_parameters.method, len(self._obstacles.scene.names))
        self._diagnostics.publish(diagnostics(status, self.get_clock().now().to_msg()))
        state.tick_times.clear()

    def _publish_markers(self) -> None:
        if self._q is None or not self._markers.get_subscription_count():
            return
        assert self._planner is not None
        result, reference = self._state.result, self._planner.reference
        self._markers.publish(self._robot_markers.message(
            self.robot.kinematics(self._q), self._obstacles.scene,
            result.nearest if result is not None else None,
            reference.position if reference is not None else None))

    def finish(self) -> None:
        """Bring the arm to rest and leave it with a stop as its last command.

        Destroyed at once, a publisher takes messages with it that are still on their way;
        best-effort listeners do not acknowledge and are told more than once. Where this fails,
        the other process has the last word.
        """
        if self._runs:
            self.guard.call('publishing the configuration', self._publish_configuration)
        try:
            self._stop()
        except Exception:
            self._last_word.hand_over()
            raise
        self._last_word.end()

    def _stop(self) -> None:
        if self._dq is None:
            return
        while self._dq is not None:
            self._come_to_rest()
            time.sleep(self._period)
        for _ in range(STOPS):
            self._publish(np.zeros(self.robot.n), known=False)
            self._record_tick(TickKind.BRAKING, np.zeros(6), None)
            time.sleep(PAUSE)
        self._output.wait_until_heard(ACKNOWLEDGED)

    def _warn(self, text: str) -> None:
        """Say what is wrong, the same thing once in a while only."""
        kind, now = text.partition(':')[0], time.monotonic()
        if now - self._said.get(kind, -np.inf) > _WARN_PERIOD:
            if len(self._said) > _KINDS:
                self._said.clear()
            self._said[kind] = now
            self.get_logger().warning(text)


def main(args: list[str] | None = None) -> int:
    """Run planner_node."""
    last_word = LastWord.stand_by(args)
    return runtime.run(lambda: PlannerNode(last_word), 'planner_node', args)


if __name__ == '__main__':
    raise SystemExit(main())
