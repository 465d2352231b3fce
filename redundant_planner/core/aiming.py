"""Aiming a tick: at a target, back to the path, out of the course of what moves, or ahead."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.commands import Asked, Commands
from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.horizon.evasive_plan import Aside, EvasivePlan
from redundant_planner.core.horizon.look_ahead import LookAhead, MOST_OBSTACLES
from redundant_planner.core.horizon.preview import Preview, TwistAhead
from redundant_planner.core.modes import (
    Aim,
    AlongPath,
    ByJoints,
    LastTick,
    Mode,
    Path,
    SteppingAside,
)
from redundant_planner.core.obstacles.nearby import Surroundings
from redundant_planner.core.obstacles.watch import ObstacleWatch
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.redundancy.reference import Start
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.own_barriers import OwnBarriers
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.safety.stages import Filtered
from redundant_planner.core.target.coming_back import ComingBack
from redundant_planner.core.target.goal import Target
from redundant_planner.core.target.progress import Progress
from redundant_planner.core.target.way import Way
from redundant_planner.core.tick import Wish

Array = npt.NDArray[np.float64]

# What is said while the arm is on a free way back to its path.
_BACK = 'the arm comes back to its path'


class Aiming:
    """Where one arm is led, from tick to tick.

    Between ticks it remembers the joint path ahead (`LookAhead`), the way to the target (`Way`),
    the joint path past what moves (`EvasivePlan`), and whether the arm has to come back from
    there (`ComingBack`).
    """

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, constants: RobotConstants,
        gains: Gains, limits: Limits, commands: Commands, own: OwnBarriers, *, filtered: bool,
        before: Aiming | None,
    ) -> None:
        """Prepare for an arm.

        Args:
            robot, parameters: the arm and its planner's.
            constants, gains, limits: made of these.
            commands: of the tips.
            own: the user's barriers.
            filtered: whether the safety filter acts.
            before: with other parameters; ways to targets go on where they have got to.
        """
        p = parameters
        self._robot, self._commands = robot, commands
        self._along_path = AlongPath(robot, p, constants, gains, commands, filtered=filtered)
        self._look_ahead = LookAhead(robot, p, limits, constants, gains)
        known = None if before is None else before._way
        self._way: Way = Way(robot, p, limits, constants, gains, before=known,
                             coupling=commands.coupling, own=own)
        self._is_led: bool = before is not None and before._is_led  # to a target
        self._by_joints: bool = before is not None and before._by_joints  # in the last tick
        self._back = ComingBack(robot, constants)
        self._evasive = EvasivePlan(robot, constants, limits, gains)
        self._evades = (
            filtered and p.path_priority != 'strict' and p.clearance_evasion_horizon > 0.0)
        self._switches = filtered and p.method == 'dynamic_factor'
        self._needs_path = p.method == 'variational'

    def reset(self) -> None:
        """Forget everything: the arm stands where it is found."""
        self._look_ahead.reset()
        self.forget_target()
        self._way.forget_past()
        self._by_joints = False
        self._back.reset()
        self._evasive.reset()

    def forget_target(self) -> None:
        """Forget the way to the target."""
        self._way.reset()
        self._is_led = False

    def leave_path(self) -> None:
        """Forget that the arm has to come back to a path."""
        self._back.reset()
        self._by_joints = False

    @property
    def guided(self) -> float:
        """Share of the null-space motion that follows the joint path ahead."""
        return self._look_ahead.guided

    def catch_up(self, *, chose: bool) -> bool:
        """Improve the joint paths ahead, and think about a free way, where that is due.

        Args:
            chose: whether obstacles have been chosen anew.

        Returns:
            Whether it did one of these.
        """
        looked_ahead, thought = self._look_ahead.catch_up(chose), self._way.catch_up()
        return self._evasive.catch_up() or looked_ahead or thought

    def aim(
        self, start: Start, asked: Asked, around: Surroundings, watch: ObstacleWatch,
        ahead: Preview | TwistAhead | None, last: LastTick, delay: float,
    ) -> Aim:
        """Return where a tick is to lead: to a target, back to the path, or along the command.

        Args:
            start: of the tick, with the twist as its command.
            asked: what it is asked for, of all tips.
            around: the obstacles near the arm.
            watch: what chose them.
            ahead: see `Planner.step`.
            last: what the tick before left.
            delay: of the commands behind what is planned [s].
        """
        target, commanded, motion, says = asked.target, asked.moves, None, ''
        goal: Target | None = self._back.target if target is None else target
        if target is not None:
            self._back.reset()
        if goal is None and self._is_led:
            self.forget_target()
        if goal is not None:
            self._is_led = True
            command, ahead, motion = self._way.aim(
                start, goal, self._robot.full_twist(last.followed), delay, watch.everywhere,
                asked.news, free=target is None)
            start, commanded = start._replace(command=command), bool(command.any())
            says = '; '.join(filter(None, (_BACK if target is None else '', self._way.lacks)))
        start = self._commands.spread(start)
        if motion is not None:
            self._evasive.reset()
            self._look_ahead.reset()
            return Aim(ByJoints(motion), start._replace(reference=start.arm.tips), commanded,
                       None, 0.0, '', says)
        aside = self._aside(start, around, watch)
        path = self._look_ahead.velocity(
            start, around.ahead, ahead, busy=aside is not None,
            chose=watch.chose, chose_ahead=watch.chose_ahead)
        guided = 0.0 if path is None else self._look_ahead.guided
        mode: Mode = self._along_path
        if aside is not None and aside.leaves:
            mode = SteppingAside(aside, self._along_path, self._robot)
        elif aside is not None:
            path, guided = aside.velocity, 1.0
        return Aim(mode, start, commanded, path, guided,
                   aside.course if aside is not None and aside.leaves else '', says)

    def _aside(
        self, start: Start, around: Surroundings, watch: ObstacleWatch,
    ) -> Aside | None:
        """Return how to get out of the way of what moves."""
        if self._evades and watch.fastest > 0.0:
            return self._evasive.aside(start, around)
        self._evasive.reset()
        return None

    def switch(self, aim: Aim, desired: Wish, around: Surroundings, watch: ObstacleWatch) -> bool:
        """Have dynamic_factor follow the joint path ahead while it is blocked itself.

        Returns:
            Whether it would have to, but among too many obstacles for a path to be planned.
        """
        if not self._switches or isinstance(aim.mode, ByJoints):
            return False
        moves = watch.fastest > 0.0
        blocked = desired.blocked and (aim.commanded or moves)
        crowded = blocked and len(around.near) > MOST_OBSTACLES
        self._look_ahead.switch(blocked and not crowded, aim.start.dt, at_once=moves)
        return crowded

    def fallbacks(self, aim: Aim, *, crowded: bool) -> list[str]:
        """Say where there is no joint path ahead, or only a part of the work for it was done."""
        said = []
        if self._needs_path and aim.path is None and not isinstance(aim.mode, ByJoints):
            said.append('there is no joint path ahead: dynamic_factor steps in')
        if crowded:
            said.append(f'no joint path is planned among more than {MOST_OBSTACLES} obstacles')
        if self._look_ahead.cut_short:
            said.append('the joint path ahead was improved in part')
        return said

    def note(
        self, aim: Aim, result: Filtered, desired: Wish, last: LastTick, *, by_target: bool,
    ) -> Path:
        """Note how a tick went, and return what came of the tip's path.

        Args:
            aim, result, desired: of the tick.
            last: what the one before left.
            by_target: whether a target commands.
        """
        start, dt = aim.start, aim.start.dt
        path = aim.mode.after(result, desired, start, last)
        self._by_joints = isinstance(aim.mode, ByJoints)
        if self._by_joints or self._way.is_along_chunk:
            self._way.went_on(result, dt)
        leaving = result.stage in (Stage.YIELDING, Stage.FORCED)
        if result.stage is Stage.SLIDING:  # as commanded, which no free way back overrules
            self._back.reset()
        if not by_target and (leaving or self._back.is_away):
            tips = start.arm.tips
            if self._back.note(last.reference or tips, tips, path.followed, dt, leaving=leaving,
                               lost=bool(self._way.lacks)):
                path = path._replace(reached=None)
        self._look_ahead.note(result.scale, dt)
        return path

    def missed(self, last: LastTick, seconds: float) -> Poses | None:
        """Note that ticks did not take place, in which the arm went on as in the last one.

        Args:
            last: what that has left.
            seconds: how long they would have taken.

        Returns:
            Where the tips should be by now; None for where they are.
        """
        self._way.missed(seconds, by_joints=self._by_joints)
        self._back.missed(last.followed, seconds)
        return self._along_path.went_on(last, seconds)

    def progress(self, target: Target, arm: Kinematics) -> Progress:
        """Return how far the arm is on its way to a target."""
        return self._way.progress(target, arm)
