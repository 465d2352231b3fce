"""Bodies with several tips among obstacles: `python -m benchmark.tips --help`.

Each problem is a pair of target poses, one for each tip, that some free posture has. Boxes and
balls lie around. Of the base it is one target out of the arm's reach. What counts is how many
targets are reached, that no link touches an obstacle or another link (by coal), and that no limit
is exceeded.
"""

from __future__ import annotations

import argparse
from functools import cache
import json
from multiprocessing import Pool
from pathlib import Path
import time
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.judge import limit_violation
from benchmark.tip_bodies import BODIES, make_body
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.target.goal import Target
from redundant_planner.core.target.progress import TargetState
from redundant_planner.io.robot_files import Robot

Array = npt.NDArray[np.float64]

DT = 0.004
_LONGEST = 20.0  # [s]
# Start and goal keep this from obstacles and between links [m], and from joint limits, as far as
# their range allows [rad, m].
_CLEAR, _LIMIT_DISTANCE = 0.03, 0.1
# Boxes and balls: how many, half extents [m], and how far from a tip at the start or the goal [m].
_OBSTACLES, _SIZES, _AWAY = 6, (0.04, 0.1), 0.5
# How far the base has to go about [m].
_BASE_GOES = (1.0, 2.5)
# Time until an arm that says that its target is blocked is believed [s].
_PATIENCE = 5.0
_HELD_UP = TargetState.BLOCKED, TargetState.OUT_OF_REACH


class Problem(NamedTuple):
    """Postures (n,) of start and goal, and obstacles."""

    start: Array
    goal: Array
    obstacles: tuple[Obstacle, ...]


class Outcome(NamedTuple):
    """What a run came to.

    Attributes:
        seed: of the problem.
        state: at its end.
        seconds: until then [s].
        clearance: smallest distance of a link to an obstacle or another link [m].
        nearest: which these were.
        violation: see `limit_violation`.
        relative_mm: how far the relative pose of the tips was lost [mm, mrad]; 0 where they are
            not coupled.
        tick_us: of ticks that move the arm, in the median [µs].
        base_way: how far the base went [m]; 0 without one.
        base_least: how far it goes if it drives first and the arm reaches then [m].
    """

    seed: int
    state: str
    seconds: float
    clearance: float
    nearest: str
    violation: float
    relative_mm: float
    tick_us: float
    base_way: float
    base_least: float


@cache
def _body(name: str) -> Robot:
    return make_body(name)


def problem_of(robot: Robot, seed: int, on_a_base: bool) -> Problem:
    """Return a random problem."""
    random = np.random.default_rng(seed)
    bodies = capsules_of(robot)
    spread = np.minimum(_LIMIT_DISTANCE, 0.1 * (robot.position_max - robot.position_min))
    low = np.maximum(robot.position_min + spread, -np.pi)
    high = np.minimum(robot.position_max - spread, np.pi)

    def posture(middle: Array | None) -> Array:
        while True:
            q = random.uniform(low, high)
            if on_a_base:
                q[:2] = 0.0
                if middle is not None:
                    angle = random.uniform(-np.pi, np.pi)
                    q[:2] = random.uniform(*_BASE_GOES) * np.array((np.cos(angle), np.sin(angle)))
            arm = robot.kinematics(q)
            lowest = min(arm.segment_start[:, 2].min(), arm.tip_positions[:, 2].min())
            if lowest > _CLEAR and Motion.through(bodies, q[None]).to_itself().distance > _CLEAR:
                return q

    start = posture(None)
    goal = posture(start)
    ends = [Motion.through(bodies, q[None]) for q in (start, goal)]
    tips = np.vstack([robot.kinematics(q).tip_positions for q in (start, goal)])
    obstacles: list[Obstacle] = []
    while len(obstacles) < _OBSTACLES:
        center = tips[random.integers(len(tips))] + random.uniform(-_AWAY, _AWAY, 3)
        half = random.uniform(*_SIZES, 3)
        name = str(len(obstacles))
        obstacle = (Obstacle(name, center, np.full(3, half[0])) if len(obstacles) % 2 else
                    Obstacle.box(name, center, 2.0 * half))
        if all(end.to_obstacles((obstacle,), DT).distance > _CLEAR for end in ends):
            obstacles.append(obstacle)
    return Problem(start, goal, tuple(obstacles))


def run(robot: Robot, problem: Problem, seed: int, parameters: PlannerParameters) -> Outcome:
    """Let the planner go to the tips' poses at the goal."""
    planner, scene = Planner(robot, parameters), Scene.of(problem.obstacles)
    poses = robot.kinematics(problem.goal).tips
    target: Any = (dict(zip(robot.tips, poses.each)) if len(robot.tips) > 1 else poses.first)
    still = np.zeros((len(robot.tips), 6)) if len(robot.tips) > 1 else np.zeros(6)
    q, postures, velocities = problem.start, [problem.start], []
    held_up, ticks, state = 0.0, [], TargetState.THINKING
    for _ in range(round(_LONGEST / DT)):
        begin = time.perf_counter()
        result = planner.step(q, still, scene, DT, target=target)
        took = time.perf_counter() - begin
        assert result.progress is not None
        state = result.progress.state
        if state is TargetState.MOVING:
            ticks.append(took)
        planner.prepare(scene)
        q = q + DT * result.dq
        postures.append(q)
        velocities.append(result.dq)
        held_up = held_up + DT if state in _HELD_UP else 0.0
        if state is TargetState.REACHED or held_up > _PATIENCE:
            break
    return judged(robot, problem, seed, state, np.array(postures), np.array(velocities), ticks)


def judged(
    robot: Robot, problem: Problem, seed: int, state: TargetState, postures: Array,
    velocities: Array, ticks: list[float],
) -> Outcome:
    """Return what a motion came to."""
    motion = Motion.through(capsules_of(robot), postures)
    nearest = min(motion.to_obstacles(problem.obstacles, DT), motion.to_itself(),
                  key=lambda approach: approach.distance)
    way = least = 0.0
    if len(robot.tips) == 1:
        way = float(np.linalg.norm(np.diff(postures[:, :2], axis=0), axis=1).sum())
        least = float(np.linalg.norm(problem.goal[:2] - problem.start[:2]))
    return Outcome(
        seed, state.value, DT * len(velocities), nearest.distance, str(nearest),
        limit_violation(robot, postures, velocities, DT), 0.0,
        1e6 * float(np.median(ticks or [np.nan])), way, least)


def summary_of(outcomes: list[Outcome]) -> dict[str, float]:
    """Return what all runs came to."""
    arrived = [o for o in outcomes if o.state == TargetState.REACHED.value]
    return {
        'count': len(outcomes),
        'arrived': len(arrived) / len(outcomes),
        'contacts': sum(o.clearance < 0.0 for o in outcomes),
        'violations': sum(o.violation > 0.0 for o in outcomes),
        'relative_mm_max': max(o.relative_mm for o in outcomes),
        'time_median': float(np.median([o.seconds for o in arrived] or [np.nan])),
        'tick_us_median': float(np.nanmedian([o.tick_us for o in outcomes])),
        'base_way_median': float(np.median([o.base_way for o in arrived] or [np.nan])),
        'base_least_median': float(np.median([o.base_least for o in arrived] or [np.nan])),
    }


def _job(job: tuple[str, int, str]) -> Outcome:
    body, seed, method = job
    robot = _body(body)
    return run(robot, problem_of(robot, seed, body == 'base'), seed,
               PlannerParameters(method=method))


def _options(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='benchmark.tips', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--body', choices=BODIES, default=BODIES[0])
    parser.add_argument('--count', type=int, default=100)
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--method', choices=METHODS, default='dynamic_factor')
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    parser.add_argument('--json', type=Path, help='file for the summary')
    return parser.parse_args(args)


def main(args: list[str] | None = None) -> None:
    """Run and print."""
    options = _options(args)
    _body(options.body)  # its shapes are fitted once
    jobs = [(options.body, options.seed + i, options.method) for i in range(options.count)]
    with Pool(options.jobs) as pool:
        outcomes = list(track(pool.imap(_job, jobs), options.body, len(jobs),
                              console=Console(stderr=True)))
    summary = summary_of(outcomes)
    for outcome in outcomes:
        if outcome.state != TargetState.REACHED.value or outcome.clearance < 0.0 or (
                outcome.violation > 0.0):
            print(f'seed {outcome.seed}: {outcome.state}, {1e3 * outcome.clearance:.2f} mm '
                  f'{outcome.nearest}, {outcome.violation:.3g} beyond limits')
    for key, value in summary.items():
        print(f'{key:20}{value:10.4g}')
    if options.json is not None:
        options.json.write_text(json.dumps(summary))


if __name__ == '__main__':
    main()
