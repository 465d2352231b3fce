"""How smoothly an arm is commanded, method by method: `python -m benchmark.smoothness --help`.

The motions are those of `benchmark.scenarios`, on an ideal arm, on one whose drives have lag and
dead time, and on one whose encoders are noisy besides. All measures are of the commands, which
is what a drive has to carry out. `--edges` is about rest instead, see `benchmark.edges`.
"""

from __future__ import annotations

import argparse
from collections import deque
from dataclasses import dataclass, replace
import json
import math
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track

from benchmark.edges import edges, print_worst, VARIANTS
from benchmark.generator import DURATION, generate, path_poses, Task
from benchmark.judge import accelerations, jerks, Judge, limit_violation
from benchmark.peers import library, missing, PEERS
from benchmark.robots import make_robot
from benchmark.scenarios import KNOWN, METHODS, print_table
from redundant_planner.core.horizon.poses_ahead import middles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

OWN = ('least_norm', 'dynamic_factor', 'variational_held', 'variational_known')


@dataclass(frozen=True)
class Drive:
    """How an arm carries out velocity commands, and what its encoders say.

    Attributes:
        lag: time constant of its velocity, a first-order lag [s].
        dead_time: from a command to the beginning of what it causes [s].
        noise: standard deviation of measured positions [rad, m].
    """

    lag: float = 0.0
    dead_time: float = 0.0
    noise: float = 0.0


DRIVES = {'ideal': Drive(), 'lag': Drive(0.03, 0.012), 'noise': Drive(0.03, 0.012, 1e-4)}


class Arm:
    """An arm that is driven so, at a posture (n,)."""

    def __init__(self, drive: Drive, start: Array, dt: float, seed: int) -> None:
        """Stand still."""
        self.q, self._dq = start.copy(), np.zeros(len(start))
        self._drive, self._dt = drive, dt
        self._random = np.random.default_rng([seed, 77])
        self._late = deque([np.zeros(len(start))] * round(drive.dead_time / dt))

    @property
    def measured(self) -> Array:
        """What its encoders say."""
        return self.q + self._drive.noise * self._random.normal(size=len(self.q))

    def move(self, dq: Array) -> None:
        """Take a command (n,), and go on for a tick."""
        self._late.append(dq)
        wanted, dt, lag = self._late.popleft(), self._dt, self._drive.lag
        kept = math.exp(-dt / lag) if lag > 0.0 else 0.0
        # The exact integral of a first-order lag over a held command.
        self.q = self.q + wanted * dt + (self._dq - wanted) * lag * (1.0 - kept)
        self._dq = wanted + (self._dq - wanted) * kept


@dataclass(frozen=True)
class Smoothness:
    """What the commands of one motion ask of the drives.

    Attributes:
        reversals: see `Verdict`.
        rms_acceleration: √(∫q̈ᵀq̈ dt / duration) [rad/s², m/s²].
        peak_acceleration_share, peak_jerk_share: of the limits, the largest.
        limit_violation: see `Judge`, jerk included.
        min_distance: of the arm to an obstacle [m].
        path_error: largest distance of the tip from the commanded path [m].
    """

    reversals: int
    rms_acceleration: float
    peak_acceleration_share: float
    peak_jerk_share: float
    limit_violation: float
    min_distance: float
    path_error: float


def smoothness(
    judge: Judge, task: Task, postures: Array, commands: Array, dt: float,
) -> Smoothness:
    """Return the measures of commands (k, n) and the postures (k + 1, n) that came of them."""
    robot = judge.robot
    acceleration, jerk = accelerations(commands, dt), jerks(commands, dt)
    verdict = judge.judge(task, postures, commands, dt)
    return Smoothness(
        verdict.reversals,
        float(np.sqrt(np.square(acceleration).sum(axis=1).mean())),
        float((np.abs(acceleration) / robot.acceleration_max).max()),
        float((np.abs(jerk) / robot.jerk_max).max()),
        limit_violation(robot, postures, commands, dt), verdict.min_distance, verdict.path_error)


def run_planner(
    robot: Robot, name: str, judge: Judge, task: Task, drive: Drive, dt: float,
) -> Smoothness:
    """Run one of this package's methods; it knows the drive as a user does who measured it."""
    parameters = replace(METHODS[name], drive_lag=drive.lag, drive_dead_time=drive.dead_time)
    planner = Planner(robot, parameters, filtered=name != 'least_norm')
    arm, scene = Arm(drive, task.start, dt, task.seed), Scene.of(task.obstacles)
    count = round(DURATION / dt)
    postures, commands = np.empty((count + 1, robot.n)), np.empty((count, robot.n))
    postures[0] = task.start
    for i in range(count):
        now = i * dt
        ahead = (lambda times, now=now: task.twist_at(now + middles(times))) \
            if name in KNOWN else None
        commands[i] = planner.step(arm.measured, task.twist_at(now), scene, dt, ahead).dq
        arm.move(commands[i])
        postures[i + 1] = arm.q
    return smoothness(judge, task, postures, commands, dt)


def run_peer(
    robot: Robot, name: str, judge: Judge, task: Task, drive: Drive, dt: float,
) -> Smoothness:
    """Run another library on the posture that it has commanded, as its examples do."""
    p = PlannerParameters()
    peer = library(name)(
        robot, task.obstacles, p.clearance_margin, p.clearance_self_margin)
    arm, poses = Arm(drive, task.start, dt, task.seed), path_poses(robot, task, dt)
    count = len(poses) - 1
    postures, commands = np.empty((count + 1, robot.n)), np.empty((count, robot.n))
    postures[0] = commanded = task.start
    for i in range(count):
        commands[i] = peer.step(commanded, poses[i + 1], dt)
        commanded = commanded + dt * commands[i]
        arm.move(commands[i])
        postures[i + 1] = arm.q
    return smoothness(judge, task, postures, commands, dt)


def summarise(found: list[Smoothness]) -> dict[str, Any]:
    """Return the JSON entry of one method on one arm."""
    return {
        'reversals_median': float(np.median([f.reversals for f in found])),
        'reversals_max': max(f.reversals for f in found),
        'rms_acceleration': float(np.median([f.rms_acceleration for f in found])),
        'peak_acceleration_share': max(f.peak_acceleration_share for f in found),
        'peak_jerk_share': max(f.peak_jerk_share for f in found),
        'violations': sum(f.limit_violation > 0.0 for f in found),
        'collisions': sum(f.min_distance < 0.0 for f in found),
        'min_distance_mm': 1e3 * min(f.min_distance for f in found),
        'max_path_error_mm': 1e3 * max(f.path_error for f in found),
    }


class Bench:
    """The Panda with its judge, in a process of its own."""

    def __init__(self, methods: list[str], drives: list[str], dt: float) -> None:
        """Prepare for some methods, on some arms."""
        self._robot = make_robot('panda', 6)
        self._judge = Judge(self._robot)
        self._methods, self._drives, self._dt = methods, drives, dt

    def __call__(self, seed: int) -> dict[tuple[str, str], Smoothness]:
        """Run every method on every arm in the scenario of a seed."""
        task = generate(self._robot, seed)
        return {(drive, name): (run_peer if name in PEERS else run_planner)(
            self._robot, name, self._judge, task, DRIVES[drive], self._dt)
            for drive in self._drives for name in self._methods}


bench: Bench


def prepare(*arguments: Any) -> None:
    """Make the `bench` of a worker process."""
    global bench
    bench = Bench(*arguments)


def _run(seed: int) -> dict[tuple[str, str], Smoothness]:
    return bench(seed)


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='benchmark.smoothness', description=__doc__)
    parser.add_argument('--count', type=int, default=10, metavar='N', help='motions')
    parser.add_argument('--seed', type=int, metavar='N', help='first seed, 41000')
    parser.add_argument('--rate', type=int, default=250, metavar='HZ')
    parser.add_argument('--method', action='append', choices=[*OWN, *PEERS],
                        help="may be given more than once; this package's if not given")
    parser.add_argument('--edges', action='store_true',
                        help='whether arms come to rest under a constant twist; N postures of '
                             'each arm, from seed 1')
    parser.add_argument('--arm', action='append', default=[], metavar='NAME',
                        help='of --edges, by the name of its URDF; may be given more than once')
    parser.add_argument('--variant', action='append', choices=list(VARIANTS),
                        help='of --edges; may be given more than once; all if not given')
    parser.add_argument('--drive', action='append', choices=list(DRIVES),
                        help='may be given more than once; all if not given')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    result = _edges(options) if options.edges else _motions(options)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + '\n')
    return 0


def _edges(options: argparse.Namespace) -> dict[str, Any]:
    result, found = edges(
        options.count, 1 if options.seed is None else options.seed, names=options.arm,
        variants=options.variant or list(VARIANTS), dt=1.0 / options.rate, jobs=options.jobs)
    print_worst(found)
    Console().print_json(data=result)
    return result


def _motions(options: argparse.Namespace) -> dict[str, Any]:
    for name in options.method or ():
        lack = missing(name) if name in PEERS else ''
        if lack:
            raise SystemExit(lack)
    methods, drives = options.method or list(OWN), options.drive or list(DRIVES)
    seed = 41000 if options.seed is None else options.seed
    seeds = range(seed, seed + options.count)
    with Pool(options.jobs, prepare, (methods, drives, 1.0 / options.rate)) as pool:
        found = list(track(pool.imap(_run, seeds), 'motions', total=options.count))
    result = {drive: {name: summarise([f[drive, name] for f in found]) for name in methods}
              for drive in drives}
    for drive in drives:
        print_table(f'{drive} arm, {options.count} motions from seed {seed}, '
                    f'{options.rate} Hz', result[drive])
    return result


if __name__ == '__main__':
    raise SystemExit(main())
