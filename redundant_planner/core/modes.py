"""The three ways in which a tick moves the arm: along the tip's path, by the joints, or aside.

Each says what it wants, what it asks of the safety filter, and what came of the path.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.commands import Commands
from redundant_planner.core.constants import Gains, RobotConstants
from redundant_planner.core.horizon.evasive_plan import Aside
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.redundancy.reference import followed_poses, reference_of, Start, Task
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.safety.stages import Filtered, Request
from redundant_planner.core.target.joint_motion import JointMotion
from redundant_planner.core.tick import Wish

Array = npt.NDArray[np.float64]

# How fast the reference pose catches up with a tip that evades along the path [1/s].
_CATCHING_UP = 5.0
# Null-space motion serves a tip that moves. Where less than this share of the command has been
# followed lately, there is less of it: an arm that cannot go on comes to rest. A little is left,
# for when it can again.
_HARDLY, _LEAST_SHARE = 0.3, 1e-4
# Below this part of that share the filter is asked for less than the whole command, too.
_FAINT = 0.01
# By how much the gain is higher along a way of the joints: it is low for a null space that turns
# away early, and there is none. With more than that, arms are not faster.
_ALONG_WAYS = 2.0


class LastTick(NamedTuple):
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

    @classmethod
    def at_rest(cls, robot: Robot) -> LastTick:
        """Return that of an arm that stands where it is found."""
        return cls(np.zeros(robot.n), None, np.zeros(robot.m), False, 0.0, 1.0, False)

    @property
    def worth(self) -> float:
        """Share of the null-space motion that is worth its while."""
        return min(max(self.share, _LEAST_SHARE) / _HARDLY, 1.0)


class Ask(NamedTuple):
    """What a mode asks of the safety filter.

    Attributes:
        request: what the tip and the joints shall do.
        gain: of the barriers, as a multiple of `clearance.gain`.
        price: of the twist, as a share of what it is worth at most.
        may_slide: whether the direction of the twist may give way, rather than its speed.
    """

    request: Request
    gain: float
    price: float
    may_slide: bool


class Path(NamedTuple):
    """What came of the tip's path.

    Attributes:
        followed: (m,) the part of it that was followed.
        reached: reference poses after it; None for the tips' own.
    """

    followed: Array
    reached: Poses | None


class AlongPath:
    """The tip keeps to its path, Eqs. 1 and 2.

    Attributes:
        keeps_path: whether a mode keeps the tip to its path.
        leaves: whether it takes the arm away from there to evade something.
    """

    keeps_path, leaves = True, False

    def __init__(
        self, robot: Robot, parameters: PlannerParameters, constants: RobotConstants,
        gains: Gains, commands: Commands, *, filtered: bool,
    ) -> None:
        """Prepare for an arm.

        Args:
            robot, parameters: the arm and its planner's.
            constants, gains: made of these.
            commands: of the tips.
            filtered: whether the safety filter acts.
        """
        self._constants, self._gains, self._commands = constants, gains, commands
        self._filtered, self._slides = filtered, parameters.path_priority == 'slide'

    def wanted(self, desired: Wish) -> Array:
        """Return the velocity (n,) that is wanted."""
        return desired.motions[0]

    def ask(self, wanted: Array, desired: Wish, start: Start, last: LastTick) -> Ask:
        """Return what is asked of the filter.

        Args:
            wanted: (n,) the velocity.
            desired, start: of the tick.
            last: what the one before left.
        """
        task = desired.task
        left_out = 1.0 - min(last.worth / _FAINT, 1.0)
        return Ask(Request(
            wanted - left_out * desired.motions[1], desired.motions[2], start.arm.jacobian,
            task.commanded + task.feedback, task.feedback, task.turning, start.arm.q,
            start.previous, self._commands.share_of, self._commands.order),
            1.0, last.worth, self._slides and bool(start.command.any()))

    def rated(self, result: Filtered, desired: Wish, start: Start) -> Filtered:
        """Return a result with the share of the command that it follows."""
        return result

    def after(self, result: Filtered, desired: Wish, start: Start, last: LastTick) -> Path:
        """Return what came of the path.

        Neither the feedback nor motion that yields is a part of it.
        """
        task, commands = desired.task, self._commands
        if not self._filtered or result.stage is Stage.SLIDING:
            # The path goes on from where the tip gets to.
            return self._after(
                start.arm.jacobian @ result.dq + task.turning - task.feedback, start)
        if result.stage is Stage.DESIRED:
            return Path(task.commanded, commands.led(desired.reached))
        shares = (result.scale if result.scales is None or commands.share_of is None else
                  result.scales[commands.share_of])
        return self._after(shares * task.commanded + result.residual * last.followed, start)

    def went_on(self, last: LastTick, seconds: float) -> Poses | None:
        """Return the reference poses after time in which the path was followed as before."""
        if last.reference is None:
            return None
        constants = self._constants
        return self._commands.led(followed_poses(
            last.reference, last.followed, constants.rows, constants.in_tool, seconds))

    def _after(self, followed: Array, start: Start) -> Path:
        constants = self._constants
        return Path(followed, self._commands.led(followed_poses(
            reference_of(start, constants, self._gains), followed, constants.rows,
            constants.in_tool, start.dt)))


class ByJoints:
    """The joints follow a way of theirs: the tip's path is not kept, nor its null space used."""

    keeps_path, leaves = False, False

    def __init__(self, motion: JointMotion) -> None:
        """Take what they are to do."""
        self._motion = motion

    def wanted(self, desired: Wish) -> Array:
        """Return the velocity (n,) that is wanted."""
        return self._motion.wanted

    def ask(self, wanted: Array, desired: Wish, start: Start, last: LastTick) -> Ask:
        """Return what is asked of the filter; see `AlongPath`."""
        return Ask(self._motion.request(start.arm.q, start.previous), _ALONG_WAYS, 1.0, False)

    def rated(self, result: Filtered, desired: Wish, start: Start) -> Filtered:
        """Return a result with the share of the way that it follows."""
        return result

    def after(self, result: Filtered, desired: Wish, start: Start, last: LastTick) -> Path:
        """Return what came of the path: it goes on from where the tip is."""
        return Path(start.arm.jacobian @ result.dq, None)


class SteppingAside:
    """The arm leaves its path before what moves gets there, and takes its time from the path."""

    keeps_path, leaves = False, True

    def __init__(self, aside: Aside, path: AlongPath, robot: Robot) -> None:
        """Take the way aside, and the path that it leaves."""
        self._aside, self._path, self._robot = aside, path, robot

    def wanted(self, desired: Wish) -> Array:
        """Return the velocity (n,) that is wanted."""
        return self._aside.velocity

    def ask(self, wanted: Array, desired: Wish, start: Start, last: LastTick) -> Ask:
        """Return what is asked of the filter; see `AlongPath`."""
        jacobian = start.arm.jacobian
        twist = jacobian @ wanted
        return Ask(Request(wanted, np.zeros_like(wanted), jacobian, twist, twist,
                           np.zeros_like(twist), start.arm.q, start.previous),
                   1.0, last.worth, False)

    def rated(self, result: Filtered, desired: Wish, start: Start) -> Filtered:
        """Return a result with the share of the command that the tip goes along its path."""
        return result._replace(
            scale=self._share_on_path(start.arm.jacobian @ result.dq, desired.task), residual=0.0)

    def after(self, result: Filtered, desired: Wish, start: Start, last: LastTick) -> Path:
        """Return what came of the path; see `AlongPath`."""
        return self._path.after(result, desired, start, last)

    def _share_on_path(self, twist: Array, task: Task) -> float:
        """Return the share of the command that a tip with a twist (m,) goes along its path.

        Where the tip has got ahead of the reference pose, that catches up.
        """
        commanded = task.commanded
        squared = float(commanded @ commanded)
        if squared == 0.0:
            return 1.0
        ahead = -float(self._robot.task_rows(task.error) @ commanded)
        share = (float(twist @ commanded) + _CATCHING_UP * ahead) / squared
        return min(max(share, 0.0), 1.0)


Mode = AlongPath | ByJoints | SteppingAside


class Aim(NamedTuple):
    """Where a tick is to lead.

    Attributes:
        mode: how.
        start: of the tick.
        commanded: whether the tip is to move.
        path: (n,) velocity of the joint path ahead; None where there is none.
        guided: share of the null-space motion that follows it.
        course: what the arm leaves its path for before it is near; empty if it does not.
        says: the part of the reason that tells of it.
    """

    mode: Mode
    start: Start
    commanded: bool
    path: Array | None
    guided: float
    course: str
    says: str
