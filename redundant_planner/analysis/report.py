"""One HTML page per analysis that needs nothing else: curves with linked time, and a 3-D view."""

from __future__ import annotations

import base64
from html import escape
import json
from pathlib import Path
import re
from typing import Any

import numpy as np
import numpy.typing as npt
from plotly.offline import get_plotlyjs

from redundant_planner.analysis.figures import capsule_surface, joint_curves, motion_picture
from redundant_planner.analysis.results import Analysis, scene_at
from redundant_planner.core.errors import PlannerError
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.tools.analyze_bag import as_text, motion_measures, reductions

Array = npt.NDArray[np.float64]

# Samples of a curve, and postures of the 3-D view: what a screen can show.
_CURVE = 1500
_POSTURES = 240
_RIBS, _SIDES = 6, 11  # grid of a link
_BALL_RIBS, _BALL_SIDES = 10, 19  # of an obstacle
# Obstacles drawn in all postures of the 3-D view together, and in a picture: the nearest ones.
_GRIDS = 6000
_PICTURED = 200
# How far around the arm obstacles are drawn, and how large one may be, in sizes of its motion.
_AROUND, _LARGE = 1.5, 1000.0
# Joints in a figure.
_DIAGRAMS = 32
_COLORS = ('#1d3557', '#c8553d', '#2a9d8f', '#e9c46a', '#6d597a', '#457b9d', '#8ab17d', '#b56576',
           '#355070', '#bc6c25')

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>__TITLE__</title>
<style>
body { font: 15px/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 1200px;
       padding: 0 12px 40px; color: #1b1f24; background: #fff; }
h1 { font-size: 1.35em; } h2 { font-size: 1.1em; margin-top: 1.6em; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
td, th { padding: 2px 10px; text-align: right; border-bottom: 1px solid #ddd;
         white-space: nowrap; }
td:first-child, th:first-child { text-align: left; }
.note { color: #8a4b00; }
.bar { display: flex; gap: 10px; align-items: center; position: sticky; bottom: 0;
       background: #fff; padding: 8px 0; }
.bar input { flex: 1; min-width: 0; } .bar button { font: inherit; width: 4.2em; }
.view { width: 100%; height: min(70vh, 560px); }
.curves { width: 100%; height: 860px; }
</style></head><body>
<h1>__TITLE__</h1>
__BODY__
<script>__PLOTLY__</script>
<script>
const BAGS = __DATA__;
function numbers(text, shape) {
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}
BAGS.forEach((bag, index) => {
  const at = name => document.getElementById(name + index);
  const time = numbers(bag.time), layout = {
    margin: {l: 60, r: 10, t: 80, b: 40}, hovermode: 'x unified',
    legend: {orientation: 'h', y: 1.01, yanchor: 'bottom'}, xaxis: {title: {text: 'time [s]'}},
    grid: {rows: bag.rows.length, columns: 1, pattern: 'coupled'},
    shapes: [{type: 'line', xref: 'x', yref: 'paper', x0: time[0], x1: time[0], y0: 0, y1: 1,
              line: {color: '#c8553d', width: 1}}]};
  const traces = [];
  bag.rows.forEach((row, r) => {
    const axis = r ? 'y' + (r + 1) : 'y';
    layout['yaxis' + (r ? r + 1 : '')] = {title: {text: row.label, font: {size: 11}}};
    row.curves.forEach((curve, i) => traces.push({
      x: time, y: numbers(curve.values), name: curve.name, yaxis: axis, xaxis: 'x', mode: 'lines',
      line: {width: 1.4, color: curve.color}, legendgroup: curve.name,
      showlegend: r === 0}));
  });
  const options = {responsive: true, displaylogo: false};
  Plotly.newPlot(at('curves'), traces, layout, options);
  if (!bag.view) return;

  const view = bag.view, frames = view.times.length;
  const points = numbers(view.vertices), size = points.length / frames;
  const chain = numbers(view.chain), links = chain.length / frames;
  const tips = numbers(view.tips), obstacles = view.obstacles.map(o => numbers(o));
  const column = (data, from, count, k) => Array.from(
    {length: count / 3}, (_, i) => data[from + 3 * i + k]);
  const xyz = (data, from, count) => [0, 1, 2].map(k => column(data, from, count, k));
  const shown = f => {
    const [x, y, z] = xyz(points, f * size, size), [u, v, w] = xyz(chain, f * links, links);
    const o = obstacles[view.scene[f]], [a, b, c] = xyz(o, 0, o.length);
    return {x: [x, u, a, [tips[3 * f]]], y: [y, v, b, [tips[3 * f + 1]]],
            z: [z, w, c, [tips[3 * f + 2]]]};
  };
  const triangles = (count, ribs, sides) => {
    const i = [], j = [], k = [];
    for (let s = 0; s < count; s++)
      for (let r = 0; r < ribs - 1; r++)
        for (let t = 0; t < sides - 1; t++) {
          const a = (s * ribs + r) * sides + t;
          i.push(a, a + 1); j.push(a + 1, a + sides + 1); k.push(a + sides, a + sides);
        }
    return {i: i, j: j, k: k};
  };
  const first = shown(0), [px, py, pz] = xyz(tips, 0, tips.length);
  const mesh = (n, count, color, opacity, name, grid) => Object.assign({
    type: 'mesh3d', x: first.x[n], y: first.y[n], z: first.z[n], color: color, opacity: opacity,
    hoverinfo: 'skip', name: name}, triangles(count, grid[0], grid[1]));
  Plotly.newPlot(at('view'), [
    mesh(0, view.capsules, '#457b9d', 0.45, 'links', view.grid),
    {type: 'scatter3d', mode: 'lines+markers', x: first.x[1], y: first.y[1], z: first.z[1],
     line: {color: '#1d3557', width: 5}, marker: {size: 3, color: '#1d3557'}, hoverinfo: 'skip'},
    mesh(2, obstacles[0].length / 3 / (view.ball[0] * view.ball[1]), '#c8553d', 0.75,
         'obstacles', view.ball),
    {type: 'scatter3d', mode: 'markers', x: first.x[3], y: first.y[3], z: first.z[3],
     marker: {size: 5, color: '#2a9d8f'}, hoverinfo: 'skip'},
    {type: 'scatter3d', mode: 'lines', x: px, y: py, z: pz, line: {color: '#2a9d8f', width: 4},
     hoverinfo: 'skip'}],
    {margin: {l: 0, r: 0, t: 0, b: 0}, showlegend: false, uirevision: 'same',
     scene: {aspectmode: 'cube', camera: {eye: {x: 1.3, y: -1.15, z: 0.5}},
             xaxis: {title: {text: 'x [m]'}, range: view.range[0]},
             yaxis: {title: {text: 'y [m]'}, range: view.range[1]},
             zaxis: {title: {text: 'z [m]'}, range: view.range[2]}}}, options);

  const slider = at('slider'), button = at('play'), clock = at('clock');
  let playing = null, drawn = -1;
  const show = f => {
    if (f === drawn) return;
    drawn = f; slider.value = f;
    clock.textContent = view.times[f].toFixed(2) + ' s';
    const s = shown(f);
    Plotly.restyle(at('view'), {x: s.x, y: s.y, z: s.z}, [0, 1, 2, 3]);
    Plotly.relayout(at('curves'), {'shapes[0].x0': view.times[f], 'shapes[0].x1': view.times[f]});
  };
  const stop = () => {
    cancelAnimationFrame(playing); playing = null; button.textContent = 'play';
  };
  const play = () => {
    button.textContent = 'pause';
    let from = drawn >= frames - 1 ? 0 : Math.max(drawn, 0);
    const begin = performance.now() - 1000 * (view.times[from] - view.times[0]);
    const step = now => {
      const t = view.times[0] + (now - begin) / 1000;
      let f = from;
      while (f < frames - 1 && view.times[f + 1] <= t) f++;
      from = f; show(f);
      if (f >= frames - 1) stop(); else playing = requestAnimationFrame(step);
    };
    playing = requestAnimationFrame(step);
  };
  button.onclick = () => playing === null ? play() : stop();
  slider.oninput = () => { stop(); show(+slider.value); };
  at('curves').on('plotly_click', event => {
    stop();
    let f = 0;
    while (f < frames - 1 && view.times[f + 1] <= event.points[0].x) f++;
    show(f);
  });
  show(0);
});
</script></body></html>
"""


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
    views = [_view(analysis) if analysis.robot is not None else None for analysis in analyses]
    body = ''.join(_section(i, *both) for i, both in enumerate(zip(analyses, views)))
    for other in analyses[1:]:
        body += _comparison(analyses[0], other)
    texts = {'TITLE': escape(title), 'BODY': body, 'PLOTLY': get_plotlyjs(),
             'DATA': _for_script([_data(*both) for both in zip(analyses, views)])}
    # All at once: a name in the bag may be one of the marks.
    return re.sub(f'__({"|".join(texts)})__', lambda mark: texts[mark[1]], _PAGE)


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
        f'<input id="slider{index}" type="range" min="0" max="{_view_count(analysis) - 1}" '
        f'value="0" aria-label="time"><span id="clock{index}"></span></div>')
    return (f'<h2>{escape(analysis.name)}</h2>{notes}{view}'
            f'<div class="curves" id="curves{index}"></div>'
            f'<div class="scroll">{_joint_rows(analysis)}</div>'
            f'<div class="scroll"><table>{measures}</table></div>')


def _joint_rows(analysis: Analysis) -> str:
    keys = list(vars(analysis.joints))
    head = ''.join(f'<th>{escape(key.replace("_", " "))}</th>' for key in keys)
    rows = ''.join(
        f'<tr><td>{escape(name)}</td>' + ''.join(
            f'<td>{getattr(analysis.joints, key)[i]:.5g}</td>' for key in keys) + '</tr>'
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


def _packed(values: npt.ArrayLike) -> str:
    return base64.b64encode(np.asarray(values, dtype='<f4').tobytes()).decode()


def _data(analysis: Analysis, view: dict[str, Any] | None) -> dict[str, Any]:
    """Return what the page's script draws."""
    curves = analysis.curves
    chosen = np.unique(np.linspace(0, len(curves.times) - 1, _CURVE).astype(int))

    def per_joint(label: str, values: Array) -> dict[str, Any]:
        return {'label': label, 'curves': [
            {'name': _label(name), 'values': _packed(values[chosen, i]),
             'color': _COLORS[i % len(_COLORS)]}
            for i, name in enumerate(analysis.joint_names)]}

    rows = [per_joint('displacement<br>[rad, m]', curves.positions - curves.positions[0]),
            per_joint('velocity<br>[rad/s, m/s]', curves.velocities),
            per_joint('acceleration<br>[rad/s², m/s²]', curves.accelerations)]
    for label, name, values in (
            ('clearance<br>[m]', 'smallest clearance', curves.clearance),
            ('off the path<br>[m]', 'distance from the commanded path', curves.path_error),
            ('twist scale', 'share of the commanded twist', curves.scale)):
        if np.isfinite(values).any():
            shown = np.where(np.isfinite(values), values, np.nan)[chosen]
            rows.append({'label': label, 'curves': [
                {'name': name, 'values': _packed(shown), 'color': '#333333'}]})
    return {'time': _packed(curves.times[chosen] - curves.times[0]), 'rows': rows,
            'view': view}


def _view_count(analysis: Analysis) -> int:
    return min(_POSTURES, len(analysis.curves.times))


def _view(analysis: Analysis) -> dict[str, Any]:
    """Return the arm at some postures as grids of points, and its obstacles."""
    robot, curves = analysis.robot, analysis.curves
    assert robot is not None
    chosen = np.linspace(0, len(curves.times) - 1, _view_count(analysis)).astype(int)
    arms = robot.kinematics_along(curves.positions[chosen])
    radii = [max(capsule.radius, 0.005) for capsule in robot.capsules]
    surfaces = np.array([
        [capsule_surface(start, end, radius, _RIBS, _SIDES).reshape(-1, 3)
         for start, end, radius in zip(starts, ends, radii)]
        for starts, ends in zip(arms.segment_start, arms.segment_end)])
    chains = np.array([np.vstack((np.zeros(3), robot.joint_points(q)))
                       for q in curves.positions[chosen]])
    scenes = [scene_at(curves, float(time)) for time in curves.times[chosen]]
    corners = chains.reshape(-1, 3)
    most = _GRIDS // len({id(scene) for scene in scenes})
    near = {id(scene): _near(scene, corners, most) for scene in scenes}
    width = max(len(rows) for rows in near.values())
    low, high = corners.min(axis=0), corners.max(axis=0)
    edges = _AROUND * (high - low).max()
    drawn: dict[str, int] = {}
    which: list[int] = []
    extents = [corners]
    for scene in scenes:
        rows = near[id(scene)]
        # As many in every scene: those that are missing are points at the origin.
        grids = np.zeros((width, _BALL_RIBS * _BALL_SIDES, 3))
        grids[:len(rows)] = _ellipsoids(scene, rows)
        packed = _packed(grids)
        if packed not in drawn:
            drawn[packed] = len(drawn)
            extents.append(np.clip(grids[:len(rows)].reshape(-1, 3), low - edges, high + edges))
        which.append(drawn[packed])
    extent = np.vstack(extents)
    middle = 0.5 * (extent.min(axis=0) + extent.max(axis=0))
    half = 0.5 * float((extent.max(axis=0) - extent.min(axis=0)).max()) + 0.05
    return {
        'times': np.round(curves.times[chosen] - curves.times[0], 4).tolist(),
        'vertices': _packed(surfaces), 'capsules': len(radii), 'grid': [_RIBS, _SIDES],
        'ball': [_BALL_RIBS, _BALL_SIDES],
        'chain': _packed(chains), 'tips': _packed(arms.tip_position), 'obstacles': list(drawn),
        'hidden': max(len(scene.names) - len(near[id(scene)]) for scene in scenes),
        'scene': which, 'range': [[float(m - half), float(m + half)] for m in middle]}


def _near(scene: Scene, corners: Array, most: int) -> npt.NDArray[np.intp]:
    """Return which obstacles are drawn around an arm's points (k, 3): the nearest ones."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = float((high - low).max()) + 1e-3
    sizes = scene.semi_axes.max(axis=1, initial=0.0)
    with np.errstate(over='ignore'):
        outside = np.maximum(np.maximum(low - scene.centers, scene.centers - high), 0.0)
        away = np.linalg.norm(outside, axis=1) - sizes
    candidates = np.flatnonzero((away < _AROUND * extent) & (sizes < _LARGE * extent))
    return np.sort(candidates[np.argsort(away[candidates], kind='stable')[:most]])


def _ellipsoids(scene: Scene, rows: npt.NDArray[np.intp]) -> Array:
    """Return grids of points like that of `capsule_surface` on obstacles, (k, u v, 3)."""
    ball = capsule_surface(
        np.zeros(3), np.zeros(3), 1.0, _BALL_RIBS, _BALL_SIDES).reshape(-1, 3)
    scaled = ball * scene.semi_axes[rows, None]
    return scaled @ scene.rotations[rows].transpose(0, 2, 1) + scene.centers[rows, None]


def write_figures(
    folder: Path, analysis: Analysis, suffixes: tuple[str, ...] = ('png', 'svg'),
) -> None:
    """Write the figures of an analysis to a folder."""
    curves = analysis.curves
    chosen = np.unique(np.linspace(0, len(curves.times) - 1, _CURVE).astype(int))
    times = curves.times[chosen] - curves.times[0]
    names, title = analysis.joint_names[:_DIAGRAMS], f"'{analysis.name}'"
    if len(names) < len(analysis.joint_names):
        title += f': the first {len(names)} of {len(analysis.joint_names)} joints'
    for suffix in suffixes:
        for kind, label, values in (
                ('displacement', 'displacement [rad, m]', curves.positions - curves.positions[0]),
                ('velocity', 'velocity [rad/s, m/s]', curves.velocities),
                ('acceleration', 'acceleration [rad/s², m/s²]', curves.accelerations)):
            joint_curves(folder / f'{analysis.name}_{kind}.{suffix}', names, label,
                         {analysis.name: ('-', times, values[chosen])}, title)
        if analysis.robot is not None:
            scene = scene_at(curves, float(curves.times[-1]))
            corners = np.vstack([analysis.robot.joint_points(q) for q in curves.positions[chosen]])
            obstacles = scene.obstacles()
            motion_picture(
                folder / f'{analysis.name}_motion.{suffix}', analysis.robot, times,
                curves.positions[chosen], curves.velocities[chosen],
                [obstacles[i] for i in _near(scene, corners, _PICTURED)], f"'{analysis.name}'")
