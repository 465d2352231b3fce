"""Random poses to go to among obstacles: `python -m benchmark.targets --help`.

Start and goal are free, the obstacles lie anywhere else (`target_problems`). With --path straight
the tip goes along a line, and many goals are behind something. What counts is that nothing is
touched, that no limit is exceeded, how many goals are reached, and how long a motion takes over
the least time that the joints' limits leave for the same joint path.

Other libraries find no way of their own. They servo to the pose, by a twist in proportion to what
is left, as in `benchmark.problem_sets`, and are judged alike.
"""

from __future__ import annotations

import argparse
from collections import Counter
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
from benchmark.peers import library, missing, PEERS
from benchmark.problem_sets.problem import Problem as StaticProblem, tip_pose
from benchmark.problem_sets.servo import servo_twist
from benchmark.robots import make_robot
from benchmark.target_problems import crossing, LONGEST, PASSES, Problem, problem_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PlannerParameters, TARGET_PATHS
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.cone import Cone
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, pose_error
from redundant_planner.core.target.progress import REACHED, TargetState

Array = npt.NDArray[np.float64]

DT = 0.004
# A run ends when the arm has been held up for so long [s]. A library that says nothing is held up
# while no joint moves faster than this [rad/s].
_HELD_UP, _PATIENCE = (TargetState.BLOCKED, TargetState.OUT_OF_REACH), 5.0
_STANDING = 1e-3
_METHODS = [name for name in METHODS if name != 'gradient_projection']
_ENDS = (TargetState.REACHED, TargetState.BLOCKED, TargetState.OUT_OF_REACH)
# Samples of a joint path, and over how many of them its direction is averaged.
_SAMPLES, _AVERAGED = 400, 15


class Outcome(NamedTuple):
    """What a run came to.

    Attributes:
        seed: of the problem.
        state: at its end.
        distance, angle: of the tip from the target at the end [m, rad].
        clearance: smallest distance of a link to an obstacle or another link [m].
        violation: see `limit_violation`.
        lean: the furthest that the tip leaned away from straight down [rad].
        thought: how long the arm thought [s].
        seconds: until the target was reached, besides [s].
        fastest: the least that the joints' limits leave for the same joint path [s].
        path: length of the joint path [rad].
        path_ratio: over the shortest one near it; NaN if nobody looked, or nothing was found.
    """

    seed: int
    state: str
    distance: float
    angle: float
    clearance: float
    violation: float
    lean: float
    thought: float
    seconds: float
    fastest: float
    path: float
    path_ratio: float = float('nan')


class Ride(NamedTuple):
    """A motion to a goal.

    Attributes:
        postures: (k + 1, n) [rad, m].
        velocities: (k, n) between them [rad/s, m/s].
        state: at its end.
        thought: how long the arm thought [s].
    """

    postures: Array
    velocities: Array
    state: TargetState
    thought: float = 0.0


def planned(robot: Robot, problem: Problem, parameters: PlannerParameters) -> Ride:
    """Let the planner go to the goal's tip pose until it is reached, or until the arm is stuck."""
    planner, scene = Planner(robot, parameters), Scene.of(problem.obstacles)
    target = tip_pose(robot, problem.goal)
    q, positions, velocities = problem.start, [problem.start], []
    still, held_up, thought = np.zeros(6), 0.0, 0.0
    for tick in range(round(LONGEST / DT)):
        if problem.moving:
            scene = Scene.of(_obstacles_at(problem, tick * DT))
        result = planner.step(q, still, scene, DT, target=target)
        q = q + DT * result.dq
        positions.append(q)
        velocities.append(result.dq)
        assert result.progress is not None
        state = result.progress.state
        held_up = held_up + DT if state in _HELD_UP else 0.0
        if _is_over(problem, state, held_up, tick):
            break
        thought += DT * (state is TargetState.THINKING)
    return Ride(np.array(positions), np.array(velocities), state, thought)


def servoed(robot: Robot, problem: Problem, name: str) -> Ride:
    """Let another library servo to the goal's tip pose, likewise.

    Raises:
        MissingPeerError: it is not installed.
    """
    p = PlannerParameters()
    peer = library(name)(robot, _obstacles_at(problem, 0.0), p.clearance_margin,
                         p.clearance_self_margin)
    target = tip_pose(robot, problem.goal)
    q, positions, velocities, held_up = problem.start, [problem.start], [], 0.0
    for tick in range(round(LONGEST / DT)):
        if problem.moving:
            peer.move(_obstacles_at(problem, tick * DT))
        tip = tip_pose(robot, q)
        wanted = integrate(tip, servo_twist(robot, tip, target), DT, robot.in_tool)
        dq = peer.step(q, wanted, DT)
        q = q + DT * dq
        positions.append(q)
        velocities.append(dq)
        off = pose_error(target, tip_pose(robot, q), robot.in_tool)
        there = max(np.linalg.norm(off[:3]), np.linalg.norm(off[3:])) < REACHED
        state = TargetState.REACHED if there else TargetState.BLOCKED
        held_up = held_up + DT if np.abs(dq).max() < _STANDING else 0.0
        if _is_over(problem, state, held_up, tick):
            break
    return Ride(np.array(positions), np.array(velocities), state)


def _is_over(problem: Problem, state: TargetState, held_up: float, tick: int) -> bool:
    """Return whether a run has ended, and what moves is past."""
    past = not problem.moving or tick * DT >= 2.0 * PASSES
    return past and (state is TargetState.REACHED or held_up > _PATIENCE)


def _obstacles_at(problem: Problem, seconds: float) -> tuple[Obstacle, ...]:
    return (*problem.obstacles, *(o.after(seconds) for o in problem.moving))


def judged(
    robot: Robot, problem: Problem, parameters: PlannerParameters, seed: int, ride: Ride,
) -> Outcome:
    """Return what a motion came to."""
    postures, target = ride.postures, tip_pose(robot, problem.goal)
    motion = Motion.through(capsules_of(robot), postures)
    clearance = min(motion.to_obstacles((*problem.obstacles, *problem.moving), DT).distance,
                    motion.to_itself().distance)
    off = pose_error(target, tip_pose(robot, postures[-1]), robot.in_tool)
    return Outcome(
        seed, ride.state.value, float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:])),
        clearance, limit_violation(robot, postures, ride.velocities, DT),
        max(float(np.arccos(min(-robot.kinematics(q).tip_rotation[2, 2], 1.0)))
            for q in postures),
        ride.thought, DT * len(ride.velocities) - ride.thought,
        fastest_time(robot, postures, parameters),
        float(np.linalg.norm(np.diff(postures, axis=0), axis=1).sum()))


def fastest_time(
    robot: Robot, positions: Array, parameters: PlannerParameters,
) -> float:
    """Return the least time for a joint path (k, n) from rest to rest [s].

    By the phase plane over its length, with the limits of velocity and acceleration (Bobrow et al.
    1985) and those of the tip's speed. Jerk limits make every motion longer by 2 a / j.
    """
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    moving = np.concatenate(([True], steps > 1e-9))
    along = np.concatenate(([0.0], np.cumsum(steps)))[moving]
    if along[-1] < 1e-6:
        return 0.0
    s = np.linspace(0.0, along[-1], _SAMPLES)
    averaged = np.ones(_AVERAGED) / _AVERAGED
    path = np.array([np.interp(s, along, column) for column in positions[moving].T]).T
    direction = np.array([np.convolve(np.gradient(column, s[1]), averaged, 'valid')
                          for column in path.T]).T
    trim = _AVERAGED // 2
    twists = np.array([robot.kinematics(q).tip_jacobian @ dq
                       for q, dq in zip(path[trim:-trim], direction)])
    length = np.maximum(np.abs(direction), 1e-9)
    speed = (robot.velocity_max / length).min(axis=1)
    for part, limit in ((twists[:, :3], parameters.limits_linear_speed),
                        (twists[:, 3:], parameters.limits_angular_speed)):
        speed = np.minimum(speed, limit / np.maximum(np.linalg.norm(part, axis=1), 1e-9))
    rise = (robot.acceleration_max / length).min(axis=1)
    ds = along[-1] / (len(speed) - 1)
    speed[0] = speed[-1] = 0.0
    for i in range(1, len(speed)):
        speed[i] = min(speed[i], np.sqrt(speed[i - 1] ** 2 + 2.0 * rise[i] * ds))
    for i in reversed(range(len(speed) - 1)):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + 2.0 * rise[i] * ds))
    jerk = 2.0 * float((robot.acceleration_max / robot.jerk_max).max())
    return float((2.0 * ds / (speed[1:] + speed[:-1])).sum()) + jerk


class _Job(NamedTuple):
    """A run: which problem, by what, and what to look at."""

    seed: int
    method: str
    path: str
    cone: float
    moving: bool
    optimum: bool


def _job(job: _Job) -> Outcome:
    robot, seed, cone = make_robot('panda', 6), job.seed, job.cone
    down = Cone(np.array((0.0, 0.0, 1.0)), np.array((0.0, 0.0, -1.0)), cone)
    problem = problem_of(robot, seed, down if cone < np.pi else None)
    if job.moving:
        problem = crossing(robot, problem, seed)
    parameters = PlannerParameters()
    if job.method in PEERS:
        ride = servoed(robot, problem, job.method)
    else:
        parameters = PlannerParameters(method=job.method, target_path=job.path, cone_angle=cone,
                                       cone_direction=(0.0, 0.0, -1.0))
        ride = planned(robot, problem, parameters)
    outcome = judged(robot, problem, parameters, seed, ride)
    if not job.optimum or ride.state is not TargetState.REACHED:
        return outcome
    from benchmark.problem_sets.shortest import path_ratio
    alone = StaticProblem(str(seed), 'targets', problem.obstacles, problem.start, problem.goal)
    return outcome._replace(path_ratio=path_ratio(
        robot, alone, ride.postures, parameters.clearance_margin))


def _options(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='benchmark.targets', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--count', type=int, default=200)
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--method', action='append', choices=[*_METHODS, *PEERS],
                        help="may be given more than once; this package's if not given; the "
                        "others' libraries have to be installed")
    parser.add_argument('--path', choices=TARGET_PATHS, default=TARGET_PATHS[0])
    parser.add_argument('--cone', type=float, default=180.0, metavar='DEG',
                        help='how far the hand may lean from straight down')
    parser.add_argument('--moving', action='store_true',
                        help='a ball crosses the way while the arm is on it')
    parser.add_argument('--optimum', action='store_true',
                        help='compare every way with the shortest one near it (CasADi)')
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    parser.add_argument('--json', type=Path, help='file for every outcome')
    options = parser.parse_args(args)
    if options.optimum and options.moving:
        parser.error('--optimum knows obstacles that stand still, not --moving')
    for name in options.method or ():
        lack = missing(name) if name in PEERS else ''
        if lack:
            parser.error(lack)
    return options


def main(args: list[str] | None = None) -> None:
    """Run and print."""
    options, outcomes = _options(args), {}
    console = Console(width=200)
    with Pool(options.jobs) as pool:
        for method in options.method or _METHODS:
            jobs = [_Job(options.seed + i, method, options.path, float(np.radians(options.cone)),
                         options.moving, options.optimum)
                    for i in range(options.count)]
            outcomes[method] = list(track(
                pool.imap(_job, jobs), method, len(jobs), console=Console(stderr=True)))
    title = f'{options.count} poses from seed {options.seed}, {options.path}'
    console.print(_table(title, outcomes))
    if options.json is not None:
        options.json.write_text(json.dumps(
            {method: [o._asdict() for o in found] for method, found in outcomes.items()}))


def _table(title: str, outcomes: dict[str, list[Outcome]]) -> Table:
    """Return one row per method; times, paths and distances are of what was reached."""
    table = Table(title=title)
    for heading in ('method', 'reached', 'blocked', 'out of reach', 'contacts', 'violations',
                    'off [mm]', 'off [deg]', 'leans [deg]', 'thought [s]', 'time', '90 %',
                    'path [rad]', 'path ratio', '90 %'):
        table.add_column(heading)
    for method, found in outcomes.items():
        reached = [o for o in found if o.state == TargetState.REACHED.value]
        ratios = [o.seconds / o.fastest for o in reached] or [np.nan]
        paths = [o.path_ratio for o in reached if np.isfinite(o.path_ratio)] or [np.nan]
        table.add_row(
            method, *(str(Counter(o.state for o in found)[state.value]) for state in _ENDS),
            str(sum(o.clearance < 0.0 for o in found)),
            str(sum(o.violation > 0.0 for o in found)),
            f'{1e3 * max((o.distance for o in reached), default=np.nan):.2f}',
            f'{np.degrees(max((o.angle for o in reached), default=np.nan)):.3f}',
            f'{np.degrees(max(o.lean for o in found)):.2f}',
            f'{np.median([o.thought for o in reached] or [np.nan]):.2f}',
            f'{np.median(ratios):.3f}', f'{np.percentile(ratios, 90):.3f}',
            f'{np.median([o.path for o in reached] or [np.nan]):.2f}',
            f'{np.median(paths):.3f}', f'{np.percentile(paths, 90):.3f}')
    return table


if __name__ == '__main__':
    main()
