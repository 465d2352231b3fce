"""Hard motions past obstacles, method by method: `python -m benchmark.scenarios --help`."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
import json
from multiprocessing import Pool
from pathlib import Path
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.evasion import unavoidable
from benchmark.generator import DURATION, generate, path_of_tips, path_poses, Task
from benchmark.judge import Judge, Verdict
from benchmark.peers import library, missing, MissingPeerError, OF_SEVERAL_TIPS, Peer, PEERS
from benchmark.robots import make_robot
from benchmark.tip_bodies import BODIES, make_body
from redundant_planner.core.horizon.poses_ahead import middles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

DT = 0.004
_TURN = np.deg2rad(0.5)
METHODS = {
    'least_norm': PlannerParameters(criteria_k_w=0.0, criteria_k_f=0.0),
    'least_norm_filtered': PlannerParameters(
        criteria_k_w=0.0, criteria_k_f=0.0, horizon_look_ahead=0.0),
    'gradient_projection': PlannerParameters(method='gradient_projection', criteria_k_f=0.0),
    'dynamic_factor_unfiltered': PlannerParameters(),
    'dynamic_factor': PlannerParameters(),
    'variational_held': PlannerParameters(method='variational'),
    'variational_known': PlannerParameters(method='variational'),
}
# These run without the safety filter.
UNFILTERED = ('least_norm', 'gradient_projection', 'dynamic_factor_unfiltered')
# These are told the twist ahead, as a user does who plays a profile.
KNOWN = ('variational_known',)
# After the twist, while obstacles move on: the last has passed by 2 s, and 4 s are for the way
# back [s].
_TO_COME_BACK = 6.0


@dataclass(frozen=True)
class Outcome:
    """One method on one task.

    Attributes:
        task: its seed.
        verdict: of the judge.
        tracked: completed with s > 0.99 throughout, less than 1 mm and 0.5 degrees off.
        reasons: what the planner said, each once.
        tick_us: (k,) time of every tick.
        postures: (k + 1, n).
        unavoidable: hit by what no motion of the arm's first joints could have evaded; not looked
            at for methods that evade nothing.
    """

    task: int
    verdict: Verdict
    tracked: bool
    reasons: tuple[str, ...]
    tick_us: Array
    postures: Array
    unavoidable: bool


def run_planner(
    robot: Robot, parameters: PlannerParameters, judge: Judge, task: Task, known: bool = False,
    filtered: bool = True,
) -> Outcome:
    """Run the planner in closed loop with an ideal arm; tell it the twist ahead if `known`."""
    planner = Planner(robot, parameters, filtered=filtered)
    moving = _is_moving(task)
    count = round((DURATION + moving * _TO_COME_BACK) / DT)
    postures = np.empty((count + 1, robot.n))
    postures[0] = task.start
    velocities, ticks = np.empty((count, robot.n)), np.empty(count)
    scene = Scene.of(task.obstacles)
    slowest, reasons = 1.0, {}
    for i in range(count):
        if moving:
            scene = Scene.of(task.obstacles_at(i * DT))
        ahead = (lambda times, now=i * DT: task.twist_at(now + middles(times))) if known else None
        begin = time.perf_counter()
        twist = task.twist_at(i * DT)
        result = planner.step(
            postures[i], twist if len(twist) == 6 else twist.reshape(-1, 6), scene, DT, ahead)
        ticks[i] = time.perf_counter() - begin
        velocities[i] = result.dq
        postures[i + 1] = postures[i] + DT * result.dq
        slowest = min(slowest, result.scale)
        if result.reason:
            reasons[result.reason] = None
    return _outcome(judge, task, postures, velocities, slowest > 0.99, tuple(reasons), ticks,
                    evades=filtered)


def run_peer(
    robot: Robot, make: Callable[..., Peer], judge: Judge, task: Task,
) -> Outcome:
    """Run another library in closed loop with an ideal arm, with the same margins."""
    p = PlannerParameters()
    peer = make(robot, task.obstacles, p.clearance_margin, p.clearance_self_margin)
    poses: list[Any] = (path_of_tips if len(robot.tips) > 1 else path_poses)(robot, task, DT)
    moving = _is_moving(task)
    poses += [poses[-1]] * round(moving * _TO_COME_BACK / DT)
    count = len(poses) - 1
    postures = np.empty((count + 1, robot.n))
    postures[0] = task.start
    velocities, ticks = np.empty((count, robot.n)), np.empty(count)
    for i in range(count):
        if moving:
            peer.move(task.obstacles_at(i * DT))
        begin = time.perf_counter()
        velocities[i] = peer.step(postures[i], poses[i + 1], DT)
        ticks[i] = time.perf_counter() - begin
        postures[i + 1] = postures[i] + DT * velocities[i]
    return _outcome(judge, task, postures, velocities, True, (), ticks)


def _outcome(
    judge: Judge, task: Task, postures: Array, velocities: Array, on_time: bool,
    reasons: tuple[str, ...], ticks: Array, *, evades: bool = True,
) -> Outcome:
    verdict = judge.judge(task, postures, velocities, DT)
    # At the very start s is below 1 while the arm takes up speed; the profile is smooth, so the
    # end of the path tells whether anything was lost.
    tracked = (on_time and verdict.path_error < 1e-3 and verdict.turn_error < _TURN
               and verdict.completed)
    hit = evades and verdict.min_distance < 0.0 and _is_moving(task)
    return Outcome(task.seed, verdict, tracked, reasons, 1e6 * ticks, postures,
                   hit and unavoidable(judge.robot, task))


def _is_moving(task: Task) -> bool:
    return any(o.velocity.any() for o in task.obstacles)


def summarise(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return the JSON entry of one method."""
    verdicts = [o.verdict for o in outcomes]
    ticks = np.concatenate([o.tick_us for o in outcomes])
    return {
        'collisions': sum(v.min_distance < 0.0 for v in verdicts),
        'unavoidable': sum(o.unavoidable for o in outcomes),
        'limit_violations': sum(v.limit_violation > 0.0 for v in verdicts),
        'tracked': float(np.mean([o.tracked for o in outcomes])),
        'on_path_at_the_end': float(np.mean([v.final_error < 1e-3 for v in verdicts])),
        'path_error_median_mm': 1e3 * float(np.median([v.path_error for v in verdicts])),
        'max_path_error_mm': 1e3 * max(v.path_error for v in verdicts),
        'max_turn_error_deg': float(np.rad2deg(max(v.turn_error for v in verdicts))),
        'max_final_error_mm': 1e3 * max(v.final_error for v in verdicts),
        'min_distance_mm': 1e3 * min(v.min_distance for v in verdicts),
        'cost_median': float(np.median([v.cost for v in verdicts])),
        'path_median': float(np.median([v.path for v in verdicts])),
        'reversals_median': float(np.median([v.reversals for v in verdicts])),
        'reversals_max': max(v.reversals for v in verdicts),
        'tick_us_median': float(np.median(ticks)),
        'tick_us_p99': float(np.percentile(ticks, 99)),
        'count': len(outcomes),
        'notable': [
            {'seed': o.task, 'reasons': list(o.reasons)[:5], 'unavoidable': o.unavoidable,
             **asdict(o.verdict)}
            for o in outcomes
            if o.verdict.min_distance < 0.0 or o.verdict.limit_violation > 0.0
            or o.verdict.path_error > 1e-3],
    }


def runners(robot: Robot, judge: Judge, names: list[str]) -> dict[
        str, Callable[[Task], Outcome]]:
    """Return method name → function of a task."""
    found: dict[str, Callable[[Task], Outcome]] = {}
    for name in names:
        if name in METHODS:
            found[name] = partial(
                run_planner, robot, METHODS[name], judge, known=name in KNOWN,
                filtered=name not in UNFILTERED)
        else:
            try:
                found[name] = partial(run_peer, robot, library(name), judge)
            except MissingPeerError as error:
                raise SystemExit(str(error)) from None
    return found


class Bench:
    """One robot with its methods, in a process of its own."""

    def __init__(
        self, robot: str, axes: int, names: list[str], moving: bool, impossible_too: bool,
    ) -> None:
        """Prepare for a robot and the methods of that name."""
        self.robot = (make_body(robot) if robot in BODIES else make_robot(robot, axes))
        self._methods = runners(self.robot, Judge(self.robot), names)
        self._kind = {'moving': moving, 'impossible_too': impossible_too}

    def task(self, seed: int) -> Task:
        """Return the task of a seed."""
        return generate(self.robot, seed, **self._kind)

    def __call__(self, seed: int) -> dict[str, Outcome]:
        """Run every method on the task of a seed."""
        task = self.task(seed)
        return {name: run(task) for name, run in self._methods.items()}


bench: Bench


def prepare(*arguments: Any) -> None:
    """Make the `bench` of a worker process."""
    global bench
    bench = Bench(*arguments)


def _run(seed: int) -> dict[str, Outcome]:
    return bench(seed)


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """Return the options that the scenario benchmarks share."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--robot', choices=('panda', 'paper', *BODIES),
                        default='panda', help='some have several tips, of which each has a path')
    parser.add_argument('--axes', type=int, choices=(3, 6), default=6)
    parser.add_argument('--count', type=int, default=50)
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--jobs', type=int, default=1,
                        help='processes; more than one and the tick times disturb each other')
    parser.add_argument('--impossible-too', action='store_true',
                        help='scenes too of which it is not known whether they can be passed')
    parser.add_argument('--json', type=Path)
    return parser


def print_table(title: str, result: dict[str, dict[str, Any]]) -> None:
    """Print one row per number, one column per method."""
    table = Table('', *result, title=title)
    keys = [key for key, value in next(iter(result.values())).items()
            if value is None or isinstance(value, (int, float))]
    for key in keys:
        table.add_row(key.replace('_', ' '), *(
            '' if entry[key] is None else f'{entry[key]:.4g}' for entry in result.values()))
    Console(width=220).print(table)


def main() -> None:
    """Run the benchmark."""
    parser = parser_of(__doc__)
    parser.add_argument('--method', action='append', choices=[*METHODS, *PEERS],
                        help="may be given more than once; this package's if not given; the "
                        "others' libraries have to be installed")
    parser.add_argument('--moving', action='store_true', help='obstacles move through the arm')
    options = parser.parse_args()
    for name in options.method or ():
        lack = missing(name) if name in PEERS else ''
        if lack:
            raise SystemExit(lack)
        if name in PEERS and options.robot in BODIES and name not in OF_SEVERAL_TIPS:
            raise SystemExit(f'{name} is driven with one tip here; with several: '
                             f'{", ".join(OF_SEVERAL_TIPS)}')
    arguments = (
        options.robot, options.axes, options.method or list(METHODS), options.moving,
        options.impossible_too)
    seeds = range(options.seed, options.seed + options.count)
    with Pool(options.jobs, prepare, arguments) as pool:
        outcomes = list(track(pool.imap(_run, seeds), 'scenarios', total=options.count))
    result = {name: summarise([found[name] for found in outcomes]) for name in outcomes[0]}
    print_table(f'{options.robot}, {options.axes} axes, {options.count} '
                f'{"moving" if options.moving else "static"} scenarios from seed {options.seed}',
                result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + '\n')


if __name__ == '__main__':
    main()
