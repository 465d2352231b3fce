"""Recorded ticks of many scenes: whoever rewrites the planner sees where a command changes.

`python -m benchmark.golden_ticks --against FILE` compares today's commands with those of a file,
`--write FILE` records them. A change that is to leave commands as they are is checked against a
file of the version before, written on the same machine: there they are the same to the last bit.
`test/core/golden_ticks.npz` is for everyone's tests, until the tick in which a scene depends on
rounding. It is written anew only where commands are meant to change.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
import sys
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from benchmark.generator import generate, Task
from benchmark.robots import make_robot
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PAPER_METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.paper.method import PaperPlanner

Array = npt.NDArray[np.float64]
Twist = Callable[[float], Array]
Target = Callable[[Kinematics, float], tuple[Any, list[Sighting]]]

FILE = Path(__file__).parents[1] / 'test' / 'core' / 'golden_ticks.npz'
DT = 0.01
READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
PAPER_START = np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])
STAGES = tuple(Stage)
# Positions so far off [rad] show what a processor's rounding decides: where commands of so many
# arms are further off than that [rad/s].
_ROUNDING, _NUDGES, _SAME = 1e-15, 3, 3e-7


@cache
def robot_of(name: str) -> Robot:
    """Return one of the arms."""
    if name == 'paper':
        return make_robot('paper', 3)
    return make_robot('panda', 3 if name == 'panda_position' else 6,
                      **({'command_frame': 'tool'} if name == 'panda_tool' else {}))


class Ticks(NamedTuple):
    """What a scene came to.

    Attributes:
        dq: (ticks, n) commands [rad/s, m/s].
        stages: (ticks,) places in `STAGES`.
        certain: so many ticks, the first ones, do not depend on how a processor rounds.
    """

    dq: Array
    stages: npt.NDArray[np.int8]
    certain: int


@dataclass(frozen=True)
class GoldenScene:
    """What the planner is given.

    Attributes:
        robot: see `robot_of`.
        start: (n,) [rad, m].
        twist: time → (6,).
        parameters: what differs from the defaults.
        obstacles: at time 0.
        target: arm at the start, time → target and news; None to follow the twist.
        seconds: how long it takes.
        pushes: tick → what is added to all joints' measurements from then on [rad, m].
    """

    robot: str
    start: Array
    twist: Twist = lambda t: np.zeros(6)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    obstacles: Sequence[Obstacle] = ()
    target: Target | None = None
    seconds: float = 2.0
    pushes: Mapping[int, float] = field(default_factory=dict)


def held(*twist: float) -> Twist:
    """Return the twist that is always the same."""
    command = np.array([*twist, *(0.0,) * (6 - len(twist))])
    return lambda t: command


def ball(
    center: npt.ArrayLike, radius: float, velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> Obstacle:
    """Return a spherical obstacle."""
    return Obstacle('ball', center, (radius,) * 3, velocity=velocity)


@cache
def task_of(robot: str, seed: int, moving: bool) -> Task:
    """Return a task of the benchmarks."""
    return generate(robot_of(robot), seed, moving=moving)


def made(robot: str, seed: int, moving: bool = False, **parameters: Any) -> GoldenScene:
    """Return the first three seconds of a task of the benchmarks."""
    task = task_of(robot, seed, moving)
    return GoldenScene(robot, task.start, task.twist_at, parameters, task.obstacles, seconds=3.0)


def to_pose(offset: npt.ArrayLike) -> Target:
    """Return a target so far from the tip's first position [m]."""
    def target(arm: Kinematics, t: float) -> tuple[Any, list[Sighting]]:
        return Pose(arm.tip_position + np.asarray(offset), arm.tip_rotation), []
    return target


def to_joints(offset: float) -> Target:
    """Return a target so far from each joint's first position [rad]."""
    return lambda arm, t: (READY + offset, [])


def after_a_hand(arm: Kinematics, t: float) -> tuple[Any, list[Sighting]]:
    """Return a pose for each third tick, on a circle."""
    at = np.floor(t / (3 * DT) + 1e-9) * 3 * DT
    goal = Pose(arm.tip_position + 0.06 * np.array([0.0, np.sin(at), 1.0 - np.cos(at)]),
                arm.tip_rotation)
    return goal, [Sighting(goal, 0.01)] if abs(t - at) < 0.5 * DT else []


def along_chunks() -> Target:
    """Return a new chunk of joint positions every half second."""
    chunks: dict[int, Chunk] = {}

    def target(arm: Kinematics, t: float) -> tuple[Any, list[Sighting]]:
        k = int(t / 0.5 + 1e-9)
        if k not in chunks:
            times = 0.1 * np.arange(1, 11)
            chunks[k] = Chunk(times, READY + 0.2 * np.sin(
                np.outer(0.5 * k + times, np.linspace(0.5, 1.5, 7))))
        return chunks[k], []
    return target


BALL_IN_THE_WAY = (ball((0.185, 0.414, 0.782), 0.03),)
FOREARM = (ball((-0.3, 0.037, 0.697), 0.06, (0.2, 0.0, 0.0)),)
FIRST_LINK_VELOCITY = np.array([0.014, 0.222, -0.202])
FIRST_LINK = (ball(np.array([0.016, 0.433, 0.324]) - 2.0 * FIRST_LINK_VELOCITY, 0.05,
                   FIRST_LINK_VELOCITY),)
HELD_UP = held(0.102, -0.04, -0.05)


def held_up(**parameters: Any) -> GoldenScene:
    """Return the paper arm with a ball in the way of its last links."""
    return GoldenScene('paper', PAPER_START, HELD_UP, parameters, BALL_IN_THE_WAY, seconds=3.0)


def scenes() -> dict[str, GoldenScene]:
    """Return all scenes by their names."""
    rail_end = np.array([0.35, *PAPER_START[1:]])
    return {
        'paper': held_up(method='paper'),
        'paper, gradient projection': held_up(method='paper_gradient_projection'),
        'gradient projection': held_up(method='gradient_projection'),
        'dynamic factor': held_up(),
        'dynamic factor, Eq. 2 alone': held_up(horizon_look_ahead=0.0),
        'variational': held_up(method='variational'),
        'slides': held_up(path_priority='slide'),
        'something moves into the forearm': GoldenScene(
            'panda', READY, obstacles=FOREARM, seconds=3.0),
        'the same, strict': GoldenScene(
            'panda', READY, parameters={'path_priority': 'strict'}, obstacles=FOREARM,
            seconds=3.0),
        'the same, variational': GoldenScene(
            'panda', READY, parameters={'method': 'variational'}, obstacles=FOREARM,
            seconds=3.0),
        'something moves into the first link': GoldenScene(
            'paper', np.array([0.2, 0.2, *PAPER_START[2:]]), obstacles=FIRST_LINK, seconds=3.0),
        'stretches out': GoldenScene('panda', READY, held(0.3, 0.0, 0.1)),
        'slides at the end of reach': GoldenScene(
            'panda', READY, held(0.3, 0.1, 0.1), {'path_priority': 'slide'}),
        'folds': GoldenScene('panda', READY, held(-0.2, 0.0, -0.05), seconds=3.0),
        'the end of a rail': GoldenScene('paper', rail_end, held(0.0, 0.0, 0.3)),
        'a cone': GoldenScene(
            'panda', READY, held(0.0, 0.0, 0.0, 0.3),
            {'cone_angle': 0.3, 'cone_direction': (0.0, 0.0, -1.0)}),
        'a preferred posture, by the tool': GoldenScene(
            'panda_tool', READY, held(0.0, 0.1, -0.05),
            {'posture_preferred': ('panda_joint3=0.5',)}),
        'position alone': GoldenScene('panda_position', READY, held(0.0, 0.15, -0.1)),
        'pushed': GoldenScene('panda', READY, pushes={30: 0.05, 90: -0.1}),
        'late drives': GoldenScene(
            'panda', READY,
            lambda t: np.array([0.0, 0.2, -0.1, 0.0, 0.0, 0.0]) * np.sin(4.0 * t),
            {'drive_lag': 0.06, 'drive_dead_time': 0.04}),
        'to a pose': GoldenScene(
            'panda', READY, target=to_pose((0.1, 0.2, -0.1)), seconds=3.0),
        'around a ball': GoldenScene(
            'panda', READY, parameters={'target_path': 'free'},
            obstacles=(ball((0.31, 0.3, 0.59), 0.06),), target=to_pose((0.0, 0.5, 0.0)),
            seconds=4.0),
        'to joint positions': GoldenScene('panda', READY, target=to_joints(0.3)),
        'after a hand': GoldenScene('panda', READY, target=after_a_hand),
        'chunks of joint positions': GoldenScene('panda', READY, target=along_chunks()),
        **{f'{robot} {seed}, {method}': made(robot, seed, method=method)
           for robot, seed in (('panda', 60), ('paper', 61))
           for method in ('gradient_projection', 'dynamic_factor', 'variational')},
        **{f'panda {seed}, moving, {method}': made('panda', seed, True, method=method)
           for seed in (62, 63) for method in ('dynamic_factor', 'variational')},
    }


def played(scene: GoldenScene, recorded: Array | None = None) -> Ticks:
    """Play a scene: the arm does what is commanded, or what was when it was recorded."""
    robot, q = robot_of(scene.robot), np.array(scene.start, dtype=float)
    parameters = PlannerParameters(**scene.parameters)
    planner = (PaperPlanner if parameters.method in PAPER_METHODS else Planner)(robot, parameters)
    arm, standing = robot.kinematics(q), Scene.of(scene.obstacles)
    moves = any(obstacle.velocity.any() for obstacle in scene.obstacles)
    commands, stages = [], []
    for tick in range(round(scene.seconds / DT)):
        t = tick * DT
        q = q + scene.pushes.get(tick, 0.0)
        around = Scene.of([o.after(t) for o in scene.obstacles]) if moves else standing
        target, news = scene.target(arm, t) if scene.target else (None, [])
        result = planner.step(q, scene.twist(t), around, DT, target=target, news=news)
        planner.prepare(around)
        commands.append(result.dq)
        stages.append(STAGES.index(result.stage))
        q = q + DT * (result.dq if recorded is None else recorded[tick])
    return Ticks(np.array(commands), np.array(stages, dtype=np.int8), len(commands))


def read(file: Path) -> dict[str, Ticks]:
    """Return the recorded ticks by the scenes' names."""
    with np.load(file) as arrays:
        names = [key.removesuffix(': dq') for key in arrays if key.endswith(': dq')]
        return {name: Ticks(arrays[f'{name}: dq'], arrays[f'{name}: stages'],
                            int(arrays.get(f'{name}: certain', len(arrays[f'{name}: dq']))))
                for name in names}


def write(file: Path) -> None:
    """Record all scenes."""
    arrays: dict[str, Any] = {}
    for name, scene in scenes().items():
        ticks = played(scene)
        arrays[f'{name}: dq'], arrays[f'{name}: stages'] = ticks.dq, ticks.stages
        arrays[f'{name}: certain'] = _certain(scene, ticks)
    np.savez_compressed(file, **arrays)


def _certain(scene: GoldenScene, ticks: Ticks) -> int:
    """Return before which tick an arm that is a rounding error elsewhere is told the same."""
    random, certain = np.random.default_rng(0), len(ticks.dq)
    for _ in range(_NUDGES):
        start = scene.start + random.uniform(-_ROUNDING, _ROUNDING, len(scene.start))
        nudged = ticks.dq + random.uniform(-_ROUNDING, _ROUNDING, ticks.dq.shape) / DT
        there = played(replace(scene, start=start), nudged)
        differs = (np.abs(there.dq - ticks.dq).max(axis=1) > _SAME) | (
            there.stages != ticks.stages)
        if differs.any():
            certain = min(certain, int(np.argmax(differs)))
    return certain


def main() -> int:
    """Record or compare; return 1 where a command differs."""
    parser = argparse.ArgumentParser(
        prog='python -m benchmark.golden_ticks', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--write', type=Path, metavar='FILE', help='record the ticks of today')
    parser.add_argument('--against', type=Path, metavar='FILE', default=FILE,
                        help="the recorded ticks (those of everyone's tests)")
    options = parser.parse_args()
    if options.write:
        write(options.write)
        return 0
    recorded, worst = read(options.against), 0.0
    for name, scene in scenes().items():
        if name not in recorded:
            print(f'  no record   {name}')
            continue
        before = recorded[name]
        ticks = played(scene, before.dq)
        off = np.abs(ticks.dq - before.dq).max(axis=1)
        first = f', from tick {int(np.argmax(off > 0.0))} on' if off.any() else ''
        stages = int((ticks.stages != before.stages).sum())
        print(f'{off.max():11.3g}  {name}{first}{f", {stages} other stages" if stages else ""}')
        worst = max(worst, float(off.max()))
    return int(worst > 0.0)


if __name__ == '__main__':
    sys.exit(main())
