"""One HTML page per analysis that needs nothing else: curves with linked time, and a 3-D view."""

from __future__ import annotations

from html import escape
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
import numpy.typing as npt
from plotly.offline import get_plotlyjs

from redundant_planner.analysis.measure_tables import (
    as_text,
    MEASURES,
    motion_measures,
    PEAKS,
    reductions,
)
from redundant_planner.analysis.report_figures import (
    accelerations_of,
    drawn_samples,
    velocities_of,
    write_figures,
)
from redundant_planner.analysis.report_template import PAGE
from redundant_planner.analysis.report_view import packed_numbers, view_count, view_of
from redundant_planner.analysis.results import Analysis
from redundant_planner.core.errors import PlannerError

Array = npt.NDArray[np.float64]

_COLORS = ('#1d3557', '#c8553d', '#2a9d8f', '#e9c46a', '#6d597a', '#457b9d', '#8ab17d', '#b56576',
           '#355070', '#bc6c25')


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


def page_of(analyses: list[Analysis]) -> str:
    """Return the page of one or more analyses as HTML."""
    title = ' and '.join(f"'{analysis.name}'" for analysis in analyses)
    views = [view_of(analysis) if analysis.robot is not None else None for analysis in analyses]
    body = ''.join(_section(i, *both) for i, both in enumerate(zip(analyses, views)))
    for other in analyses[1:]:
        body += _comparison(analyses[0], other)
    texts = {'TITLE': escape(title), 'BODY': body, 'PLOTLY': get_plotlyjs(),
             'DATA': _for_script([_data(*both) for both in zip(analyses, views)])}
    # All at once: a name in the bag may be one of the marks.
    return re.sub(f'__({"|".join(texts)})__', lambda mark: texts[mark[1]], PAGE)


def _for_script(data: Any) -> str:
    """Return data as JSON that cannot end the script it stands in, nor break one of its lines."""
    # json.dumps writes all but ASCII as escapes, U+2028 and U+2029 among it.
    text = json.dumps(data, allow_nan=False)
    for sign in '<>&':
        text = text.replace(sign, f'\\u{ord(sign):04x}')
    return text


def _label(text: str) -> str:
    """Return a text as plotly shows it: in labels it takes some HTML for markup."""
    return escape(text, quote=False)


def _section(index: int, analysis: Analysis, shown: dict[str, Any] | None) -> str:
    measures = ''.join(
        f'<tr><td>{escape(key.replace("_", " "))}</td><td>{escape(as_text(value))}</td></tr>'
        for key, value in motion_measures(analysis).items())
    notes = ''.join(f'<p class="note">{escape(note)}</p>' for note in analysis.notes)
    if shown is not None and shown['hidden']:
        notes += (f'<p class="note">the 3-D view leaves out up to {shown["hidden"]} obstacles '
                  'that are farther away than the others</p>')
    view = '' if analysis.robot is None else (
        f'<div class="view" id="view{index}"></div><div class="bar">'
        f'<button id="play{index}" aria-label="play or pause">play</button>'
        f'<input id="slider{index}" type="range" min="0" max="{view_count(analysis) - 1}" '
        f'value="0" aria-label="time"><span id="clock{index}"></span></div>')
    return (f'<h2>{escape(analysis.name)}</h2>{notes}{view}'
            f'<div class="curves" id="curves{index}"></div>'
            f'<div class="scroll">{_joint_rows(analysis)}</div>'
            f'<div class="scroll"><table>{measures}</table></div>')


def _joint_rows(analysis: Analysis) -> str:
    columns = {title: getattr(analysis.joints, key) for key, title in MEASURES.items()}
    if analysis.commanded is not None:
        columns |= {title: getattr(analysis.commanded, key)
                    for key, (title, _) in PEAKS.items()}
    head = ''.join(f'<th>{escape(title)}</th>' for title in columns)
    rows = ''.join(
        f'<tr><td>{escape(name)}</td>' + ''.join(
            f'<td>{values[i]:.5g}</td>' for values in columns.values()) + '</tr>'
        for i, name in enumerate(analysis.joint_names))
    return f'<table><tr><th>joint</th>{head}</tr>{rows}</table>'


def _comparison(base: Analysis, improved: Analysis) -> str:
    rows = reductions(base, improved)
    keys = list(next(iter(rows.values())))
    head = ''.join(f'<th>{escape(key.replace("_", " "))}</th>' for key in keys)
    lines = ''.join(
        f'<tr><td>{escape(name)}</td>'
        + ''.join(f'<td>{row[key]:.1f}</td>' if np.isfinite(row[key]) else '<td>–</td>'
                  for key in keys) + '</tr>' for name, row in rows.items())
    return (f'<h2>Reductions (%) of {escape(improved.name)} against {escape(base.name)}</h2>'
            f'<div class="scroll"><table><tr><th>joint</th>{head}</tr>{lines}</table></div>')


def _data(analysis: Analysis, view: dict[str, Any] | None) -> dict[str, Any]:
    """Return what the page's script draws."""
    curves = analysis.curves
    chosen = drawn_samples(curves)

    def per_joint(label: str, values: Array) -> dict[str, Any]:
        return {'label': label, 'curves': [
            {'name': _label(name), 'values': packed_numbers(values[chosen, i]),
             'color': _COLORS[i % len(_COLORS)]}
            for i, name in enumerate(analysis.joint_names)]}

    rows = [per_joint('displacement<br>measured [rad, m]', curves.positions - curves.positions[0])]
    rows += [per_joint(f'velocity<br>{which} [rad/s, m/s]', values)
             for which, values in velocities_of(curves).items()]
    rows += [per_joint(f'acceleration<br>{which} [rad/s², m/s²]', values)
             for which, values in accelerations_of(curves).items()]
    for label, name, values in (
            ('clearance<br>[m]', 'smallest clearance', curves.clearance),
            ('off the path<br>[m]', 'distance from the commanded path', curves.path_error),
            ('twist scale', 'share of the commanded twist', curves.scale)):
        if np.isfinite(values).any():
            shown = np.where(np.isfinite(values), values, np.nan)[chosen]
            rows.append({'label': label, 'curves': [
                {'name': name, 'values': packed_numbers(shown), 'color': '#333333'}]})
    return {'time': packed_numbers(curves.times[chosen] - curves.times[0]), 'rows': rows,
            'view': view}
