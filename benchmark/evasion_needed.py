"""How far obstacles that move ask the tip to leave its path: `python -m benchmark.evasion_needed`.

For the scenes of `benchmark.scenarios --moving`, beside what the planner does there. An optimiser
that knows the obstacles' whole course looks for the joint motion whose largest deviation from the
path is least (`benchmark/least_deviation.py`). It keeps the planner's limits and clearance (what
the planner kept, where that was less than its margin), and is back on the path at the end. Each
of two measures has a motion of its own:

- pose: √(‖Δp‖² + (1 m · 2 sin ½θ)²) to the nearest pose of the path. Six axes are commanded, and
  metres and radians weigh alike, as in the planner. Speed along the path is free: the planner's
  gives way first, too. This is what the planner is compared with.
- position: ‖Δp‖ alone, as the judge measures it, while the hand may turn as it likes. Nothing asks
  less of the computed motion, but it is not the task that was commanded.

What is computed is a motion that can be made, not a proof that none is better. An optimiser finds
the best near its starts, so it begins with several: the planner's own motion, an arm that stands,
the motion without obstacles, and one that leans aside. coal and the judge's limits measure what
comes out, every 4 ms.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import json
from multiprocessing import Pool
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.generator import generate, Task
from benchmark.judge import Judge
from benchmark.least_deviation import LeastDeviation, Path as TipPath
from benchmark.robots import make_robot
from benchmark.scenarios import DT, METHODS, run_planner
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# The computed motion is back after this long, 4 s after the command ends; the planner has 2 s more
# [s].
SECONDS = 8.0
# What a radian counts beside a metre [m].
LEVERS = {'pose': 1.0, 'position': 0.0}
# A tip this near to its path is on it, and no deviation counts as less in a ratio [m].
_ON_PATH = 1e-3
# How far an arm leans aside as a start, about, and when [rad, s].
_LEAN, _LEAN_FROM, _LEAN_UNTIL = 0.7, 0.5, 4.5
_LEANS = 1
# How often a motion is asked to keep more, and what it may lack [m].
_TIGHTENED, _LACK = 3, 2e-3
_EVERY = 2  # ticks at which deviations are measured, as the judge does


class Deviation(NamedTuple):
    """How a motion leaves its path.

    Attributes:
        largest: deviation [m].
        last: at the end [m].
        clearance: smallest distance of a link to an obstacle, by coal [m].
        itself: smallest distance between two links [m].
        excess: over a limit of position, velocity or acceleration, as a share of it.
    """

    largest: float
    last: float
    clearance: float
    itself: float
    excess: float


class Comparison(NamedTuple):
    """A scene.

    Attributes:
        seed: of the task.
        measure: of `LEVERS`.
        planner: what it did.
        computed: what the optimiser found; None if no start led to a motion that keeps clear.
        reasons: what the planner said, each once.
    """

    seed: int
    measure: str
    planner: Deviation
    computed: Deviation | None
    reasons: tuple[str, ...]

    @property
    def ratio(self) -> float:
        """The planner's largest deviation over the computed one."""
        if self.computed is None:
            return float('nan')
        return max(self.planner.largest, _ON_PATH) / max(self.computed.largest, _ON_PATH)


def starts(robot: Robot, task: Task, own: Array) -> Iterator[Array]:
    """Yield motions to begin with, (k, n) over `SECONDS`.

    Args:
        robot: the arm.
        task: what to do.
        own: (k, n) the planner's motion, every `DT`.
    """
    yield own[:round(SECONDS / DT) + 1]
    standing = np.tile(task.start, (round(SECONDS / DT) + 1, 1))
    yield standing
    yield along_the_path(robot, task)
    times = np.linspace(0.0, SECONDS, len(standing))
    share = np.clip((times - _LEAN_FROM) / (_LEAN_UNTIL - _LEAN_FROM), 0.0, 1.0)
    random = np.random.default_rng(task.seed)
    for _ in range(_LEANS):
        yield standing + np.outer(np.sin(np.pi * share) ** 2,
                                  _LEAN * random.normal(size=robot.n))


def along_the_path(robot: Robot, task: Task) -> Array:
    """Return the planner's postures (k, n) where nothing moves and nothing is in the way."""
    alone = Task(task.seed, task.start, task.twist, ())
    moved = run_planner(robot, METHODS['dynamic_factor'], Judge(robot), alone).postures
    rest = round(SECONDS / DT) + 1 - len(moved)
    return np.vstack((moved, np.tile(moved[-1], (rest, 1))))


def deviation(robot: Robot, task: Task, postures: Array, lever: float) -> Deviation:
    """Measure a motion, postures (k, n) every `DT`."""
    motion = Motion.through(capsules_of(robot), postures)
    off = TipPath.of(robot, task).deviations(robot, postures[::_EVERY], lever)
    return Deviation(
        float(off.max()), float(off[-1]), motion.to_obstacles(task.obstacles, DT).distance,
        motion.to_itself().distance, _excess(robot, postures))


def _excess(robot: Robot, postures: Array) -> float:
    """Return the largest excess over a limit, without jerk, which evading may break."""
    velocities = np.diff(postures, axis=0) / DT
    accelerations = np.diff(velocities, axis=0, prepend=np.zeros((1, robot.n))) / DT
    return max(
        0.0, float((postures - robot.position_max).max()),
        float((robot.position_min - postures).max()),
        float((np.abs(velocities) / robot.velocity_max).max() - 1.0 - 1e-6),
        float((np.abs(accelerations) / robot.acceleration_max).max() - 1.0 - 1e-6))


def compare(robot: Robot, task: Task) -> list[Comparison]:
    """Return a scene with each measure."""
    ran = run_planner(robot, METHODS['dynamic_factor'], Judge(robot), task)
    found, begins = [], list(starts(robot, task, ran.postures))
    for name, lever in LEVERS.items():
        own = deviation(robot, task, ran.postures, lever)
        if own.largest < _ON_PATH:
            # The planner shows that the scene asks for nothing.
            found.append(Comparison(task.seed, name, own, own, ran.reasons))
            continue
        margin = min(max(own.clearance, 0.0), PlannerParameters().clearance_margin)
        postures = _least(robot, task, begins, lever, margin)
        computed = None
        if postures is not None:
            computed = deviation(robot, task, postures, lever)
            # What leaves the path least in one measure does well in the next one.
            begins.insert(0, postures)
        found.append(Comparison(task.seed, name, own, computed, ran.reasons))
    return found


def _least(
    robot: Robot, task: Task, begins: list[Array], lever: float, margin: float,
) -> Array | None:
    """Return the postures (k, n), every `DT`, that deviate least; None if none keep clear.

    An optimiser looks at some instants only. What comes nearer in between is asked to keep as much
    more, until it keeps the margin at every tick.
    """
    kept = margin
    for _ in range(_TIGHTENED):
        problem = LeastDeviation(robot, task, SECONDS, begins, lever=lever, margin=kept)
        points = problem.best()
        if points is None:
            return None
        postures = problem.postures(points, DT)
        lack = margin - deviation(robot, task, postures, lever).clearance
        if lack < _LACK:
            return postures
        kept, begins = kept + lack, [postures, *begins[:2]]
    return None


def _job(seed: int) -> list[Comparison]:
    robot = make_robot('panda', 6)
    return compare(robot, generate(robot, seed, moving=True))


def summarise(comparisons: list[Comparison]) -> dict[str, Any]:
    """Return the JSON of one measure; medians are over the scenes that have a computed motion."""
    solved = [(c, c.computed) for c in comparisons if c.computed is not None]

    def median(values: list[float]) -> float | None:
        return float(np.median(values)) if values else None

    return {
        'computed_median': median([computed.largest for _, computed in solved]),
        'planner_median': median([c.planner.largest for c, _ in solved]),
        'ratio_median': median([c.ratio for c, _ in solved]),
        'back': sum(c.planner.last < _ON_PATH for c in comparisons),
        'computed_back': sum(computed.last < _ON_PATH for _, computed in solved),
        'solved': len(solved),
        'count': len(comparisons),
        'scenes': [{
            'seed': c.seed, 'planner': c.planner._asdict(),
            'ratio': None if c.computed is None else c.ratio,
            'computed': None if c.computed is None else c.computed._asdict(),
            'reasons': list(c.reasons)[:5]} for c in comparisons],
    }


def _print(console: Console, name: str, comparisons: list[Comparison]) -> None:
    table = Table(title=f'{name}, {len(comparisons)} moving scenes')
    for heading in ('seed', 'computed [mm]', 'clear [mm]', 'links apart [mm]', 'beyond a limit',
                    'planner [mm]', 'clear [mm]', 'at the end [mm]', 'ratio'):
        table.add_column(heading, justify='right')
    for c in comparisons:
        computed = ('none', '', '', '') if c.computed is None else (
            f'{1e3 * c.computed.largest:.1f}', f'{1e3 * c.computed.clearance:.1f}',
            f'{1e3 * c.computed.itself:.1f}', f'{c.computed.excess:.1g}')
        table.add_row(
            str(c.seed), *computed, f'{1e3 * c.planner.largest:.1f}',
            f'{1e3 * c.planner.clearance:.1f}', f'{1e3 * c.planner.last:.1f}', f'{c.ratio:.2f}')
    console.print(table)
    figures = summarise(comparisons)
    if figures['solved']:
        console.print(
            f'medians of {figures["solved"]}: computed {1e3 * figures["computed_median"]:.1f} mm, '
            f'planner {1e3 * figures["planner_median"]:.1f} mm, ratio '
            f'{figures["ratio_median"]:.2f}; the planner is back in {figures["back"]} of '
            f'{figures["count"]}')


def main(args: list[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        prog='benchmark.evasion_needed', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--count', type=int, default=20)
    parser.add_argument('--seed', type=int, default=60000, help='first seed')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    seeds = range(options.seed, options.seed + options.count)
    measures: dict[str, list[Comparison]] = {name: [] for name in LEVERS}
    with Pool(options.jobs) as pool:
        for scene in track(pool.imap(_job, seeds), 'scenes', len(seeds),
                           console=Console(stderr=True)):
            for found in scene:
                measures[found.measure].append(found)
            # A scene takes minutes: what is known so far outlives whatever stops the run.
            if options.json is not None:
                options.json.write_text(json.dumps(report(measures), indent=1) + '\n')
    for name, comparisons in measures.items():
        _print(Console(width=160), name, comparisons)


def report(measures: dict[str, list[Comparison]]) -> dict[str, Any]:
    """Return the JSON: the first measure's figures, and those of the others by name."""
    first, *others = measures
    return summarise(measures[first]) | {name: summarise(measures[name]) for name in others}


if __name__ == '__main__':
    main()
