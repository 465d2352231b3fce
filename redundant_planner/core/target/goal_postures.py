"""Postures with the tip at a pose: from random ones, and on along the null space from each."""

from __future__ import annotations

from collections.abc import Generator
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.horizon.least_norm_path import least_norm_path
from redundant_planner.core.horizon.poses_ahead import poses_of
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.free_space import FreeSpace, Place

Array = npt.NDArray[np.float64]

# Steps of the way to the pose, and steps that settle there, so often at most.
_APPROACH, _SETTLE, _SETTLINGS = 6, 8, 3
# Steps of Levenberg and Marquardt after these, at most, and the least damping of them [m²].
_LAST_STEPS, _LEAST_DAMPING = 12, 1e-12
# A posture has settled after a step smaller than this [rad, m], and is at the pose within this
# [m, rad].
_SETTLED, _AT_POSE = 1e-6, 1e-5
# Steps along the null space to either side, how many at once, and their size [rad, m].
_ASIDE, _AT_ONCE, _ASIDE_SIZE = 10, 5, 0.15
# How near to the pose these have to end to be led right to it [m, rad].
_NEAR_POSE = 1e-3
# Every other guess is this far from where the arm is, about [rad, m].
_SPREAD = 0.5


def goal_postures(
    space: FreeSpace, q: Array, pose: Pose, random: np.random.Generator,
) -> Generator[list[Place] | None, None, None]:
    """Yield postures, some after each piece of work and often none; None after each guess.

    They need not be free.

    The first guess is where the arm is, then near it and anywhere in turn.

    Args:
        space: where the arm may be.
        q: (n,) where it is.
        pose: that the tip shall have.
        random: the numbers.
    """
    low, high = space.joint_ranges(q)
    guess, guesses = q, 0
    while True:
        found = posture_at(space, guess, pose)
        yield []
        if found is not None:
            yield _places(space, [found])
            yield from _neighbours(space, found, pose, random)
        guesses += 1
        guess = (random.uniform(low, high) if guesses % 2 else
                 np.clip(random.normal(q, _SPREAD), low, high))
        yield None


def only_posture(space: FreeSpace, q: Array) -> Generator[list[Place] | None, None, None]:
    """Yield one posture (n,), and then None for ever, as there is no other."""
    yield [space.place(q)]
    while True:
        yield None


def posture_at(space: FreeSpace, guess: Array, pose: Pose) -> Array | None:
    """Return a posture (n,) with the tip at a pose; None where a guess leads elsewhere."""
    robot = space.robot
    arm = robot.kinematics(guess)
    tip = Pose(arm.tip_position, arm.tip_rotation)
    away = se3.pose_error(pose, tip, False)
    way = [se3.displaced(tip, share * away, False)
           for share in np.linspace(0.0, 1.0, _APPROACH + 1)[1:]]
    space.spend(_APPROACH + _SETTLE)
    q = least_norm_path(robot, guess, poses_of(way), space.joints)[-1]
    for _ in range(_SETTLINGS):
        nodes = least_norm_path(robot, q, poses_of([pose] * _SETTLE), space.joints)
        q = nodes[-1]
        if np.abs(nodes[-1] - nodes[-2]).max() < _SETTLED:
            break
    return _finished(space, q, pose)


def _finished(space: FreeSpace, q: Array, pose: Pose) -> Array | None:
    """Return a posture (n,) at a pose that is near another posture (n,), None where none is.

    The steps of a path of least norm have a constant damping, and hardly get on near a
    singularity. Here it is the square of what is left, which converges quadratically there, too
    (Levenberg and Marquardt; Yamashita and Fukushima 2001).
    """
    robot, joints = space.robot, space.joints
    for _ in range(_LAST_STEPS):
        arm = robot.kinematics(q)
        error = robot.task_rows(se3.pose_error(
            pose, Pose(arm.tip_position, arm.tip_rotation), robot.in_tool))
        if np.abs(error).max() < _AT_POSE:
            break
        space.spend(1)
        scaled = arm.jacobian * joints.scaling
        damping = max(float(error @ error), _LEAST_DAMPING)
        step = scaled.T @ np.linalg.solve(scaled @ scaled.T + damping * np.eye(len(error)), error)
        q = np.clip(q + joints.scaling * step, joints.position_min, joints.position_max)
    return q if off_pose(robot, q, pose) < _AT_POSE else None


def _neighbours(
    space: FreeSpace, q: Array, pose: Pose, random: np.random.Generator,
) -> Generator[list[Place], None, None]:
    """Yield the postures that lie along the null space from one (n,)."""
    robot, joints, due = space.robot, space.joints, poses_of([pose] * 2)
    aside = random.normal(size=robot.n)
    for way in (aside, -aside) if robot.n > robot.m else ():
        at, postures = q, []
        for step in range(1, _ASIDE + 1):
            jacobian = robot.kinematics(at).jacobian
            way = joints.scaling * null_space.project(
                null_space.decompose(jacobian * joints.scaling), way / joints.scaling)
            way /= max(math.sqrt(way @ way), _SETTLED)
            at = least_norm_path(robot, at + _ASIDE_SIZE * way, due, joints)[-1]
            space.spend(4)
            off = off_pose(robot, at, pose)
            if off < _AT_POSE:
                postures.append(at)
            elif off < _NEAR_POSE:
                there = _finished(space, at, pose)
                postures += [] if there is None else [there]
                yield []
            if step % _AT_ONCE == 0:
                yield _places(space, postures)
                postures = []


def _places(space: FreeSpace, postures: list[Array]) -> list[Place]:
    """Return postures (n,) with their room."""
    return [Place(*found) for found in zip(postures, space.rooms(np.array(postures)))
            ] if postures else []


def off_pose(robot: Robot, q: Array, pose: Pose) -> float:
    """Return how far the tip is from a pose at a posture (n,), on controlled axes [m, rad]."""
    arm = robot.kinematics(q)
    tip = Pose(arm.tip_position, arm.tip_rotation)
    return float(np.abs(robot.task_rows(se3.pose_error(pose, tip, robot.in_tool))).max())
