"""Chunks: planned trajectories among obstacles, and policies: `python -m benchmark.chunks --help`.

Trajectories are as MoveIt has them: joint positions and velocities every 0.1 s, from rest to rest,
smooth and within the limits of joints and tip. Half of them would hit one of four obstacles. The
others keep 3 cm; they shall be followed as they are. The curve between two points is the cubic
that a joint_trajectory_controller takes.

Policies send a new chunk before the old one ends. Each is off by some centiradian, or some
centimetres of the tip, from one slow motion: two successive chunks disagree.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.judge import accelerations, limit_violation, reversals
from benchmark.robots import make_robot
from benchmark.target_problems import problem_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.progress import TargetState

Array = npt.NDArray[np.float64]

DT = 0.004
# A trajectory is free that keeps this from obstacles and between links [m].
_CLEAR = 0.03
# Of a trajectory: time between points [s], shares of the limits that it takes, how far its middle
# lies beside the straight way [rad], and samples that are looked at.
_SAMPLING, _SHARES, _BESIDE, _SAMPLES = 0.1, (0.2, 1.0), 0.3, 400
# A run along a trajectory ends so long after the trajectory does, or once the arm is blocked for
# so long [s].
_LONGER, _PATIENCE = 1.0, 1.5
# Of a policy: points in a chunk, their rates [1/s], which share of a chunk is used, and how long a
# run is [s].
_POINTS, _RATES, _USED, _RUN = (10, 50), (5.0, 30.0), (0.3, 0.9), 10.0
# Its motion: amplitude [rad] or [m, rad], frequency [1/s]. What a chunk is off by: joints [rad],
# tip [m, rad].
_AMPLITUDE, _TIP_AMPLITUDE, _FREQUENCY = 0.25, (0.1, 0.2), (0.05, 0.1)
_OFF, _TIP_OFF = 0.01, (0.02, 0.02)
_READY = np.array([0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8])


def trajectory_of(robot: Robot, seed: int, hits: bool) -> tuple[Chunk, tuple[Obstacle, ...]]:
    """Return a random trajectory and four obstacles, of which it hits one or none."""
    random = np.random.default_rng((seed, int(hits)))
    bodies, parameters = capsules_of(robot), PlannerParameters()
    while True:
        problem = problem_of(robot, int(random.integers(2**31)))
        middle = 0.5 * (problem.start + problem.goal) + random.normal(0.0, _BESIDE, robot.n)
        path = CubicSpline((0.0, 0.5, 1.0), (problem.start, middle, problem.goal))
        chunk = _timed(robot, parameters, path, random)
        postures = curve_of(chunk)(np.linspace(0.0, chunk.times[-1], _SAMPLES))
        motion = Motion.through(bodies, postures)
        inside = ((postures > robot.position_min + _CLEAR)
                  & (postures < robot.position_max - _CLEAR)).all()
        if not inside or motion.to_itself().distance < _CLEAR:
            continue
        distance = motion.to_obstacles(problem.obstacles, DT).distance
        if (distance < 0.0) if hits else (distance > _CLEAR):
            return chunk, problem.obstacles


def _timed(
    robot: Robot, parameters: PlannerParameters, path: CubicSpline, random: np.random.Generator,
) -> Chunk:
    """Return a path as a trajectory, its time by the limits."""
    x = np.linspace(0.0, 1.0, _SAMPLES + 1)
    along = (x**3 * (10.0 - 15.0 * x + 6.0 * x**2) if random.random() < 0.5
             else _trapezoid(x, float(random.uniform(0.1, 0.5))))
    q = path(along)
    rate, bend = np.gradient(q, x, axis=0), np.gradient(np.gradient(q, x, axis=0), x, axis=0)
    twists = np.array([robot.kinematics(one).tip_jacobian @ dq for one, dq in zip(q, rate)])
    share = float(random.uniform(*_SHARES))
    shortest = max(
        float((np.abs(rate) / robot.velocity_max).max()) / share,
        float(np.sqrt((np.abs(bend) / robot.acceleration_max).max() / share)),
        float(np.linalg.norm(twists[:, :3], axis=1).max()) / parameters.twist_speeds[0],
        float(np.linalg.norm(twists[:, 3:], axis=1).max()) / parameters.twist_speeds[1])
    count = int(np.ceil(shortest / _SAMPLING)) + 1
    duration = _SAMPLING * (count - 1)
    times = np.linspace(0.0, 1.0, count)
    points = CubicSpline(x, q)(times)
    rates = CubicHermiteSpline(x, q, rate)(times, 1) / duration
    rates[[0, -1]] = 0.0
    return Chunk(duration * times, points, rates)


def _trapezoid(x: Array, ramp: float) -> Array:
    """Return the way at x from 0 to 1 with a speed that rises and falls for a share each."""
    speed = np.minimum(np.minimum(x / ramp, (1.0 - x) / ramp), 1.0)
    along = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))))
    return np.asarray(along / along[-1])


def curve_of(chunk: Chunk) -> CubicHermiteSpline:
    """Return the cubics through a trajectory's points."""
    return CubicHermiteSpline(chunk.times, chunk.points, chunk.velocities)


def along_trajectory(robot: Robot, seed: int, hits: bool) -> dict[str, Any]:
    """Follow a trajectory; return what came of it."""
    chunk, obstacles = trajectory_of(robot, seed, hits)
    assert isinstance(chunk.points, np.ndarray), 'of the joints'
    planner, scene = Planner(robot, PlannerParameters()), Scene.of(obstacles)
    q, blocked = np.array(chunk.points[0]), 0.0
    postures, velocities = [q], []
    while DT * len(velocities) < chunk.times[-1] + _LONGER:
        result = planner.step(q, np.zeros(6), scene, DT, target=chunk)
        q = q + DT * result.dq
        postures.append(q)
        velocities.append(result.dq)
        assert result.progress is not None
        state = result.progress.state
        blocked = blocked + DT if state is TargetState.BLOCKED else 0.0
        if state is TargetState.REACHED or blocked > _PATIENCE:
            break
    motion = Motion.through(capsules_of(robot), np.array(postures))
    dense = curve_of(chunk)(np.linspace(0.0, chunk.times[-1], round(chunk.times[-1] / 5e-4)))
    seconds = DT * len(velocities)
    assert result.progress is not None, 'a chunk commands'
    return {
        'kind': 'hits' if hits else 'free', 'seed': seed, 'state': state.value,
        'clearance_m': min(motion.to_obstacles(obstacles, DT).distance,
                           motion.to_itself().distance),
        'off_rad': max(float(np.abs(dense - one).max(axis=1).min()) for one in postures),
        'time_ratio': seconds / float(chunk.times[-1]), 'behind_s': result.progress.behind,
        'reason': result.reason,
        'violation': limit_violation(robot, np.array(postures), np.array(velocities), DT),
        'reversals_per_10_s': 10.0 / seconds * reversals(
            accelerations(np.array(velocities), DT), robot.acceleration_max)}


def chunks_of(robot: Robot, random: np.random.Generator, tip: bool) -> Callable[[float], Chunk]:
    """Return a policy: time [s] → a chunk that begins then."""
    count, rate = int(random.integers(_POINTS[0], _POINTS[1] + 1)), random.uniform(*_RATES)
    times = np.arange(count) / rate
    width = 6 if tip else robot.n
    scale = np.repeat(_TIP_AMPLITUDE, 3) if tip else np.full(width, _AMPLITUDE)
    off = np.repeat(_TIP_OFF, 3) if tip else np.full(width, _OFF)
    frequency, phase = random.uniform(*_FREQUENCY, width), random.uniform(0.0, 6.28, width)
    begin = robot.kinematics(_READY)
    home = Pose(begin.tip_position, begin.tip_rotation)

    def chunk(now: float) -> Chunk:
        x = 6.28 * frequency * (now + times)[:, None] + phase
        points = scale * (np.sin(x) - np.sin(phase)) + random.normal(0.0, off)
        if not tip:
            return Chunk(times, _READY + points)
        return Chunk(times, [se3.displaced(home, point, False) for point in points])

    return chunk


def by_policy(robot: Robot, seed: int, tip: bool) -> dict[str, Any]:
    """Follow a policy for 10 s; return what came of it."""
    random = np.random.default_rng((seed, 2 + int(tip)))
    planner, policy = Planner(robot, PlannerParameters()), chunks_of(robot, random, tip)
    q, until, now = _READY.copy(), -1.0, 0.0
    postures, velocities, off, behind = [q], [], [], 0.0
    reasons = set()
    while now < _RUN:
        if now > until:
            chunk = policy(now)
            until = now + random.uniform(*_USED) * chunk.times[-1]
        result = planner.step(q, np.zeros(6), Scene.of(()), DT, target=chunk)
        q = q + DT * result.dq
        postures.append(q)
        velocities.append(result.dq)
        assert result.progress is not None
        off.append(result.progress.beside)
        behind = max(behind, result.progress.behind)
        reasons.add(result.reason)
        now += DT
    return {
        'kind': 'tip policy' if tip else 'joint policy', 'seed': seed,
        'points': len(chunk.times), 'rate': float(1.0 / chunk.times[1]),
        'off_rad': float(np.median(off)), 'behind_s': behind,
        'reason': '; '.join(sorted(reasons - {''})),
        'violation': limit_violation(robot, np.array(postures), np.array(velocities), DT),
        'reversals_per_10_s': reversals(
            accelerations(np.array(velocities), DT), robot.acceleration_max)}


def _job(job: tuple[str, int, bool]) -> dict[str, Any]:
    robot = make_robot('panda', 6)
    kind, seed, other = job
    return (along_trajectory if kind == 'trajectory' else by_policy)(robot, seed, other)


def _options(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='benchmark.chunks', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--count', type=int, default=100, help='trajectories')
    parser.add_argument('--policies', type=int, default=30, help='policies')
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    parser.add_argument('--json', type=Path, help='file for every outcome')
    return parser.parse_args(args)


def main(args: list[str] | None = None) -> None:
    """Run and print."""
    options = _options(args)
    jobs = [('trajectory', options.seed + i // 2, bool(i % 2)) for i in range(options.count)]
    jobs += [('policy', options.seed + i // 2, bool(i % 2)) for i in range(options.policies)]
    console = Console(width=200)
    if options.jobs > 1:
        with Pool(options.jobs) as pool:
            found = list(track(pool.imap(_job, jobs), 'chunks', len(jobs),
                               console=Console(stderr=True)))
    else:
        found = [_job(job) for job in track(jobs, 'chunks', console=Console(stderr=True))]
    console.print(_table(found))
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1))


def _table(found: list[dict[str, Any]]) -> Table:
    """Return one row for each kind, with the worst of each."""
    table = Table(title='chunks')
    for heading in ('kind', 'runs', 'contacts', 'least clearance [mm]', 'violations', 'blocked',
                    'off [mrad]', 'time, median', 'time, longest', 'behind [s]',
                    'reversals in 10 s, median', 'most'):
        table.add_column(heading)
    for kind in dict.fromkeys(one['kind'] for one in found):
        runs = [one for one in found if one['kind'] == kind]
        clearances = [one.get('clearance_m', np.nan) for one in runs]
        times = [one.get('time_ratio', np.nan) for one in runs]
        turns = [one['reversals_per_10_s'] for one in runs]
        table.add_row(
            kind, str(len(runs)), str(sum(c < 0.0 for c in clearances)),
            f'{1e3 * min(clearances):.1f}', str(sum(one['violation'] > 0.0 for one in runs)),
            str(sum(one.get('state') == TargetState.BLOCKED.value for one in runs)),
            f"{1e3 * max(one['off_rad'] for one in runs):.2f}", f'{np.median(times):.3f}',
            f'{max(times):.3f}', f"{max(one['behind_s'] for one in runs):.3f}",
            f'{np.median(turns):.1f}', f'{max(turns):.1f}')
    return table


if __name__ == '__main__':
    main()
