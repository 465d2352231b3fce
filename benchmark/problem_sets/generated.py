"""Problems made from a seed: furniture, and a start and a goal that are free and within reach."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from benchmark.bodies import Bodies, capsules_of
from benchmark.problem_sets.families import FAMILIES, Furniture
from benchmark.problem_sets.problem import posture_fault, Problem, tip_pose
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, pose_error

Array = npt.NDArray[np.float64]

# The Panda's usual start posture, and how far a start may be from it, about [rad].
_READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
_SPREAD = 0.25
# Start and goal keep this from obstacles, a little more than the planner [m].
_CLEAR = 0.015
# What there is to do, at least [m].
_SHORTEST = 0.15
# Tries at a start and a goal in one piece of furniture, and steps towards a pose.
_TRIES, _STEPS = 30, 60
_DAMPING, _SOLVED = 0.02, 1e-5


def generate(robot: Robot, seed: int, family: str, number: int) -> Problem:
    """Return a problem; the same arguments return the same.

    Args:
        robot: the arm, a Panda with all six axes controlled.
        seed: of the set.
        family: one of `FAMILIES`.
        number: in the family.
    """
    random = np.random.default_rng([seed, list(FAMILIES).index(family), number])
    capsules = capsules_of(robot)
    while True:
        furniture = FAMILIES[family](random)
        # Half of the ways begin where the arm usually does, half of them in the furniture.
        usual = random.uniform() < 0.5
        goal = _in_furniture(robot, capsules, furniture, random)
        start = goal if goal is None else (
            _near_ready(robot, capsules, furniture, random) if usual
            else _in_furniture(robot, capsules, furniture, random))
        if goal is not None and start is not None and _far(robot, start, goal):
            return Problem(f'{family}/{number:04d}', family, furniture.obstacles, start, goal)


def problems(
    robot: Robot, seed: int, families: Sequence[str], count: int,
) -> Iterator[Problem]:
    """Yield `count` problems of each family."""
    for family in families:
        for number in range(count):
            yield generate(robot, seed, family, number)


def _far(robot: Robot, start: Array, goal: Array) -> bool:
    error = pose_error(tip_pose(robot, goal), tip_pose(robot, start), robot.in_tool)
    return bool(np.linalg.norm(error[:3]) > _SHORTEST)


def _near_ready(
    robot: Robot, capsules: Bodies, furniture: Furniture, random: np.random.Generator,
) -> Array | None:
    for _ in range(_TRIES):
        q = _READY + _SPREAD * random.normal(size=robot.n)
        if not posture_fault(robot, capsules, furniture.obstacles, q, _CLEAR):
            return q
    return None


def _in_furniture(
    robot: Robot, capsules: Bodies, furniture: Furniture, random: np.random.Generator,
) -> Array | None:
    """Return a free posture with the hand where it goes in the furniture."""
    for _ in range(_TRIES):
        guess = random.uniform(robot.position_min, robot.position_max)
        q = posture_at(robot, furniture.hand(random), guess)
        if q is not None and not posture_fault(
                robot, capsules, furniture.obstacles, q, _CLEAR):
            return q
    return None


def posture_at(robot: Robot, pose: Pose, guess: Array) -> Array | None:
    """Return a posture (n,) with the tip at a pose, None where damped steps do not lead there.

    Args:
        robot: the arm.
        pose: in the base frame.
        guess: (n,) posture to begin with.
    """
    model, margin = robot.model, PlannerParameters().limits_position_margin
    data, tip = model.createData(), model.getFrameId(robot.tip_frame)
    low, high = robot.position_min + margin, robot.position_max - margin
    target, q = pin.SE3(pose.rotation, pose.position), np.clip(guess, low, high)
    for _ in range(_STEPS):
        pin.computeJointJacobians(model, data, q)
        at = pin.updateFramePlacement(model, data, tip)
        error = pin.log6(at.actInv(target)).vector
        if np.linalg.norm(error) < _SOLVED:
            return np.asarray(q)
        jacobian = pin.getFrameJacobian(model, data, tip, pin.ReferenceFrame.LOCAL)
        step = jacobian.T @ np.linalg.solve(
            jacobian @ jacobian.T + _DAMPING ** 2 * np.eye(6), error)
        q = np.clip(q + step * min(1.0, 0.5 / np.abs(step).max()), low, high)
    return None
