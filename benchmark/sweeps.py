"""Two balls that sweep through an arm on its way to a pose: does it come back? `--help`.

A Panda servoes to a pose that it reaches along the line, while two balls cross the way at 0.2 m/s
and go on. What counts is that none is hit, that the tip arrives once they have passed, and how far
off its way it was.
"""

from __future__ import annotations

import argparse
import json
from multiprocessing import Pool
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.judge import limit_violation
from benchmark.problem_sets.servo import servo_twist
from benchmark.robots import make_robot
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

DT = 0.004
_LONGEST = 15.0  # [s]
_READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
_SPEED, _SIZES = 0.2, (0.05, 0.09)  # [m/s], radius [m]
# When a ball is where it was aimed at, and how far from the arm it begins [s], [m].
_PASSES, _CLEAR_AT_FIRST = (1.5, 4.0), 0.15
# How far it stays from the arm's column, which cannot get out of its way [m].
_FROM_COLUMN, _COLUMN = 0.35, 0.5
_DISPLACED, _TURNED = (0.1, 0.3), 0.5  # the goal from the start [m], [rad]
_ARRIVED, _ARRIVED_ANGLE = 1e-3, np.radians(0.2)


class Outcome(NamedTuple):
    """What a run came to.

    Attributes:
        seed: of the scene.
        distance: of the tip from the goal at the end [m].
        seconds: until it arrived for good; `_LONGEST` if it did not.
        passed: when the balls were past [s].
        off: how far the tip was from the line to the goal, at most [m].
        clearance: smallest distance of a link to a ball or another link [m].
        violation: see `limit_violation`.
        reason: at the end.
    """

    seed: int
    distance: float
    seconds: float
    passed: float
    off: float
    clearance: float
    violation: float
    reason: str


class SweepScene(NamedTuple):
    """Where an arm starts and the tip shall go, the balls, and when these are past [s]."""

    start: Array
    goal: Pose
    balls: tuple[Obstacle, ...]
    passed: float


def scene_of(robot: Robot, seed: int) -> SweepScene:
    """Return a random scene."""
    random = np.random.default_rng(seed)
    while True:
        start = _READY + random.uniform(-0.4, 0.4, robot.n)
        arm = robot.kinematics(start)
        tip = Pose(arm.tip_position, arm.tip_rotation)
        away, turn = random.normal(size=(2, 3))
        away *= random.uniform(*_DISPLACED) / np.linalg.norm(away)
        turn *= random.uniform(0.0, _TURNED) / np.linalg.norm(turn)
        goal = se3.displaced(tip, np.concatenate((away, turn)), False)
        if _servoed(robot, start, goal, ())[1] < 0.6 * _LONGEST:
            break
    balls: list[Obstacle] = []
    passed = 0.0
    column = np.column_stack((np.zeros((6, 2)), np.linspace(0.0, _COLUMN, 6)))
    points = np.vstack((arm.segment_start[3:], arm.segment_end[3:]))
    while len(balls) < 2:
        direction = random.normal(size=3) * (1.0, 1.0, 0.4)
        velocity = _SPEED * direction / np.linalg.norm(direction)
        at = points[random.integers(len(points))] + random.normal(0.0, 0.05, 3)
        when = random.uniform(*_PASSES)
        center = at - when * velocity
        radius = random.uniform(*_SIZES)
        course = center + np.outer(np.linspace(0.0, _LONGEST, 300), velocity)
        ball = Obstacle(f'ball{len(balls)}', center, np.full(3, radius), velocity=velocity)
        maps = inflated_obstacles(Scene.of([ball]), [c.radius for c in robot.capsules],
                                  moved=robot.moved)
        apart = link_clearance(maps, arm.segment_start, arm.segment_end).distance.min()
        if apart > _CLEAR_AT_FIRST and (
                np.linalg.norm(course[:, None] - column, axis=2).min() > _FROM_COLUMN):
            balls.append(ball)
            passed = max(passed, when + 2.0)
    return SweepScene(start, goal, tuple(balls), passed)


def _moved(balls: tuple[Obstacle, ...], seconds: float) -> Scene:
    return Scene.of([Obstacle(b.name, b.center + seconds * b.velocity, b.half_extents,
                              velocity=b.velocity) for b in balls])


def _servoed(
    robot: Robot, start: Array, goal: Pose, balls: tuple[Obstacle, ...],
    parameters: PlannerParameters | None = None,
) -> tuple[list[Array], float, str]:
    """Servo to a pose; return the postures, when it arrived for good, and the last reason."""
    planner, q = Planner(robot, parameters or PlannerParameters()), np.array(start)
    postures, since, reason = [q], 0.0, ''
    for tick in range(round(_LONGEST / DT)):
        arm = robot.kinematics(q)
        tip = Pose(arm.tip_position, arm.tip_rotation)
        error = se3.pose_error(goal, tip, False)
        if max(np.linalg.norm(error[:3]) / _ARRIVED,
               np.linalg.norm(error[3:]) / _ARRIVED_ANGLE) > 1.0:
            since = (tick + 1) * DT
        elif not balls:
            break
        result = planner.step(q, servo_twist(robot, tip, goal), _moved(balls, tick * DT), DT)
        q = q + DT * result.dq
        reason = result.reason
        postures.append(q)
    return postures, since, reason


def run(robot: Robot, seed: int, parameters: PlannerParameters) -> Outcome:
    """Servo through a scene."""
    scene = scene_of(robot, seed)
    postures, seconds, reason = _servoed(
        robot, scene.start, scene.goal, scene.balls, parameters)
    path = np.array(postures)
    motion = Motion.through(capsules_of(robot), path)
    tips = np.array([robot.kinematics(q).tip_position for q in postures])
    way = scene.goal.position - tips[0]
    along = np.clip((tips - tips[0]) @ way / (way @ way), 0.0, 1.0)
    return Outcome(
        seed, float(np.linalg.norm(tips[-1] - scene.goal.position)), seconds, scene.passed,
        float(np.linalg.norm(tips - tips[0] - np.outer(along, way), axis=1).max()),
        min(motion.to_obstacles(scene.balls, DT).distance, motion.to_itself().distance),
        limit_violation(robot, path, np.diff(path, axis=0) / DT, DT), reason)


def _job(job: tuple[int, str]) -> Outcome:
    seed, method = job
    return run(make_robot('panda', 6), seed, PlannerParameters(method=method))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(prog='benchmark.sweeps', description=__doc__)
    parser.add_argument('--count', type=int, default=24)
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--method', choices=METHODS, default='dynamic_factor')
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    parser.add_argument('--json', type=Path, help='file for every outcome')
    options = parser.parse_args()
    with Pool(options.jobs) as pool:
        jobs = [(options.seed + i, options.method) for i in range(options.count)]
        found = list(track(pool.imap(_job, jobs), options.method, len(jobs),
                           console=Console(stderr=True)))
    table = Table(title=f'{options.count} scenes from seed {options.seed}, {options.method}')
    for heading in ('arrive', 'hit', 'violations', 'nearest [mm]', 'seconds', '90 %',
                    'off its way [m]', 'farthest at the end [m]'):
        table.add_column(heading)
    seconds = [o.seconds for o in found]
    table.add_row(
        str(sum(o.seconds < _LONGEST for o in found)), str(sum(o.clearance < 0.0 for o in found)),
        str(sum(o.violation > 0.0 for o in found)),
        f'{1e3 * min(o.clearance for o in found):.1f}', f'{np.median(seconds):.1f}',
        f'{np.percentile(seconds, 90):.1f}', f'{np.median([o.off for o in found]):.3f}',
        f'{max(o.distance for o in found):.3f}')
    Console().print(table)
    if options.json is not None:
        options.json.write_text(json.dumps([o._asdict() for o in found]))


if __name__ == '__main__':
    main()
