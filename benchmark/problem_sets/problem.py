"""One problem: where an arm starts, where its tip shall be, and what stands around it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmark.bodies import Bodies
from benchmark.closest_approach import Motion
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """One problem.

    Attributes:
        name: family and number.
        family: of similar problems.
        obstacles: that stand still.
        start: (n,) posture [rad, m].
        goal: (n,) a posture that has the tip where it shall be; any other will do as well.
    """

    name: str
    family: str
    obstacles: tuple[Obstacle, ...]
    start: Array
    goal: Array


def tip_pose(robot: Robot, q: Array) -> Pose:
    """Return where the tip is at a posture (n,)."""
    arm = robot.kinematics(q)
    return Pose(arm.tip_position, arm.tip_rotation)


def settled(robot: Robot, capsules: Bodies, problem: Problem) -> Problem:
    """Return a problem as every method gets it.

    What the last capsule, the fingers, holds at the goal is no obstacle: nobody could get there.
    Start and goal at a limit move to where the planner keeps from it, by 10 mrad.
    """
    start, goal = _inside(robot, problem.start), _inside(robot, problem.goal)
    nearest = Motion.through(capsules, goal[None]).to_obstacles(problem.obstacles, 0.0)
    obstacles = problem.obstacles
    if nearest.distance < 0.0 and nearest.first == capsules.names[-1]:
        obstacles = tuple(o for o in obstacles if o.name != nearest.second)
    return replace(problem, obstacles=obstacles, start=start, goal=goal)


def _inside(robot: Robot, q: Array) -> Array:
    margin = PlannerParameters().limits_position_margin
    inside = np.clip(q, robot.position_min + margin, robot.position_max - margin)
    return inside if np.abs(inside - q).max() < 2.0 * margin else q


def fault_of(
    robot: Robot, capsules: Bodies, problem: Problem, margin: float | None = None,
) -> str:
    """Return what rules a problem out, empty if nothing does.

    Start and goal have to keep from every limit, from obstacles and between links what the
    planner keeps there. No planner with these margins can solve another problem.
    """
    for name, q in (('start', problem.start), ('goal', problem.goal)):
        why = posture_fault(robot, capsules, problem.obstacles, q, margin)
        if why:
            return f'{name} {why}'
    return ''


def posture_fault(
    robot: Robot, capsules: Bodies, obstacles: tuple[Obstacle, ...], q: Array,
    margin: float | None = None,
) -> str:
    """Return what is wrong with a posture (n,), empty if nothing is.

    Args:
        robot: the arm.
        capsules: its shapes.
        obstacles: that stand still.
        q: (n,) [rad, m].
        margin: kept from obstacles [m]; the planner's if None.
    """
    p = PlannerParameters()
    low, high = robot.position_min, robot.position_max
    if (q < low + p.limits_position_margin).any() or (q > high - p.limits_position_margin).any():
        return 'beyond a limit'
    motion = Motion.through(capsules, q[None])
    if motion.to_itself().distance < p.clearance_self_margin:
        return 'too near to itself'
    kept = p.clearance_margin if margin is None else margin
    if motion.to_obstacles(obstacles, 0.0).distance < kept:
        return 'too near to an obstacle'
    return ''
