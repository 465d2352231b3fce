"""One HTML page per analysis that needs nothing else: key figures, a 3-D view, curves, tables."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
import json
from pathlib import Path
import re
from typing import Any

from plotly.offline import get_plotlyjs

from redundant_planner.analysis.motion_interval import shown_together
from redundant_planner.analysis.report_data import MOST_JOINTS, page_data
from redundant_planner.analysis.report_figures import write_figures
from redundant_planner.analysis.report_tables import (
    chunks_html,
    comparison_html,
    facts_html,
    joint_columns,
    joints_html,
    motion_html,
    peak_columns,
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
    shown = shown_together([analysis.curves for analysis in analyses])
    views = [view_of(analysis, shown) if analysis.robot is not None else None
             for analysis in analyses]
    body = (facts_html(analyses) + tiles_html(names, [tiles_of(one) for one in analyses])
            + _notes(analyses, views) + _motion_section(analyses) + _curve_section(analyses)
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


def _motion_section(analyses: Sequence[Analysis]) -> str:
    """Return the 3-D views beside the curves of the whole arm."""
    views = ''.join(
        '<div>' + (_bag_title(i, analysis.name) if len(analyses) > 1 else '')
        + f'<div class="view" id="view{i}"></div>'
        f'<img class="picture on-paper" id="picture{i}" alt="the arm and the obstacles"></div>'
        for i, analysis in enumerate(analyses) if analysis.robot is not None)
    several = ' several' if len(analyses) > 1 else ''
    return ('<h2>The motion</h2><p class="lead">Time counts from the begin of the command. Press '
            'on a curve to see the arm at that moment. The number above a curve is the value '
            f'there.</p>{_legend(analyses)}<div class="motion{several}">'
            f'<div class="views">{views}</div><div class="charts" id="charts-arm"></div></div>')


def _legend(analyses: Sequence[Analysis]) -> str:
    """Return what colours and lines stand for."""
    shown = ''
    if any(analysis.robot is not None for analysis in analyses):
        shown = ''.join(
            f'<span><i class="swatch" style="background: var(--{color})"></i>{what}</span>'
            for color, what in (('bone', 'arm'), ('arm', 'shapes of its links'),
                                ('obstacle', 'obstacles'), ('path', 'path of the tip'),
                                ('ghost', 'posture at the start')))
    lines = [('curve measured s0', 'measured'), ('limit', 'limit')]
    if _commanded(analyses):
        lines.insert(0, ('curve commanded s0', 'commanded'))
    shown += ''.join(
        f'<span><svg width="30" height="8"><line class="{style}" x1="0" x2="30" y1="4" '
        f'y2="4"/></svg>{what}</span>' for style, what in lines)
    if len(analyses) > 1:
        shown += ''.join(f'<span>{_bag_title(i, analysis.name)}</span>'
                         for i, analysis in enumerate(analyses))
    return f'<p class="legend">{shown}</p>'


def _curve_section(analyses: Sequence[Analysis]) -> str:
    kind = 'commanded' if _commanded(analyses) else 'measured'
    return '<h2>Joints over time</h2>' + ''.join(
        f'<h3>{title}</h3><div class="charts" id="charts-{group}"></div>'
        for group, title in (('position', 'Positions, measured'), ('velocity', 'Velocities'),
                             ('acceleration', f'Accelerations, {kind}')))


def _commanded(analyses: Sequence[Analysis]) -> bool:
    return any(analysis.commanded is not None for analysis in analyses)


def _table_section(analyses: Sequence[Analysis]) -> str:
    title = 'Whole motion' if len(analyses) == 1 else 'Whole motion, and differences'
    tables = f'<h2>{title}</h2>{motion_html(analyses)}'
    for i, analysis in enumerate(analyses):
        bag = f': {_bag_title(i, analysis.name)}' if len(analyses) > 1 else ''
        tables += (f'<h2>Joints{bag}</h2>{joints_html(analysis, joint_columns(analysis))}'
                   f'<h3>Peaks</h3>{joints_html(analysis, peak_columns(analysis))}')
        if analysis.chunks:
            tables += f'<h2>Chunks{bag}</h2>{chunks_html(analysis)}'
    if len(analyses) > 1:
        tables += f'<h2>Joints, and differences</h2>{comparison_html(analyses)}'
    return tables


def _bag_title(index: int, name: str) -> str:
    return f'<i class="key s{index % 6}">{chr(65 + index % 26)}</i> {escape(name)}'
