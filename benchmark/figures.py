"""All figures of one run on one machine, on one page: docs/figures.md.

`--run DIR` runs every benchmark and leaves its JSON in DIR/<name>.json, with date, machine,
versions and commands in DIR/run.json. Whatever DIR has of this machine and these versions stays:
`--only` adds a question, or asks it again. `--quick` runs a few of each, a minute at most: enough
to see that all of them run, too few to compare by. `--read DIR` makes the page of such a folder.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
import json
import os
from pathlib import Path
import shlex
import subprocess
import sys
import time
from typing import Any

from rich.console import Console

from benchmark.figure_questions import Figure, LESS, Question, QUESTIONS
from benchmark.peers import missing, PEERS
from benchmark.speed import versions
from redundant_planner import __version__
from redundant_planner.io.resources import panda_urdf

TOP = Path(__file__).resolve().parent.parent
PAGE = TOP / 'docs' / 'figures.md'
# The run that docs/figures.md shows.
FOLDER = TOP / 'benchmark' / 'figures'
RUN = 'run.json'
# After this time a quick command is given up [s].
_PATIENCE = 300.0
# A peer that is better by less is as good.
_AS_GOOD = 0.01
# Lines of prose on the page are no longer.
_WIDE = 100


class FiguresError(Exception):
    """A folder has no such figures."""


def run(folder: Path, questions: Sequence[Question], console: Console, *, quick: bool) -> int:
    """Run the benchmarks, and write what they found; return how many failed.

    Args:
        folder: for the JSON files, made if it is not there.
        questions: to answer.
        console: to say how far it is.
        quick: whether a few of each are enough.
    """
    folder.mkdir(parents=True, exist_ok=True)
    peers = [name for name in PEERS if not missing(name)]
    about = _begun(folder, quick=quick)
    for question in questions:
        command, began = question.command(peers, quick=quick), time.monotonic()
        console.print(f'{question.name}: {said(command)}', highlight=False)
        file = folder / f'{question.name}.json'
        file.unlink(missing_ok=True)
        try:
            done = subprocess.run(
                [sys.executable, *command, '--json', str(file)], cwd=TOP, capture_output=True,
                text=True, check=False, timeout=_PATIENCE if quick else None)
            failure = '' if done.returncode == 0 and file.is_file() else (
                done.stderr.strip() or 'no word').splitlines()[-1]
        except subprocess.TimeoutExpired:
            failure = f'not done after {_PATIENCE:g} s'
        about['commands'][question.name] = said(command)
        about['seconds'][question.name] = round(time.monotonic() - began, 1)
        about['failed'].pop(question.name, None)
        if failure:
            about['failed'][question.name] = failure
            console.print(f'[red]{question.name} failed:[/red] {failure}', highlight=False)
        (folder / RUN).write_text(json.dumps(about, indent=1) + '\n', encoding='utf-8')
    return len(about['failed'])


def _begun(folder: Path, *, quick: bool) -> dict[str, Any]:
    """Return what a run says of itself: the folder's, if this one goes on with it."""
    about: dict[str, Any] = {
        'date': datetime.now(timezone.utc).strftime('%Y-%m-%d'), 'quick': quick,
        'machine': _machine(), 'versions': {'redundant_planner': __version__, **versions()}}
    try:
        before = _read(folder / RUN)
    except FiguresError:
        before = {}
    if all(before.get(key) == about[key] for key in ('quick', 'machine', 'versions')):
        return {**before, 'date': about['date']}
    return {**about, 'commands': {}, 'seconds': {}, 'failed': {}}


def said(command: Sequence[str]) -> str:
    """Return a command as one types it."""
    return 'python ' + shlex.join(command)


def _machine() -> str:
    """Return which processor this is, and how many cores it has."""
    name = ''
    try:
        lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines()
        name = next((line.partition(':')[2].strip() for line in lines
                     if line.startswith('model name')), '')
    except OSError:  # no Linux
        pass
    return f'{name or "unknown processor"}, {os.cpu_count()} cores'


def page_of(folder: Path) -> str:
    """Return the page of a folder's figures.

    Raises:
        FiguresError: it has none, or one cannot be read.
    """
    about = _read(folder / RUN)
    parts = [_head(about)]
    for question in QUESTIONS:
        if question.name not in about['commands']:
            continue
        parts.append(f'## {question.title}\n\n    {about["commands"][question.name]}\n')
        if question.name in about['failed']:
            parts.append(f'It failed: {about["failed"][question.name]}.\n')
            continue
        try:
            figures = question.figures(_read(folder / f'{question.name}.json'))
        except (KeyError, TypeError, AttributeError) as error:
            raise FiguresError(f"'{folder / question.name}.json' is not what {question.module} "
                               f'writes now: {error!r}') from None
        parts.append(table_of(figures) + (f'\n{_filled(question.remark)}\n'
                                          if question.remark else ''))
    return '\n'.join(parts)


def _read(file: Path) -> Any:
    try:
        return json.loads(file.read_text(encoding='utf-8'))
    except (OSError, ValueError) as error:
        raise FiguresError(f"'{file}' is no figure: {error}; python -m benchmark.figures --run "
                           f"'{file.parent}' makes all of them") from None


def _head(about: Mapping[str, Any]) -> str:
    version = ', '.join(f'{name} {number}' for name, number in about['versions'].items()
                        if number and name != 'machine')
    quick = ('These are quick runs, a few of each, as the commands say: enough to show that all '
             'of it runs, too few to compare by. The figures of whole runs are in '
             '[benchmarks.md](benchmarks.md) and [from_mink.md](from_mink.md).\n'
             if about['quick'] else '')
    prose = (f'All figures on this page are of one run on one machine: {about["machine"]}, '
             f'{about["date"]}. {quick}', f'Versions: {version}.',
             'A table answers a question. What another library does better stands first in it, '
             'and the best of a row is bold. [benchmarks.md](benchmarks.md) says how each of '
             'them runs. `python -m benchmark.figures` makes the page.')
    kind = ' (quick run)' if about['quick'] else ''
    return f'# Figures of one run{kind}\n\n' + '\n'.join(
        _filled(' '.join(part.split())) + '\n' for part in prose)


def _filled(text: str) -> str:
    """Return a paragraph in lines that are not too long; links stay whole."""
    lines = ['']
    for word in text.split():
        if len(lines[-1]) + len(word) + 1 > _WIDE:
            lines.append('')
        lines[-1] += f'{" " if lines[-1] else ""}{word}'
    return '\n'.join(lines)


def table_of(figures: Sequence[Figure]) -> str:
    """Return figures as a table: a column for each method, and first what peers do better."""
    columns = list(dict.fromkeys(name for figure in figures for name in figure.values))
    ordered = sorted(figures, key=lambda figure: not peers_are_better(figure))
    rows = [f'| | {" | ".join(name if name in PEERS else _own(name) for name in columns)} |',
            f'|---{"|---" * len(columns)}|']
    for figure in ordered:
        texts = {name: number(value) for name, value in figure.values.items() if value == value}
        best = _best(figure, list(texts))
        # Where all are alike nobody is better.
        bold = '' if best is None or len(set(texts.values())) < 2 else number(best)
        rows.append(f'| {figure.title} | ' + ' | '.join(
            f'**{texts[name]}**' if texts.get(name, '') == bold != '' else texts.get(name, '')
            for name in columns) + ' |')
    return '\n'.join(rows) + '\n'


def _own(name: str) -> str:
    """Return a column's title; methods of this package are parameters' values."""
    return f'`{name}`' if '_' in name or name == 'variational' else name


def number(value: float) -> str:
    """Return a number with three digits that count; what is less than a millionth is none."""
    value = 0.0 if abs(value) < 1e-6 else value
    if value == round(value) and abs(value) < 1e5:
        return f'{value:.0f}'
    return f'{value:.3g}' if 1e-3 <= abs(value) < 1e3 else (
        f'{value:.0f}' if abs(value) >= 1e3 else f'{value:.0e}')


def peers_are_better(figure: Figure) -> bool:
    """Return whether another library's figure is better than all of this package's."""
    peers = _best(figure, [name for name in figure.values if name in PEERS])
    own = _best(figure, [name for name in figure.values if name not in PEERS])
    if peers is None or own is None:
        return False
    gain = own - peers if figure.better == LESS else peers - own
    return gain > _AS_GOOD * max(abs(own), abs(peers))


def _best(figure: Figure, names: Sequence[str]) -> float | None:
    values = [figure.values[name] for name in names
              if figure.values[name] == figure.values[name]]  # no NaN
    if not values or not figure.better:
        return None
    return min(values) if figure.better == LESS else max(values)


def main(args: list[str] | None = None) -> int:
    """Run the benchmarks, or make the page; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='benchmark.figures', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--run', type=Path, metavar='DIR', help='run all, and leave the JSON here')
    parser.add_argument('--quick', action='store_true', help='with --run: a few of each')
    parser.add_argument('--only', action='append', default=[], metavar='NAME',
                        choices=[question.name for question in QUESTIONS],
                        help='with --run: this question; may be given more than once')
    parser.add_argument('--read', type=Path, metavar='DIR', help='make the page of these figures')
    parser.add_argument('--out', type=Path, default=PAGE, metavar='FILE',
                        help='the page (default: docs/figures.md)')
    options = parser.parse_args(args)
    if options.run is None and options.read is None:
        parser.error('give --run, --read or both')
    console, failed = Console(stderr=True), 0
    if options.run is not None and panda_urdf() is None:
        # The processes of a benchmark that has none would be started again and again.
        print('benchmark.figures: no Panda URDF: pip install example-robot-data', file=sys.stderr)
        return 2
    if options.run is not None:
        failed = run(options.run, [question for question in QUESTIONS
                                   if question.name in options.only or not options.only],
                     console, quick=options.quick)
    if options.read is not None:
        try:
            options.out.write_text(page_of(options.read), encoding='utf-8')
        except (FiguresError, OSError) as error:
            print(f'benchmark.figures: {error}', file=sys.stderr)
            return 2
        console.print(f'page: {options.out}')
    return 1 if failed else 0


if __name__ == '__main__':
    raise SystemExit(main())
