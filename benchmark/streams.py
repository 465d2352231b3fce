"""Streams of poses and joint positions, as headsets and policies send them.

    python -m benchmark.streams --count 20 --seed 1

Each run is a Panda at a random posture and one motion (`sent_motions`): a circle, an eight, or a
hand, of ten seconds, sent at a rate, with noise, in bursts, with gaps, or with frames that are
wrong. The same motion given exactly, tick by tick, is run beside it: reversals that the motion
itself asks of the joints count for nobody.

pink and mink (`--peer`) get the same targets behind a first-order filter of the same lag.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.judge import accelerations, limit_violation, reversals
from benchmark.peers import library, missing
from benchmark.robots import make_robot
from benchmark.sent_motions import BEGINS, INPUTS, LASTS, Message, messages, motion, RADIUS, Signal
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose, pose_error
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.core.target.progress import TargetState

Array = npt.NDArray[np.float64]

DT = 0.004
# An arm at rest: its fastest joint [rad/s].
_AT_REST = 1e-3
# Lags that are tried, in steps [s]; start postures are this far from the Panda's usual one [rad],
# and the motion given exactly stays this near to its path there [m, rad].
_LONGEST_LAG, _LAG_STEP = 0.6, 0.002
_SPREAD, _FOLLOWS = 0.3, 2e-3
_READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


class Outcome(NamedTuple):
    """What one run came to; numbers as in the JSON."""

    reversals: int
    lag: float
    rms: float
    radius_error: float
    thinking: int
    rest_share: float
    violation: float
    farthest: float


def run_stream(
    robot: Robot, parameters: PlannerParameters, start: Array, sent: list[Message], *,
    stamped: bool,
) -> tuple[Array, Array, list[TargetState]]:
    """Run the planner; return postures (k + 1, n), commands (k, n) and the states."""
    planner, scene = Planner(robot, parameters), Scene.of(())
    count, at = round((BEGINS + LASTS) / DT), 0
    postures, commands = np.empty((count + 1, robot.n)), np.empty((count, robot.n))
    postures[0], states = start, []
    for i in range(count):
        news = []
        while at < len(sent) and sent[at].arrival <= i * DT + 1e-9:
            news.append(Sighting(
                sent[at].target, i * DT - sent[at].stamp if stamped else None))
            at += 1
        result = planner.step(postures[i], np.zeros(6), scene, DT, target=sent[at - 1].target,
                              news=news[-1:] if not stamped else news)
        assert result.progress is not None
        commands[i], postures[i + 1] = result.dq, postures[i] + DT * result.dq
        states.append(result.progress.state)
    return postures, commands, states


def run_exactly(
    robot: Robot, parameters: PlannerParameters, start: Array, signal: Signal,
) -> tuple[Array, Array]:
    """Give the planner the motion itself, tick by tick; return postures and commands."""
    planner, scene = Planner(robot, parameters), Scene.of(())
    count = round((BEGINS + LASTS) / DT)
    postures, commands = np.empty((count + 1, robot.n)), np.empty((count, robot.n))
    postures[0] = start
    for i in range(count):
        now, then = signal(i * DT), signal((i + 1) * DT)
        if isinstance(now, Pose) and isinstance(then, Pose):
            twist = pose_error(then, now, False) / DT
            commands[i] = planner.step(postures[i], twist, scene, DT).dq
        else:
            commands[i] = (np.asarray(then) - np.asarray(now)) / DT
        postures[i + 1] = postures[i] + DT * commands[i]
    return postures, commands


def run_peer(
    robot: Robot, name: str, start: Array, sent: list[Message], lag: float,
) -> tuple[Array, Array]:
    """Run another library on the filtered targets; return postures and commands."""
    p = PlannerParameters()
    peer = library(name)(robot, (), p.clearance_margin, p.clearance_self_margin)
    count, at = round((BEGINS + LASTS) / DT), 0
    postures, commands = np.empty((count + 1, robot.n)), np.empty((count, robot.n))
    postures[0] = start
    arm = robot.kinematics(start)
    pose = Pose(arm.tip_position, arm.tip_rotation)
    for i in range(count):
        while at < len(sent) - 1 and sent[at + 1].arrival <= i * DT + 1e-9:
            at += 1
        target = sent[at].target
        assert isinstance(target, Pose)
        pose = integrate(pose, (1.0 - math.exp(-DT / lag)) * pose_error(target, pose, False),
                         1.0, False)
        commands[i] = peer.step(postures[i], pose, DT)
        postures[i + 1] = postures[i] + DT * commands[i]
    return postures, commands


def judged(
    robot: Robot, signal: Signal, postures: Array, commands: Array, states: list[TargetState],
    own: int, *, circle: bool,
) -> Outcome:
    """Return what a run came to.

    Args:
        robot: the arm.
        signal: the motion.
        postures, commands, states: of the run.
        own: the reversals of the motion itself.
        circle: whether it is one.
    """
    first = round(BEGINS / DT)
    times = DT * np.arange(first, len(commands))
    where = _values(robot, postures[first:-1])
    grid = np.arange(0.0, _LONGEST_LAG, _LAG_STEP)
    truth_times = np.arange(-_LONGEST_LAG, times[-1] + DT, DT)
    truth = np.array([_value(signal(max(t, 0.0))) for t in truth_times])

    def off(lag: float) -> Array:
        late = np.array([np.interp(times - lag, truth_times, column) for column in truth.T]).T
        if late.shape[1] == robot.n:
            return np.linalg.norm(postures[first:-1] - late, axis=1)
        return np.linalg.norm(where - late, axis=1)
    lag = min(grid, key=lambda lag: float((off(lag)[50:] ** 2).sum()))
    error = off(lag)[50:]
    radius = 0.0
    if circle:
        settled = where[250:]
        center = settled.mean(axis=0)
        _, _, axes = np.linalg.svd(settled - center, full_matrices=False)
        flat = (settled - center) @ axes[:2].T
        # The circle of least squares (Kåsa 1976).
        found = np.linalg.lstsq(np.column_stack((2.0 * flat, np.ones(len(flat)))),
                                (flat * flat).sum(axis=1), rcond=None)[0]
        radius = math.sqrt(found[2] + found[0] ** 2 + found[1] ** 2) / RADIUS - 1.0
    turns = reversals(accelerations(commands, DT)[first:], robot.acceleration_max)
    return Outcome(
        max(turns - own, 0), float(lag), float(np.sqrt((error**2).mean())), abs(radius),
        sum(a is TargetState.THINKING and b is not TargetState.THINKING
            for a, b in pairwise(states)),
        float((np.abs(commands[first:]).max(axis=1) < _AT_REST).mean()),
        limit_violation(robot, postures, commands, DT), float(error.max()))


def _values(robot: Robot, postures: Array) -> Array:
    """Return the tip's places (k, 3)."""
    return np.array([robot.kinematics(q).tip_position for q in postures])


def _value(target: Pose | Array) -> Array:
    return target.position if isinstance(target, Pose) else target


def start_of(robot: Robot, parameters: PlannerParameters, seed: int, *, joints: bool) -> tuple[
        Array, Signal, int]:
    """Return a posture from which the motion can be followed, that, and its own reversals."""
    random = np.random.default_rng([seed, 4])
    while True:
        start = _READY + random.uniform(-_SPREAD, _SPREAD, robot.n)
        signal = motion(robot, start, seed, joints=joints)
        postures, commands = run_exactly(robot, parameters, start, signal)
        arm, end = robot.kinematics(postures[-1]), signal(BEGINS + LASTS)
        if limit_violation(robot, postures, commands, DT) == 0.0 and (
                not isinstance(end, Pose) or np.abs(pose_error(
                    end, Pose(arm.tip_position, arm.tip_rotation), False)).max() < _FOLLOWS):
            first = round(BEGINS / DT)
            return start, signal, reversals(
                accelerations(commands, DT)[first:], robot.acceleration_max)


def summarised(found: list[Outcome], circles: list[bool]) -> dict[str, Any]:
    """Return the JSON entry of one input."""
    rings = [f.radius_error for f, circle in zip(found, circles) if circle]
    return {
        'reversals_median': float(np.median([f.reversals for f in found])),
        'reversals_max': max(f.reversals for f in found),
        'lag_s': float(np.median([f.lag for f in found])),
        'rms_mm': 1e3 * float(np.median([f.rms for f in found])),
        'radius_error': max(rings, default=0.0),
        'thinking': sum(f.thinking for f in found),
        'rest_share': max(f.rest_share for f in found),
        'violations': sum(f.violation > 0.0 for f in found),
        'outlier_mm': 1e3 * max(f.farthest for f in found),
    }


def _print(title: str, result: dict[str, dict[str, Any]]) -> None:
    """Print one row per input, one column per number."""
    table = Table('input', *next(iter(result.values())), title=title)
    for name, entry in result.items():
        table.add_row(name, *(f'{value:.3g}' for value in entry.values()))
    Console(width=160).print(table)


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='benchmark.streams', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--count', type=int, default=3, metavar='N', help='motions per input')
    parser.add_argument('--seed', type=int, default=1, metavar='N', help='of the first motion')
    parser.add_argument('--input', action='append', choices=list(INPUTS),
                        help='may be given more than once; all if not given')
    parser.add_argument('--method', choices=METHODS, default='dynamic_factor')
    parser.add_argument('--peer', action='append', choices=['mink', 'pink'], default=[])
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    for name in options.peer:
        if lack := missing(name):
            raise SystemExit(lack)
    robot, parameters = make_robot('panda', 6), PlannerParameters(method=options.method)
    names = options.input or list(INPUTS)
    result: dict[str, dict[str, Any]] = {}
    runs = {}
    for joints in {INPUTS[name].joints for name in names}:
        for seed in range(options.seed, options.seed + options.count):
            runs[joints, seed] = start_of(robot, parameters, seed, joints=joints)
    for name in track(names, 'inputs'):
        given = INPUTS[name]
        found: dict[str, list[Outcome]] = {entry: [] for entry in (
            name, *(f'{name} {peer}' for peer in options.peer if not given.joints))}
        circles = []
        for seed in range(options.seed, options.seed + options.count):
            start, signal, own = runs[given.joints, seed]
            sent = messages(signal, given, seed)
            circles.append(seed % 3 == 0 and not given.joints)
            postures, commands, states = run_stream(
                robot, parameters, start, sent, stamped=given.stamped)
            found[name].append(judged(
                robot, signal, postures, commands, states, own, circle=circles[-1]))
            for peer in options.peer if not given.joints else ():
                found[f'{name} {peer}'].append(judged(
                    robot, signal, *run_peer(robot, peer, start, sent, parameters.target_lag), [],
                    own, circle=circles[-1]))
        result |= {entry: summarised(ran, circles) for entry, ran in found.items()}
    _print(f'{options.count} motions from seed {options.seed}, {options.method}', result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + '\n')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
