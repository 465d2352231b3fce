"""Goals among tables, shelves and cages: `python -m benchmark.problem_sets --help`.

MotionBenchMaker's problems for the Panda, from a folder with scenes and requests in MoveIt's
YAML, or problems made from a seed. Every method servoes to the goal's pose along a straight line,
for 30 s at most. With --command target_pose this package's methods find their own way instead.
coal judges every tick with the exact shapes and the collision meshes.

    python -m benchmark.problem_sets problems --family table_pick --count 20
    python -m benchmark.problem_sets --generated --seed 7 --explain --json generated.json
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from functools import partial
import json
from multiprocessing import Pool
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from benchmark.peers import missing
from benchmark.problem_sets.families import FAMILIES
from benchmark.problem_sets.judgement import Outcome, summarise
from benchmark.problem_sets.moveit_files import find_files, ProblemFileError
from benchmark.problem_sets.workers import (
    Job,
    METHODS,
    PEERS,
    prepare,
    Result,
    ROBOPLAN_RRT,
    run_job,
    Task,
    Worker,
)
from benchmark.scenarios import print_table

DEFAULT_METHODS = ('dynamic_factor', 'variational')


def _options(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='benchmark.problem_sets', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('folder', nargs='?', type=Path, metavar='DIR',
                        help='with folders of scene*.yaml and request*.yaml, one for each family')
    parser.add_argument('--generated', action='store_true',
                        help='problems made from a seed instead: ' + ', '.join(FAMILIES))
    parser.add_argument('--seed', type=int, default=0, help='of the generated problems')
    parser.add_argument('--family', action='append', default=[], metavar='NAME',
                        help='may be given more than once; all if not given')
    parser.add_argument('--count', type=int, metavar='N',
                        help='problems of each family at most; 100 generated ones if not given')
    parser.add_argument('--method', action='append', choices=[*METHODS, *PEERS],
                        help='may be given more than once; dynamic_factor, variational and, '
                        'where they are installed, mink and pink if not given')
    parser.add_argument('--margin', type=float, default=0.01, metavar='M',
                        help='that everybody keeps from obstacles [m]')
    parser.add_argument('--command', choices=('twist', 'target_pose'), default='twist',
                        help='what this package gets: twists along the line, as everybody, or '
                        'the goal itself')
    parser.add_argument('--optimum', action='store_true',
                        help='compare every way with the shortest one near it (CasADi)')
    parser.add_argument('--toppra', action='store_true',
                        help='compare the time of every motion with the shortest on the same '
                        'path (TOPP-RA, jerk not limited)')
    parser.add_argument('--again', action='store_true',
                        help='with --command target_pose: once the arm has gone there and back')
    parser.add_argument('--roboplan', action='store_true',
                        help="besides, RoboPlan's RRT-Connect, shortcuts and TOPP-RA, which get "
                        "the goal's posture")
    parser.add_argument('--explain', action='store_true',
                        help='plan what was not reached without the line as well')
    parser.add_argument('--jobs', type=int, default=1,
                        help='processes; more than one and the tick times disturb each other')
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    if (options.folder is None) != options.generated:
        parser.error('give either a folder or --generated')
    if options.again and options.command != 'target_pose':
        parser.error('--again takes --command target_pose')
    if options.count is not None and options.count < 1:
        parser.error(f'--count is {options.count}; it takes 1 or more')
    return options


def _jobs(options: argparse.Namespace) -> list[Job]:
    """Return what identifies the problems: files, or a seed, family and number."""
    if options.generated:
        for family in options.family:
            if family not in FAMILIES:
                raise ProblemFileError(f"there is no family '{family}' to generate; there are "
                                       + ', '.join(FAMILIES))
        return [(options.seed, family, i) for family in options.family or FAMILIES
                for i in range(options.count or 100)]
    found: list[Job] = []
    taken: Counter[str] = Counter()
    for files in find_files(options.folder, options.family):
        taken[files[0]] += 1
        if options.count is None or taken[files[0]] <= options.count:
            found.append(files)
    return found


def run(
    jobs: Sequence[Job], task: Task, processes: int,
) -> dict[str, Any]:
    """Run all methods on all problems; return the JSON."""
    results: list[Result] = []
    bar = partial(track, description='problems', total=len(jobs), console=Console(stderr=True))
    if processes == 1:
        results += bar(map(Worker(task), jobs))
    else:
        with Pool(processes, prepare, (task,)) as pool:
            results += bar(pool.imap(run_job, jobs))
    left_out = Counter(result.fault for result in results if result.fault)
    kept = [result for result in results if not result.fault]
    if not kept:
        raise ProblemFileError(f'no problem is left of {len(jobs)}: {dict(left_out)}')
    entries = {}
    for method in task.methods:
        outcomes: list[Outcome] = [result.outcomes[method] for result in kept]
        entries[method] = summarise(outcomes, left_out)
        if task.explain:
            entries[method].update(_explained(outcomes, kept))
    return entries


def _explained(outcomes: Sequence[Outcome], kept: Sequence[Result]) -> dict[str, float | None]:
    """Return why the stopped stopped: shares of them."""
    stopped = [result for outcome, result in zip(outcomes, kept) if not outcome.reached]
    count = len(stopped)
    return {
        'line_fault': sum(bool(r.free_way) for r in stopped) / count if count else None,
        'line_blocked': sum(bool(r.line_blocked) for r in stopped) / count if count else None}


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    options = _options(args)
    console = Console(width=220)
    methods = options.method or list(DEFAULT_METHODS) + [
        name for name in ('mink', 'pink') if not missing(name)]
    if options.roboplan:
        lack = missing('roboplan')
        if lack:
            console.print(f'[red]error:[/red] {lack}', soft_wrap=True, highlight=False)
            return 2
        methods.append(ROBOPLAN_RRT)
    task = Task(tuple(methods), options.margin, options.explain,
                options.command == 'target_pose', options.optimum, options.toppra, options.again)
    try:
        result = run(_jobs(options), task, options.jobs)
    except ProblemFileError as error:
        console.print(f'[red]error:[/red] {error}', soft_wrap=True, highlight=False)
        return 2
    first = result[methods[0]]
    print_table(
        f'{first["count"]} problems, margin {1e3 * options.margin:g} mm; left out: '
        + (', '.join(f'{count} {why}' for why, count in first['left_out'].items()) or 'none'),
        result)
    for name, entry in result.items():
        for one in entry['notable']:
            if name in METHODS:
                console.print(f'{name}: {one}', soft_wrap=True, highlight=False)
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=2) + '\n')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
