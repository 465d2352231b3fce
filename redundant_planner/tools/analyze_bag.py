"""analyze_bag: what happened in a recorded motion, and how two of them compare."""

from __future__ import annotations

import argparse
import csv
from dataclasses import asdict
from functools import partial
import json
from pathlib import Path
import sys
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, TaskID
from rich.table import Table

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.measure_tables import (
    as_text,
    COMPARED,
    MEASURES,
    motion_measures,
    PEAKS,
    reductions,
    telling,
)
from redundant_planner.analysis.results import Analysis
from redundant_planner.core.errors import PlannerError
from redundant_planner.io.printable import printable

# A narrower terminal wraps lines rather than cut numbers off.
_WIDTH = 140


def joint_table(analysis: Analysis) -> Table:
    """Return the measures of every joint."""
    table = Table(title=f"'{analysis.name}': {analysis.end - analysis.begin:.2f} s, "
                        f'{analysis.samples} joint states')
    table.add_column('joint')
    measures = telling(analysis.joints)
    for key in measures:
        table.add_column(MEASURES[key], justify='right')
    robot, commanded = analysis.robot, analysis.commanded
    if commanded is not None:
        for title, _ in PEAKS.values():
            table.add_column(title, justify='right')
    for i, name in enumerate(analysis.joint_names):
        cells = [f'{getattr(analysis.joints, key)[i]:.5g}' for key in measures]
        for key, (_, limit) in PEAKS.items() if commanded is not None else ():
            cells.append(f'{getattr(commanded, key)[i]:.5g}')
            if robot is not None:
                cells[-1] += f' / {getattr(robot, limit)[i]:.3g}'
        table.add_row(name, *cells)
    return table


def motion_table(analyses: list[Analysis]) -> Table:
    """Return the measures of whole motions, one column each."""
    table = Table(show_header=len(analyses) > 1)
    table.add_column('')
    for analysis in analyses:
        table.add_column(analysis.name, justify='right')
    columns = [motion_measures(analysis) for analysis in analyses]
    for key in columns[0]:
        table.add_row(key.replace('_', ' '), *(as_text(column[key]) for column in columns))
    return table


def comparison_table(base: Analysis, improved: Analysis) -> Table:
    """Return by how much every measure of every joint became smaller, as in Table 1.

    Raises:
        PlannerError: the bags have different joints.
    """
    if set(base.joint_names) != set(improved.joint_names):
        raise PlannerError(f"'{base.name}' and '{improved.name}' have different joints: "
                           f'{list(base.joint_names)}, {list(improved.joint_names)}')
    table = Table(title=f"reductions (%) of '{improved.name}' against '{base.name}'")
    table.add_column('joint')
    compared = [key for key in COMPARED if key in telling(base.joints)]
    for key in compared:
        table.add_column(MEASURES[key], justify='right')
    for name, row in reductions(base, improved).items():
        table.add_row(name, *('–' if np.isnan(row[key]) else f'{row[key]:.1f}'
                              for key in compared))
    return table


def as_json(analysis: Analysis) -> dict[str, Any]:
    """Return an analysis as it stands in the JSON file."""
    robot = analysis.robot
    joints: dict[str, dict[str, float | None]] = {}
    for i, name in enumerate(analysis.joint_names):
        joints[name] = {key: float(value[i]) for key, value in asdict(analysis.joints).items()}
        if robot is not None:
            joints[name] |= {'velocity_limit': float(robot.velocity_max[i]),
                             'acceleration_limit': float(robot.acceleration_max[i]),
                             'jerk_limit': (float(robot.jerk_max[i])
                                            if np.isfinite(robot.jerk_max[i]) else None)}
        if analysis.commanded is not None:
            joints[name] |= {f'commanded_peak_{key}': float(getattr(analysis.commanded, key)[i])
                             for key in PEAKS}
    return {'bag': analysis.name, 'begin': analysis.begin, 'end': analysis.end,
            'samples': analysis.samples, 'joints': joints, 'motion': motion_measures(analysis),
            'notes': list(analysis.notes)}


def write_csv(path: Path, analysis: Analysis) -> None:
    """Write the curves, one row per sample."""
    curves, names = analysis.curves, analysis.joint_names
    head = ['time', *(f'{kind}.{name}' for kind in ('position', 'velocity', 'acceleration')
                      for name in names),
            'distance', 'scale', 'path_error', 'tip.x', 'tip.y', 'tip.z']
    told = curves.commanded or ()
    head += [f'commanded_{kind}.{name}'
             for kind, _ in zip(('velocity', 'acceleration'), told) for name in names]
    rows = np.column_stack((
        curves.times, curves.positions, curves.velocities, curves.accelerations,
        curves.clearance, curves.scale, curves.path_error, curves.tips, *told))
    with path.open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows(rows.tolist())


def _show(bar: Progress, task: TaskID, share: float) -> None:
    bar.update(task, completed=share)


def main(args: list[str] | None = None) -> int:
    """Run analyze_bag; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='analyze_bag', description=__doc__)
    parser.add_argument('bags', nargs='+', type=Path, metavar='BAG')
    parser.add_argument('--urdf', default='', help='URDF of the arm, where the bag has none')
    parser.add_argument('--params', type=Path, help='parameter file of the arm')
    parser.add_argument('--tip', default='', help="end effector's link, with a URDF alone")
    parser.add_argument('--namespace', default='', help='of the topics, where there are several')
    parser.add_argument('--begin', type=float, default=0.0, metavar='SECONDS')
    parser.add_argument('--end', type=float, default=np.inf, metavar='SECONDS')
    parser.add_argument('--json', type=Path, metavar='FILE', help='write all measures')
    parser.add_argument('--csv', type=Path, metavar='FILE', help='write the curves (one bag)')
    parser.add_argument('--report', type=Path, metavar='DIR',
                        help='write an HTML page with curves and a 3-D view, and figures')
    options = parser.parse_args(args)
    # Names in a bag are no markup.
    console = Console(markup=False, emoji=False)
    console.width = max(console.width, _WIDTH)
    try:
        if options.params is not None and not options.params.is_file():
            raise PlannerError(f"'{options.params}' is not a file")
        if not options.begin < options.end:
            raise PlannerError(f'--begin {options.begin:g} must lie before --end {options.end:g}')
        analyses = []
        for bag in options.bags:
            with Progress(console=Console(stderr=True), transient=True,
                          disable=not sys.stderr.isatty()) as bar:
                task = bar.add_task(f"reading '{escape(bag.name)}'", total=1.0)
                analyses.append(analyse(
                    bag, params=options.params, urdf=options.urdf, tip=options.tip,
                    namespace=options.namespace, begin=options.begin, end=options.end,
                    progress=partial(_show, bar, task)))
        for analysis in analyses:
            console.print(joint_table(analysis))
        console.print(motion_table(analyses))
        for other in analyses[1:]:
            console.print(comparison_table(analyses[0], other))
        for analysis in analyses:
            for note in analysis.notes:
                console.print(f"'{analysis.name}': {note}", style='yellow', highlight=False)
        if options.json is not None:
            content: dict[str, Any] = {'bags': [as_json(analysis) for analysis in analyses]}
            if len(analyses) > 1:
                content['reductions'] = {
                    other.name: reductions(analyses[0], other) for other in analyses[1:]}
            options.json.write_text(json.dumps(content, indent=1), encoding='utf-8')
        if options.csv is not None:
            write_csv(options.csv, analyses[0])
        if options.report is not None:
            from redundant_planner.analysis.report import write_report
            console.print(f'report: {write_report(options.report, analyses)}')
    except (PlannerError, OSError) as error:
        print(f'analyze_bag: {printable(str(error))}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('analyze_bag: interrupted', file=sys.stderr)
        return 130
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
