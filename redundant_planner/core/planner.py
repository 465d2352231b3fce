"""One tick of the planner: state, command and scene in, joint velocity out.

`Planner.step` is the only composition in the package. It senses, aims, wishes, guards and
remembers; each of these is an object or a function of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from operator import is_not
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.constants import gains_of, joint_weights, limits_of, robot_constants
from redundant_planner.core.errors import known, ParameterError, PlannerError, shown, StateError
from redundant_planner.core.horizon.evasive_plan import Aside, EvasivePlan
from redundant_planner.core.horizon.look_ahead import LookAhead, MOST_OBSTACLES
from redundant_planner.core.horizon.preview import Preview, TwistAhead
from redundant_planner.core.kernels import Indices
from redundant_planner.core.machine_code.packed import Packed
from redundant_planner.core.obstacles.clearance import pseudo_distance
from redundant_planner.core.obstacles.contacts import AllowedContacts, Contact, contacts
from redundant_planner.core.obstacles.nearby import Surroundings
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.watch import ObstacleWatch
from redundant_planner.core.own_rules import Barrier, checked_rules, Criterion
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.redundancy.command import limited_twists
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.redundancy.own_criteria import OwnCriteria
from redundant_planner.core.redundancy.reference import followed_poses, reference_of, Start, Task
from redundant_planner.core.robot.joint_observer import JointObserver
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import checked_pose, Pose, Poses, poses_error, turned
from redundant_planner.core.safety.barriers import (
    barrier_bounds,
    Barriers,
    barriers_in,
    room_for_rows,
    with_rows,
    without_null_space,
)
from redundant_planner.core.safety.jerk import reversal_time, Smoothing
from redundant_planner.core.safety.limits import braked, slowed_limits, stopping_time
from redundant_planner.core.safety.own_barriers import OwnBarriers, OwnRows
from redundant_planner.core.safety.reasons import reason_for
from redundant_planner.core.safety.slow_down import SlowDown
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.safety.stages import Filtered, Request, safe_velocity
from redundant_planner.core.safety.way_out import LastWayOut
from redundant_planner.core.step_result import Nearest, OwnValue, StepResult, TipResult
from redundant_planner.core.target.coming_back import ComingBack
from redundant_planner.core.target.free_way import JointMotion
from redundant_planner.core.target.goal import checked_target, poses_of_tips, Target, TipTargets
from redundant_planner.core.target.moving_target import checked_news, Sighting
from redundant_planner.core.target.way import Way
from redundant_planner.core.tick import Setup, Wish, wish, World

Array = npt.NDArray[np.float64]

# The mean that keeps the jerk limits takes as many ticks as there are in up to a second [s].
_SHORTEST_TICK, _LONGEST_TICK = 1e-4, 10.0
# What is said while the arm is on a free way back to its path, and where jerk is not limited.
_BACK = 'the arm comes back to its path'
_JERK_GIVES_WAY = 'jerk gives way to a clearance'
# Stages that keep every clearance with the path kept: they may be those of a slower arm.
_SLOWER_STAGES = (Stage.SCALED, Stage.SLIDING, Stage.BRAKING)
# Stages that tell how much of a command can be followed.
_ON_PATH = (*_SLOWER_STAGES, Stage.STOPPED)
# Fastest joint of an arm that moves gently [rad/s, m/s].
_GENTLE = 0.05
# How fast the reference pose catches up with a tip that evades along the path [1/s].
_CATCHING_UP = 5.0
# Null-space motion serves a tip that moves. Where less than this share of the command has been
# followed lately, which is a mean over so long [s], there is less of it: an arm that cannot go on
# comes to rest. A little is left, for when it can again.
_HARDLY, _LATELY, _LEAST_SHARE = 0.3, 0.3, 1e-4
# Below this part of that share the filter is asked for less than the whole command, too.
_FAINT = 0.01
# Share of the acceleration limits that coupled tips use but to brake.
_COUPLED_ACCELERATION = 0.7
# How long clearance goes before jerk after a tick in which it could not be kept [s].
_RUSH = 0.1


# By how much the gain is higher along a way of the joints: it is low for a null space that turns
# away early, and there is none. With more than that, arms are not faster.
_ALONG_WAYS = 2.0


class _LastTick(NamedTuple):
    """What one tick leaves to the next.

    Attributes:
        dq: (n,) the velocity that it planned.
        reference: poses that the tips should have now; None after a reset, for their own.
        followed: (m,) the part of the path that was followed.
        leaving: whether the arm is leaving its path to evade something.
        rush: for how long clearance still goes before jerk [s].
        share: of the command that has been followed lately.
        slid: whether the tip turned aside from something at rest.
    """

    dq: Array
    reference: Poses | None
    followed: Array
    leaving: bool
    rush: float
    share: float
    slid: bool

    @property
    def worth(self) -> float:
        """Share of the null-space motion that is worth its while."""
        return min(max(self.share, _LEAST_SHARE) / _HARDLY, 1.0)


class _Aim(NamedTuple):
    """Where a tick is to lead.

    Attributes:
        start: of the tick.
        commanded: whether the tip is to move.
        joints: what the joints are to do on a free way; None where the tip keeps to a path.
        aside: out of the way of what moves; None where there is no need, or no way.
        path: (n,) velocity of the joint path ahead; None where there is none.
        guided: share of the null-space motion that follows it.
        says: the part of the reason that tells of it.
    """

    start: Start
    commanded: bool
    joints: JointMotion | None
    aside: Aside | None
    path: Array | None
    guided: float
    says: str


def _check_tick(dt: float) -> None:
    if not dt >= _SHORTEST_TICK:
        raise StateError(f'dt is {dt}; it must be {_SHORTEST_TICK:g} s or longer')
    if dt > _LONGEST_TICK:
        raise StateError(f'dt is {dt}; it must be {_LONGEST_TICK:g} s or shorter')


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
        self._controlled = robot.full_twist(np.ones(robot.m))
        # Each tip has a share of the commanded speed of its own.
        self._share_of_tips = robot.rows // 6 if len(robot.tips) > 1 else None
        self._given_tips: tuple[TipTargets, Poses] | None = None
        self._coupling: Coupling | None = None
        self._last = self._at_rest()
        self._smoothing = Smoothing(
            robot.n, reversal_time(robot.acceleration_max, robot.jerk_max) if filtered else 0.0)
        self._observer = JointObserver(robot.n, 0.0, 0.0)
        self._parameters, self._margin_grew = parameters, False
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
        robot = self.robot
        weights, limits = joint_weights(robot, parameters), limits_of(robot, parameters)
        if self._coupling is not None:
            limits = limits._replace(
                acceleration_max=_COUPLED_ACCELERATION * limits.acceleration_max)
        constants, gains = robot_constants(robot, parameters), gains_of(parameters)
        watch = ObstacleWatch(robot, parameters, limits, constants, gains)
        slow_down = SlowDown(robot, parameters.slow_down)
        # Nothing has changed where one of these refused the parameters.
        self._margin_grew = self._margin_grew or (
            parameters.clearance_margin > self._parameters.clearance_margin)
        self._parameters, self._weights, self._limits = parameters, weights, limits
        self._constants, self._gains = constants, gains
        self._setup = Packed.of(Setup(
            constants, limits, gains, room_for_rows(constants, len(robot.tips))))
        self._look_ahead = LookAhead(
            robot, parameters, self._limits, self._constants, self._gains)
        self._way = Way(robot, parameters, limits, constants, gains, getattr(self, '_way', None),
                        self._coupling, self._own_barriers)
        self._back = ComingBack(robot, constants)
        self._evasive = EvasivePlan(robot, constants, limits, gains)
        self._way_out = LastWayOut(robot, constants, limits, parameters.singularity_margin)
        self._watch, self._slow_down = watch, slow_down
        drive = parameters.drive_lag, parameters.drive_dead_time
        if drive != (self._observer.lag, self._observer.dead_time):
            self._observer = JointObserver(robot.n, *drive)

    def hold(self, things: Iterable[Obstacle]) -> None:
        """Make what the hand holds a part of the arm, from the next tick on, and it alone.

        It is kept from all but the links that move along with the tip.

        Args:
            things: their shapes at rest in the tip's frame; none to let go of all.

        Raises:
            ObstacleError: they cannot be held; the arm is as before then.
        """
        before, self.robot = self.robot, self.robot.holding(things)
        try:
            self.parameters = self._parameters
        except PlannerError:
            self.robot = before
            raise

    @property
    def coupling(self) -> Coupling | None:
        """How tips hold an object together; None where each moves on its own."""
        return self._coupling

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
        robot, due = self.robot, self._last.reference
        if len(robot.tips) < 2 or robot.m < 6 * len(robot.tips):
            raise StateError(f"'{robot.name}' has {robot.m} controlled axes of the tips "
                             f'{known(robot.tips)}; to couple takes two tips with six axes each')
        if q is not None:
            due = robot.kinematics(q).tips
        if due is None:
            raise StateError('the tips cannot be coupled before a tick has told where they are, '
                             'or after a way of the joints; give q')
        self._set_coupling(Coupling.of(due, None if held is None else checked_pose(held)))

    def uncouple(self) -> None:
        """Let each tip move on its own again."""
        self._set_coupling(None)

    def _set_coupling(self, coupling: Coupling | None) -> None:
        self._coupling = coupling
        self._way.reset()
        self.parameters = self._parameters

    def contacts(self, q: Array, scene: Scene | Sequence[Obstacle]) -> tuple[Contact, ...]:
        """Return which links touch which obstacles at a posture (n,), and whether they may.

        Raises:
            StateError: `q` does not have n finite entries.
        """
        return contacts(
            self.robot, self.robot.kinematics(q), self._scene_of(scene),
            AllowedContacts(self._parameters.allowed_contacts, self.robot))

    @property
    def _share_of(self) -> Indices | None:
        """Which share of the speed each controlled axis goes with; None for one share."""
        return self._share_of_tips if self._coupling is None else None

    def reset(self) -> None:
        """Forget the last velocity and the reference pose: the arm stands where it is found."""
        self._last = self._at_rest()
        self._smoothing.reset()
        self._observer.reset()
        self._look_ahead.reset()
        self._way.reset()
        self._back.reset()
        self._evasive.reset()
        self._way_out.forget()
        self._watch.reset()

    def _scene_of(self, given: Scene | Sequence[Obstacle]) -> Scene:
        """Return obstacles as a scene: the same one for the same obstacles."""
        if isinstance(given, Scene):
            return given
        things = tuple(given)
        if len(things) != len(self._given[0]) or any(map(is_not, things, self._given[0])):
            self._given = things, Scene.of(things)
        return self._given[1]

    def _of_tips(self, target: TipTargets, due: Poses, command: Array) -> Poses:
        """Return the poses that tips shall go to; the others stay where they are due.

        A tip that a twist moves is due somewhere else in each tick; its target takes the twist
        out of the command (6 t,).
        """
        aimed = [target.get(tip) is not None for tip in self.robot.tips]
        command.reshape(-1, 6)[aimed] = 0.0
        known = self._given_tips
        if known is None or known[0] is not target or command.any():
            before = due if known is None or known[0] is not target else known[1]
            others = Poses.of(*(
                now if part.any() else pose for now, pose, part in zip(
                    due.each, before.each, command.reshape(-1, 6))))
            known = self._given_tips = target, poses_of_tips(target, self.robot, others)
        return known[1]

    def _of_object(
        self, coupling: Coupling, target: Target | TipTargets,
    ) -> Poses:
        """Return the poses of coupled tips where their object is at a target."""
        return coupling.tips(self._of_first(coupling, target)[self.robot.tips[0]])

    def _of_first(
        self, coupling: Coupling, target: Target | TipTargets,
    ) -> dict[str, Pose]:
        """Return the pose of the tip that leads where the object is at a target."""
        if not isinstance(target, Pose):
            raise StateError('the tips are coupled: the target has to be a pose of their object')
        return {self.robot.tips[0]: coupling.first_at(checked_pose(target))}

    def _tip_results(
        self, poses: Poses, desired: Wish, result: Filtered,
    ) -> tuple[TipResult, ...]:
        """Return what a tick decided about each of several tips."""
        tips = len(self.robot.tips)
        if tips == 1:
            return ()
        shares = np.full(tips, result.scale) if result.scales is None else result.scales
        errors = desired.task.error.reshape(tips, 6)
        return tuple(TipResult(pose, errors[t].copy(), float(shares[t]))
                     for t, pose in enumerate(poses.each))

    def _at_rest(self) -> _LastTick:
        return _LastTick(
            np.zeros(self.robot.n), None, np.zeros(self.robot.m), False, 0.0, 1.0, False)

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
        return self._look_ahead.guided

    def prepare(self, scene: Scene | Sequence[Obstacle]) -> bool:
        """Do a part of the next `step` ahead of it, where there is time for that.

        It chooses from many obstacles, and improves the joint paths ahead. The next step becomes
        shorter by that, and nothing else changes.

        Returns:
            Whether it improved a path, which takes longer than most ticks.
        """
        chose = self._watch.prepare(self._scene_of(scene), self._last.dq)
        looked_ahead = self._look_ahead.catch_up(chose)
        return self._evasive.catch_up() or looked_ahead

    def step(
        self, q: Array, twist: Array, scene: Scene | Sequence[Obstacle], dt: float,
        ahead: Preview | TwistAhead | None = None,
        target: Target | TipTargets | None = None, *,
        news: Sequence[Sighting] = (), gently: bool = False,
    ) -> StepResult:
        """Return the joint velocity for the next `dt`.

        Args:
            q: (n,) measured joint positions [rad, m]. They may be late, as `drive.lag` and
                `drive.dead_time` say, and noisy.
            twist: (6,) commanded tip twist in the command frame [m/s, rad/s]; entries of axes
                that are not controlled do not count. Of an arm with t tips (t, 6).
            scene: the obstacles. Pass the same object, or the same obstacles, while nothing
                changes.
            dt: time until the next tick [s].
            ahead: what will be commanded, for the joint path ahead: a preview that starts now
                (`Preview.ahead` for one that started earlier), or a function of times from now
                (N + 1,) [s] that returns the mean twists (N, 6) from each to the next. Without
                it the planner takes the present command as held.
            target: where to go, as fast as the limits allow: a pose of the tip, or joint positions
                (n,) [rad, m]; or a chunk of either, to follow in its time: the same object in each
                tick while it holds. Of an arm with several tips, tip → its pose, or joint
                positions; tips without a pose follow their twist, or stay where they are. None to
                follow the twist. Of tips with a target `twist` and `ahead` do not count.
            news: all targets that came since the last step, `target` the last of them, with the
                ages of their stamps: of a stream whose messages come late or several at once.
                Where it is empty, one came if `target` is another than in the last step.
            gently: whether the arm is only to show that it follows: no joint is asked to be
                faster than 0.05 rad/s or m/s.

        Raises:
            StateError: `q`, `twist`, `ahead`, `target` or `news` does not fit, or `dt` is not
                within 1e-4 to 10 s.
        """
        # Sense: where the arm is, and the obstacles near it.
        coupled = self._coupling is not None
        command, commanded = limited_twists(
            twist, self._controlled[:6] if coupled else self._controlled,
            *self._parameters.twist_speeds)
        _check_tick(dt)
        scene = self._scene_of(scene)
        if not isinstance(target, Mapping | None) and not coupled:
            target = checked_target(target, self.robot)
        arm = self.robot.kinematics_at(self._posture(q, dt))
        poses, last = arm.tips, self._last
        due = last.reference or poses
        if self._coupling is not None:
            due = self._coupling.tips(due.first)
            command = self._coupling.first_twist(command, due.first, in_tool=self.robot.in_tool)
            if target is not None:
                target = self._of_object(self._coupling, target)
                news = [Sighting(self._of_first(self._coupling, seen.target), seen.age)
                        for seen in news]
        elif isinstance(target, Mapping):
            target = self._of_tips(target, due, command)
        news = checked_news(news, target, self.robot)
        around = self._watch.look(scene, arm, last.dq, dt)

        # Aim: at the target, out of the course of what moves, and along the joint path ahead.
        aim = self._aim(Start(arm, due, command, last.dq, dt),
                        commanded, around, ahead, target, news)
        start, joints = aim.start, aim.joints

        # Wish: ẋ and J⁺ẋ + k P∇H, Eqs. 1, 2 and 18.
        world = World(
            around.maps, around.start, around.end, around.range,
            last.dq if aim.path is None else aim.path, aim.guided, last.worth,
            self._observer.strayed, self._own_criteria.gradient(arm))
        desired = wish(start, world, self._setup)

        # Guard: every limit and barrier, docs/safety.md.
        crowded = joints is None and self._switch(desired, around, aim.commanded, dt)
        wanted, least_norm, homogeneous = desired.motions
        leaves, reason = aim.aside is not None and aim.aside.leaves, ''
        if joints is not None:
            wanted = joints.wanted
        elif aim.aside is not None and leaves:
            wanted = aim.aside.velocity
        result, share, slower, possible = Filtered.untouched(wanted), 1.0, '', 1.0
        if self._filtered and not leaves:
            share, slower = self._slow_down.share(wanted, scene, arm)
            if gently:
                share = min(share, _GENTLE / max(float(np.abs(wanted).max()), _GENTLE))
        own = self._own_rows(start) if self._filtered and self._own_barriers.barriers else None
        if own is not None and own.broken:
            result = self._braking(start)
            possible, reason = result.scale, (
                f'{result.stage.value}: {known(own.broken)} is not a finite number')
        elif self._filtered and (
                joints is not None or leaves or share < 1.0 or not desired.admissible or not (
                    own is None or self._keeps(wanted, own, dt))):
            barriers = barriers_in(self._setup.value.rows, desired.rows_used)
            if own is not None:
                barriers = with_rows(barriers, own.barriers)
            result = self._filter(desired, wanted, barriers, start, joints, share, leaves=leaves)
            if share < 1.0 and result.stage not in _SLOWER_STAGES:
                # A clearance that asks for a faster arm goes first.
                share, slower = 1.0, ''
                result = self._filter(
                    desired, wanted, barriers, start, joints, share, leaves=leaves)
            reason = self._reason(result, barriers, around, aim)
            if result.stage in _ON_PATH and joints is None:
                possible = self._possible(result, start.command)
            result = result._replace(
                scale=share * result.scale,
                scales=None if result.scales is None else share * result.scales)
        fallbacks = '; '.join(self._fallbacks(
            result, desired, aim.path is None and joints is None, crowded))
        jerk_kept = self._smoothing.keeps_jerk
        reasons = (fallbacks, aim.says, slower, reason, '' if jerk_kept else _JERK_GIVES_WAY)

        # Remember: where the tip should be, and how fast the arm is.
        self._remember(result, possible, desired, start, joints is not None, target is not None)
        return StepResult(
            self._smoothing.sent.copy(), least_norm, homogeneous, desired.factor,
            result.scale, result.stage, '; '.join(filter(None, reasons)), fallbacks,
            desired.clearance_index, self._nearest(desired, around),
            desired.manipulability, poses.first, desired.task.error[:6], jerk_kept,
            None if target is None else self._way.progress(target, arm),
            self._tip_results(poses, desired, result),
            () if own is None and not self._own_criteria.values else self._own_values(own))

    def _own_rows(self, start: Start) -> OwnRows:
        """Return what the user's barriers ask of a tick."""
        return self._own_barriers.rows(
            start, self._limits, self._parameters.clearance_gain, self._constants.scaling,
            self._smoothing.corner, self._observer.strayed)

    def _keeps(self, dq: Array, own: OwnRows, dt: float) -> bool:
        """Return whether a velocity (n,) keeps the user's barriers."""
        stop = stopping_time(self._last.dq, self._limits.acceleration_max) + dt
        bounds = barrier_bounds(own.barriers, self._parameters.clearance_gain, stop, dt)
        return bool((own.barriers.gradient @ dq >= bounds).all())

    def _braking(self, start: Start) -> Filtered:
        """Return a velocity with which all joints slow down in proportion."""
        slower = braked(start.previous, self._limits.acceleration_max, start.dt)
        before = float(np.abs(start.previous).max())
        return Filtered.untouched(slower)._replace(
            scale=0.0, residual=float(np.abs(slower).max()) / before if before else 0.0,
            stage=Stage.BRAKING)

    def _own_values(self, own: OwnRows | None) -> tuple[OwnValue, ...]:
        """Return what the user's barriers and criteria came to."""
        values = () if own is None else tuple(
            OwnValue(barrier.name, value)
            for barrier, value in zip(self._own_barriers.barriers, own.values))
        return values + self._own_criteria.values

    def _aim(
        self, start: Start, commanded: bool, around: Surroundings,
        ahead: Preview | TwistAhead | None, target: Target | None, news: Sequence[Sighting],
    ) -> _Aim:
        """Return where a tick is to lead: to a target, back to the path, or along the command.

        Args:
            start: of the tick, with the twist as its command.
            commanded: whether that commands something.
            around: the obstacles near the arm.
            ahead, target, news: see `step`.
        """
        joints: JointMotion | None = None
        goal, says = self._back.target if target is None else target, ''
        if target is not None:
            self._back.reset()
        if goal is None:
            self._way.reset()
        else:
            command, ahead, joints = self._way.aim(
                start, goal, self.robot.full_twist(self._last.followed),
                self._smoothing.delay, self._watch.everywhere, news, free=target is None)
            start, commanded = start._replace(command=command), bool(command.any())
            says = '; '.join(filter(None, (_BACK if target is None else '', self._way.lacks)))
        if self._coupling is not None:
            start = start._replace(command=self._coupling.twists(
                start.command[:6], start.reference_of(0), start.dt, in_tool=self.robot.in_tool))
        aside = self._evade(start, around, by_joints=joints is not None)
        if joints is None:
            path = self._look_ahead.velocity(
                start, around.ahead, ahead, busy=aside is not None,
                chose=self._watch.chose, chose_ahead=self._watch.chose_ahead)
            guided = 0.0 if path is None else self._look_ahead.guided
            if aside is not None and not aside.leaves:
                path, guided = aside.velocity, 1.0
            return _Aim(start, commanded, None, aside, path, guided, says)
        # What the joints do is given: the tip's path is not kept, nor its null space used.
        self._look_ahead.reset()
        there = start._replace(reference=start.arm.tips)
        return _Aim(there, commanded, joints, None, None, 0.0, says)

    def _remember(
        self, result: Filtered, possible: float, desired: Wish, start: Start, by_joints: bool,
        by_target: bool,
    ) -> None:
        """Note how a tick went.

        Args:
            result: of the tick.
            possible: share of the command that could be followed, by an arm that nothing slows.
            desired, start: of the tick.
            by_joints: whether the joints follow a way of theirs, rather than the tip its path.
            by_target: whether a target commands.
        """
        arm, last, dt = start.arm, self._last, start.dt
        if by_joints:
            followed, reached = arm.jacobian @ result.dq, None
            self._way.went_on(result, dt)
        else:
            followed, reached = self._followed(result, desired, start)
            if self._way.is_along_chunk:
                self._way.went_on(result, dt)
        leaving = result.stage in (Stage.YIELDING, Stage.FORCED)
        if result.stage is Stage.SLIDING:  # as commanded, which no free way back overrules
            self._back.reset()
        if not by_target and (leaving or self._back.is_away) and self._back.note(
                last.reference or arm.tips, arm.tips, followed, dt, leaving=leaving,
                lost=bool(self._way.lacks)):
            reached = None
        self._look_ahead.note(result.scale, dt)
        self._observer.commanded(self._smoothing.take(result.dq), dt)
        self._last = _LastTick(
            result.dq, reached, followed, leaving,
            _RUSH if result.stage is Stage.FORCED and desired.intruded and not (
                self._margin_grew and self._watch.fastest == 0.0) else last.rush - dt,
            last.share + (1.0 - math.exp(-dt / _LATELY)) * (possible - last.share),
            result.stage is Stage.SLIDING)
        # Where a margin has grown and nothing moves, jerk does not give way.
        self._margin_grew = self._margin_grew and desired.intruded

    def braked(self, dq: Array, dt: float) -> None:
        """Note that something else than the last step's velocity was commanded, to stop the arm.

        The next step goes on from there, and leaves the path that was followed.

        Args:
            dq: (n,) that velocity [rad/s, m/s].
            dt: how long it holds [s].

        Raises:
            StateError: `dq` or `dt` does not fit.
        """
        _check_tick(dt)
        dq, last = np.array(dq, dtype=float), self._last
        if dq.shape != (self.robot.n,) or not np.isfinite(dq).all():
            raise StateError(f'dq is {shown(dq)}; it takes {self.robot.n} finite numbers, one for '
                             'each joint')
        self._back.reset()
        self._smoothing.take_over(dq, dt)
        self._observer.commanded(dq, dt)
        self._last = self._at_rest()._replace(
            dq=self._smoothing.latest, rush=last.rush - dt)

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

    def _evade(
        self, start: Start, around: Surroundings, *, by_joints: bool,
    ) -> Aside | None:
        """Return how to get out of the way of what moves."""
        p = self._parameters
        evades = (self._watch.fastest > 0.0 and self._filtered and p.path_priority != 'strict'
                  and p.clearance_evasion_horizon > 0.0)
        if evades and not by_joints:
            return self._evasive.aside(start, around)
        self._evasive.reset()
        return None

    def _switch(
        self, desired: Wish, around: Surroundings, commanded: bool, dt: float,
    ) -> bool:
        """Have dynamic_factor follow the joint path ahead while it is blocked itself.

        Returns:
            Whether it would have to, but among too many obstacles for a path to be planned.
        """
        if self._parameters.method != 'dynamic_factor' or not self._filtered:
            return False
        blocked = desired.blocked and (commanded or self._watch.fastest > 0.0)
        crowded = blocked and len(around.near) > MOST_OBSTACLES
        self._look_ahead.switch(
            blocked and not crowded, dt, at_once=self._watch.fastest > 0.0)
        return crowded

    def _fallbacks(
        self, result: Filtered, desired: Wish, pathless: bool, crowded: bool,
    ) -> list[str]:
        """Say where there is no joint path ahead, and which bounds on its work a tick reached."""
        fallbacks = []
        if pathless and self._parameters.method == 'variational':
            fallbacks.append('there is no joint path ahead: dynamic_factor steps in')
        if crowded:
            fallbacks.append(
                f'no joint path is planned among more than {MOST_OBSTACLES} obstacles')
        for stage in result.cut_short:
            fallbacks.append(f'out of iterations where {stage.value}')
        if self._filtered and desired.unseen_share < 1.0:
            fallbacks.append('slower among more obstacles than a tick takes in: '
                             f'{math.floor(100.0 * desired.unseen_share)}% of the speed')
        if self._own_criteria.broken:
            fallbacks.append(
                f'without {known(self._own_criteria.broken)}, which is not a finite number')
        if self._look_ahead.cut_short:
            fallbacks.append('the joint path ahead was improved in part')
        return fallbacks

    def _filter(
        self, desired: Wish, wanted: Array, barriers: Barriers, start: Start,
        joints: JointMotion | None, share: float, *, leaves: bool,
    ) -> Filtered:
        """Return the admissible velocity nearest to a share of the wanted one (n,)."""
        p, task, limits = self._parameters, desired.task, self._limits
        jacobian, homogeneous = start.arm.jacobian, desired.motions[2]
        if desired.unseen_share < 1.0:
            limits = limits._replace(velocity_max=slowed_limits(
                start.previous, limits.velocity_max, limits.acceleration_max,
                desired.unseen_share, start.dt))
        if joints is not None or leaves:
            barriers = without_null_space(barriers)
        if joints is not None:
            request = joints.request(start.arm.q, start.previous)
        elif leaves:
            twist = jacobian @ wanted
            request = Request(wanted, np.zeros_like(wanted), jacobian, twist, twist,
                              np.zeros_like(twist), start.arm.q, start.previous)
        else:
            left_out = 1.0 - min(self._last.worth / _FAINT, 1.0)
            request = Request(
                wanted - left_out * desired.motions[1], homogeneous, jacobian,
                task.commanded + task.feedback, task.feedback, task.turning, start.arm.q,
                start.previous, self._share_of)
        if self._coupling is not None:
            request = self._coupled(self._coupling, request, start, task)
        if share < 1.0:
            request = request._replace(desired=share * wanted, twist=share * request.twist)
        result = safe_velocity(
            request, limits, barriers, weights=self._weights,
            gain=p.clearance_gain if joints is None else _ALONG_WAYS * p.clearance_gain,
            price=1.0 if joints is not None else self._last.worth, slides=self._last.slid,
            may_yield=leaves or (desired.intruded and p.path_priority != 'strict'),
            may_slide=p.path_priority == 'slide' and joints is None and not leaves and bool(
                start.command.any()), leaves=leaves, dt=start.dt)
        if leaves:
            result = result._replace(
                scale=self._share_on_path(jacobian @ result.dq, task), residual=0.0)
        return result

    def _coupled(
        self, coupling: Coupling, request: Request, start: Start, task: Task,
    ) -> Request:
        """Return a request in which the first tip leads, and the others keep their pose to it."""
        arm, turning = start.arm, task.turning.reshape(-1, 6)
        if self.robot.in_tool:
            turning = np.array([
                turned(part, rotation) for part, rotation in zip(turning, arm.tip_rotations)])
        off = poses_error(coupling.tips(arm.tips.first), arm.tips, False)
        rates = self._parameters.feedback_gain * off[6:]
        return request._replace(
            jacobian=np.vstack((request.jacobian[:6], coupling.rows(arm))),
            twist=np.concatenate((request.twist[:6], rates)),
            feedback=np.concatenate((request.feedback[:6], rates)),
            turning=np.concatenate((request.turning[:6], coupling.relative(turning.ravel(), arm))),
            share_of=np.repeat((0, 1), (6, len(rates))), path_axes=6,
            spare=1.0 / _COUPLED_ACCELERATION)

    def _possible(self, result: Filtered, command: Array) -> float:
        """Return the share of its command (6 t,) that the tip follows which is held up least.

        Null-space motion is worth its while as long as one tip gets on.
        """
        if result.scales is None:
            return result.scale
        moves = command.reshape(-1, 6).any(axis=1)
        return float(result.scales[moves].max(initial=0.0)) if moves.any() else result.scale

    def _share_on_path(self, twist: Array, task: Task) -> float:
        """Return the share of the command that a tip which leaves its path goes along it.

        Where the tip has got ahead of the reference pose, that catches up.

        Args:
            twist: (m,) of the tip.
            task: what the tip was to do.
        """
        commanded = task.commanded
        squared = float(commanded @ commanded)
        if squared == 0.0:
            return 1.0
        ahead = -float(self.robot.task_rows(task.error) @ commanded)
        share = (float(twist @ commanded) + _CATCHING_UP * ahead) / squared
        return min(max(share, 0.0), 1.0)

    def _followed(
        self, result: Filtered, desired: Wish, start: Start,
    ) -> tuple[Array, Poses]:
        """Return the part (m,) of the path that is followed, and the reference poses after it.

        Neither the feedback nor motion that yields is a part of it.
        """
        task, jacobian, constants = desired.task, start.arm.jacobian, self._constants
        if not self._filtered:
            followed = jacobian @ result.dq + task.turning - task.feedback
        elif result.stage is Stage.DESIRED:
            reached = desired.reached
            if self._coupling is not None:
                reached = self._coupling.tips(reached.first)
            return task.commanded, reached
        elif result.stage is Stage.SLIDING:  # the path goes on from where the tip gets to
            followed = jacobian @ result.dq + task.turning - task.feedback
        else:
            shares = (result.scale if result.scales is None or self._share_of is None else
                      result.scales[self._share_of])
            followed = shares * task.commanded + result.residual * self._last.followed
        reference = followed_poses(
            reference_of(start, constants, self._gains), followed, constants.rows,
            constants.in_tool, start.dt)
        if self._coupling is not None:
            reference = self._coupling.tips(reference.first)
        return followed, reference

    def _reason(
        self, result: Filtered, barriers: Barriers, around: Surroundings, aim: _Aim,
    ) -> str:
        """Say what holds the arm back."""
        start, aside = aim.start, aim.aside
        change = np.abs(result.dq - self._last.dq) / (start.dt * self._limits.acceleration_max)
        return reason_for(
            result, barriers, around, self.robot, change, start.arm.q, self._way_out,
            self._own_barriers.names, commanded=aim.commanded,
            course=aside.course if aside is not None and aside.leaves else '')

    def _nearest(self, desired: Wish, around: Surroundings) -> Nearest | None:
        if desired.nearest_link < 0:
            return None
        obstacle = desired.nearest_obstacle
        lead = self._parameters.clearance_lead * float(around.maps.speeds[obstacle])
        return Nearest(
            self.robot.capsules[desired.nearest_link].name,
            around.scene.names[around.near[obstacle]],
            pseudo_distance(desired.nearest_normalized_distance), desired.nearest_distance + lead)
