"""Time per tick, beside mink and pink on the same arm, capsules and obstacles.

    python -m benchmark.speed --json speed.json

The arm moves its tips to and fro, at up to 7 cm/s and 0.1 rad/s, among small ellipsoids, or boxes
and others with `--shapes`. All of them lie within reach (up to 1.2 m from the base) or spread over
a hall (20 m × 20 m × 4 m). Every figure is a median over ticks of one process; compare ratios, the
machine's own speed changes from minute to minute. `tick_own_p99_us` is the 99th percentile of
ticks that are repeated five times, of each the fastest: what ticks differ by themselves, without
what the machine puts in between.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
from pathlib import Path
import platform
import resource
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.crowds import ELLIPSOIDS, Layout, obstacles_off, SHAPE_NAMES, shapes_of
from benchmark.peers import library, missing, OF_SEVERAL_TIPS
from benchmark.robots import make_robot
from benchmark.tip_bodies import BODIES, make_body
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.near_pairs import near_pairs
from redundant_planner.core.obstacles.obstacle import ELLIPSOID, Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.jacobian import derivative_between
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Poses
from redundant_planner.core.safety.barriers import barriers_of
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.stages import Request, safe_velocity

Array = npt.NDArray[np.float64]

COUNTS = (0, 1, 3, 10, 100, 1000, 10_000)
_DT = 0.004
STARTS = {'panda': np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7]),
           'paper': np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])}
_TWIST = np.array([0.05, 0.05, 0.0, 0.0, 0.0, 0.1])
# The tip goes to and fro, gently enough for the acceleration limits; so many ticks a turn.
_TURN = 500
_HOUR = 3600 * 250
# The same ticks are repeated: the fastest time of each is its own, the rest the machine's.
_PASSES = 5
# pink takes 0.4 ms per obstacle and tick, mink makes a model with a body for each.
# cbfpy compiles a barrier for each pair, NEO measures each in Python, and RoboPlan, where an
# ellipsoid is a body on joints, takes 20 GB for a hundred.
_MOST = {'mink': 1000, 'pink': 100, 'roboplan': 10, 'neo': 100, 'cbfpy': 10}
_EXTENTS = {'reach': ((-0.8, -0.8, 0.0), (0.8, 0.8, 1.2)),
            'hall': ((-10.0, -10.0, 0.0), (10.0, 10.0, 4.0))}


def robot_named(name: str) -> tuple[Robot, Array]:
    """Return an arm or a body, and where it starts (n,)."""
    if name in BODIES:
        body = make_body(name)
        return body, body.ready
    return make_robot(name, 6 if name == 'panda' else 3), STARTS[name]


def obstacles_around(
    robot: Robot, start: Array, count: int, where: str, layout: Layout = ELLIPSOIDS,
) -> list[Obstacle]:
    """Return obstacles of 2 to 5 cm that keep 5 cm off the arm's start posture."""
    postures = _way(robot, start) if layout.clear_way else np.array([start])
    return obstacles_off(robot, postures, count, _EXTENTS[where], layout.shapes)


def _way(robot: Robot, start: Array) -> Array:
    """Return postures (k, n) of the motion, and where it leads if it goes on at any time."""
    turn, ahead = _TURN * _DT, PlannerParameters().horizon_look_ahead
    time = np.linspace(0.0, turn, 200)
    # ∫ sin(2π t / T), and on from there.
    gone = turn / (2.0 * np.pi) * (1.0 - np.cos(2.0 * np.pi * time / turn))
    speed = np.sin(2.0 * np.pi * time / turn)
    on = gone + ahead * speed
    postures = []
    for end in (on.min(), on.max()):
        q, steps = start, 12
        for _ in range(steps):
            postures.append(q)
            q = q + end / steps * (np.linalg.pinv(robot.kinematics(q).jacobian)
                                   @ robot.task_rows(np.tile(_TWIST, len(robot.tips))))
        postures.append(q)
    return np.array(postures)


def planner_times(
    robot: Robot, start: Array, obstacles: list[Obstacle], method: str, ticks: int,
    passes: int = 1,
) -> Array:
    """Return the times of ticks, (passes, ticks); every pass does exactly the same [us]."""
    times = np.empty((passes, ticks))
    for one in range(passes):
        planner, scene = Planner(robot, PlannerParameters(method=method)), Scene.of(obstacles)
        planner.prepare(scene)
        q = start
        for i in range(ticks):
            twist = _twists_at(i, robot)
            begin = time.perf_counter()
            result = planner.step(q, twist, scene, _DT)
            times[one, i] = time.perf_counter() - begin
            q = q + _DT * result.dq
    return 1e6 * times


def peer_times(
    peer: str, robot: Robot, start: Array, obstacles: list[Obstacle], ticks: int,
) -> Array:
    """Return the times of another library's ticks [us].

    Raises:
        MissingPeerError: it is not installed.
    """
    p = PlannerParameters()
    solver = library(peer)(
        robot, obstacles, p.clearance_margin, p.clearance_self_margin)
    poses, q = robot.kinematics(start).tips, start
    times = np.empty(ticks)
    for i in range(ticks):
        poses = Poses.of(*(integrate(pose, _twist_at(i), _DT, False) for pose in poses.each))
        due: Any = poses if len(robot.tips) > 1 else poses.first
        begin = time.perf_counter()
        dq = solver.step(q, due, _DT)
        times[i] = time.perf_counter() - begin
        q = q + _DT * dq
    return 1e6 * times


def _twist_at(tick: int) -> Array:
    return np.sin(2.0 * np.pi * tick / _TURN) * _TWIST


def _twists_at(tick: int, robot: Robot) -> Array:
    """Return what `Planner.step` takes: the same twist of each tip."""
    return _twist_at(tick) if len(robot.tips) == 1 else np.tile(
        _twist_at(tick), (len(robot.tips), 1))


def sections(
    robot: Robot, start: Array, obstacles: list[Obstacle], ticks: int,
) -> dict[str, float]:
    """Return where a tick's time goes, each part by itself, called from Python [us]."""
    maps = inflated_obstacles(Scene.of(obstacles), [c.radius for c in robot.capsules],
                              moved=robot.moved)
    arm, p = robot.kinematics(start), PlannerParameters()
    fastest = robot.acceleration_max * _DT  # in the first tick from rest
    speeds = robot.lever_arm_bounds @ fastest
    all_seen = np.full(len(speeds), np.inf)
    links = robot.links(arm)
    near = near_pairs(
        maps, links, fastest, speeds, p.clearance_gain, p.clearance_influence_distance, all_seen)
    limits = Limits(np.array((robot.position_max, robot.position_min)),
                    np.array(robot.velocity_max), np.array(robot.acceleration_max), 0.0)
    at_rest, twist = np.zeros(robot.n), robot.task_rows(np.tile(_TWIST, len(robot.tips)))
    parts = {
        'kinematics': lambda: robot.kinematics(start),
        'clearances and gradients': lambda: near_pairs(
            maps, links, fastest, speeds, p.clearance_gain, p.clearance_influence_distance,
            all_seen),
        'decomposition': lambda: null_space.decompose(arm.jacobian),
        'derivative of J': lambda: derivative_between(
            twist, arm.tip_jacobian, start, arm.tip_rotations, robot.in_tool, robot.rows),
        # From rest the arm cannot follow at once, so here there is one to solve.
        'filter with a QP': lambda: safe_velocity(
            Request(np.linalg.pinv(arm.jacobian) @ twist, at_rest, arm.jacobian, twist,
                    np.zeros(robot.m), np.zeros(robot.m), start, at_rest),
            limits, barriers_of(near.gradient, near.rate, near.normalized_distance),
            weights=np.ones(robot.n), gain=p.clearance_gain, may_yield=False,
            may_slide=False, dt=_DT),
    }
    return {name: _median(part, ticks) for name, part in parts.items()}


def hour_growth(robot: Robot, start: Array) -> float:
    """Return what an hour's worth of ticks at 250 Hz adds to the most memory held [MiB]."""
    planner = Planner(robot, PlannerParameters())
    scene, q = Scene.of(obstacles_around(robot, start, 10, 'reach')), start
    sizes = []
    for i in track(range(_HOUR), description='an hour of ticks'):
        if i in (_HOUR // 60, _HOUR - 1):
            sizes.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
        q = q + _DT * planner.step(q, _twists_at(i, robot), scene, _DT).dq
    return (sizes[1] - sizes[0]) / 1024.0


def _median(part: Any, ticks: int) -> float:
    times = np.empty(ticks)
    for i in range(ticks):
        begin = time.perf_counter()
        part()
        times[i] = time.perf_counter() - begin
    return 1e6 * float(np.median(times))


def measure(
    name: str, counts: list[int], ticks: int, peers: bool, layout: Layout = ELLIPSOIDS,
) -> dict[str, Any]:
    """Measure everything for one arm; keys as in the JSON, then the number of obstacles."""
    robot, start = robot_named(name)
    result: dict[str, Any] = {
        key: {} for key in (
            'tick_us', 'tick_p99_us', 'tick_own_p99_us', 'variational_us', 'hall_tick_us',
            *(f'{peer}_us' for peer in _MOST), *(f'ratio_to_{peer}' for peer in _MOST),
            'ratio_variational_to_mink')}
    for count in track(counts, description=name):
        key = str(count)
        around = obstacles_around(robot, start, count, 'reach', layout)
        times = planner_times(robot, start, around, 'dynamic_factor', ticks, _PASSES)
        result['tick_us'][key] = float(np.median(times))
        result['tick_p99_us'][key] = float(np.percentile(times, 99))
        result['tick_own_p99_us'][key] = float(np.percentile(times.min(axis=0), 99))
        result['hall_tick_us'][key] = float(np.median(planner_times(
            robot, start, obstacles_around(robot, start, count, 'hall', layout),
            'dynamic_factor', ticks)))
        if count <= _MOST['mink']:
            result['variational_us'][key] = float(np.median(planner_times(
                robot, start, around, 'variational', ticks // 4)))
        for label, most in _MOST.items():
            if not peers or name == 'paper' or count > most or missing(label) or (
                    len(robot.tips) > 1 and label not in OF_SEVERAL_TIPS):
                continue
            taken = float(np.median(peer_times(
                label, robot, start, around, max(ticks // (1 + count), 40))))
            result[f'{label}_us'][key] = taken
            result[f'ratio_to_{label}'][key] = result['tick_us'][key] / taken
            if label == 'mink':
                result['ratio_variational_to_mink'][key] = result['variational_us'][key] / taken
    result['sections_us'] = sections(
        robot, start, obstacles_around(robot, start, 3, 'reach', layout), ticks)
    return result


def versions() -> dict[str, str]:
    """Return what was measured with."""
    found = {'python': platform.python_version(), 'machine': platform.machine()}
    for package in ('numpy', 'numba', 'pin', 'daqp', 'mink', 'mujoco', 'pin-pink', 'roboplan',
                    'cbfpy', 'jax'):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = ''
    return found


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='benchmark.speed', description=__doc__)
    parser.add_argument('--robot', choices=(*STARTS, *BODIES), default='panda')
    parser.add_argument('--counts', type=int, nargs='+', default=list(COUNTS), metavar='COUNT')
    parser.add_argument('--ticks', type=int, default=2000)
    parser.add_argument('--shapes', choices=SHAPE_NAMES, default=ELLIPSOID,
                        help='of the obstacles; mixed for all in turn')
    parser.add_argument('--clear-way', action='store_true',
                        help='they also keep off the motion and where it would lead, so that '
                        'nothing is planned')
    parser.add_argument('--voxels', type=int, default=0, metavar='N',
                        help='also ticks while N voxels come in a CUBE_LIST at 30 Hz')
    parser.add_argument('--without-peers', action='store_true')
    parser.add_argument('--hour', action='store_true',
                        help="also what an hour's worth of ticks adds to the memory")
    parser.add_argument('--json', type=Path)
    options = parser.parse_args(args)
    result = measure(options.robot, options.counts, options.ticks, not options.without_peers,
                     Layout(shapes_of(options.shapes), options.clear_way))
    further: dict[str, float] = {}
    if options.voxels or options.hour:
        robot, start = robot_named(options.robot)
    if options.voxels:
        from benchmark.voxels import voxel_ticks
        further = voxel_ticks(robot, start, options.voxels, _twist_at,
                             options.ticks)
    if options.hour:
        further['hour_growth_mib'] = hour_growth(robot, start)
    table = Table('', *map(str, options.counts),
                  title=f'{options.robot}, {options.shapes}: time per tick by obstacles')
    for key, found in result.items():
        if found and key != 'sections_us':
            table.add_row(key.replace('_us', ' [µs]').replace('_', ' '), *(
                f'{found[str(count)]:.4g}' if str(count) in found else ''
                for count in options.counts))
    console = Console(width=120)
    console.print(table)
    console.print('parts of a tick in µs: ' + ', '.join(
        f'{name} {taken:.3g}' for name, taken in result['sections_us'].items()))
    for key, value in further.items():
        console.print(f'{key.replace("_", " ")}: {value:.4g}')
    if options.json is not None:
        options.json.write_text(json.dumps(
            {'robot': options.robot, 'shapes': options.shapes,
             'clear_way': options.clear_way, 'versions': versions(),
             **result, **further}, indent=1))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
