"""Bodies with several tips among obstacles: `python -m benchmark.tips --help`.

Each problem is a pair of target poses, one for each tip, that some free posture has. Boxes and
balls lie around. Of the base it is one target out of the arm's reach. With --coupled the tips hold
one object, which goes along a line. With --separate each arm has a planner of its own, and they
tell each other `~/body`; what they share, such as a torso, stays. What counts is how many targets
are reached, that no link touches an obstacle or another link (by coal), and that no limit is
exceeded.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
import json
from multiprocessing import Pool
from pathlib import Path
import time
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track

from benchmark.bodies import Bodies, capsules_of
from benchmark.closest_approach import Motion
from benchmark.judge import limit_violation
from benchmark.tip_bodies import arms_of, BODIES, make_body
from benchmark.two_arms import moved
from redundant_planner.core.constants import gains_of, limits_of, robot_constants
from redundant_planner.core.horizon.least_norm_path import path_joints, PathJoints
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.coupling import Coupling
from redundant_planner.core.robot.se3 import integrate, poses_error
from redundant_planner.core.target.inverse_kinematics import AT_POSE, solve
from redundant_planner.core.target.progress import TargetState
from redundant_planner.io.robot_files import Robot

Array = npt.NDArray[np.float64]
T = TypeVar('T')

DT = 0.004
_LONGEST = 20.0  # [s]
# Start and goal keep this from obstacles and between links [m], and from joint limits, as far as
# their range allows [rad, m].
_CLEAR, _LIMIT_DISTANCE = 0.03, 0.1
# Boxes and balls: how many, half extents [m], and how far from a tip at the start or the goal [m].
_OBSTACLES, _SIZES, _AWAY = 6, (0.04, 0.1), 0.5
# How far the base has to go about [m].
_BASE_GOES = (1.0, 2.5)
# A base that drives first stops at this distance from the target, and the arm reaches then [m].
_REACHES = 0.5
# Coupled tips: how far the object goes [m, rad], at how many places of its line a posture has to
# be found, and the smallest singular value of J there.
_OBJECT_GOES, _OBJECT_TURNS, _PLACES, _REGULAR = 0.3, 0.6, 12, 0.1
# Time until an arm that says that its target is blocked is believed [s].
_PATIENCE = 5.0
_HELD_UP = TargetState.BLOCKED, TargetState.OUT_OF_REACH


class Problem(NamedTuple):
    """Postures (n,) of start and goal, obstacles, and the twist of coupled tips' object."""

    start: Array
    goal: Array
    obstacles: tuple[Obstacle, ...]
    twist: Array | None = None


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
        base_least: how far it goes straight ahead if it drives first and the arm reaches then [m].
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
            if _is_clear(robot, bodies, q):
                return q

    start = posture(None)
    goal = posture(start)
    ends = [Motion.through(bodies, q[None]) for q in (start, goal)]
    tips = np.vstack([robot.kinematics(q).tip_positions for q in (start, goal)])
    return Problem(start, goal, _obstacles(random, tips, lambda obstacle: all(
        end.to_obstacles((obstacle,), DT).distance > _CLEAR for end in ends)))


def _obstacles(
    random: np.random.Generator, tips: Array, is_away: Callable[[Obstacle], bool],
) -> tuple[Obstacle, ...]:
    """Return boxes and balls about places (k, 3) that are far enough away."""
    obstacles: list[Obstacle] = []
    while len(obstacles) < _OBSTACLES:
        center = tips[random.integers(len(tips))] + random.uniform(-_AWAY, _AWAY, 3)
        half = random.uniform(*_SIZES, 3)
        name = str(len(obstacles))
        obstacle = (Obstacle(name, center, np.full(3, half[0])) if len(obstacles) % 2 else
                    Obstacle.box(name, center, 2.0 * half))
        if is_away(obstacle):
            obstacles.append(obstacle)
    return tuple(obstacles)


def coupled_problem_of(robot: Robot, seed: int) -> Problem:
    """Return a random motion of what both hands hold, along a line that postures are found for.

    Obstacles are away from start and goal, and from the hands on the line; other links may have
    to make way.
    """
    random, bodies = np.random.default_rng(seed), capsules_of(robot)
    joints = _path_joints(robot)
    low = np.maximum(robot.position_min + _LIMIT_DISTANCE, -np.pi)
    high = np.minimum(robot.position_max - _LIMIT_DISTANCE, np.pi)
    if robot.position_max[0] - robot.position_min[0] < 1.0:  # a lift
        low[0], high[0] = robot.position_min[0], robot.position_max[0]
    hands = [i for i, joint in enumerate(bodies.joints) if joint in robot.chain.tip_joints]
    while True:
        q = random.uniform(low, high)
        if not _is_good(robot, bodies, q):
            continue
        tips = robot.kinematics(q).tips
        coupling = Coupling.of(tips)
        twist = np.concatenate((
            random.uniform(-_OBJECT_GOES, _OBJECT_GOES, 3) / np.sqrt(3.0),
            random.uniform(-_OBJECT_TURNS, _OBJECT_TURNS, 3) / np.sqrt(3.0)))
        held, postures = coupling.object_pose(tips.first), [q]
        for share in np.linspace(0.0, 1.0, _PLACES + 1)[1:]:
            pose = integrate(held, twist, share, False)
            found = solve(postures[-1], coupling.tips(coupling.first_at(pose)), robot.chain,
                          joints)
            if found.error > AT_POSE or not _is_good(robot, bodies, found.q):
                break
            postures.append(found.q)
        else:
            break
    ends = [Motion.through(bodies, postures[i][None]) for i in (0, -1)]
    of_hands = Motion.through(_part(bodies, hands), np.array(postures))
    tip_places = np.vstack([robot.kinematics(q).tip_positions for q in postures])
    return Problem(postures[0], postures[-1], _obstacles(
        random, tip_places, lambda obstacle: all(
            motion.to_obstacles((obstacle,), DT).distance > _CLEAR
            for motion in (*ends, of_hands))), twist)


def _part(bodies: Bodies, chosen: list[int]) -> Bodies:
    """Return some of an arm's shapes."""
    def some(field: Sequence[T]) -> tuple[T, ...]:
        return tuple(field[i] for i in chosen)

    return replace(
        bodies, names=some(bodies.names), links=some(bodies.links), joints=some(bodies.joints),
        placements=some(bodies.placements), shapes=some(bodies.shapes), self_pairs=[])


def _is_good(robot: Robot, bodies: Bodies, q: Array) -> bool:
    """Return whether a posture (n,) is regular, and free of itself and of the floor."""
    values = np.linalg.svd(robot.kinematics(q).jacobian, compute_uv=False)
    return bool(values[-1] > _REGULAR) and _is_clear(robot, bodies, q)


def _is_clear(robot: Robot, bodies: Bodies, q: Array) -> bool:
    """Return whether the links that move are clear of each other and the floor at q (n,)."""
    arm = robot.kinematics(q)
    ends = np.vstack((arm.segment_start[robot.moved], arm.segment_end[robot.moved],
                      arm.tip_positions))
    return bool(ends[:, 2].min() > _CLEAR
                and Motion.through(bodies, q[None]).to_itself().distance > _CLEAR)


def run_coupled(
    robot: Robot, problem: Problem, seed: int, parameters: PlannerParameters,
) -> Outcome:
    """Let the planner take the object to the end of its line."""
    planner, scene = Planner(robot, parameters), Scene.of(problem.obstacles)
    assert problem.twist is not None
    q, still = problem.start, np.zeros(6)
    planner.step(q, np.zeros((len(robot.tips), 6)), scene, DT)
    planner.couple()
    assert planner.coupling is not None and planner.reference is not None
    coupling = planner.coupling
    target = integrate(coupling.object_pose(planner.reference), problem.twist, 1.0, False)
    postures, velocities, ticks = [q], [], []
    state, held_up, lost = TargetState.MOVING, 0.0, 0.0
    for _ in range(round(_LONGEST / DT)):
        begin = time.perf_counter()
        result = planner.step(q, still, scene, DT, target=target)
        ticks.append(time.perf_counter() - begin)
        planner.prepare(scene)
        q = q + DT * result.dq
        postures.append(q)
        velocities.append(result.dq)
        tips = robot.kinematics(q).tips
        off = poses_error(coupling.tips(tips.first), tips, False).reshape(-1, 2, 3)
        lost = max(lost, float(np.linalg.norm(off, axis=2).max()))
        assert result.progress is not None
        state = result.progress.state
        held_up = held_up + DT if state in _HELD_UP else 0.0
        if state is TargetState.REACHED or held_up > _PATIENCE:
            break
    return judged(robot, problem, seed, state, np.array(postures), np.array(velocities),
                  ticks)._replace(relative_mm=1e3 * lost)


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


def run_separate(
    robot: Robot, problem: Problem, seed: int, parameters: PlannerParameters,
) -> Outcome:
    """Let two planners go there, one for each arm."""
    arms = arms_of(robot, problem.start)
    poses = robot.kinematics(problem.goal).tips.each
    found = moved(
        (arms[0][0], arms[1][0]), (problem.start[arms[0][1]], problem.start[arms[1][1]]),
        (poses[0], poses[1]), (problem.obstacles, problem.obstacles), parameters, _LONGEST)
    postures = np.tile(problem.start, (len(found.positions[0]), 1))
    velocities = np.zeros((len(found.velocities[0]), robot.n))
    for (_, own), positions, speeds in zip(arms, found.positions, found.velocities):
        postures[:, own], velocities[:, own] = positions, speeds
    state = next((state for state in found.states if state is not TargetState.REACHED),
                 TargetState.REACHED)
    outcome = judged(robot, problem, seed, state, postures, velocities, found.ticks)
    return outcome._replace(seconds=max(found.since))


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
        target = robot.kinematics(problem.goal).tip_position[:2]
        least = max(float(np.linalg.norm(target - problem.start[:2])) - _REACHES, 0.0)
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


def _path_joints(robot: Robot) -> PathJoints:
    parameters = PlannerParameters()
    return path_joints(robot_constants(robot, parameters), gains_of(parameters),
                       limits_of(robot, parameters))


def _job(job: tuple[str, int, str, str]) -> Outcome:
    body, seed, method, how = job
    robot, parameters = _body(body), PlannerParameters(method=method)
    if how == 'coupled':
        return run_coupled(robot, coupled_problem_of(robot, seed), seed, parameters)
    problem = problem_of(robot, seed, body == 'base')
    return (run_separate if how == 'separate' else run)(robot, problem, seed, parameters)


def _options(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='benchmark.tips', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--body', choices=BODIES, default=BODIES[0])
    how = parser.add_mutually_exclusive_group()
    how.add_argument('--coupled', dest='how', action='store_const', const='coupled', default='',
                     help='both hands hold one object')
    how.add_argument('--separate', dest='how', action='store_const', const='separate',
                     help='each arm has a planner of its own')
    parser.add_argument('--count', type=int, default=100)
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--method', choices=METHODS, default='dynamic_factor')
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    parser.add_argument('--json', type=Path, help='file for the summary')
    options = parser.parse_args(args)
    if options.how and options.body == 'base':
        parser.error(f'--{options.how} takes a body with two hands')
    return options


def main(args: list[str] | None = None) -> None:
    """Run and print."""
    options = _options(args)
    _body(options.body)  # its shapes are fitted once
    jobs = [(options.body, options.seed + i, options.method, options.how)
            for i in range(options.count)]
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
