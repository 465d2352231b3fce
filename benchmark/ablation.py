"""What is each mechanism worth? `python -m benchmark.ablation --help`.

One mechanism after the other is switched off, by a parameter or by putting nothing in its place,
and the same motions are made with and without it: past obstacles that stand and that move, through
sweeping balls, to targets and through furniture, along streams, into the edges of what arms can
do, with two arms. The table has the lines
and constants that it takes, and for each figure how much it differs without. Motions come in
blocks of seeds; a difference that has the same sign in every block is shown in bold, any other
is noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from functools import cache
import json
from multiprocessing import Pool
from pathlib import Path
import re
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark import edges, scenarios, streams, sweeps, targets, two_arms
from benchmark.example_arms import arms
from benchmark.generator import generate
from benchmark.judge import Judge
from benchmark.problem_sets import generated
from benchmark.problem_sets.families import FAMILIES
from benchmark.problem_sets.judgement import collided, Judge as ProblemJudge
from benchmark.problem_sets.servo import planner_step, servo
from benchmark.robots import make_robot
from benchmark.sent_motions import INPUTS, messages
from benchmark.target_problems import problem_of
import redundant_planner
from redundant_planner.core.horizon import look_ahead
from redundant_planner.core.horizon.evasive_plan import EvasivePlan
from redundant_planner.core.horizon.multi_start import MultiStart
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.target.coming_back import ComingBack
from redundant_planner.core.target.progress import TargetState
from redundant_planner.io.resources import panda_urdf

Array = npt.NDArray[np.float64]
Figures = dict[str, float]

_CORE = Path(redundant_planner.__file__).parent / 'core'
_CONSTANT = re.compile(r'^(?:[A-Z_][A-Z0-9_]*(?:, )?)+ = ', re.MULTILINE)
# Seeds of the blocks, far from those of other benchmarks' tables.
_SEED, _BLOCK = 700_000, 10_000
# Motions to each block, by kind: each takes from one to ten seconds.
_COUNTS = {'static': 12, 'moving': 12, 'sweeps': 8, 'targets': 12, 'problems': 10, 'streams': 3,
           'edges': 30, 'two_arms': 6}
# Inputs of streams that are looked at.
_STREAMS = ('72 Hz', '10 Hz')
_DT = 0.004
# That problems are to be solved at [m].
_PROBLEM_MARGIN = 0.005


class Mechanism(NamedTuple):
    """What can be switched off.

    Attributes:
        name: for the table.
        files: within core, that go with it as a whole.
        parameters: with which it is off.
        off: how else it is switched off.
    """

    name: str
    files: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = {}
    off: Callable[[], AbstractContextManager[Any]] | None = None


def _no_steps_aside(self: EvasivePlan, *_: Any) -> None:
    self.reset()


# With nothing switched off.
NOTHING = Mechanism('')
MECHANISMS = (
    Mechanism('evasive plan', ('horizon/evasive_plan.py', 'horizon/evasive_path.py'),
              off=lambda: patch.object(EvasivePlan, 'aside', _no_steps_aside)),
    Mechanism('joint path ahead within dynamic_factor', ('horizon/look_ahead.py',),
              {'horizon_look_ahead': 0.0}),
    Mechanism('other ways of the joint path ahead', ('horizon/multi_start.py',),
              off=lambda: patch.object(MultiStart, 'step', lambda *_, **__: None)),
    Mechanism('free way back', ('target/coming_back.py',),
              off=lambda: patch.object(ComingBack, 'target', None)),
    Mechanism('stand-by of the joint path ahead',
              off=lambda: patch.object(look_ahead, '_STANDBY', 0.0)),
    Mechanism('stay of the joint path ahead',
              off=lambda: patch.object(look_ahead, '_STAY', 0.0)),
    Mechanism('criterion of manipulability', parameters={'criteria_k_m': 0.0}),
    Mechanism('damping', parameters={
        'singularity_damping': 0.0, 'singularity_damping_threshold': 0.0}),
    Mechanism('row of singular values', parameters={'singularity_margin': 0.0}),
    Mechanism('smoothing of clearance', parameters={'clearance_smoothing': 0.0}),
    Mechanism('lead of moving obstacles', parameters={'clearance_lead': 0.0}),
)


def size_of(mechanism: Mechanism) -> tuple[int, int]:
    """Return how many lines and how many constants go with a mechanism."""
    texts = [(_CORE / file).read_text() for file in mechanism.files]
    return (sum(len(text.splitlines()) for text in texts),
            sum(found.group().count(',') + 1
                for text in texts for found in _CONSTANT.finditer(text)))


@cache
def _panda() -> Robot:
    return make_robot('panda', 6)


@cache
def _judge() -> Judge:
    return Judge(_panda())


@cache
def _problem_judge() -> ProblemJudge:
    urdf = panda_urdf()
    assert urdf is not None, 'pip install example-robot-data'
    return ProblemJudge(_panda(), urdf)


@cache
def _arms() -> tuple[Robot, Robot]:
    return two_arms.arms()


def _scenario(seed: int, parameters: PlannerParameters, moving: bool) -> Figures:
    task = generate(_panda(), seed, moving=moving)
    outcome = scenarios.run_planner(_panda(), parameters, _judge(), task)
    verdict = outcome.verdict
    figures = {'hits': float(verdict.min_distance < 0.0), 'joint path': verdict.path,
               'effort': verdict.cost, 'reversals': float(verdict.reversals),
               'violations': float(verdict.limit_violation > 0.0)}
    if moving:
        return figures | {'off the path [mm]': 1e3 * verdict.path_error,
                          'back': float(verdict.final_error < 1e-3)}
    return figures | {'completed': float(outcome.tracked)}


def _static(seed: int, parameters: PlannerParameters) -> Figures:
    return _scenario(seed, parameters, moving=False)


def _moving(seed: int, parameters: PlannerParameters) -> Figures:
    return _scenario(seed, parameters, moving=True)


def _swept(seed: int, parameters: PlannerParameters) -> Figures:
    outcome = sweeps.run(_panda(), seed, parameters)
    return {'hits': float(outcome.clearance < 0.0), 'seconds': outcome.seconds,
            'off the way [mm]': 1e3 * outcome.off, 'violations': float(outcome.violation > 0.0)}


def _target(seed: int, parameters: PlannerParameters) -> Figures:
    robot = _panda()
    problem = problem_of(robot, seed)
    parameters = replace(parameters, target_path='free')
    ride = targets.planned(robot, problem, parameters)
    outcome = targets.judged(robot, problem, parameters, seed, ride)
    return {'reached': float(ride.state is TargetState.REACHED), 'seconds': outcome.seconds,
            'joint path': outcome.path, 'hits': float(outcome.clearance < 0.0),
            'violations': float(outcome.violation > 0.0)}


def _problem(seed: int, parameters: PlannerParameters) -> Figures:
    robot, families = _panda(), list(FAMILIES)
    problem = generated.generate(robot, seed, families[seed % len(families)], 0)
    parameters = replace(parameters, clearance_margin=_PROBLEM_MARGIN)
    step = planner_step(Planner(robot, parameters), problem, to_target=True)
    outcome = _problem_judge().judge(problem, servo(robot, problem, step, to_target=True))
    return {'reached': float(outcome.reached), 'seconds': outcome.time,
            'joint path': outcome.path, 'hits': float(collided(outcome)),
            'violations': float(outcome.limit_violation > 0.0)}


def _edge(seed: int, parameters: PlannerParameters) -> Figures:
    random = np.random.default_rng(seed)
    urdfs = [urdf for urdf, _ in arms()]
    case = edges.Case(urdfs[random.integers(len(urdfs))], seed, 0, int(random.integers(6)),
                      int(random.choice([1, -1])), '')
    arm = edges.arm_of(case.urdf)
    motion = edges.driven(arm.robot, parameters, edges.start_of(arm, seed, 0), case.twist, _DT)
    rest = edges.rest_of(arm, motion, _DT)
    return {'reversals': float(rest.reversals), 'restless': float(rest.restless),
            'violations': float(rest.violation > 0.0)}


def _stream(seed: int, parameters: PlannerParameters) -> Figures:
    robot = _panda()
    start, signal, own = streams.start_of(robot, parameters, seed, joints=False)
    found = []
    for name in _STREAMS:
        given = INPUTS[name]
        sent = messages(signal, given, seed)
        found.append(streams.judged(robot, signal, *streams.run_stream(
            robot, parameters, start, sent, stamped=given.stamped), own, circle=False))
    return {'reversals': float(sum(one.reversals for one in found)),
            'off [mm]': 1e3 * max(one.rms for one in found),
            'violations': float(any(one.violation > 0.0 for one in found))}


def _both(seed: int, parameters: PlannerParameters) -> Figures:
    outcome = two_arms.run(_arms(), seed, parameters)
    arrived = [state == TargetState.REACHED.value for state in outcome.states]
    return {'both arrive': float(all(arrived)), 'seconds': max(outcome.seconds),
            'hits': float(outcome.clearance < 0.0),
            'violations': float(outcome.violation > 0.0)}


KINDS: Mapping[str, Callable[[int, PlannerParameters], Figures]] = {
    'static': _static, 'moving': _moving, 'sweeps': _swept, 'targets': _target,
    'problems': _problem, 'streams': _stream, 'edges': _edge, 'two_arms': _both}


class Job(NamedTuple):
    """One motion: without which mechanism, of which kind, in which block, from which seed."""

    mechanism: int
    kind: str
    block: int
    seed: int
    method: str


def without(mechanism: Mechanism, kind: str, seed: int, method: str) -> Figures:
    """Return the figures of one motion with a mechanism switched off."""
    parameters = PlannerParameters(method=method, **mechanism.parameters)
    with ExitStack() as stack:
        if mechanism.off is not None:
            stack.enter_context(mechanism.off())
        return KINDS[kind](seed, parameters)


def _run(job: Job) -> Figures:
    mechanism = MECHANISMS[job.mechanism] if job.mechanism >= 0 else NOTHING
    return without(mechanism, job.kind, job.seed, job.method)


class Difference(NamedTuple):
    """What a figure comes to with everything, and how much it differs without a mechanism.

    Attributes:
        figure: kind and name.
        all: with everything, the mean over all motions.
        blocks: the mean difference in each block.
    """

    figure: str
    all: float
    blocks: tuple[float, ...]

    @property
    def counts(self) -> bool:
        """Whether it has the same sign in every block."""
        return all(b > 0.0 for b in self.blocks) or all(b < 0.0 for b in self.blocks)


def differences(found: Mapping[Job, Figures], mechanism: int) -> list[Difference]:
    """Return the differences that a mechanism makes, of the same motions with and without it."""
    blocks: dict[str, dict[int, list[tuple[float, float]]]] = {}
    for job, figures in found.items():
        if job.mechanism == mechanism:
            whole = found[job._replace(mechanism=-1)]
            for name, value in figures.items():
                blocks.setdefault(f'{job.kind}: {name}', {}).setdefault(job.block, []).append(
                    (whole[name], value))
    return [Difference(
        figure, float(np.mean([pair[0] for pairs in of.values() for pair in pairs])),
        tuple(float(np.mean([after - before for before, after in pairs]))
              for _, pairs in sorted(of.items())))
        for figure, of in blocks.items()]


def _table(found: Mapping[Job, Figures], chosen: Sequence[int]) -> Table:
    rows = {chosen_one: differences(found, chosen_one) for chosen_one in chosen}
    table = Table('without', 'lines', 'constants', title='what differs')
    for difference in rows[chosen[0]]:
        table.add_column(f'{difference.figure}\n{difference.all:.4g}')
    for one in chosen:
        lines, constants = size_of(MECHANISMS[one])
        table.add_row(MECHANISMS[one].name, str(lines or ''), str(constants or ''), *(
            f'[bold]{mean:+.3g}[/]' if d.counts else f'{mean:+.3g}' if mean else ''
            for d in rows[one] for mean in (float(np.mean(d.blocks)),)))
    return table


def main(args: list[str] | None = None) -> int:
    """Switch mechanisms off; return the process's exit status."""
    parser = argparse.ArgumentParser(
        prog='python -m benchmark.ablation', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [mechanism.name for mechanism in MECHANISMS]
    parser.add_argument('--without', action='append', choices=names, metavar='NAME',
                        help=f'a mechanism; all if not given: {", ".join(names)}')
    parser.add_argument('--kind', action='append', choices=list(KINDS),
                        help='of motions; all if not given')
    parser.add_argument('--blocks', type=int, default=3, metavar='N')
    parser.add_argument('--share', type=float, default=1.0, metavar='X',
                        help='of the motions in each block')
    parser.add_argument('--seed', type=int, default=_SEED, help='of the first block')
    parser.add_argument('--method', choices=METHODS, default='dynamic_factor')
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    chosen = [names.index(name) for name in options.without or names]
    jobs = [Job(mechanism, kind, block, options.seed + block * _BLOCK + i, options.method)
            for kind in options.kind or KINDS for block in range(options.blocks)
            for i in range(max(round(options.share * _COUNTS[kind]), 1))
            for mechanism in (-1, *chosen)]
    with Pool(options.jobs) as pool:
        found = dict(zip(jobs, track(pool.imap(_run, jobs), 'motions', len(jobs),
                                     console=Console(stderr=True))))
    Console(width=400).print(_table(found, chosen))
    if options.json is not None:
        options.json.write_text(json.dumps({MECHANISMS[one].name: {
            'lines': size_of(MECHANISMS[one])[0], 'constants': size_of(MECHANISMS[one])[1],
            'differences': {d.figure: {'all': d.all, 'blocks': d.blocks, 'counts': d.counts}
                            for d in differences(found, one)}} for one in chosen}, indent=1))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
