"""Random poses to go to: start, goal, obstacles, and a ball that crosses.

Start and goal are postures that are free at the margin; the obstacles lie anywhere else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.robot.cone import Cone, cone_room
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Start and goal keep this from obstacles and between links [m], and from joint limits [rad].
_CLEAR, _LIMIT_DISTANCE = 0.03, 0.1
_LOWEST = 0.1  # the tip [m]
_OBSTACLES, _SIZES, _REACH = 4, (0.03, 0.1), 0.8  # count, half extents [m], from the base [m]
_STEPS_INTO_CONE = 20
LONGEST = 15.0  # run [s]
# A ball that crosses: speed [m/s], radius [m], and when it does [s].
_BALL_SPEEDS, _BALL_SIZES, PASSES = (0.15, 0.35), (0.05, 0.09), 1.5
# How far it stays from the arm's column, which cannot get out of its way, and from the arm at the
# start [m].
_FROM_BASE, _CLEAR_AT_FIRST = 0.4, 0.1


class Problem(NamedTuple):
    """A pose to go to: postures (n,) of start and goal, obstacles, and those that move."""

    start: Array
    goal: Array
    obstacles: tuple[Obstacle, ...]
    moving: tuple[Obstacle, ...] = ()


def problem_of(robot: Robot, seed: int, cone: Cone | None = None) -> Problem:
    """Return a random problem, with start and goal in a cone if there is one."""
    random = np.random.default_rng(seed)
    radii = np.array([capsule.radius for capsule in robot.capsules])

    def posture() -> Array:
        while True:
            q = random.uniform(robot.position_min + _LIMIT_DISTANCE,
                               robot.position_max - _LIMIT_DISTANCE)
            if cone is not None:
                q = _upright(robot, q, cone)
            arm = robot.kinematics(q)
            if cone is not None and cone_room(
                    cone, arm.tip_rotation, arm.joint_screws)[0] < 0.2 * cone.angle:
                continue
            apart = link_distances(arm.segment_start, arm.segment_end, radii, robot.self_pairs)
            if apart.distance.min() > _CLEAR and arm.tip_position[2] > _LOWEST:
                return np.asarray(q)

    start, goal = posture(), posture()
    obstacles: list[Obstacle] = []
    while len(obstacles) < _OBSTACLES:
        center = random.uniform(-_REACH, _REACH, 3) + (0.0, 0.0, 0.4)
        half = random.uniform(*_SIZES, 3)
        name = str(len(obstacles))
        obstacle = (Obstacle(name, center, half) if len(obstacles) % 2 else
                    Obstacle.box(name, center, 2.0 * half))
        if all(_distance(robot, q, obstacle) > _CLEAR for q in (start, goal)):
            obstacles.append(obstacle)
    return Problem(start, goal, tuple(obstacles))


def _distance(robot: Robot, q: Array, obstacle: Obstacle) -> float:
    arm = robot.kinematics(q)
    maps = inflated_obstacles(Scene.of([obstacle]), [c.radius for c in robot.capsules],
                              moved=robot.moved)
    return float(link_clearance(maps, arm.segment_start, arm.segment_end).distance.min())


def crossing(robot: Robot, problem: Problem, seed: int) -> Problem:
    """Return a problem with a ball that crosses the way, while the arm is on it."""
    random = np.random.default_rng(seed)
    begin, end = (robot.kinematics(q).tip_position for q in (problem.start, problem.goal))
    base = np.column_stack((np.zeros((6, 2)), np.linspace(0.0, 0.5, 6)))
    while True:
        direction = random.normal(size=3)
        velocity = random.uniform(*_BALL_SPEEDS) * direction / np.linalg.norm(direction)
        # It does not have to pass half way where that is too near to the base.
        at = 0.5 * (begin + end) + random.normal(0.0, 0.1, 3) - PASSES * velocity
        ball = Obstacle('ball', at, np.full(3, random.uniform(*_BALL_SIZES)), velocity=velocity)
        course = at + np.outer(np.linspace(0.0, LONGEST, 200), velocity)
        past_the_base = np.linalg.norm(course[:, None] - base, axis=2).min() > _FROM_BASE
        if past_the_base and _distance(robot, problem.start, ball) > _CLEAR_AT_FIRST:
            return problem._replace(moving=(ball,))


def _upright(robot: Robot, q: Array, cone: Cone) -> Array:
    """Return a posture (n,) near another one with the tip in its cone, as far as it goes."""
    for _ in range(_STEPS_INTO_CONE):
        arm = robot.kinematics(q)
        room, gradient = cone_room(cone, arm.tip_rotation, arm.joint_screws)
        missing = max(0.4 * cone.angle - room, 0.0)
        q = np.clip(q + missing / max(float(gradient @ gradient), 1e-9) * gradient,
                    robot.position_min + _LIMIT_DISTANCE, robot.position_max - _LIMIT_DISTANCE)
    return q
