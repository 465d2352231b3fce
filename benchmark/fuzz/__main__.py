"""Attacks the package with generated and mutated input, and counts what happens.

    python -m benchmark.fuzz --seed 1 --minutes 10 --json fuzz.json

Every kind of attack gets an equal share of the time. A refusal is the right answer to bad input;
an exception that nobody foresaw, a stall, an output beyond a limit and one that is not finite
are defects, and so is the death of the process that is attacked: another one goes on with the
next attack then. Defects are shown with an account of the first of each sort, and the exit status
is 1. Attack N of a kind depends on the seed alone: `--what KIND --at N` runs it again by itself.
"""

from __future__ import annotations

import argparse
import importlib
from itertools import count
import json
import logging
from pathlib import Path
import time
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from benchmark.fuzz.child import Attack, Child
from benchmark.fuzz.tally import COUNTS, Tally

KINDS = ('core', 'bytes', 'parameters', 'robots', 'files', 'bags', 'clouds')


def attack_of(kind: str) -> Attack:
    """Return the attack of a kind: the function `attack` of its module."""
    attack: Attack = importlib.import_module(f'benchmark.fuzz.attack_{kind}').attack
    return attack


def child_of(kind: str, seed: int) -> Child:
    """Return what runs the attacks of a kind."""
    return Child(attack_of(kind), (seed, KINDS.index(kind)))


def run_for(kinds: list[str], seed: int, minutes: float) -> dict[str, Tally]:
    """Run the kinds one after another, each for its share of the time."""
    tallies = {kind: Tally() for kind in kinds}
    share = 60.0 * minutes / len(kinds)
    # No thread draws it, as this process is forked; what a child writes is the child's.
    with Progress(console=Console(stderr=True), transient=True, auto_refresh=False,
                  redirect_stdout=False, redirect_stderr=False) as bar:
        for kind, tally in tallies.items():
            with child_of(kind, seed) as child:  # importing may compile
                task, begin = bar.add_task(kind, total=share), time.monotonic()
                for number in count():
                    tally.add(child.run(number))
                    elapsed = time.monotonic() - begin
                    bar.update(task, completed=elapsed, refresh=True)
                    if elapsed >= share:
                        break
    return tallies


def as_json(tallies: dict[str, Tally], seed: int) -> dict[str, Any]:
    """Return the sums, and the counts of every kind."""
    def counts(tally: Tally) -> dict[str, int]:
        return {name: getattr(tally, name) for name in COUNTS}

    total = {name: sum(getattr(tally, name) for tally in tallies.values()) for name in COUNTS}
    kinds = {kind: {**counts(tally), 'exceptions': dict(tally.kinds), 'findings': tally.first}
             for kind, tally in tallies.items()}
    return {'seed': seed, **total, 'kinds': kinds}


def main(args: list[str] | None = None) -> int:
    """Run the attacks; return 1 if they found something."""
    parser = argparse.ArgumentParser(
        prog='benchmark.fuzz', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--minutes', type=float, default=1.0)
    parser.add_argument('--what', choices=KINDS, help='one kind of attack (default: all)')
    parser.add_argument('--at', type=int, metavar='N', help='attack N alone, with --what')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args(args)
    logging.disable(logging.CRITICAL)
    kinds = [options.what] if options.what else list(KINDS)
    if options.at is not None:
        if not options.what:
            parser.error('--at takes --what')
        with child_of(options.what, options.seed) as child:
            tallies = {options.what: child.run(options.at)}
    else:
        tallies = run_for(kinds, options.seed, options.minutes)
    content = as_json(tallies, options.seed)
    console = Console(width=120)
    table = Table(title=f'seed {options.seed}')
    table.add_column('attack')
    for name in COUNTS:
        table.add_column(name.replace('_', ' '), justify='right')
    for kind, tally in tallies.items():
        table.add_row(kind, *(str(getattr(tally, name)) for name in COUNTS))
    table.add_row('all', *(str(content[name]) for name in COUNTS))
    console.print(table)
    for kind, tally in tallies.items():
        for what, trace in tally.first.items():
            console.print(f'{kind}, seed {options.seed}: {what}, {trace}',
                          markup=False, highlight=False)
    if options.json is not None:
        options.json.write_text(json.dumps(content, indent=1))
    return 0 if all(tally.clean for tally in tallies.values()) else 1


if __name__ == '__main__':
    raise SystemExit(main())
