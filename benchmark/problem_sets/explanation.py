"""Why a goal was not reached: whether the line leads there, and whether any way does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from benchmark.bodies import Bodies
from benchmark.closest_approach import Motion
from benchmark.free_way import FreeWay
from benchmark.problem_sets.generated import posture_at
from benchmark.problem_sets.problem import posture_fault, Problem, tip_pose
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Poses along the line that are looked at.
_POSES = 400
# Searches with other random numbers, to the goal's posture and to others with the same pose.
_SEARCHES = 2
_OTHER_GOALS, _GUESSES = 2, 20


def free_way_exists(robot: Robot, capsules: Bodies, problem: Problem, margin: float) -> bool:
    """Return whether a search finds a way to the goal's pose that gives up the line.

    It finds most ways there are, but not all of them: a share of ways is a lower bound.

    Args:
        robot: the arm.
        capsules: its shapes.
        problem: start and goal are free.
        margin: kept from obstacles [m].
    """
    search = FreeWay(robot, capsules, problem.obstacles, margin)
    goals = [problem.goal, *_other_goals(robot, capsules, problem, margin)]
    return any(search.find(problem.start, goal, seed) is not None
               for goal in goals for seed in range(_SEARCHES))


def _other_goals(
    robot: Robot, capsules: Bodies, problem: Problem, margin: float,
) -> list[Array]:
    """Return free postures (n,) with the tip at the goal."""
    random, pose = np.random.default_rng(0), tip_pose(robot, problem.goal)
    found: list[Array] = []
    for _ in range(_GUESSES):
        q = posture_at(robot, pose, random.uniform(robot.position_min, robot.position_max))
        if q is not None and not posture_fault(robot, capsules, problem.obstacles, q, margin):
            found.append(q)
        if len(found) == _OTHER_GOALS:
            break
    return found


def line_blocked(robot: Robot, capsules: Bodies, problem: Problem, margin: float) -> bool:
    """Return whether the line takes what the last joint carries nearer than the margin.

    That goes where the tip's pose takes it, whatever the rest of the arm does: no planner can
    follow this line to its end. If it returns False, the rest of the arm may still be in the way.

    Args:
        robot, capsules, problem, margin: as of `free_way_exists`.
    """
    model = robot.model
    frame = model.frames[model.getFrameId(robot.tip_frame)]
    chosen = [i for i, joint in enumerate(capsules.joints) if joint == frame.parentJoint]
    carried = replace(
        capsules, self_pairs=[], **{
            name: tuple(getattr(capsules, name)[i] for i in chosen)
            for name in ('names', 'links', 'joints', 'placements', 'shapes')})
    start, goal = (tip_pose(robot, q) for q in (problem.start, problem.goal))
    turn = pin.log3(goal.rotation @ start.rotation.T)
    rotations = np.empty((len(chosen), _POSES, 3, 3))
    positions = np.empty((len(chosen), _POSES, 3))
    for i, share in enumerate(np.linspace(0.0, 1.0, _POSES)):
        tip = pin.SE3(pin.exp3(share * turn) @ start.rotation,
                      start.position + share * (goal.position - start.position))
        joint = tip * frame.placement.inverse()
        for k, placement in enumerate(carried.placements):
            at = joint * placement
            rotations[k, i], positions[k, i] = at.rotation, at.translation
    nearest = Motion(carried, rotations, positions).to_obstacles(problem.obstacles, 0.0)
    return nearest.distance < margin
