"""reproduce_paper: Table 1, the figures and the percentages of the 2015 paper, beside ours."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
import json
from pathlib import Path
import sys
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from redundant_planner.analysis.figures import joint_curves, three_views
from redundant_planner.core.errors import PlannerError
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.resources import panda_urdf, resolve, share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.io.scenario import Scenario
from redundant_planner.paper import experiment

_STYLES = {'dynamic_factor': '-', 'gradient_projection': '--', 'corrected': ':'}
_TITLES = {
    'gradient_projection': 'traditional', 'dynamic_factor': "the paper's",
    'corrected': 'corrected', 'gradient_projection_links': 'traditional, links clear',
}


def find_panda(given: str | None) -> Robot | None:
    """Return the Panda of config/, on the given URDF or the first that this machine has."""
    path = resolve(given) if given else panda_urdf()
    if path is None:
        return None
    return load_robot(share_directory() / 'config' / 'robots' / 'panda.yaml', urdf=str(path))


def summary(
    scenario: Scenario, robot: Robot, runs: Mapping[str, experiment.Run], panda: Robot | None,
) -> dict[str, Any]:
    """Return everything that is printed, as plain numbers under names."""
    result: dict[str, Any] = {}
    for name, run in runs.items():
        result[name] = {
            'final': dict(zip(experiment.JOINTS, run.final.tolist())),
            **{field: dict(zip(experiment.JOINTS, getattr(run, field).tolist())) for field in (
                'displacement', 'path', 'initial_velocity', 'velocity_change',
                'acceleration_change')},
            'path_total': float(run.path.sum()), 'effort': run.effort,
            's_min_joints': run.s_min_joints, 's_min_links': run.s_min_links,
            'tracking_error': run.tracking_error, 'end_error': run.end_error}
    result['table1_max_error'] = {
        name: float(np.abs(runs[name].final - column).max())
        for name, column in experiment.TABLE_1.items()}
    base = runs['gradient_projection']
    tips = {'start': (base.start, experiment.PRINTED_START)} | {
        name: (column, experiment.PRINTED_END) for name, column in experiment.TABLE_1.items()}
    result['printed_position_error'] = {
        name: float(np.abs(robot.kinematics([*q, 0.0]).tip_position - printed).max())
        for name, (q, printed) in tips.items()}
    result['reductions'] = {
        'printed': experiment.PRINTED_REDUCTIONS,
        'from_table_1': experiment.printed_reductions(base.start),
        'dynamic_factor': experiment.reductions(base, runs['dynamic_factor']),
        'corrected': experiment.reductions(base, runs['corrected']),
        'corrected_vs_gradient_projection_links': experiment.reductions(
            runs['gradient_projection_links'], runs['corrected'])}
    robots = {'paper': robot} | ({'panda': panda} if panda else {})
    result['eq17'] = experiment.equation_17_report(robots)
    return result


def print_summary(
    console: Console, runs: Mapping[str, experiment.Run], result: dict[str, Any],
) -> None:
    """Print the tables."""
    console.print(_joint_table(
        'Table 1: final positions (m, rad)', runs, 'final', experiment.TABLE_1))
    console.print(_joint_table('Displacement |end − start| (m, rad)', runs, 'displacement', {}))
    console.print(_joint_table('Path Σ|Δq|, Eq. 10 (m, rad)', runs, 'path', {}))

    table = _table('The motion', 'measure', runs)
    for label, field in (
            ('path, all joints', 'path_total'), ('∫q̇ᵀq̇ dt, Eq. 11', 'effort'),
            ('smallest S over joints, Eq. 7', 's_min_joints'),
            ('smallest S over whole links', 's_min_links')):
        table.add_row(label, *(f'{result[name][field]:.5f}' for name in runs))
    for label, field in (('off the line (mm)', 'tracking_error'), ('end off (mm)', 'end_error')):
        table.add_row(label, *(f'{1e3 * result[name][field]:.4f}' for name in runs))
    console.print(table)

    columns = {'printed': 'paper', 'from_table_1': 'its Table 1', 'dynamic_factor': "paper's",
               'corrected': 'corrected',
               'corrected_vs_gradient_projection_links': 'corrected / links clear'}
    table = Table(title='Reductions against the traditional method (%)')
    table.add_column('measure')
    for column in columns.values():
        table.add_column(column, justify='right')
    reductions = result['reductions']
    for label, key in (
            ('displacement', 'displacement'), ('initial velocity', 'initial_velocity'),
            ('velocity change', 'velocity_change'),
            ('acceleration change', 'acceleration_change')):
        for i, joint in enumerate(experiment.JOINTS):
            table.add_row(f'{label} {joint}', *(
                _percent(reductions[c][key][i]) if key in reductions[c] else ''
                for c in columns), end_section=i == len(experiment.JOINTS) - 1)
    for label, key in (
            ('prismatic, signed sum', 'prismatic_signed'),
            ('prismatic, displacements', 'prismatic'), ('prismatic, paths', 'prismatic_path'),
            ('revolute, displacements', 'revolute'), ('revolute, paths', 'revolute_path'),
            ('∫q̇ᵀq̇ dt', 'effort')):
        table.add_row(label, *(_percent(reductions[c].get(key)) for c in columns))
    console.print(table)

    table = Table(title='Eq. 17 as printed, worst of 20 postures')
    for heading in ('robot', 'reading', '‖P∇H_f‖ / ‖J⁺ẋ‖', 'rank', 'axes', 'condition number'):
        table.add_column(heading)
    for name, report in result['eq17'].items():
        for reading, suffix in (('by every joint', ''), ('along the motion', '_along_motion')):
            table.add_row(
                name, reading, f'{report["projected_norm" + suffix]:.1e}',
                str(report['rank' + suffix]), str(report['axes']),
                f'{report["condition_number" + suffix]:.0e}')
    console.print(table)
    errors = result['table1_max_error']
    console.print(
        'Table 1 is met within '
        + ' and '.join(f'{error:.4f} ({_TITLES[name]})' for name, error in errors.items())
        + '; the printed positions within '
        f'{1e3 * max(result["printed_position_error"].values()):.2f} mm.')


def _table(title: str, first: str, names: Sequence[str] | Mapping[str, Any]) -> Table:
    table = Table(title=title)
    table.add_column(first)
    for name in names:
        table.add_column(_TITLES[name], justify='right')
    return table


def _joint_table(
    title: str, runs: Mapping[str, experiment.Run], field: str, printed: Mapping[str, Any],
) -> Table:
    table = _table(title, 'joint', runs)
    for name in printed:
        table.add_column(f'printed, {_TITLES[name]}', justify='right', style='dim')
    for i, joint in enumerate(experiment.JOINTS):
        table.add_row(joint, *(f'{getattr(run, field)[i]:.4f}' for run in runs.values()),
                      *(f'{column[i]:.4f}' for column in printed.values()))
    return table


def _percent(value: float | None) -> str:
    return '' if value is None else f'{value:.1f}'


def write_figures(
    folder: Path, scenario: Scenario, robot: Robot, runs: Mapping[str, experiment.Run],
) -> list[Path]:
    """Write Figs. 4 to 8 and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, name in (('4', 'gradient_projection'), ('5', 'dynamic_factor'),
                         ('5_corrected', 'corrected')):
        paths.append(folder / f'figure_{number}.png')
        three_views(paths[-1], robot, runs[name].motion.positions, scenario.obstacles,
                    f'Fig. {number[0]}: {_TITLES[name]}')
    columns = [robot.joint_names.index(name) for name in experiment.JOINTS]

    def curves(values: Any) -> dict[str, tuple[str, Any, Any]]:
        shown = {}
        for name, style in _STYLES.items():
            data = values(runs[name])[:, columns]
            shown[_TITLES[name]] = (style, runs[name].motion.times[:len(data)], data)
        return shown

    for figure, what, label, values in (
            (6, 'displacement', 'displacement [m, rad]',
             lambda run: run.motion.positions - run.motion.positions[0]),
            (7, 'velocity', 'velocity [m/s, rad/s]', lambda run: run.motion.velocities),
            (8, 'acceleration', 'acceleration [m/s², rad/s²]',
             lambda run: np.diff(run.motion.velocities, axis=0) / experiment.TICK)):
        paths.append(folder / f'figure_{figure}.png')
        joint_curves(paths[-1], experiment.JOINTS, label, curves(values), f'Fig. {figure}: {what}')
    return paths


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


def main(args: list[str] | None = None) -> int:
    """Reproduce the paper; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='reproduce_paper', description=__doc__)
    parser.add_argument('--json', type=Path, metavar='PATH', help='write all numbers to a file')
    parser.add_argument('--out', type=Path, metavar='DIR', help='write Figs. 4 to 8 to a folder')
    parser.add_argument('--fit', action='store_true',
                        help='repeat the fit of the gains to Table 1 and print them')
    parser.add_argument('--panda-urdf', metavar='URDF',
                        help="Panda for the table on Eq. 17, if it isn't found by itself")
    options = parser.parse_args(args)
    console = Console()
    try:
        scenario = experiment.paper_scenario()
        robot = experiment.paper_robot(scenario)
        panda = find_panda(options.panda_urdf)
        runs = {name: experiment.run(scenario, robot, parameters)
                for name, parameters in experiment.methods().items()}
        result = summary(scenario, robot, runs, panda)
        if options.fit:
            result['fit'] = experiment.fit_table_1()
        print_summary(console, runs, result)
        if panda is None:
            console.print('No Panda URDF on this machine: its rows of Eq. 17 are left out '
                          '(--panda-urdf).')
        if options.fit:
            console.print('fitted: ' + ', '.join(
                f'{name} = {value:.6g}' for name, value in result['fit'].items()))
        if options.json:
            options.json.parent.mkdir(parents=True, exist_ok=True)
            options.json.write_text(json.dumps(_plain(result), indent=2) + '\n')
        if options.out:
            for path in write_figures(options.out, scenario, robot, runs):
                console.print(f'figure: {path}')
    except (PlannerError, OSError) as error:
        print(f'reproduce_paper: {error}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
