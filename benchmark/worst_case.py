"""The longest tick among hostile obstacles: `python -m benchmark.worst_case --help`.

Crowds of obstacles of all shapes appear around a moving arm, vanish, grow, wander, turn, close in
and surround it, while its command leaps about. Every tick is timed by the processor time of this
process, with what a new scene costs (`Planner.prepare`) included. Ticks are shared evenly between
the arms, the methods and the numbers of obstacles. The reference is the median tick of
`dynamic_factor` without obstacles in the same run.

The longest ticks are played again, and the fastest time of each counts: what the machine itself
put in between does not (`longest_at_first_us` has it). A shared machine is half as fast at one
time as at another, so the reference is taken before and after each play, and the smaller of both
is what the play's ticks are multiples of. `longest_us` is the longest in times of the run's
reference.

    python -m benchmark.worst_case --ticks 1000000 --json worst_case.json
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field
import gc
import itertools
import json
from pathlib import Path
import time
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmark.crowds import Crowd, KINDS, SHAPE_NAMES, shapes_of
from benchmark.robots import make_robot
from benchmark.speed import planner_times, STARTS
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

COUNTS = (0, 10, 100, 1000, 10_000)
_ARMS = {'panda': 6, 'paper': 3}
_DT = 0.004
# Ticks of one act, from a new start posture and another kind of crowd; and between two scenes.
_ACT = 250
_SCENE_EVERY = 8
# How many of the longest ticks are told, and how often the act of each is played again.
_TOLD = 5
_REPEATS = 7
_REFERENCE_TICKS = 500


class Act(NamedTuple):
    """A motion through a crowd: the same every time.

    Attributes:
        arm, method: whose ticks.
        count: of obstacles.
        seed, number: of the random numbers, and which kind of crowd.
        shapes: of the obstacles.
    """

    arm: str
    method: str
    count: int
    seed: int
    number: int
    shapes: tuple[str, ...]

    @property
    def kind(self) -> str:
        """What the obstacles do."""
        return KINDS[self.number % len(KINDS)] if self.count else 'none'


class Tick(NamedTuple):
    """A tick that took long.

    Attributes:
        time: it took [us]; of `TimedActs`, in times of the reference beside it.
        act, index: which.
        stage: of the safety filter.
    """

    time: float
    act: Act
    index: int
    stage: str


@dataclass
class Found:
    """Times of the ticks among a number of obstacles.

    Attributes:
        times: of all [us].
        fallbacks: ticks in which a bound on the work was reached.
        slowest: the longest tick of every act.
    """

    times: list[float] = field(default_factory=list)
    fallbacks: int = 0
    slowest: list[Tick] = field(default_factory=list)


def start_posture(robot: Robot, random: np.random.Generator) -> Array:
    """Return a posture (n,) well inside the limits."""
    low = np.where(np.isfinite(robot.position_min), robot.position_min, -np.pi)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, np.pi)
    return np.asarray(low + random.uniform(0.1, 0.9, robot.n) * (high - low))


def play(robot: Robot, act: Act) -> tuple[Array, int, Tick]:
    """Play an act; return the times of its ticks [us], how many fell back, and the longest."""
    random = np.random.default_rng((act.seed, act.number, act.count))
    crowd = Crowd(act.kind, act.count, act.shapes, random)
    planner = Planner(robot, PlannerParameters(method=act.method))
    q = start_posture(robot, random)
    scene, twist, ahead = Scene.of(), np.zeros(6), None
    times, fallbacks, stage = np.empty(_ACT), 0, ''
    for i in range(_ACT):
        if i % 50 == 0:
            twist = random.normal(size=6) * random.choice([0.0, 0.1, 0.3, 1.0], size=6)
            ahead = None
            if random.random() < 0.3:
                span = np.linspace(0.0, 3.0, 20)
                ahead = Preview(span, np.outer(np.cos(span), twist)).between
        new = i % _SCENE_EVERY == 0
        if new:
            scene = crowd.scene(robot, q, _DT * _SCENE_EVERY)
        begin = time.process_time_ns()
        if new:
            planner.prepare(scene)
        result = planner.step(q, twist, scene, _DT, ahead)
        times[i] = 1e-3 * (time.process_time_ns() - begin)
        fallbacks += bool(result.fallback)
        if times[i] == times[:i + 1].max():
            stage = result.stage.name
        q = np.clip(q + _DT * result.dq, robot.position_min, robot.position_max)
    longest = int(times.argmax())
    return times, fallbacks, Tick(float(times[longest]), act, longest, stage)


class TimedActs:
    """Plays acts, with the reference beside each."""

    def __init__(self) -> None:
        """Make the arms."""
        self._robots = {name: make_robot(name, axes) for name, axes in _ARMS.items()}
        self.references = [self._reference()]

    def play(self, act: Act) -> tuple[Array, float, int, Tick]:
        """Play an act.

        Returns:
            Times of its ticks [us], the reference beside them [us], how many ticks fell back,
            and the longest tick.
        """
        times, fallbacks, longest = play(self._robots[act.arm], act)
        self.references.append(self._reference())
        beside = min(self.references[-2:])
        return times, beside, fallbacks, longest._replace(time=longest.time / beside)

    def replayed(self, act: Act) -> Array:
        """Play an act again; return its ticks in times of the reference beside them."""
        self.references.append(self._reference())
        times, beside, _, _ = self.play(act)
        return times / beside

    def _reference(self) -> float:
        times = planner_times(
            self._robots['panda'], STARTS['panda'], [], 'dynamic_factor', _REFERENCE_TICKS)
        return float(np.median(times))


def confirmed(slowest: list[Tick], acts: TimedActs) -> list[Tick]:
    """Return the ticks that take longest by themselves, the longest first.

    Now and then the machine puts something into a tick, which its processor time has as well, and
    for seconds at a time it is slower among much data than the reference shows. An act is the same
    every time. Those that seem longest are therefore played again, in turn, and the fastest time
    of each tick counts.
    """
    found = {tick.act: tick for tick in slowest}
    least: dict[Act, Array] = {}
    plays: Counter[Act] = Counter()
    while True:
        longest = sorted(found.values(), key=lambda tick: -tick.time)[:_TOLD]
        again = [tick for tick in longest if plays[tick.act] < _REPEATS]
        if not again:
            return longest
        for tick in again:
            times = acts.replayed(tick.act)
            times = least[tick.act] = np.minimum(times, least.get(tick.act, times))
            plays[tick.act] += 1
            at = int(times.argmax())
            found[tick.act] = tick._replace(
                time=float(times[at]), index=at, stage=tick.stage if at == tick.index else '')


def measure(
    counts: list[int], ticks: int, methods: list[str], seed: int, shapes: tuple[str, ...],
) -> dict[str, Any]:
    """Measure ticks among obstacles of some shapes, shared evenly; keys as in the JSON."""
    timed, found = TimedActs(), {count: Found() for count in counts}
    cases = list(itertools.product(counts, _ARMS, methods))
    acts = max(round(ticks / (_ACT * len(cases))), 1)
    gc.collect()
    gc.freeze()  # as the node does
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task('acts', total=acts * len(cases))
        for number in range(acts):
            for count, arm, method in cases:
                times, _, fallbacks, longest = timed.play(
                    Act(arm, method, count, seed, number, shapes))
                found[count].times.extend(times.tolist())
                found[count].fallbacks += fallbacks
                found[count].slowest.append(longest)
                bar.advance(task)
    unit = float(np.median(timed.references))
    return {'reference_us': unit, 'seed': seed, 'shapes': shapes,
            'obstacles': {str(count): _entry(one, timed, unit) for count, one in found.items()}}


def _entry(found: Found, acts: TimedActs, unit: float) -> dict[str, Any]:
    longest = confirmed(found.slowest, acts)
    return {'longest_us': unit * longest[0].time, 'longest_at_first_us': max(found.times),
            'p9999_us': float(np.percentile(found.times, 99.99)),
            'median_us': float(np.median(found.times)), 'ticks': len(found.times),
            'fallbacks': found.fallbacks,
            'what': [f'{unit * tick.time:.0f} us: {tick.act.arm}, {tick.act.method}, '
                     f'{tick.act.kind}, act {tick.act.number}, tick {tick.index} '
                     f'{tick.stage}'.rstrip()
                     for tick in longest]}


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    parser = argparse.ArgumentParser(
        prog='benchmark.worst_case', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--ticks', type=int, default=100_000)
    parser.add_argument('--counts', type=int, nargs='+', default=list(COUNTS), metavar='COUNT')
    parser.add_argument('--method', action='append', choices=METHODS)
    parser.add_argument('--shapes', choices=SHAPE_NAMES, default='mixed',
                        help='of the obstacles; all of them if not given')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    result = measure(
        options.counts, options.ticks, options.method or list(METHODS), options.seed,
        shapes_of(options.shapes))
    unit = result['reference_us']
    table = Table(title=f'processor time per tick; reference {unit:.1f} us')
    for column in ('obstacles', 'ticks', 'median', '99.99 %', 'longest', 'times the reference',
                   'longest at first', 'fallbacks'):
        table.add_column(column, justify='right')
    for count, entry in result['obstacles'].items():
        table.add_row(
            count, str(entry['ticks']), f'{entry["median_us"]:.0f} us',
            f'{entry["p9999_us"]:.0f} us', f'{entry["longest_us"]:.0f} us',
            f'{entry["longest_us"] / unit:.1f}', f'{entry["longest_at_first_us"]:.0f} us',
            str(entry['fallbacks']))
    console = Console(width=110)
    console.print(table)
    for count, entry in result['obstacles'].items():
        for what in entry['what']:
            console.print(f'{count}: {what}', highlight=False)
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
