"""Runs to a goal: by a twist in proportion to what is left (NEO, Haviland 2021), or as a target.

All methods get the same twist at every tick. It takes position and orientation to the goal in
proportion: on the line from where the tip is. Or this package's planner gets the goal itself as
its target, and finds its own way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmark.peers import library
from benchmark.problem_sets.problem import Problem, tip_pose
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose, pose_error

Array = npt.NDArray[np.float64]
# Posture (n,) and twist (6,) → joint velocity (n,), and what held the arm back, if that is known.
Step = Callable[[Array, Array], tuple[Array, str]]

DT = 0.004
# The longest run [s].
LONGEST = 30.0
# Of the pose error [1/s], and the caps of its parts [m/s, rad/s].
_GAIN = 2.0
_SPEED, _ANGULAR_SPEED = 0.25, 1.0
# The goal is reached within these [m, rad].
_NEAR, _NEAR_ANGLE = 0.005, 0.02
# An arm this slow has come to rest [rad/s].
_AT_REST = 1e-6
# An arm that has moved less than this in that time will not go on [rad, s]; with a target it may
# still think.
_STANDING, _PATIENCE, _PATIENCE_WITH_TARGET = 1e-3, 3.0, 8.0


class Run(NamedTuple):
    """What a method did.

    Attributes:
        postures: (k + 1, n) [rad, m].
        velocities: (k, n) between them [rad/s, m/s].
        tick_us: (k,) the method's CPU time for each [us].
        reached: whether the tip came to the goal.
        reason: what held the arm back last, if it did not.
    """

    postures: Array
    velocities: Array
    tick_us: Array
    reached: bool
    reason: str


def servo_twist(robot: Robot, pose: Pose, goal: Pose) -> Array:
    """Return the twist (6,) towards a goal, in command axes [m/s, rad/s]."""
    wanted = _GAIN * pose_error(goal, pose, robot.in_tool)
    excess = max(float(np.linalg.norm(wanted[:3])) / _SPEED,
                 float(np.linalg.norm(wanted[3:])) / _ANGULAR_SPEED, 1.0)
    return wanted / excess


def servo(
    robot: Robot, problem: Problem, step: Step, longest: float = LONGEST, *,
    to_target: bool = False,
) -> Run:
    """Let a method take an ideal arm to a problem's goal.

    Args:
        robot: the arm.
        problem: what to do.
        step: the method.
        longest: after which time it has to end [s].
        to_target: whether the method goes to the goal by itself, and may stand and think.
    """
    goal, q = tip_pose(robot, problem.goal), np.array(problem.start)
    postures, velocities, ticks, reason, reached = [q], [], [], '', False
    standing = round((_PATIENCE_WITH_TARGET if to_target else _PATIENCE) / DT)
    for i in range(round(longest / DT)):
        pose = tip_pose(robot, q)
        error = pose_error(goal, pose, robot.in_tool)
        reached = bool(np.linalg.norm(error[:3]) < _NEAR
                       and np.linalg.norm(error[3:]) < _NEAR_ANGLE)
        if reached or (i >= standing
                       and np.abs(q - postures[i - standing]).max() < _STANDING):
            break
        twist = servo_twist(robot, pose, goal)
        begin = time.thread_time()
        dq, reason = step(q, twist)
        ticks.append(time.thread_time() - begin)
        q = q + DT * dq
        postures.append(q)
        velocities.append(dq)
    return Run(np.array(postures), np.array(velocities).reshape(-1, robot.n),
               1e6 * np.array(ticks), reached, '' if reached else reason)


def planner_step(planner: Planner, problem: Problem, *, to_target: bool = False) -> Step:
    """Return this package's step for a problem, by twists or to the goal as a target."""
    scene = Scene.of(problem.obstacles)
    planner.prepare(scene)
    target = tip_pose(planner.robot, problem.goal) if to_target else None

    def step(q: Array, twist: Array) -> tuple[Array, str]:
        result = planner.step(q, twist, scene, DT, target=target)
        state = '' if result.progress is None else f'{result.progress.state.value}; '
        return result.dq, state + result.reason

    return step


def there_and_back(planner: Planner, problem: Problem) -> Problem:
    """Go to the goal and back; return the problem from where the arm then stands."""
    here = problem.start
    for goal in (problem.goal, problem.start):
        part = replace(problem, start=here, goal=goal)
        step = planner_step(planner, part, to_target=True)
        here = servo(planner.robot, part, step, to_target=True).postures[-1]
        dq = np.ones_like(here)
        while np.abs(dq).max() > _AT_REST:
            dq, _ = step(here, np.zeros(6))
            here = here + DT * dq
    return replace(problem, start=here)


def peer_step(robot: Robot, name: str, problem: Problem, margin: float) -> Step:
    """Return another library's step: towards where the twist leads in one tick.

    Raises:
        MissingPeerError: it is not installed.
    """
    peer = library(name)(
        robot, problem.obstacles, margin, PlannerParameters().clearance_self_margin)

    def step(q: Array, twist: Array) -> tuple[Array, str]:
        target = integrate(tip_pose(robot, q), twist, DT, robot.in_tool)
        return peer.step(q, target, DT), ''

    return step
