"""How much longer than the shortest: `python -m benchmark.optimality --help`."""

from __future__ import annotations

import json
from multiprocessing import Pool
from typing import Any

import numpy as np
from rich.progress import track

from benchmark import scenarios
from benchmark.generator import path_poses
from benchmark.scenarios import DT, Outcome, parser_of, prepare, print_table
from redundant_planner.core.parameters import PlannerParameters

METHODS = ('dynamic_factor', 'least_norm_filtered', 'variational_held', 'variational_known')


def _run(seed: int) -> tuple[dict[str, Outcome], float | None]:
    """Return what the methods came to and the optimum's ∫ q̇ᵀq̇ dt, None if none was found."""
    from benchmark.optimum import Optimum
    bench = scenarios.bench
    outcomes = bench(seed)
    completed = [o.postures for o in outcomes.values() if o.tracked]
    robot, task = bench.robot, bench.task(seed)
    best = Optimum(robot, task.start, path_poses(robot, task, DT), DT, task.obstacles,
                   PlannerParameters().clearance_margin).best(
                       completed if task.way is None else [*completed, task.way])
    return outcomes, None if best is None else best[0]


def summarise(found: list[tuple[dict[str, Outcome], float | None]], name: str) -> dict[str, Any]:
    """Return the JSON entry of one method: over the tasks that it completed."""
    ratios = {outcomes[name].task: outcomes[name].verdict.cost / optimum
              for outcomes, optimum in found
              if optimum is not None and outcomes[name].tracked}
    values = list(ratios.values())
    return {
        'median_ratio': float(np.median(values)) if values else np.nan,
        'p90_ratio': float(np.percentile(values, 90)) if values else np.nan,
        'completed': float(np.mean([outcomes[name].tracked for outcomes, _ in found])),
        'solvable': float(np.mean([optimum is not None for _, optimum in found])),
        'ratios': ratios,
    }


def main() -> None:
    """Run the benchmark."""
    options = parser_of(__doc__).parse_args()
    names = list(METHODS)
    seeds = range(options.seed, options.seed + options.count)
    with Pool(options.jobs, prepare, (
            options.robot, options.axes, names, False, options.impossible_too)) as pool:
        found = list(track(pool.imap(_run, seeds), 'scenarios', total=options.count))
    result = {name: summarise(found, name) for name in names}
    # The name that others look for: nobody runs the least-norm motion without a filter.
    result['least_norm'] = result.pop('least_norm_filtered')
    print_table(f'∫ q̇ᵀq̇ dt over the optimum: {options.robot}, {options.axes} axes, '
                f'{options.count} scenarios from seed {options.seed}', result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + '\n')


if __name__ == '__main__':
    main()
