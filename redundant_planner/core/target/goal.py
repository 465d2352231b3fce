"""Where an arm shall go: a pose of the tip, positions of all joints, or a chunk of either."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, StateError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import checked_pose, Pose, Poses
from redundant_planner.core.target.chunk import Chunk

Array = npt.NDArray[np.float64]

# Tip → its pose in the base frame, or a chunk of such; None for one that has no target.
TipTargets = Mapping[str, Pose | Chunk | None]
# A pose in the base frame, or joint positions (n,) [rad, m].
Goal = Pose | Array


class TipGoals(NamedTuple):
    """Where all tips of an arm shall go.

    Attributes:
        poses: of those without a chunk; where the others begin.
        chunks: of each tip; None for one without.
    """

    poses: Poses
    chunks: tuple[Chunk | None, ...]


# A goal, or those of several tips, or the way to a goal with its times.
Target = Goal | TipGoals | Chunk
# A chunk may go beyond the limits by this, as measured positions do; it is followed up to them
# [rad, m].
_BEYOND = 1e-3


def checked_target(target: Target, robot: Robot) -> Target:
    """Return a target as arrays of numbers.

    Raises:
        StateError: it is neither a pose nor n joint positions nor a chunk of these, or a joint
            cannot go there.
    """
    if isinstance(target, Chunk):
        if not target.of_poses:
            _check_range(target, robot)
        elif len(robot.tips) > 1:
            raise StateError(f'the target is one chunk; say of which tip: {known(robot.tips)}')
        return target
    if isinstance(target, TipGoals):
        raise StateError('several poses are given; say of which tip each is')
    return checked_goal(target, robot)


def checked_goal(target: Goal, robot: Robot) -> Goal:
    """Return a pose or joint positions as arrays of numbers; errors as `checked_target`."""
    if isinstance(target, tuple):
        if len(robot.tips) > 1:
            raise StateError(f'the target is one pose; say of which tip: {known(robot.tips)}')
        return checked_pose(target)
    q = robot.checked_posture(target)
    beyond = (q < robot.position_min) | (q > robot.position_max)
    if beyond.any():
        raise StateError('; '.join(
            f"the target of joint '{robot.joint_names[j]}' is {q[j]:.6g}; it must be "
            f'{robot.position_min[j]:.6g} to {robot.position_max[j]:.6g}'
            for j in np.flatnonzero(beyond)))
    return q


def _check_range(chunk: Chunk, robot: Robot) -> None:
    """Raise StateError if a chunk has another number of joints, or leads beyond a limit."""
    low, high = chunk.range
    if len(low) != robot.n:
        raise StateError(f'the chunk has {len(low)} joints; {robot.name} has {robot.n}')
    beyond = (low < robot.position_min - _BEYOND) | (high > robot.position_max + _BEYOND)
    if beyond.any():
        raise StateError('; '.join(
            f"the chunk takes joint '{robot.joint_names[j]}' from {low[j]:.6g} to {high[j]:.6g}; "
            f'it must stay within {robot.position_min[j]:.6g} to {robot.position_max[j]:.6g}'
            for j in np.flatnonzero(beyond)))


def checked_targets(targets: TipTargets, robot: Robot) -> None:
    """Check where tips shall go.

    Raises:
        StateError: there is no such tip, a pose is none, or a chunk is of joint positions.
    """
    unknown = [tip for tip in targets if tip not in robot.tips]
    if unknown or not targets:
        raise StateError(f'there are targets for {known(unknown) if unknown else "no tip"}; '
                         f"the tips of '{robot.name}' are {known(robot.tips)}")
    for tip, target in targets.items():
        if isinstance(target, Chunk):
            if not target.of_poses:
                raise StateError(f"the chunk of '{tip}' is of joint positions; give it for the "
                                 'whole body, without a tip')
        elif target is not None:
            checked_pose(target)


def goals_of_tips(targets: TipTargets, robot: Robot, others: Poses) -> TipGoals:
    """Return where each tip of a robot shall go.

    Args:
        targets: of some tips, checked.
        robot: the robot.
        others: where the tips without one shall be.
    """
    given = [targets.get(tip) for tip in robot.tips]
    return TipGoals(
        Poses.of(*(checked_pose(goal) if isinstance(goal, Pose) else other
                   for goal, other in zip(given, others.each))),
        tuple(goal if isinstance(goal, Chunk) else None for goal in given))
