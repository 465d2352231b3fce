"""One tick of the planner: state, command and scene in, joint velocity out.

`Planner.step` is the only composition in the package. It senses, aims, wishes, guards and
remembers; each of these is an object or a function of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from operator import is_not

import numpy as np
import numpy.typing as npt

from redundant_planner.core.aiming import Aiming
from redundant_planner.core.commands import Commands, order_of
from redundant_planner.core.constants import gains_of, robot_constants
from redundant_planner.core.errors import known, ParameterError, PlannerError, shown, StateError
from redundant_planner.core.horizon.preview import Preview, TwistAhead
from redundant_planner.core.machine_code.packed import Packed
from redundant_planner.core.modes import LastTick, Path
from redundant_planner.core.obstacles.contacts import AllowedContacts, Contact, contacts
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.watch import ObstacleWatch
from redundant_planner.core.own_rules import Barrier, checked_rules, Criterion
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.redundancy.own_criteria import OwnCriteria
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.joint_observer import JointObserver
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.core.safeguard import Admitted, Safeguard
from redundant_planner.core.safety.barriers import room_for_rows
from redundant_planner.core.safety.jerk import check_tick, reversal_time, Smoothing
from redundant_planner.core.safety.own_barriers import OwnBarriers
from redundant_planner.core.safety.reasons import fallbacks_of
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.step_result import StepResult
from redundant_planner.core.target.goal import Target, TipTargets
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.core.tick import Setup, Wish, wish, World

Array = npt.NDArray[np.float64]

_JERK_GIVES_WAY = 'jerk gives way to a clearance'
# The share of a command that has been followed lately is a mean over so long [s].
_LATELY = 0.3
# How long clearance goes before jerk after a tick in which it could not be kept [s].
_RUSH = 0.1


class Planner:
    """Velocity-level redundancy resolution for one robot.

    The same sequence of inputs gives the same sequence of outputs. Between ticks it remembers:
    the last tick (its velocity, the reference pose, how much of the path was followed), when the
    links were last measured against each other, the obstacles near the arm (`ObstacleWatch`),
    the joint path ahead (`LookAhead`), the way to its target (`Way`), the joint path past what
    moves (`EvasivePlan`), and whether it has to come back from there (`ComingBack`).
    """

    def __init__(
        self, robot: Robot, parameters: PlannerParameters | None = None, *,
        filtered: bool = True, barriers: Sequence[Barrier] = (),
        criteria: Sequence[Criterion] = (),
    ) -> None:
        """Prepare for a robot.

        Args:
            robot: the arm.
            parameters: the planner's; the defaults if None.
            filtered: whether the safety filter acts; off only to compare methods without it.
            barriers: of the user's own, which the filter keeps at 0 or more.
            criteria: of the user's own, which null-space motion makes larger.

        Raises:
            ParameterError: the parameters do not fit this robot, or the gradient of a barrier or
                criterion is not that of its value.
        """
        parameters = PlannerParameters() if parameters is None else parameters
        sizes = checked_rules(robot, barriers, criteria)
        self._own_barriers = OwnBarriers(robot, barriers, sizes[:len(barriers)])
        self._own_criteria = OwnCriteria(robot.n, criteria)
        self.robot = robot
        self._filtered = filtered
        self._given: tuple[tuple[Obstacle, ...], Scene] = (), Scene.of()  # obstacles, if a list is
        self._commands = Commands(robot)
        self._last = LastTick.at_rest(robot)
        self._smoothing = Smoothing(
            robot.n, reversal_time(robot.acceleration_max, robot.jerk_max) if filtered else 0.0)
        self._observer = JointObserver(robot.n, 0.0, 0.0)
        self._parameters = parameters
        self.parameters = parameters

    @property
    def parameters(self) -> PlannerParameters:
        """The parameters in use; assigning replaces them all, from the next tick on."""
        return self._parameters

    @parameters.setter
    def parameters(self, parameters: PlannerParameters) -> None:
        if parameters.method not in METHODS:
            raise ParameterError(
                f"parameter 'method' is '{parameters.method}'; a planner that began with one of "
                f'{known(METHODS)} keeps to these')
        robot, own = self.robot, self._own_barriers
        order = order_of(robot, parameters.tip_order)
        constants, gains = robot_constants(robot, parameters), gains_of(parameters)
        safeguard = Safeguard(robot, parameters, constants, self._commands, own.names)
        limits = safeguard.limits
        watch = ObstacleWatch(
            robot, parameters, limits, constants, gains, getattr(self, '_watch', None))
        # Nothing has changed where one of these refused the parameters.
        self._parameters, self._constants, self._limits = parameters, constants, limits
        self._commands.order = order
        self._setup = Packed.of(Setup(
            constants, limits, gains, room_for_rows(constants, len(robot.tips))))
        self._aiming = Aiming(
            robot, parameters, constants, gains, limits, self._commands, own,
            filtered=self._filtered, before=getattr(self, '_aiming', None))
        self._watch, self._safeguard = watch, safeguard
        drive = parameters.drive_lag, parameters.drive_dead_time
        if drive != (self._observer.lag, self._observer.dead_time):
            self._observer = JointObserver(robot.n, *drive)

    def hold(self, things: Iterable[Obstacle]) -> None:
        """Make what the hand holds a part of the arm, from the next tick on, and it alone.

        It is kept from all but the links that move along with the tip, or, coupled, with any tip.

        Args:
            things: their shapes at rest in the first tip's frame; none to let go of all.

        Raises:
            ObstacleError: they cannot be held; the arm is as before then.
        """
        before, self.robot = self.robot, self.robot.holding(things, by_all=bool(self.coupling))
        try:
            self.parameters = self._parameters
        except PlannerError:
            self.robot = before
            raise

    @property
    def coupling(self) -> Coupling | None:
        """How tips hold an object together; None where each moves on its own."""
        return self._commands.coupling

    def couple(self, held: Pose | None = None, q: npt.ArrayLike | None = None) -> None:
        """Keep all tips where they are to each other: they hold one object.

        From the next tick on, `step` takes the object's twist (6,) and its pose as a target.

        Args:
            held: the object's pose in the base frame; half way between the tips and in base axes
                if None.
            q: (n,) where the arm is [rad, m]; where it should be if None.

        Raises:
            StateError: there is one tip, an axis of a tip is not controlled, or nothing tells
                where they are.
        """
        self._commands.couple(
            self._last.reference if q is None else self.robot.kinematics(q).tips, held)
        self._begin_anew()

    def uncouple(self) -> None:
        """Let each tip move on its own again."""
        self._commands.coupling = None
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Let the way to a target begin again, of tips that go together in another way."""
        self._aiming.forget_target()
        self.hold(self.robot.held)

    def contacts(self, q: Array, scene: Scene | Sequence[Obstacle]) -> tuple[Contact, ...]:
        """Return which links touch which obstacles at a posture (n,), and whether they may.

        Raises:
            StateError: `q` does not have n finite entries.
        """
        return contacts(
            self.robot, self.robot.kinematics(q), self._scene_of(scene),
            AllowedContacts(self._parameters.allowed_contacts, self.robot))

    def reset(self) -> None:
        """Forget the last velocity and the reference pose: the arm stands where it is found."""
        self._last = LastTick.at_rest(self.robot)
        self._smoothing.reset()
        self._observer.reset()
        self._aiming.reset()
        self._safeguard.reset()
        self._watch.reset()

    def _scene_of(self, given: Scene | Sequence[Obstacle]) -> Scene:
        """Return obstacles as a scene: the same one for the same obstacles."""
        if isinstance(given, Scene):
            return given
        things = tuple(given)
        if len(things) != len(self._given[0]) or any(map(is_not, things, self._given[0])):
            self._given = things, Scene.of(things)
        return self._given[1]

    @property
    def reference(self) -> Pose | None:
        """Where the first tip should be now; None before the first tick after a reset."""
        return None if self._last.reference is None else self._last.reference.first

    @property
    def references(self) -> Poses | None:
        """Where all tips should be now; None before the first tick after a reset."""
        return self._last.reference

    @property
    def posture_ahead(self) -> Array:
        """Where the arm will be by its commands at the end of the latest (n,) [rad, m]."""
        return self._observer.ahead

    @property
    def guided(self) -> float:
        """Share of the null-space motion that follows the joint path ahead."""
        return self._aiming.guided

    @property
    def margin(self) -> float:
        """Distance kept from obstacles: `clearance.margin`, or `target.margin` [m]."""
        return self._watch.margin

    def prepare(self, scene: Scene | Sequence[Obstacle]) -> bool:
        """Do a part of the next `step` ahead of it, where there is time for that.

        It chooses from many obstacles, improves the joint paths ahead, and thinks about a free
        way. The next step becomes shorter by that, and nothing else changes.

        Returns:
            Whether it did one of the last two, which may take a large part of a period.
        """
        return self._aiming.catch_up(
            chose=self._watch.prepare(self._scene_of(scene), self._last.dq))

    def step(
        self, q: Array, twist: Array, scene: Scene | Sequence[Obstacle], dt: float,
        ahead: Preview | TwistAhead | None = None,
        target: Target | TipTargets | None = None, *,
        news: Sequence[Sighting] = (), gently: bool = False, carefully: bool = False,
    ) -> StepResult:
        """Return the joint velocity for the next `dt`.

        Args:
            q: (n,) measured joint positions [rad, m]. They may be late, as `drive.lag` and
                `drive.dead_time` say, and noisy.
            twist: (6,) commanded tip twist in the command frame [m/s, rad/s]; entries of axes
                that are not controlled do not count. Of an arm with t tips (t, 6).
            scene: the obstacles; the same object, or the same obstacles, while nothing changes.
            dt: time until the next tick [s].
            ahead: what will be commanded, for the joint path ahead: a preview that starts now
                (`Preview.ahead` for one that started earlier), or a function of times from now
                (N + 1,) [s] that returns the mean twists (N, 6) from each to the next. Without
                it the planner takes the present command as held.
            target: where to go, as fast as the limits allow: a pose of the tip, or joint positions
                (n,) [rad, m]; or a chunk of either, to follow in its time: the same object in each
                tick while it holds. Of an arm with several tips, tip → its pose or chunk, or what
                all joints do; tips without one follow their twist, or stay where they are. Of
                coupled tips, a pose or chunk of what they hold. None to follow the twist. Of tips
                with a target `twist` and `ahead` do not count.
            news: all targets that came since the last step, `target` the last of them, with the
                ages of their stamps: of a stream whose messages come late or several at once.
                Where it is empty, one came if `target` is another than in the last step.
            gently: whether the arm is only to show that it follows: no joint is asked to be
                faster than 0.05 rad/s or m/s.
            carefully: whether the arm has not been seen to move yet: no joint is asked to be
                faster than that, or than it can stop from within 0.08 s, if that is more.

        Raises:
            StateError: `q`, `twist`, `ahead`, `target` or `news` does not fit, or `dt` is not
                within 1e-4 to 10 s.
        """
        # Sense: where the arm is, and the obstacles near it.
        check_tick(dt)
        asked = self._commands.checked(twist, target, news, self._parameters.twist_speeds)
        scene = self._scene_of(scene)
        arm = self.robot.kinematics_at(self._posture(q, dt))
        last, tips = self._last, arm.tips
        due = self._commands.led(last.reference or tips)
        asked = self._commands.placed(asked, due)
        around = self._watch.look(scene, arm, last.dq, dt, by_target=target is not None)

        # Aim: at the target, out of the course of what moves, and along the joint path ahead.
        aim = self._aiming.aim(
            Start(arm, due, asked.twist, last.dq, dt), asked, around, self._watch, ahead, last,
            self._smoothing.delay)

        # Wish: ẋ and J⁺ẋ + k P∇H, Eqs. 1, 2 and 18.
        desired = wish(aim.start, World(
            around.maps, around.start, around.end, around.range,
            last.dq if aim.path is None else aim.path, aim.guided, last.worth,
            self._observer.strayed, self._own_criteria.gradient(arm)), self._setup)

        # Guard: every limit and barrier, docs/safety.md.
        crowded = self._aiming.switch(aim, desired, around, self._watch)
        own = self._own_barriers.rows(
            aim.start, self._limits, self._parameters.clearance_gain, self._constants.scaling,
            self._smoothing.corner, self._observer.strayed) if self._filtered else None
        admitted = self._safeguard.admitted(
            aim, desired, self._setup.value.rows, scene, around, last, own, gently=gently,
            carefully=carefully
        ) if self._filtered else Admitted.untouched(aim.mode.wanted(desired))

        # Remember: where the tip should be, and how fast the arm is.
        path = self._aiming.note(
            aim, admitted.result, desired, last, by_target=target is not None)
        self._remember(admitted, path, desired, dt)

        result = admitted.result
        fallback = '; '.join(
            self._aiming.fallbacks(aim, crowded=crowded)
            + (fallbacks_of(result, desired.unseen_share) if self._filtered else [])
            + self._own_criteria.fallbacks)
        jerk_kept = self._smoothing.keeps_jerk
        reasons = fallback, aim.says, *admitted.says, '' if jerk_kept else _JERK_GIVES_WAY
        motions, error = desired.motions, desired.task.error
        return StepResult(
            self._smoothing.sent.copy(), motions[1], motions[2], desired.factor,
            result.scale, result.stage, '; '.join(filter(None, reasons)), fallback,
            desired.clearance_index, self._safeguard.nearest(desired, around),
            desired.manipulability, tips.first, error[:6], jerk_kept,
            None if asked.target is None else self._aiming.progress(asked.target, arm),
            self._commands.results(tips, error, result),
            (() if own is None else own.values) + self._own_criteria.values)

    def _remember(self, admitted: Admitted, path: Path, desired: Wish, dt: float) -> None:
        """Note what a tick leaves to the next."""
        result, last = admitted.result, self._last
        self._observer.commanded(self._smoothing.take(result.dq), dt)
        # Where a margin has grown and nothing moves, jerk does not give way.
        rushes = result.stage is Stage.FORCED and desired.intruded and not (
            self._watch.margin_grew and self._watch.fastest == 0.0)
        self._last = LastTick(
            result.dq, path.reached, path.followed,
            result.stage in (Stage.YIELDING, Stage.FORCED),
            _RUSH if rushes else last.rush - dt,
            last.share + (1.0 - math.exp(-dt / _LATELY)) * (admitted.possible - last.share),
            result.stage is Stage.SLIDING)
        self._watch.margin_grew = self._watch.margin_grew and desired.intruded

    def braked(self, dq: Array, dt: float) -> None:
        """Note that something else than the last step's velocity was commanded, to stop the arm.

        The next step goes on from there, and leaves the path that was followed.

        Args:
            dq: (n,) that velocity [rad/s, m/s].
            dt: how long it holds [s].

        Raises:
            StateError: `dq` or `dt` does not fit.
        """
        check_tick(dt)
        dq, last = np.array(dq, dtype=float), self._last
        if dq.shape != (self.robot.n,) or not np.isfinite(dq).all():
            raise StateError(f'dq is {shown(dq)}; it takes {self.robot.n} finite numbers, one for '
                             'each joint')
        self._aiming.leave_path()
        self._smoothing.take_over(dq, dt)
        self._observer.commanded(dq, dt)
        self._last = LastTick.at_rest(self.robot)._replace(
            dq=self._smoothing.latest, rush=last.rush - dt)

    def missed(self, ticks: int) -> None:
        """Note that ticks did not take place, and the arm went on by its latest velocity.

        Its path and its way have gone on with it. One that takes positions waits instead.

        Args:
            ticks: how many, each as long as the latest was to be.

        Raises:
            StateError: that is no whole number, or below 0.
        """
        if not isinstance(ticks, (int, np.integer)) or ticks < 0:
            raise StateError(f'ticks is {shown(ticks)}; it takes a whole number, 0 or more')
        if ticks:
            self._last = self._last._replace(reference=self._aiming.missed(
                self._last, self._observer.went_on(ticks)))

    def _posture(self, measured: Array, dt: float) -> Array:
        """Return where the arm will be once all that was planned has been carried out (n,).

        Where clearance could not be kept, jerk gives way: what is planned is commanded as it is.
        """
        posture = self._smoothing.begin(
            self._observer.sense(self.robot.checked_posture(measured), dt), self._limits, dt,
            at_once=self._last.rush > 0.0)
        if self._smoothing.latest is not self._last.dq:  # another mean has taken over
            self._last = self._last._replace(dq=self._smoothing.latest)
        return posture
