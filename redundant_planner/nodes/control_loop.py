"""The control loop: each tick reads, decides, moves or brakes the arm, and publishes."""

from __future__ import annotations

import array
from collections.abc import Callable
from operator import itemgetter
import time

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import limits_of
from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.safety.jerk import SmoothStop
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.payload import Payload
from redundant_planner.io.recorded_tick import TickKind
from redundant_planner.nodes.arm_watch import ArmWatch
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.command_output import CommandOutput
from redundant_planner.nodes.command_pacer import CommandPacer
from redundant_planner.nodes.commanded_positions import CommandedPositions
from redundant_planner.nodes.guard import Guard, line_of
from redundant_planner.nodes.joint_input import JointInput
from redundant_planner.nodes.last_word import LastWord
from redundant_planner.nodes.loop_clock import LoopClock
from redundant_planner.nodes.obstacle_input import ObstacleInput
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.second_process import ACKNOWLEDGED, PAUSE, STOPS
from redundant_planner.nodes.state_report import LoopState
from redundant_planner.nodes.supervisor import Decision, PAUSED, Supervisor
from redundant_planner.nodes.tick_record import Asked, TickRecord
from redundant_planner.nodes.tip_commands import TipCommands
from redundant_planner.nodes.tip_coupling import TipCoupling
from redundant_planner.paper.method import PaperPlanner, planner_of

Array = npt.NDArray[np.float64]

# A measured posture that jumps by more than this beyond what the arm can travel starts everything
# again from there [rad, m].
_JUMP = 0.1
# So long an arm that takes velocities is taken to go on by one that none follows: drives may time
# out. Beyond that, where it is measured counts [s].
_GOES_ON = 0.05


class ControlLoop:
    """Runs `Planner.step` on the latest inputs, as far as the supervisor lets the arm move.

    Work that the command of a tick does not need is done after that command is out.

    Attributes:
        planner, supervisor: the mathematics, and the arm's permission to move.
        joints, command, obstacles, attached, output: the inputs and the output.
        coupling: of several tips, as the operator wants it.
        inboxes: subscriptions that each tick fetches, and who takes their messages.
        settings: of the loop; assigning new ones changes its timeouts.
        state: for reports.
        pacer: when ticks and commands are due.
        clock: that it runs by.
        now: when the latest tick began [s].
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
        self._period = 1.0 / settings.rate
        self.pacer = CommandPacer(self._period)
        self._robot = robot
        self.clock = clock
        self._last_word, self._guard, self._warn = last_word, guard, warn
        self._record = None if publish_tick is None else TickRecord(
            publish_tick, command, self.obstacles, self.attached)
        self.coupling = TipCoupling(robot, command)
        self.joints = JointInput(robot, self.supervisor, lambda: self.now, warn)
        self._watch = ArmWatch(self.supervisor, robot.joint_names, self._period,
                               lambda: output.unheard(patience=0.0))
        self._positions = CommandedPositions(
            limits_of(robot, planner.parameters), self._period, self._watch)
        self._stop = SmoothStop(robot.acceleration_max, robot.jerk_max, self._period)
        self._last_command: Array | None = None  # velocities; None while the arm rests
        self._is_sent = False  # whether this tick's command is out
        self._missed = 0  # ticks that did not take place before this one
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
                self.joints.sent_ns.append(sent)
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
        # An arm that did not follow, or that others have moved, is no more held anywhere.
        self._positions.start(self._posture(), np.inf)
        for _ in range(STOPS):
            self._send(np.zeros(self._robot.n), TickKind.BRAKING)
            time.sleep(PAUSE)
        self.output.wait_until_heard(ACKNOWLEDGED)

    def _move_or_brake(self) -> Decision:
        """Do what the supervisor decides; return that."""
        if self.supervisor.recovery_due(self.at_rest):
            self._recover()
        if not self.at_rest:
            self._missed = int(min(
                self.pacer.missed, self.output.goes_on, _GOES_ON // self._period
            )) if self.settings.drive_goes_on else 0
            self.planner.missed(self._missed)
        self._see_whether_it_follows()
        decision = self.supervisor.decide(
            self.now, self.at_rest, self.settings.joint_state_timeout)
        if decision.time_jumped:
            self.command.forget_preview()
        if decision.warning:
            self._warn(decision.warning)
        if decision.hold:
            self._forget_target(decision.hold)
            if self.coupling.wanted and decision.hold == PAUSED and self.velocity.any():
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
        self._positions.reset()
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
        if not dq.any() and (not self.supervisor.astray or self._positions.are_back):
            self._last_command = None
            self.command.forget()
            if self.supervisor.astray or self.supervisor.was_moved:
                # Whoever wakes up takes what comes first for where to be.
                self._positions.reset()

    def _move(self, ignore_command: str) -> None:
        """Take a step of the planner; the command is zero if there is a reason to ignore it."""
        posture, kind = self._posture(), TickKind.GOING_ON
        if self.at_rest:
            kind = TickKind.STARTING
            self._begin(posture)
        self.coupling.apply(self.planner, posture)
        if ignore_command:
            self._forget_target(ignore_command)
            asked = Asked(self.coupling.no_twist)
        else:
            asked = self._asked(posture)
        self.state.trouble = ignore_command
        if kind is TickKind.GOING_ON and isinstance(self.planner, Planner):
            if self.supervisor.tries:
                kind = TickKind.TRYING
            elif self._watch.sets_off:
                kind = TickKind.SETTING_OFF
        self.obstacles.tracker.expire(self.now)
        result = self.planner.step(
            posture, asked.twist, self.obstacles.scene, self._period, asked.ahead, asked.target,
            news=asked.news, gently=kind is TickKind.TRYING,
            carefully=kind is TickKind.SETTING_OFF)
        if not np.isfinite(result.dq).all():
            raise ArithmeticError(f'the planner asked for the velocities {result.dq.tolist()}')
        self._send(result.dq, kind, asked)
        self._stop.moving(result.dq)
        if kind is TickKind.STARTING:
            self._say_what_touches(posture)
        before = self.state.result
        if result.reason and not (before is not None and before.reason):
            self._warn(result.reason)
        self.state.result = result
        self.state.jerk_given_up += not result.jerk_kept

    def _begin(self, posture: Array) -> None:
        """Begin to move an arm that stands at a posture (n,) [rad, m]."""
        self.planner.reset()
        parameters = self.planner.parameters
        self._watch.begin(
            posture, parameters.drive_lag + self.output.lag, parameters.drive_dead_time)
        self._positions.start(posture, self._lead)

    def _asked(self, posture: Array) -> Asked:
        """Return what the operator asks of an arm at a posture (n,) [rad, m]."""
        command, planner = self.command, self.planner
        timeout = self.settings.incoming_command_timeout

        def places(due: Poses | None = None) -> Poses:
            """Return where what the operator moves is, or where it is if its tips are there."""
            tips = self._robot.kinematics(posture).tips if due is None else due
            return self.coupling.places(planner, tips)

        target = command.target(places(planner.references)) if command.has_target else None
        return Asked(command.twist(timeout, places), command.ahead(timeout), target,
                     command.take_news() if target is not None else ())

    def _see_whether_it_follows(self) -> None:
        """Compare what was commanded with what was measured, and see who moves the arm."""
        wishes = self.command.has_target or self.command.moves(
            self.settings.incoming_command_timeout)
        self._watch.look(self.now, self._last_command, wishes=wishes,
                         tolerance=self.settings.follow_tolerance)
        self.state.astray = self.supervisor.astray

    @property
    def _lead(self) -> float:
        """How far commanded positions may be ahead of a standing arm [rad, m]."""
        return self.settings.follow_tolerance or _JUMP

    def _posture(self) -> Array:
        posture = self.supervisor.posture
        assert posture is not None, 'the arm moves only after a measurement'
        return posture

    def _send(self, dq: Array, kind: TickKind, asked: Asked | None = None) -> None:
        """Publish a command (n,) at its moment, and the inputs that led to it."""
        posture, result = self._posture(), self.state.result
        planner = None if kind is TickKind.BRAKING else self.planner
        positions = self._positions.next(
            dq, self._lead, planner if isinstance(planner, Planner) else None,
            result.nearest if result is not None else None)
        self.pacer.wait()
        stamp_ns = self.clock.stamp_ns()
        turned = self.joints.turned
        self._last_word.note(stamp_ns, positions + turned, dq)
        self.output.publish(stamp_ns, positions, dq, turned)
        self._last_command, self._is_sent = dq, True
        if self._record is not None:
            self._record.write(stamp_ns, self.now, kind, posture,
                               asked or Asked(self.coupling.no_twist), self._missed)
        self._missed = 0

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
