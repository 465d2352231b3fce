"""The report's tables: what was run, the joints, the whole motion, and how two bags differ."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.joint_units import joint_units, UNKNOWN
from redundant_planner.analysis.measure_tables import (
    chunk_rows,
    CHUNKS,
    MEASURES,
    MOTION,
    motion_measures,
    PEAKS,
    telling,
    UNITS,
)
from redundant_planner.analysis.motion_interval import motion_interval
from redundant_planner.analysis.report_numbers import difference_text, number_text, share_text
from redundant_planner.analysis.results import Analysis

Array = npt.NDArray[np.float64]

_NOT_RECORDED = 'not recorded'


class Column(NamedTuple):
    """A column of the joints' table.

    Attributes:
        title: its name.
        unit: where a joint's own is `u`.
        values: (n,).
        group: that it belongs to, empty for none.
    """

    title: str
    unit: str
    values: Array
    group: str = ''


def facts_html(analyses: Sequence[Analysis]) -> str:
    """Return what was run, a column per bag."""
    columns = [facts_of(analysis) for analysis in analyses]
    head = ''.join(f'<th scope="col">{_bag_head(i, analysis.name)}</th>'
                   for i, analysis in enumerate(analyses)) if len(analyses) > 1 else ''
    rows = ''.join(
        f'<tr><th scope="row">{title}</th>'
        + ''.join(f'<td>{escape(column[title] or _NOT_RECORDED)}</td>' for column in columns)
        + '</tr>' for title in columns[0])
    above = f'<tr><th></th>{head}</tr>' if head else ''
    return f'<div class="scroll"><table class="facts">{above}{rows}</table></div>'


def facts_of(analysis: Analysis) -> dict[str, str]:
    """Return title → what was run; empty for what the bag does not tell."""
    facts, robot = analysis.facts, analysis.robot
    begin, end = motion_interval(analysis.curves)
    count = len(analysis.joint_names)
    return {
        'Robot': f'{robot.name}, {count} joints' if robot is not None else '',
        'Method': facts.method, 'Recorded': facts.date,
        'Software': f'redundant_planner {facts.software}' if facts.software else '',
        'Motion': (f'{end - begin:.2f} s, from {begin:.2f} s into the bag; '
                   f'{analysis.end - analysis.begin:.2f} s recorded'),
        'Samples': f'{analysis.samples} joint states'}


def joint_columns(analysis: Analysis) -> list[Column]:
    """Return the columns of the joints' table, without those that tell nothing."""
    return [Column(MEASURES[key], UNITS[key], getattr(analysis.joints, key))
            for key in telling(analysis.joints)]


def peak_columns(analysis: Analysis) -> list[Column]:
    """Return the columns of the table of peaks, in groups, each beside its limit."""
    joints, told, robot = analysis.joints, analysis.commanded, analysis.robot
    columns = [Column('measured', 'u/s', joints.peak_velocity, 'velocity')]
    if told is None:
        # Beside commands it would say more of noise than of the motion.
        columns.append(Column('measured', 'u/s²', joints.peak_acceleration, 'acceleration'))
        return columns
    for kind, limit in PEAKS.items():
        peaks, unit = getattr(told, kind), UNITS[kind]
        columns.append(Column('commanded', unit, peaks, kind))
        limits = getattr(robot, limit) if robot is not None else None
        if limits is not None and np.isfinite(limits).any():
            columns += [Column('limit', unit, limits, kind),
                        Column('share', '%', 100.0 * peaks / limits, kind)]
    return columns


def joints_html(analysis: Analysis, columns: Sequence[Column]) -> str:
    """Return measures of every joint, joints of a unit together."""
    units = joint_units(analysis)
    groups = ''.join(
        f'<th scope="colgroup" colspan="{sum(one.group == group for one in columns)}">{group}</th>'
        for group in dict.fromkeys(column.group for column in columns) if group)
    head = ''.join(f'<th scope="col">{column.title}</th>' for column in columns)
    body = ''
    for unit in dict.fromkeys(units):
        shown = '[rad, m]' if unit == UNKNOWN else unit
        body += '<tbody><tr class="units"><th></th>' + ''.join(
            f'<td>{column.unit.replace("u", shown)}</td>' for column in columns) + '</tr>'
        for i in (i for i, one in enumerate(units) if one == unit):
            cells = ''.join(_cell(column, i) for column in columns)
            body += f'<tr><th scope="row">{escape(analysis.joint_names[i])}</th>{cells}</tr>'
        body += '</tbody>'
    above = f'<tr class="groups"><th></th>{groups}</tr>' if groups else ''
    return (f'<div class="scroll"><table><thead>{above}<tr><th scope="col">joint</th>{head}</tr>'
            f'</thead>{body}</table></div>')


def _cell(column: Column, joint: int) -> str:
    value = float(column.values[joint])
    beyond = column.unit == '%' and value > 101.0
    mark = ' class="beyond"' if beyond else ''
    return f'<td{mark}>{"✕ " if beyond else ""}{number_text(value)}</td>'


def motion_html(analyses: Sequence[Analysis]) -> str:
    """Return the measures of whole motions, and the difference of each bag to the first."""
    columns = [motion_measures(analysis) for analysis in analyses]
    rows = ''
    for key, (title, unit, scale) in MOTION.items():
        values = [None if column[key] is None else scale * column[key] for column in columns]
        if all(value is None for value in values):
            continue
        rows += (f'<tr><th scope="row">{title}</th>{_compared(values)}'
                 f'<td class="unit">{unit}</td></tr>')
    rows += ('<tr><th scope="row">Nearest pair</th>'
             + ''.join(f'<td>{escape(column["nearest_pair"] or "–")}</td>'
                       + ('<td></td><td></td>' if i else '')
                       for i, column in enumerate(columns)) + '<td></td></tr>')
    return (f'<div class="scroll"><table><thead><tr><th></th>{_compared_head(analyses)}'
            f'<th scope="col">unit</th></tr></thead><tbody>{rows}</tbody></table></div>')


def chunks_html(analysis: Analysis) -> str:
    """Return how the arm followed the chunks that it was sent, a row for each run of them."""
    head = ''.join(f'<th scope="col">{title}</th>' for title in CHUNKS)
    body = ''.join('<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row) + '</tr>'
                   for row in chunk_rows(analysis))
    return (f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody>'
            '</table></div>')


def comparison_html(analyses: Sequence[Analysis]) -> str:
    """Return how the joints of further bags differ from those of the first."""
    first = analyses[0]
    units = joint_units(first)
    body = ''
    for title, key, unit in (('Path ∫|q̇|', 'path', 'u'), ('∫q̇²', 'effort', 'u²/s'),
                             ('Displacement', 'displacement', 'u'),
                             ('Peak velocity, measured', 'peak_velocity', 'u/s')):
        body += f'<tbody><tr class="units"><th colspan="99" scope="rowgroup">{title}</th></tr>'
        for i, name in enumerate(first.joint_names):
            values = [float(getattr(analysis.joints, key)[analysis.joint_names.index(name)])
                      for analysis in analyses]
            shown = unit.replace('u', '[rad, m]' if units[i] == UNKNOWN else units[i])
            body += (f'<tr><th scope="row">{escape(name)}</th>{_compared(values)}'
                     f'<td class="unit">{shown}</td></tr>')
        body += '</tbody>'
    return (f'<div class="scroll"><table><thead><tr><th scope="col">joint</th>'
            f'{_compared_head(analyses)}<th scope="col">unit</th></tr></thead>{body}</table>'
            '</div>')


def _compared_head(analyses: Sequence[Analysis]) -> str:
    if len(analyses) == 1:
        return '<th scope="col">value</th>'
    return ''.join(
        f'<th scope="col">{_bag_head(i, analysis.name)}</th>'
        + (f'<th scope="col">{chr(65 + i % 26)} − A</th><th scope="col">change [%]</th>'
           if i else '') for i, analysis in enumerate(analyses))


def _compared(values: Sequence[float | None]) -> str:
    """Return the cells of a row: every value, and after each but the first the difference."""
    base = values[0]
    cells = f'<td>{number_text(base)}</td>'
    for value in values[1:]:
        cells += f'<td>{number_text(value)}</td>'
        cells += ('<td>–</td><td>–</td>' if base is None or value is None else
                  f'<td>{difference_text(base, value)}</td><td>{share_text(base, value)}</td>')
    return cells


def _bag_head(index: int, name: str) -> str:
    return f'<i class="key s{index % 6}">{chr(65 + index % 26)}</i> {escape(name)}'
