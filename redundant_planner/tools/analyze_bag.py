"""analyze_bag: what happened in a recorded motion, and how two of them compare."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
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
from redundant_planner.analysis.joint_units import joint_units, UNKNOWN
from redundant_planner.analysis.measure_tables import (
    as_text,
    chunk_rows,
    CHUNKS,
    COMPARED,
    MEASURES,
    MOTION,
    motion_measures,
    PEAKS,
    reductions,
    telling,
    UNITS,
)
from redundant_planner.analysis.results import Analysis
from redundant_planner.core.errors import PlannerError
from redundant_planner.io.printable import printable

# As wide as a page of text: a narrower terminal wraps lines rather than cut numbers off.
_WIDTH = 100


def joint_table(analysis: Analysis) -> Table:
    """Return the measures of every joint."""
    measures = telling(analysis.joints)
    table = _joints_table(
        f"'{analysis.name}': {analysis.end - analysis.begin:.2f} s, "
        f'{analysis.samples} joint states, as measured', [MEASURES[key] for key in measures])
    _add_joints(table, analysis, [UNITS[key] for key in measures], lambda i: [
        f'{getattr(analysis.joints, key)[i]:.5g}' for key in measures])
    return table


def peak_table(analysis: Analysis) -> Table:
    """Return the largest velocity, acceleration and jerk of every joint, beside its limit."""
    robot, told, joints = analysis.robot, analysis.commanded, analysis.joints
    kinds = ('velocity', 'acceleration') if told is None else tuple(PEAKS)
    peaks = [getattr(joints, f'peak_{kind}') if told is None else getattr(told, kind)
             for kind in kinds]
    limits = [None if robot is None else getattr(robot, PEAKS[kind]) for kind in kinds]
    titles = [f'{kind}{"" if limit is None else " / limit"}'
              for kind, limit in zip(kinds, limits)]
    units = [UNITS[kind] for kind in kinds]
    if told is not None:
        # A measured acceleration would say more of noise than of the motion.
        peaks, limits = [joints.peak_velocity, *peaks], [None, *limits]
        titles, units = ['velocity, measured', *titles], [UNITS['velocity'], *units]
    table = _joints_table(
        f"peaks of '{analysis.name}', {'measured' if told is None else 'as commanded'}", titles)

    def cells(i: int) -> list[str]:
        return [f'{peak[i]:.5g}' + ('' if limit is None else f' / {limit[i]:.4g}')
                for peak, limit in zip(peaks, limits)]

    _add_joints(table, analysis, units, cells)
    return table


def _joints_table(title: str, columns: Sequence[str]) -> Table:
    table = Table(title=title)
    table.add_column('joint', overflow='fold')
    for column in columns:
        table.add_column(column, justify='right', overflow='fold')
    return table


def _add_joints(
    table: Table, analysis: Analysis, units: Sequence[str], cells: Callable[[int], list[str]],
) -> None:
    """Add a row for each joint, those of a unit together and below it."""
    own = joint_units(analysis)
    for unit in dict.fromkeys(own):
        shown = '[rad, m]' if unit == UNKNOWN else unit
        table.add_section()
        table.add_row('', *(one.replace('u', shown) for one in units), style='dim')
        for i in (i for i, one in enumerate(own) if one == unit):
            table.add_row(analysis.joint_names[i], *cells(i))


def motion_table(analyses: list[Analysis]) -> Table:
    """Return the measures of whole motions, one column each."""
    table = Table(show_header=len(analyses) > 1)
    table.add_column('', overflow='fold')
    for analysis in analyses:
        table.add_column(analysis.name, justify='right', overflow='fold')
    table.add_column('unit', overflow='fold')
    columns = [motion_measures(analysis) for analysis in analyses]
    for key, (title, unit, scale) in MOTION.items():
        values = [None if column[key] is None else scale * column[key] for column in columns]
        if any(value is not None for value in values):
            table.add_row(title, *map(as_text, values), unit)
    table.add_row('Nearest pair', *(as_text(column['nearest_pair']) for column in columns), '')
    return table


def chunk_table(analysis: Analysis) -> Table:
    """Return how the arm followed the chunks that it was sent."""
    table = Table(title=f"chunks that '{analysis.name}' was sent")
    for title in CHUNKS:
        table.add_column(title, overflow='fold')
    for row in chunk_rows(analysis):
        table.add_row(*row)
    return table


def comparison_table(base: Analysis, improved: Analysis) -> Table:
    """Return by how much every measure of every joint became smaller, as in Table 1.

    Raises:
        PlannerError: the bags have different joints.
    """
    if set(base.joint_names) != set(improved.joint_names):
        raise PlannerError(f"'{base.name}' and '{improved.name}' have different joints: "
                           f'{list(base.joint_names)}, {list(improved.joint_names)}')
    compared = [key for key in COMPARED if key in telling(base.joints)]
    table = _joints_table(f"reductions (%) of '{improved.name}' against '{base.name}'",
                          [f'{MEASURES[key]} [%]' for key in compared])
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
            'chunks': [asdict(run) | {'planner_said': word} for run, word in analysis.chunks],
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


def _analysed(bag: Path, options: argparse.Namespace) -> Analysis:
    """Measure a bag, with a progress bar in a terminal."""
    with Progress(console=Console(stderr=True), transient=True,
                  disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(f"reading '{escape(bag.name)}'", total=1.0)
        return analyse(
            bag, params=options.params, urdf=options.urdf, tip=options.tip,
            namespace=options.namespace, begin=options.begin, end=options.end,
            progress=partial(_show, bar, task))


def _print(console: Console, analyses: list[Analysis]) -> None:
    """Print the measures of all bags, and what tells the others from the first one."""
    for analysis in analyses:
        console.print(joint_table(analysis))
        console.print(peak_table(analysis))
        if analysis.chunks:
            console.print(chunk_table(analysis))
    console.print(motion_table(analyses))
    for other in analyses[1:]:
        console.print(comparison_table(analyses[0], other))
    for analysis in analyses:
        for note in analysis.notes:
            console.print(f"'{analysis.name}': {note}", style='yellow', highlight=False)


def _write(options: argparse.Namespace, console: Console, analyses: list[Analysis]) -> None:
    """Write the files that the command line asks for."""
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
    console.width = _WIDTH
    try:
        if options.params is not None and not options.params.is_file():
            raise PlannerError(f"'{options.params}' is not a file")
        if not options.begin < options.end:
            raise PlannerError(f'--begin {options.begin:g} must lie before --end {options.end:g}')
        analyses = [_analysed(bag, options) for bag in options.bags]
        _print(console, analyses)
        _write(options, console, analyses)
    except (PlannerError, OSError) as error:
        print(f'analyze_bag: {printable(str(error))}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('analyze_bag: interrupted', file=sys.stderr)
        return 130
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
