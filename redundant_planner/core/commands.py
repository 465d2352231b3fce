"""What the tips of an arm are asked to do in a tick, and how those move that hold one object.

With one tip that is its twist or target, checked. Several tips have each a twist and target of
their own; while they are coupled, both are the object's, and the first tip leads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ParameterError, shown, StateError
from redundant_planner.core.kernels import Indices
from redundant_planner.core.redundancy.command import limited_twists
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.redundancy.reference import Start, Task
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import checked_pose, Pose, Poses, poses_error, turned
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.stages import Filtered, Request
from redundant_planner.core.step_result import TipResult
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import (
    checked_target,
    checked_targets,
    goals_of_tips,
    Target,
    TipGoals,
    TipTargets,
)
from redundant_planner.core.target.moving_target import checked_news, Sighting

Array = npt.NDArray[np.float64]

# Share of the acceleration limits that coupled tips use but to brake.
_COUPLED_ACCELERATION = 0.7
# A tip's share of its speed is worth so many times that of the next one in `tip_order`.
_PRECEDENCE = 10.0


class Asked(NamedTuple):
    """What a tick is asked for.

    Attributes:
        twist: (6 t,) of the tips, in command axes [m/s, rad/s]; (6,) of coupled ones' object.
        moves: whether it moves anything.
        target: where to go instead; None to follow the twist.
        of_tips: targets of several tips, before it is known where the others are due.
        news: targets that came since the last tick.
    """

    twist: Array
    moves: bool
    target: Target | None
    of_tips: TipTargets | None
    news: tuple[Sighting, ...]


class Commands:
    """The commands of one arm's tips.

    Attributes:
        coupling: how tips hold an object together; None where each moves on its own.
        order: what each tip's speed is worth, as a multiple of the others'; None where all are
            alike.
    """

    def __init__(self, robot: Robot) -> None:
        """Begin with tips that move on their own."""
        self.coupling: Coupling | None = None
        self.order: Array | None = None
        self._robot = robot
        self._controlled = robot.full_twist(np.ones(robot.m))
        self._share_of_tips = robot.rows // 6 if len(robot.tips) > 1 else None
        self._given: tuple[TipTargets, TipGoals] | None = None
        self._of_object: tuple[Chunk, Chunk] | None = None  # and of the tip that leads

    def couple(self, tips: Poses | None, held: Pose | None) -> None:
        """Have tips hold an object together; see `Planner.couple`.

        Args:
            tips: their poses.
            held: the object's; half way between the tips and in base axes if None.

        Raises:
            StateError: see there.
        """
        robot = self._robot
        if len(robot.tips) < 2 or robot.m < 6 * len(robot.tips):
            raise StateError(f"'{robot.name}' has {robot.m} controlled axes of the tips "
                             f'{known(robot.tips)}; to couple takes two tips with six axes each')
        if tips is None:
            raise StateError('the tips cannot be coupled before a tick has told where they are, '
                             'or after a way of the joints; give q')
        self.coupling = Coupling.of(tips, None if held is None else checked_pose(held))

    def limits(self, limits: Limits) -> Limits:
        """Return joint limits that leave coupled tips room to stay together."""
        if self.coupling is None:
            return limits
        return limits._replace(acceleration_max=_COUPLED_ACCELERATION * limits.acceleration_max)

    def checked(
        self, twist: Array, target: Target | TipTargets | None,
        news: Sequence[Sighting], speeds: tuple[float, float],
    ) -> Asked:
        """Return what a tick is asked for, as arrays of numbers, no faster than it may be.

        Args:
            twist, target, news: see `Planner.step`.
            speeds: largest linear and angular speed of a twist [m/s, rad/s].

        Raises:
            StateError: one of them does not fit.
        """
        robot, coupling = self._robot, self.coupling
        of_tips: TipTargets | None = None
        command, moves = limited_twists(
            twist, self._controlled if coupling is None else self._controlled[:6], *speeds)
        if coupling is not None:
            if target is not None:
                target = self._goals_of_object(coupling, target)
            news = [Sighting(self._of_first(coupling, seen.target), seen.age) for seen in news]
        elif isinstance(target, Mapping):
            if self._given is None or self._given[0] is not target:
                checked_targets(target, robot)
            target, of_tips = None, target
        elif target is not None:
            target = checked_target(target, robot)
        return Asked(command, moves, target, of_tips, checked_news(
            news, target if of_tips is None else of_tips, robot))

    def placed(self, asked: Asked, due: Poses) -> Asked:
        """Return what is asked for, of all tips.

        Args:
            asked: checked; its twist is changed in place where tips have targets.
            due: where the tips should be now.
        """
        if self.coupling is not None:
            return asked._replace(twist=self.coupling.first_twist(
                asked.twist, due.first, in_tool=self._robot.in_tool))
        if asked.of_tips is not None:
            return asked._replace(target=self._of_tips(asked.of_tips, due, asked.twist))
        return asked

    def _of_tips(self, target: TipTargets, due: Poses, command: Array) -> TipGoals:
        """Return where tips shall go; the others stay where they are due.

        A tip that a twist moves is due somewhere else in each tick; its target takes the twist
        out of the command (6 t,).
        """
        aimed = [target.get(tip) is not None for tip in self._robot.tips]
        command.reshape(-1, 6)[aimed] = 0.0
        before = self._given
        if before is None or before[0] is not target or command.any():
            kept = due if before is None or before[0] is not target else before[1].poses
            others = Poses.of(*(
                now if part.any() else pose for now, pose, part in zip(
                    due.each, kept.each, command.reshape(-1, 6))))
            before = self._given = target, goals_of_tips(target, self._robot, others)
        return before[1]

    def _goals_of_object(
        self, coupling: Coupling, target: Target | TipTargets,
    ) -> TipGoals:
        """Return where coupled tips shall go, by a pose of their object or a chunk of such."""
        if not isinstance(target, Chunk) or not target.of_poses:
            first = self._of_first(coupling, target)[self._robot.tips[0]]
            return TipGoals(coupling.tips(first), (None,))
        if self._of_object is None or self._of_object[0] is not target:
            poses = [coupling.first_at(pose) for pose in target.points if isinstance(pose, Pose)]
            self._of_object = target, Chunk(target.times, poses, late=target.late)
        chunk = self._of_object[1]
        assert isinstance(chunk.end, Pose)
        return TipGoals(coupling.tips(chunk.end), (chunk,))

    def _of_first(self, coupling: Coupling, target: Target | TipTargets) -> dict[str, Pose]:
        """Return the pose of the tip that leads where the object is at a target."""
        if not isinstance(target, Pose):
            raise StateError('the tips are coupled: the target has to be a pose of their object, '
                             'or a chunk of poses')
        return {self._robot.tips[0]: coupling.first_at(checked_pose(target))}

    def led(self, poses: Poses) -> Poses:
        """Return poses of all tips, which are where the first one takes coupled ones."""
        return poses if self.coupling is None else self.coupling.tips(poses.first)

    def spread(self, start: Start) -> Start:
        """Return a tick's start whose command is of all tips, where it is the first one's."""
        if self.coupling is None:
            return start
        return start._replace(command=self.coupling.twists(
            start.command[:6], start.reference_of(0), start.dt, in_tool=self._robot.in_tool))

    @property
    def share_of(self) -> Indices | None:
        """Which share of the speed each controlled axis goes with; None for one share."""
        return self._share_of_tips if self.coupling is None else None

    def request(self, request: Request, start: Start, task: Task, gain: float) -> Request:
        """Return a request in which coupled tips keep their pose to the first one, which leads.

        Args:
            request: of all tips.
            start, task: of the tick.
            gain: how fast a lost pose is made good [1/s].
        """
        coupling = self.coupling
        if coupling is None:
            return request
        arm, turning = start.arm, task.turning.reshape(-1, 6)
        if self._robot.in_tool:
            turning = np.array([
                turned(part, rotation) for part, rotation in zip(turning, arm.tip_rotations)])
        off = poses_error(coupling.tips(arm.tips.first), arm.tips, False)
        rates = gain * off[6:]
        return request._replace(
            jacobian=np.vstack((request.jacobian[:6], coupling.rows(arm))),
            twist=np.concatenate((request.twist[:6], rates)),
            feedback=np.concatenate((request.feedback[:6], rates)),
            turning=np.concatenate((request.turning[:6], coupling.relative(turning.ravel(), arm))),
            share_of=np.repeat((0, 1), (6, len(rates))), order=None, path_axes=6,
            spare=1.0 / _COUPLED_ACCELERATION)

    def results(
        self, poses: Poses, errors: Array, result: Filtered,
    ) -> tuple[TipResult, ...]:
        """Return what a tick decided about each of several tips; nothing of one tip.

        Args:
            poses: where they are.
            errors: (6 t,) how far from where they should be.
            result: of the safety filter.
        """
        tips = len(self._robot.tips)
        if tips == 1:
            return ()
        shares = np.full(tips, result.scale) if result.scales is None else result.scales
        return tuple(TipResult(pose, errors[6 * t:6 * t + 6].copy(), float(shares[t]))
                     for t, pose in enumerate(poses.each))


def order_of(robot: Robot, first: Sequence[str]) -> Array | None:
    """Return what each tip's speed is worth (t,); None where all are alike.

    Args:
        robot: the robot.
        first: the tips that come before the others, in their order.

    Raises:
        ParameterError: one is no tip of the robot, or is named twice.
    """
    unknown = [tip for tip in first if tip not in robot.tips]
    if unknown or len(set(first)) < len(first):
        raise ParameterError(f"parameter 'tip_order' is {shown(list(first))}; it takes tips of "
                             f"'{robot.name}', each once: {known(robot.tips)}")
    if not first:
        return None
    ranks = [first.index(tip) if tip in first else len(first) for tip in robot.tips]
    return _PRECEDENCE ** (max(ranks) - np.array(ranks, dtype=float))


def possible_share(result: Filtered, command: Array) -> float:
    """Return the share of its command (6 t,) that the tip follows which is held up least.

    Null-space motion is worth its while as long as one tip gets on.
    """
    if result.scales is None:
        return result.scale
    moves = command.reshape(-1, 6).any(axis=1)
    return float(result.scales[moves].max(initial=0.0)) if moves.any() else result.scale
