"""The control loop: each tick reads, decides, moves or brakes the arm, and publishes."""

from __future__ import annotations

import array
from collections import deque
from collections.abc import Callable
from operator import itemgetter
import time

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import limits_of
from redundant_planner.core.errors import ObstacleError, StateError
from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.core.safety.following import Following
from redundant_planner.core.safety.jerk import SmoothStop
from redundant_planner.core.safety.position_command import PositionCommand
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Target, TipTargets
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.payload import Payload
from redundant_planner.io.recorded_tick import RecordedTick, TickKind
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.command_output import CommandOutput
from redundant_planner.nodes.command_pacer import CommandPacer
from redundant_planner.nodes.guard import Guard, line_of
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.last_word import LastWord
from redundant_planner.nodes.loop_clock import LoopClock
from redundant_planner.nodes.messages import base_states
from redundant_planner.nodes.obstacle_input import ObstacleInput
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.second_process import ACKNOWLEDGED, PAUSE, STOPS
from redundant_planner.nodes.state_report import LoopState
from redundant_planner.nodes.supervisor import (
    Decision,
    FRESH_AFTER,
    MOVED_BY_OTHERS,
    PAUSED,
    Supervisor,
)
from redundant_planner.nodes.tip_commands import TipCommands
from redundant_planner.nodes.tip_topics import OBJECT
from redundant_planner.paper.method import PaperPlanner, planner_of

Array = npt.NDArray[np.float64]

_NO_TWIST = np.zeros(6)
# An arm this slow stands still, as to what its hands begin to hold [rad/s, m/s].
_STANDS_STILL = 1e-3
# A measured posture that jumps by more than this beyond what the arm can travel starts everything
# again from there [rad, m].
_JUMP = 0.1
# Measurements whose times are remembered.
_MEASUREMENTS = 200
# Less need not be kept clear of obstacles [m].
_LITTLE = 1e-3


class ControlLoop:
    """Runs `Planner.step` on the latest inputs, as far as the supervisor lets the arm move.

    Work that the command of a tick does not need is done after that command is out.

    Attributes:
        planner, supervisor: the mathematics, and the arm's permission to move.
        command, obstacles, attached, output: the inputs and the output.
        inboxes: subscriptions that each tick fetches, and who takes their messages.
        settings: of the loop; assigning new ones changes its timeouts.
        state: for reports.
        pacer: when ticks and commands are due.
        clock: that it runs by.
        now: when the latest tick began [s].
        measured_ns: when the latest joint_states were sent, by the system's clock [ns].
    """

    def __init__(
        self, planner: Planner | PaperPlanner, settings: PlannerNodeParameters, *,
        clock: LoopClock, command: CommandInput | TipCommands, obstacles: ObstacleInput,
        attached: Payload, output: CommandOutput, last_word: LastWord, guard: Guard,
        warn: Callable[[str], None], publish_tick: Callable[[array.array[float]], None] | None,
    ) -> None:
        """Prepare, with the arm at rest.

        Args:
            planner: of the robot.
            settings: of the loop.
            clock: that it runs by.
            command, obstacles: the inputs.
            attached: what the hand holds.
            output: takes each command.
            last_word: stops the arm should this process die.
            guard: counts exceptions.
            warn: takes sentences for the log.
            publish_tick: takes all inputs of each tick (`RecordedTick`); None to leave that out.
        """
        robot = planner.robot
        self.planner = planner
        self.supervisor = Supervisor(robot.velocity_max, _JUMP, robot.joint_names)
        self.command, self.obstacles, self.output = command, obstacles, output
        self.attached = ObstacleInput(
            ['attached'], ObstacleSources([attached.tracker]), 1.0 / settings.rate, guard, warn)
        self._payload = attached
        self.inboxes: list[tuple[PolledSubscription, Callable[[bytes], None]]] = []
        self.settings = settings
        self.state = LoopState()
        self.now = -np.inf
        self.measured_ns: deque[int] = deque(maxlen=_MEASUREMENTS)
        self._period = 1.0 / settings.rate
        self.pacer = CommandPacer(self._period)
        self._robot = robot
        self.clock = clock
        self._last_word, self._guard, self._warn = last_word, guard, warn
        self._publish_tick = publish_tick
        self._joints = JointReader(robot.joint_names, Seams.of(robot))
        self._position_command = PositionCommand(limits_of(robot, planner.parameters))
        self._following = Following(robot.joint_names, self._period, settings.follow_tolerance)
        # Where an arm stands that does not follow; None if it moves.
        self._anchor: Array | None = None
        self._wished_at = -np.inf  # when somebody commanded the arm last
        self._stop = SmoothStop(robot.acceleration_max, robot.jerk_max, self._period)
        self._last_command: Array | None = None  # velocities; None while the arm rests
        self._chunk: Chunk | None = None  # the latest one that is on ~/ticks
        self._is_sent = False  # whether this tick's command is out
        self._no_time = ''  # why the loop's clock stands still

    @property
    def at_rest(self) -> bool:
        """Whether the arm rests and the node is silent."""
        return self._last_command is None

    @property
    def velocity(self) -> Array:
        """The latest command (n,), zero while the arm rests [rad/s, m/s]."""
        return np.zeros(self._robot.n) if self._last_command is None else self._last_command

    @property
    def held(self) -> frozenset[str]:
        """Names of what the hand holds."""
        return self.obstacles.tracker.hidden

    def on_joint_states(self, raw: bytes) -> None:
        """Take a serialised JointState."""
        try:
            which = self._joints.read(raw)
        except StateError as error:
            self._warn(f'joint_states ignored: {error}')
            return
        if len(which):
            self.supervisor.measured(self._joints.posture, self.now, which)
        else:
            self.supervisor.heard_others(self._joints.others)

    def on_odometry(self, raw: bytes) -> None:
        """Take a serialised Odometry: the positions of the base's joints."""
        try:
            self.on_joint_states(base_states(raw))
        except StateError as error:
            self._warn(f'odom ignored: {error}')

    def on_target(self, raw: bytes) -> None:
        """Take a serialised target_pose."""
        if self._goes_to_targets('target_pose'):
            assert isinstance(self.command, CommandInput), 'several tips have their own topics'
            self.command.on_target(raw)

    def on_joint_target(self, raw: bytes) -> None:
        """Take a serialised target_joints."""
        if self._goes_to_targets('target_joints'):
            self.command.on_joint_target(raw, self._robot, self.supervisor.posture)

    def on_path(self, raw: bytes) -> None:
        """Take a serialised target_path."""
        if self._goes_to_targets('target_path'):
            assert isinstance(self.command, CommandInput), 'several tips have their own topics'
            self.command.on_path(raw)

    def on_trajectory(self, raw: bytes) -> None:
        """Take a serialised target_trajectory."""
        if self._goes_to_targets('target_trajectory'):
            self.command.on_trajectory(raw, self._robot, self.supervisor.posture)

    def _goes_to_targets(self, topic: str) -> bool:
        """Return whether the method can; if not, say so."""
        if isinstance(self.planner, Planner):
            return True
        self._warn(f"{topic} ignored: method '{self.planner.parameters.method}' follows twists "
                   'only')
        return False

    def tick(self) -> bool:
        """Command the arm once; an unforeseen exception brings it to rest.

        Returns:
            Whether there was or is much to do besides.
        """
        begin = time.perf_counter()
        messages = [
            (sent, inbox.topic, take, raw) for inbox, take in self.inboxes for raw, sent in
            self._guard.call(f'reading {inbox.topic}', inbox.fetch_stamped) or ()]
        # Of a target and a twist the later one commands, also where both come within a tick.
        messages.sort(key=itemgetter(0))
        self.now = self.clock.now()
        if not self.clock.simulated:  # simulated time stands still while a command waits
            self.pacer.begin(self.now)
        self._is_sent, self._no_time = False, ''
        for sent, topic, take, raw in messages:
            if topic == 'joint_states':
                self.measured_ns.append(sent)
            self._guard.call(f'reading {topic}', take, raw)
        try:
            decision = self._move_or_brake()
        except Exception as error:
            self._guard.caught('the tick', error)
            self.supervisor.fail(
                f'fault in the tick: {line_of(error)}; ~/reset goes on from there')
            decision = Decision(self.supervisor.failure, is_fault=True)
            if not self._is_sent:
                self._guard.call('braking', self._brake)
        self.state.hold, self.state.fault = decision.hold, decision.is_fault
        elapsed = time.perf_counter() - begin - self.pacer.waited
        self.state.tick_times.append(elapsed)
        self.state.overruns += elapsed > self._period
        moves = not decision.hold
        return bool(self._guard.call('reading obstacles', self._read_and_prepare, moves))

    def refuse_time(self, reason: str) -> None:
        """Have `brake_without_time` stop the arm: without time there are no ticks."""
        self._warn(reason)
        self._no_time = reason

    def brake_without_time(self) -> bool:
        """Brake, if the loop's clock stands still; return whether it does."""
        if self._no_time:
            self.state.hold, self.state.fault = self._no_time, True
            self._brake()
        return bool(self._no_time)

    def finish(self) -> None:
        """Bring a moving arm to rest and leave it with a stop as its last command.

        A publisher that is destroyed at once takes messages with it that are still on their way,
        and best-effort listeners do not acknowledge: they are told more than once.
        """
        if self.at_rest:
            return
        while not self.at_rest:
            self._brake()
            time.sleep(self._period)
        for _ in range(STOPS):
            self._send(np.zeros(self._robot.n), TickKind.BRAKING)
            time.sleep(PAUSE)
        self.output.wait_until_heard(ACKNOWLEDGED)

    def _move_or_brake(self) -> Decision:
        """Do what the supervisor decides; return that."""
        if self.supervisor.recovery_due(self.at_rest):
            self._recover()
        self._see_whether_it_follows()
        decision = self.supervisor.decide(
            self.now, self.at_rest, self.settings.joint_state_timeout)
        if decision.time_jumped:
            self.command.forget_preview()
        if decision.warning:
            self._warn(decision.warning)
        if decision.hold:
            self._forget_target(decision.hold)
            if self._coupled and decision.hold == PAUSED and self.velocity.any():
                self._move(decision.hold)  # what the hands hold stays whole on the way to rest
            else:
                self._brake()
        else:
            self._move(decision.ignore_command)
        return decision

    def _forget_target(self, reason: str) -> None:
        """Let go of a target, if there is one: kept, it would move the arm at some later time."""
        if self.command.has_target:
            # Who asks for a pause is told by its answer, and may be who sent the target.
            if reason != PAUSED:
                self._warn(f'target forgotten: {reason}')
            self.command.forget_target()

    def _recover(self) -> None:
        """Forget all about the motion: any part of it may have led to the failure."""
        self.planner = planner_of(self.planner.robot, self.planner.parameters)
        self._position_command.reset()
        self.supervisor.follows()
        self.command.forget()
        self.command.forget_preview()
        self.state.result = None
        self.supervisor.recovered()

    def _brake(self) -> None:
        """Slow down within the acceleration limits; at rest, forget the command."""
        if self._last_command is None:
            return
        dq = self._stop.next()
        self._send(dq, TickKind.BRAKING)
        self.planner.braked(dq, self._period)
        if not dq.any() and (not self.supervisor.astray or self._anchor is None
                             or self._position_command.is_at(self._anchor)):
            self._last_command = None
            self.command.forget()
            if self.supervisor.astray or self.supervisor.was_moved:
                # Whoever wakes up takes what comes first for where to be.
                self._position_command.reset()

    def _move(self, ignore_command: str) -> None:
        """Take a step of the planner; the command is zero if there is a reason to ignore it."""
        posture, kind = self._posture(), TickKind.GOING_ON
        if self.at_rest:
            kind = TickKind.STARTING
            self.planner.reset()
            lag, dead_time = _drive_of(self.planner)
            self._following.begin(posture, lag + self.output.lag, dead_time)
            self._position_command.start(posture, self._lead)
        self._couple(posture)
        twist, ahead, target = self._no_twist, None, None
        if ignore_command:
            self._forget_target(ignore_command)
        else:
            timeout = self.settings.incoming_command_timeout
            target = self._target(posture)
            twist = self._twist(timeout, posture)
            ahead = self.command.ahead(timeout)
        self.state.trouble = ignore_command
        news = self.command.take_news() if target is not None else ()
        gently = self.supervisor.tries and isinstance(self.planner, Planner)
        if gently and kind is TickKind.GOING_ON:
            kind = TickKind.TRYING
        self.obstacles.tracker.expire(self.now)
        result = self.planner.step(
            posture, twist, self.obstacles.scene, self._period, ahead, target,
            news=news, gently=kind is TickKind.TRYING)
        if not np.isfinite(result.dq).all():
            raise ArithmeticError(f'the planner asked for the velocities {result.dq.tolist()}')
        self._send(result.dq, kind, twist, ahead, target, news)
        self._stop.moving(result.dq)
        if kind is TickKind.STARTING:
            self._say_what_touches(posture)
        before = self.state.result
        if result.reason and not (before is not None and before.reason):
            self._warn(result.reason)
        self.state.result = result
        self.state.jerk_given_up += not result.jerk_kept

    def couple(self, wanted: bool) -> tuple[bool, str]:
        """Have several tips of an arm that stands still hold one object, or no longer.

        Returns:
            Whether that can be, and a sentence about it.
        """
        robot = self._robot
        if not isinstance(self.command, TipCommands):
            return False, f"'{robot.name}' has one tip; to couple takes two (parameter 'tips')"
        if np.abs(self.velocity).max() > _STANDS_STILL:
            return False, 'the arm moves; couple and let go while it stands still'
        if wanted and self.supervisor.posture is None:
            return False, 'nothing was heard on joint_states yet'
        if wanted and robot.m < 6 * len(robot.tips):
            return False, 'to couple takes all six axes of each tip'
        self.command.forget()
        self.command.coupled = wanted
        return True, (f'{" and ".join(robot.tips)} hold one object: move it by {OBJECT}/cmd_vel '
                      f'and {OBJECT}/target_pose' if wanted else 'each tip moves on its own')

    @property
    def object_pose(self) -> Pose | None:
        """Where what the tips hold is in the base frame; None while they hold nothing."""
        posture, planner = self.supervisor.posture, self.planner
        if not isinstance(planner, Planner) or planner.coupling is None or posture is None:
            return None
        return planner.coupling.object_pose(self._robot.kinematics(posture).tips.first)

    @property
    def _coupled(self) -> bool:
        return isinstance(self.command, TipCommands) and self.command.coupled

    @property
    def _no_twist(self) -> Array:
        """Return a command of none."""
        tips = len(self._robot.tips)
        return _NO_TWIST if tips == 1 or self._coupled else np.zeros((tips, 6))

    def _couple(self, posture: Array) -> None:
        """Couple the tips, or let go, as it is wanted: between two ticks of the planner."""
        planner = self.planner
        if not isinstance(planner, Planner) or self._coupled == (planner.coupling is not None):
            return
        if self._coupled:
            planner.couple(q=posture)
        else:
            planner.uncouple()

    def _see_whether_it_follows(self) -> None:
        """Compare what was commanded with what was measured, and see who moves the arm."""
        supervisor, following = self.supervisor, self._following
        timeout = self.settings.incoming_command_timeout
        wishes = self.command.has_target or self.command.moves(timeout)
        supervisor.heard_a_wish(wishes, self.now, self.at_rest)
        self._wished_at = self.now if wishes else self._wished_at
        self.state.astray = supervisor.astray
        if self._last_command is None:
            return
        following.tolerance = self.settings.follow_tolerance
        reason = following.tick(
            self._last_command, self._posture(), supervisor.measurement_ages(self.now),
            tries=supervisor.tries)
        if reason and (supervisor.tries or not supervisor.astray):
            unheard = self.output.unheard(patience=0.0)
            # One that moves is told nothing new: it might go astray on the way to where it is.
            self._anchor = None if following.moves_alone else self._posture()
            supervisor.does_not_follow(f'{reason} {unheard}'.rstrip())
        elif supervisor.tries and following.has_followed:
            supervisor.follows()
        if self.now - self._wished_at < FRESH_AFTER:
            following.rest()
        elif following.tolerance > 0.0 and following.moved_by_others > MOVED_BY_OTHERS:
            following.rest()
            supervisor.moved_by_others()
        self.state.astray = supervisor.astray

    @property
    def _lead(self) -> float:
        """How far commanded positions may be ahead of a standing arm [rad, m]."""
        return self.settings.follow_tolerance or _JUMP

    def _where_it_may_be(self, dq: Array, kind: TickKind) -> tuple[Array | None, Array | None]:
        """Return the posture (n,) that commanded positions keep to, and how near (n,) [rad, m].

        An arm that does not follow is where it was found. Otherwise positions may be ahead of
        the planned posture by what the drives explain, as long as no link gets nearer to an
        obstacle than it is.
        """
        if self.supervisor.astray and not self.supervisor.tries:
            return self._anchor, None
        if kind is TickKind.BRAKING or not isinstance(self.planner, Planner):
            return None, None
        lead = self._lead + self._following.travel
        nearest = self.state.result.nearest if self.state.result is not None else None
        if nearest is not None:
            reach = float((self.planner.robot.lever_arm_bounds @ lead).max())
            lead = lead * min(1.0, max(nearest.distance, 0.0) / max(reach, _LITTLE))
        return self.planner.posture_ahead, lead

    def _posture(self) -> Array:
        posture = self.supervisor.posture
        assert posture is not None, 'the arm moves only after a measurement'
        return posture

    def _target(self, posture: Array) -> Target | TipTargets | None:
        """Return where the arm shall go; None if a twist commands."""
        if not self.command.has_target:
            return None
        due = self.planner.references
        return self.command.target(self._places(
            self._robot.kinematics(posture).tips if due is None else due))

    def _twist(self, timeout: float, posture: Array) -> Array:
        """Return the twist (6,) of the operator's in the planner's command axes, or several."""
        return self.command.twist(
            timeout, lambda: self._places(self._robot.kinematics(posture).tips))

    def _places(self, tips: Poses) -> Poses:
        """Return where the tips are, or what they hold."""
        if not self._coupled or not isinstance(self.planner, Planner):
            return tips
        coupling = self.planner.coupling or Coupling.of(tips)
        return Poses.of(coupling.object_pose(tips.first))

    def _send(
        self, dq: Array, kind: TickKind, twist: Array | None = None,
        ahead: TwistAhead | None = None, target: Target | TipTargets | None = None,
        news: tuple[Sighting, ...] = (),
    ) -> None:
        """Publish a command (n,) at its moment, and the inputs that led to it."""
        posture = self._posture()
        positions = self._position_command.advance(
            dq, self._period, *self._where_it_may_be(dq, kind))
        self.pacer.wait()
        stamp_ns = self.clock.stamp_ns()
        turned = self._joints.turned
        self._last_word.note(stamp_ns, positions + turned, dq)
        self.output.publish(stamp_ns, positions, dq, turned)
        self._last_command, self._is_sent = dq, True
        if self._publish_tick is not None:
            elapsed = self.command.preview_elapsed() if ahead is not None else np.nan
            obstacles = tuple(zip(self.obstacles.read_counts, self.obstacles.last_read))
            # A chunk is recorded once, and not in each tick.
            goes_on = isinstance(target, Chunk) and target is self._chunk
            if isinstance(target, Chunk):
                self._chunk, target = target, None if goes_on else target
            self._publish_tick(RecordedTick(
                stamp_ns, self.now, kind, obstacles[0][0], self.command.previews, elapsed,
                self.attached.read_counts[0], self._no_twist if twist is None else twist, posture,
                target, obstacles,
                goes_on, news).numbers())

    def _read_and_prepare(self, moves: bool) -> bool:
        """Read messages on obstacles and attached, if that need not wait; prepare the next tick.

        Args:
            moves: whether the planner decided on this tick.

        Returns:
            Whether there was much to do.
        """
        holds = self.attached.read(self.now)
        self._payload.tracker.expire(self.now)
        self._hold()
        begin, put_off = time.perf_counter(), self.obstacles.put_off(self.pacer.left)
        read = not put_off and self.obstacles.read(self.now)
        prepared = moves and self.planner.prepare(self.obstacles.scene)
        if read:
            self.obstacles.took = time.perf_counter() - begin
        return holds or put_off or read or prepared

    def _hold(self) -> None:
        """Make what is attached by now a part of the arm, and no obstacle."""
        things = self._payload.changed()
        if things is None:
            return
        try:
            self.planner.hold(things)
        except ObstacleError as error:
            self._warn(f'what it holds stays as it was: {error}')
            return
        self.obstacles.tracker.hidden = self._payload.names
        if self.supervisor.posture is not None:
            self._say_what_touches(self.supervisor.posture)

    def _say_what_touches(self, posture: Array) -> None:
        """Name links and obstacles that touch, which holds the arm back or is meant."""
        if isinstance(self.planner, Planner):
            for contact in self.planner.contacts(posture, self.obstacles.scene):
                self._warn(str(contact))


def _drive_of(planner: Planner | PaperPlanner) -> tuple[float, float]:
    """Return lag and dead time of the drives, as far as they are known [s]."""
    return planner.parameters.drive_lag, planner.parameters.drive_dead_time
