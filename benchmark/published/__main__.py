"""Scenes that others published: `python -m benchmark.published NAME DIR --json FILE`.

    python -m benchmark.published oscbf ~/oscbf --count 10
    python -m benchmark.published planner_bench ~/localPlannerBench --method variational
    python -m benchmark.published neo ~/robotics-toolbox-python
    python -m benchmark.published collision_ik ~/collision_ik_ros

DIR is a checkout of the set's repository. Its Python files are read, not run. All methods get the
same twist at every tick, or the pose where it leads, and coal judges the capsules at every tick.
"""

from __future__ import annotations

import argparse
from collections import Counter
import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from benchmark.peers import installed, missing, PEERS
from benchmark.published.readers import SETS
from benchmark.published.run import METHODS, Runner, summarise
from benchmark.published.scene import PublishedError, Scene
from benchmark.scenarios import print_table


def _options(args: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='benchmark.published', description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('name', choices=list(SETS), metavar='NAME', help=', '.join(SETS))
    parser.add_argument('folder', type=Path, metavar='DIR')
    parser.add_argument('--count', type=int, default=10, metavar='N',
                        help='targets, further cases or paths: see the docs')
    parser.add_argument('--margin', type=float, default=0.01, metavar='M',
                        help='that everybody keeps from obstacles [m]')
    parser.add_argument('--method', action='append', choices=[*METHODS, *PEERS],
                        help='may be given more than once; all that are installed if not given')
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    if options.count < 1:
        parser.error(f'--count is {options.count}; it takes 1 or more')
    return options


def run(scenes: list[Scene], methods: list[str], margin: float) -> dict[str, Any]:
    """Run all methods on all scenes that can be begun; return the JSON.

    Raises:
        PublishedError: none can be.
    """
    runner = Runner(margin)
    faults = {scene.name: runner.fault(scene) for scene in scenes}
    kept = [scene for scene in scenes if not faults[scene.name]]
    why = Counter(fault for fault in faults.values() if fault)
    if not kept:
        raise PublishedError(f'no scene is left of {len(scenes)}: {dict(why)}')
    console = Console(stderr=True)
    return {method: summarise(
        [runner.run(scene, method) for scene in track(kept, method, console=console)],
        len(scenes) - len(kept)) for method in methods}


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    options = _options(args)
    methods = options.method or [*METHODS, *installed()]
    try:
        for method in methods:
            lack = missing(method) if method in PEERS else ''
            if lack:
                raise PublishedError(lack)
        scenes = SETS[options.name].read(options.folder, options.count)
        result = run(scenes, methods, options.margin)
    except PublishedError as error:
        Console(width=220).print(f'[red]error:[/red] {error}', soft_wrap=True, highlight=False)
        return 2
    print_table(f'{options.name}: {len(scenes)} scenes', result)
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=2) + '\n')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
