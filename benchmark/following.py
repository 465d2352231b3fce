"""Arms that follow badly, and arms that do not follow: `python -m benchmark.following --help`.

planner_node's own loop commands a Panda through simulated ros2_control controllers
(`benchmark.controlled_loop`). Three questions:

- Of an arm that is late, noisy, loose or pushed, does anybody say that it does not follow?
- Of one that does not, how soon is it said, is it at rest, and how far does it move when it wakes
  up?
- With `--clear`: do commanded positions keep clear of obstacles and of the arm itself whenever
  the planned posture does?
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from itertools import count
import json
from multiprocessing import Pool
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.bodies import Bodies, capsules_of
from benchmark.closest_approach import Motion
from benchmark.controlled_loop import Commands, ControlledLoop
from benchmark.generator import DURATION, generate, Task
from benchmark.robots import make_robot
from benchmark.ros2_control import OUTPUTS, POSITION, Settings, TRAJECTORY, VELOCITY
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

_READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
# Every joint goes another way, so that swapped ones show.
_ASIDE = np.array([1.0, -0.6, 0.8, 0.4, 1.0, 0.7, -0.9])
_FORWARD = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
_RATE = 250
_LISTENS = 1.5  # until the planner moves the arm for the first time [s]
# Frozen hardware freezes so long after the first command [s].
_FREEZES = 0.3
# Slower is rest [rad/s].
_REST = 1e-9
# A joint that hangs in the gears, and by how much gains are off.
_STUCK = 'panda_joint4'
# A push lasts so long [s]; among obstacles twists are faster than the tasks' by this.
_PUSHED, _HASTE = 0.2, 1.5
# How much nearer than touching counts, as `Motion` measures to that [m].
_TOUCHES = -1e-5

# What an arm may do without being taken for one that does not follow.
INNOCENT: Mapping[str, Mapping[str, Any]] = {
    'ideal': {},
    'lag 80 ms': {'lag': 0.08},
    'dead time 40 ms': {'dead_time': 0.04},
    'both': {'lag': 0.08, 'dead_time': 0.04},
    'noise 0.5 mrad': {'noise': 5e-4},
    'states at 20 Hz': {'states_rate': 20.0},
    'states 100 ms late': {'states_delay': 0.1},
    '20 Hz and 100 ms late': {'states_rate': 20.0, 'states_delay': 0.1},
    'play of 10 mrad': {'backlash': 0.01},
    'pushes of 5 mm': {'pushed': 0.01},
    'pushes of 50 mm': {'pushed': 0.1},
    'stops of 20 to 300 ms': {'sleeps': (0.02, 0.3)},
}
# What is to be noticed.
GUILTY: Mapping[str, Mapping[str, Any]] = {
    'inactive': {'active': False},
    'frozen': {'frozen': True},
    'dead': {'dead': True},
    'a joint stuck': {'stuck': (_STUCK,)},
    'half the gain': {'gain': 0.5},
    '1.5 times the gain': {'gain': 1.5},
    'two joints swapped': {'swapped': True},
}


class Innocent(NamedTuple):
    """What a run of an arm that follows came to.

    Attributes:
        case, output: which.
        minutes: of simulated time.
        alarms: how often it was said that it does not follow.
        restarts: how often the motion started again from where the arm was.
        step: largest step of a commanded position, as a share of v_max T.
        acceleration: largest second difference of them, as a share of the limit.
    """

    case: str
    output: str
    minutes: float
    alarms: int
    restarts: int
    step: float
    acceleration: float


class Guilty(NamedTuple):
    """What became of an arm that does not follow.

    Attributes:
        case, output, command: which, and how it was commanded.
        error_s: from the first command that moves, or from the trouble on, to the error;
            infinite if there was none [s].
        rest_s: the same, to the last command that moves, or that comes back to the arm [s].
        awake_speed, awake_way: once it wakes up, until a fresh command: the fastest any joint
            moves and how far [rad/s], [rad].
        follows: whether it follows a fresh command then.
        off: how far a joint was by then from where its commands lead, at most [rad].
        step, acceleration: see `Innocent`.
    """

    case: str
    output: str
    command: str
    error_s: float
    rest_s: float
    awake_speed: float
    awake_way: float
    follows: bool
    off: float
    step: float
    acceleration: float


class Clear(NamedTuple):
    """How near commanded positions came to obstacles and to the arm itself.

    Attributes:
        seed, case: which.
        commanded, planned: smallest distances, negative inside [m].
        touches: whether a commanded posture touches while the planned one does not.
        what: of the commanded one.
        step, acceleration: see `Innocent`.
    """

    seed: int
    case: str
    commanded: float
    planned: float
    touches: bool
    what: str
    step: float
    acceleration: float


def steps_of(robot: Robot, commands: Commands) -> tuple[float, float]:
    """Return the largest step and the largest second difference of positions, as shares."""
    steps = np.diff(commands.positions, axis=0)
    # Between two motions there are no commands.
    apart = np.diff(commands.times) > 1.5 / _RATE
    steps[apart] = 0.0
    changes = np.diff(steps, axis=0) * _RATE**2
    changes[apart[1:] | apart[:-1]] = 0.0
    return (float((np.abs(steps) * _RATE / robot.velocity_max).max(initial=0.0)),
            float((np.abs(changes) / robot.acceleration_max).max(initial=0.0)))


def innocent(case: str, output: str, seconds: float, seed: int) -> Innocent:
    """Drive an arm about at random, with targets now and then."""
    robot, random = make_robot('panda', 6), np.random.default_rng(seed)
    options = dict(INNOCENT[case])
    push, sleeps = options.pop('pushed', 0.0), options.pop('sleeps', None)
    run = ControlledLoop(robot, _READY, output, settings=Settings(**options))
    run.run(_LISTENS)
    alarms, told = 0, False
    end = run.now + seconds
    while run.now < end:
        kind = random.uniform()
        run.drive(None)
        if kind < 0.1:
            run.go_to(_READY + random.uniform(-0.5, 0.5, robot.n))
        elif kind < 0.8:
            run.drive(random.normal(size=6) * random.choice([0.02, 0.1, 0.3]))
        if push and random.uniform() < 0.5:
            takes = random.uniform(0.1, 0.4)
            speed = random.normal(size=robot.n)
            speed *= push / np.abs(speed).max() / takes
            run.manager.settings = Settings(
                **options, pushed=dict(zip(robot.joint_names, speed.tolist())))
            run.run(takes)
            run.manager.settings = Settings(**options)
        if sleeps is not None and random.uniform() < 0.3:
            run.sleeps_until = run.now + random.uniform(*sleeps)
        run.run(random.uniform(0.3, 3.0))
        alarms += bool(run.loop.state.astray) and not told
        told = bool(run.loop.state.astray)
        # From the end of reach nothing moves any more.
        if random.uniform() < 0.1:
            run.drive(None)
            run.go_to(_READY)
            run.run(4.0)
    restarts = sum('jumped' in sentence for _, sentence in run.warnings)
    return Innocent(case, output, seconds / 60.0, alarms, restarts,
                    *steps_of(robot, run.commands()))


def _by_twist(run: ControlledLoop) -> None:
    run.drive(_FORWARD)


def _by_target(run: ControlledLoop) -> None:
    run.go_to(_READY + 0.5 * _ASIDE)


def _by_stream(run: ControlledLoop) -> None:
    """Send targets on a way to and fro, in every eighth tick."""
    begin, ticks = run.now, count()

    def send() -> None:
        if next(ticks) % 8 == 0:
            run.go_to(_READY + 0.3 * np.sin(2.0 * (run.now - begin)) * _ASIDE)

    run.sender = send


COMMANDS: Mapping[str, Callable[[ControlledLoop], None]] = {
    'cmd_vel': _by_twist, 'go_to': _by_target, 'stream': _by_stream}


def guilty(case: str, output: str, command: str) -> Guilty:
    """Command an arm that does not follow for five seconds, then wake it up."""
    robot = make_robot('panda', 6)
    options, joints = dict(GUILTY[case]), list(robot.joint_names)
    if 'gain' in options:
        options['gain'] = dict.fromkeys(joints, options['gain'])
    if options.pop('swapped', False):
        joints[1], joints[3] = joints[3], joints[1]
    # Frozen hardware freezes in motion; everything else is so from the start.
    late = case in ('frozen', 'dead')
    run = ControlledLoop(robot, _READY, output, joints=joints,
                         settings=Settings(**({} if late else options)))
    run.run(_LISTENS)
    COMMANDS[command](run)
    if late:
        run.run(_FREEZES)
        run.manager.settings = Settings(**options)
    begin, at = run.now, run.manager.q.copy()
    found = run.run(5.0, until=lambda: bool(run.loop.state.astray))
    found_at = run.now if found else np.inf
    run.run(max(begin + 5.0 - run.now, 0.0))
    commands = run.commands(begin)
    moves = np.abs(commands.velocities).max(axis=1) > _REST
    moving = commands.times[moves]
    first = begin if late or not len(moving) else float(moving[0])
    if output != VELOCITY:
        moves[1:] |= np.abs(np.diff(commands.positions, axis=0)).max(axis=1) > _REST / _RATE
        moving = commands.times[moves]
    rest = float(moving[-1]) - first if len(moving) else 0.0
    there = (at + commands.velocities.sum(axis=0) / _RATE if output == VELOCITY
             else commands.positions[-1])
    off = float(np.abs(run.manager.q - there).max())
    run.manager.settings = Settings()
    begin = run.now
    run.run(1.0)
    awake = run.motion(begin)
    run.drive(None)
    run.run(1.0)
    begin, at = run.now, run.manager.q.copy()
    run.drive(_FORWARD)
    run.run(2.0)
    follows = not run.error and bool(np.abs(run.manager.q - at).max() > 0.1)
    return Guilty(
        case, output, command, found_at - first, rest, float(np.abs(awake.velocities).max()),
        float(np.abs(awake.positions - awake.positions[0]).max()), follows, off,
        *steps_of(robot, run.commands()))


# What happens to arms that take positions among obstacles.
AMONG: Mapping[str, Mapping[str, Any]] = {
    **{name: INNOCENT[name] for name in (
        'both', 'noise 0.5 mrad', '20 Hz and 100 ms late', 'play of 10 mrad', 'pushes of 50 mm',
        'stops of 20 to 300 ms')},
    **{name: GUILTY[name] for name in ('a joint stuck', 'half the gain', '1.5 times the gain')},
    'emergency stop of 1 s': {'stops': 1.0},
}


def clear(seed: int) -> Clear:
    """Drive towards obstacles that inverse kinematics hits, with a trouble drawn by the seed."""
    robot, random = make_robot('panda', 6), np.random.default_rng([seed, 49])
    task = generate(robot, seed)
    case = list(AMONG)[seed % len(AMONG)]
    options = dict(AMONG[case])
    push, sleeps, stop = (options.pop(key, None) for key in ('pushed', 'sleeps', 'stops'))
    if 'gain' in options:
        options['gain'] = dict.fromkeys(robot.joint_names, options['gain'])
    if 'stuck' in options:
        options['stuck'] = (str(random.choice(robot.joint_names)),)
    settings = Settings(**options)
    output = (POSITION, TRAJECTORY)[seed // len(AMONG) % 2]
    run = ControlledLoop(robot, task.start, output, obstacles=task.obstacles, settings=settings)
    run.run(_LISTENS)
    begin, when = run.now, random.uniform(0.5, DURATION - 1.0)
    while run.now < begin + DURATION:
        t = run.now - begin
        run.drive(_HASTE * task.twist_at(t))
        if abs(t - when) < 0.5 / _RATE:
            if push is not None:
                speed = random.normal(size=robot.n)
                speed *= push / np.abs(speed).max() / _PUSHED
                run.manager.settings = Settings(
                    **options, pushed=dict(zip(robot.joint_names, speed.tolist())))
            elif sleeps is not None:
                run.sleeps_until = run.now + random.uniform(*sleeps)
            elif stop is not None:
                run.manager.settings = Settings(**options, frozen=True)
        if abs(t - when - (stop or _PUSHED)) < 0.5 / _RATE:
            run.manager.settings = settings
        run.run(1.0 / _RATE)
    run.drive(None)
    run.run(1.0)
    commands = run.commands()
    bodies = capsules_of(robot)
    commanded, what, at = _nearest(bodies, commands.positions, task)
    planned, _, _ = _nearest(bodies, commands.planned, task)
    then, _, _ = _nearest(bodies, commands.planned[at:at + 1], task)
    return Clear(seed, case, commanded, planned, commanded < _TOUCHES <= then, what,
                 *steps_of(robot, commands))


def _nearest(bodies: Bodies, postures: Array, task: Task) -> tuple[float, str, int]:
    """Return the smallest distance to obstacles or the arm itself, of what, at which posture."""
    motion = Motion.through(bodies, postures)
    nearest = min(motion.to_obstacles(task.obstacles, 0.0), motion.to_itself(),
                  key=lambda approach: approach.distance)
    return nearest.distance, str(nearest), nearest.index


def _called(arguments: tuple[Callable[..., NamedTuple], tuple[Any, ...]]) -> NamedTuple:
    function, rest = arguments
    return function(*rest)


def _all(
    console: Console, title: str,
    jobs: Sequence[tuple[Callable[..., NamedTuple], tuple[Any, ...]]],
) -> list[Any]:
    """Run all jobs on two processes and print what they came to."""
    with Pool(2) as pool:
        rows = list(track(pool.imap(_called, jobs), total=len(jobs), description=title,
                          console=console))
    return rows


def _print(console: Console, rows: Sequence[NamedTuple]) -> None:
    table = Table(*rows[0]._fields)
    for row in rows:
        table.add_row(*(f'{value:.4g}' if isinstance(value, float) else str(value)
                        for value in row))
    console.print(table)


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(
        prog='python -m benchmark.following', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--minutes', type=float, default=3.0, metavar='M',
                        help='simulated time of each kind of arm that follows (%(default)s)')
    parser.add_argument('--clear', type=int, default=0, metavar='N',
                        help='only: positions among obstacles, N motions')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--json', type=Path, metavar='FILE', help='write the outcomes there')
    options = parser.parse_args()
    console = Console(width=160)
    if options.clear:
        rows = _all(console, 'among obstacles', [
            (clear, (options.seed + i,)) for i in range(options.clear)])
        outcomes = {'clear': rows}
        worst = sorted(rows, key=lambda row: row.commanded)[:10]
        _print(console, worst)
        console.print(f'{sum(row.touches for row in rows)} of {len(rows)} commanded postures '
                      'touch where the planned one does not')
    else:
        follows = _all(console, 'arms that follow', [
            (innocent, (case, output, 60.0 * options.minutes, options.seed))
            for case in INNOCENT for output in OUTPUTS])
        _print(console, follows)
        strays = _all(console, 'arms that do not', [
            (guilty, (case, output, command))
            for case in GUILTY for output in OUTPUTS for command in COMMANDS])
        _print(console, strays)
        outcomes = {'innocent': follows, 'guilty': strays}
    if options.json:
        options.json.write_text(json.dumps(
            {key: [row._asdict() for row in rows] for key, rows in outcomes.items()}, indent=1))


if __name__ == '__main__':
    main()
