"""One HTML page per analysis that needs nothing else: key figures, a 3-D view, curves, tables."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
import json
from pathlib import Path
import re
from typing import Any

from plotly.offline import get_plotlyjs

from redundant_planner.analysis.report_data import MOST_JOINTS, page_data
from redundant_planner.analysis.report_figures import write_figures
from redundant_planner.analysis.report_tables import (
    comparison_html,
    facts_html,
    joints_html,
    motion_html,
)
from redundant_planner.analysis.report_template import PAGE
from redundant_planner.analysis.report_tiles import tiles_html, tiles_of
from redundant_planner.analysis.report_view import view_of
from redundant_planner.analysis.results import Analysis
from redundant_planner.core.errors import PlannerError


def write_report(folder: Path, analyses: list[Analysis]) -> Path:
    """Write the page, and PNG and SVG figures beside it; return the page.

    Args:
        folder: to write to, made if it is not there.
        analyses: one or more.

    Raises:
        PlannerError: the folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlannerError(f"'{folder}' cannot be written to: {error}") from None
    file = folder / 'report.html'
    file.write_text(page_of(analyses), encoding='utf-8')
    for analysis in analyses:
        write_figures(folder, analysis)
    return file


def page_of(analyses: Sequence[Analysis]) -> str:
    """Return the page of one or more analyses as HTML."""
    names = [analysis.name for analysis in analyses]
    views = [view_of(analysis) if analysis.robot is not None else None for analysis in analyses]
    body = (facts_html(analyses) + tiles_html(names, [tiles_of(one) for one in analyses])
            + _notes(analyses, views) + _view_section(analyses) + _curve_section(analyses)
            + _table_section(analyses))
    texts = {'TITLE': escape(f'Motion report: {" and ".join(names)}'), 'BODY': body,
             'PLOTLY': get_plotlyjs(), 'DATA': _for_script(page_data(analyses, views))}
    # All at once: a name in the bag may be one of the marks.
    return re.sub(f'__({"|".join(texts)})__', lambda mark: texts[mark[1]], PAGE)


def _for_script(data: Any) -> str:
    """Return data as JSON that cannot end the script it stands in, nor break one of its lines."""
    # json.dumps writes all but ASCII as escapes, U+2028 and U+2029 among it.
    text = json.dumps(data, allow_nan=False)
    for sign in '<>&':
        text = text.replace(sign, f'\\u{ord(sign):04x}')
    return text


def _notes(analyses: Sequence[Analysis], views: Sequence[dict[str, Any] | None]) -> str:
    """Return what is missing or left out, as a list."""
    found = []
    for analysis, view in zip(analyses, views):
        told = list(analysis.notes)
        if view is not None and view['hidden']:
            told.append(f'the 3-D view leaves out up to {view["hidden"]} obstacles that are '
                        'farther away than the others')
        if len(analysis.joint_names) > MOST_JOINTS:
            told.append(f'diagrams show the first {MOST_JOINTS} of '
                        f'{len(analysis.joint_names)} joints')
        found += [f'{analysis.name}: {note}' if len(analyses) > 1 else note for note in told]
    items = ''.join(f'<li>{escape(note)}</li>' for note in dict.fromkeys(found))
    return f'<ul class="notes">{items}</ul>' if items else ''


def _view_section(analyses: Sequence[Analysis]) -> str:
    views = ''.join(
        '<div>' + (_bag_title(i, analysis.name) if len(analyses) > 1 else '')
        + f'<div class="view" id="view{i}"></div>'
        f'<img class="picture on-paper" id="picture{i}" alt="the arm and the obstacles"></div>'
        for i, analysis in enumerate(analyses) if analysis.robot is not None)
    if not views:
        return ''
    legend = ''.join(
        f'<span><i class="swatch" style="background: var(--{color})"></i>{what}</span>'
        for color, what in (('bone', 'arm'), ('arm', 'shapes of its links'),
                            ('obstacle', 'obstacles'), ('path', 'path of the tip'),
                            ('ghost', 'posture at the start')))
    return (f'<h2>The motion</h2><p class="legend">{legend}</p><div class="views">{views}</div>')


def _curve_section(analyses: Sequence[Analysis]) -> str:
    told = any(analysis.commanded is not None for analysis in analyses)
    lines = [('commanded', 'commanded')] if told else []
    lines += [('measured', 'measured'), ('limit', 'limit')]
    legend = ''.join(
        f'<span><svg width="30" height="8"><line class="curve {style} s0" x1="0" x2="30" y1="4" '
        f'y2="4"/></svg>{what}</span>' for style, what in lines)
    if len(analyses) > 1:
        legend += ''.join(f'<span>{_bag_title(i, analysis.name)}</span>'
                          for i, analysis in enumerate(analyses))
    # Accelerations of measured motions are differences of noisy velocities.
    return ('<h2>Curves</h2><p class="lead">Time counts from the begin of the motion. Press on a '
            'curve to see the arm at that moment. The number beside a title is the value there.'
            f'</p><p class="legend">{legend}</p>'
            '<div class="charts wide" id="charts-arm"></div>'
            + ''.join(f'<h3>{title}</h3><div class="charts" id="charts-{group}"></div>'
                      for group, title in (
                          ('position', 'Joint positions, measured'),
                          ('velocity', 'Joint velocities'),
                          ('acceleration', 'Joint accelerations, '
                           + ('commanded' if told else 'measured')))))


def _table_section(analyses: Sequence[Analysis]) -> str:
    title = 'Whole motion' if len(analyses) == 1 else 'Whole motion, and differences'
    tables = f'<h2>{title}</h2>{motion_html(analyses)}'
    for i, analysis in enumerate(analyses):
        bag = f': {_bag_title(i, analysis.name)}' if len(analyses) > 1 else ''
        tables += f'<h2>Joints{bag}</h2>{joints_html(analysis)}'
    if len(analyses) > 1:
        tables += f'<h2>Joints, and differences</h2>{comparison_html(analyses)}'
    return tables


def _bag_title(index: int, name: str) -> str:
    return f'<i class="key s{index % 6}">{chr(65 + index % 26)}</i> {escape(name)}'
