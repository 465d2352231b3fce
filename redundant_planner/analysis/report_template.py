"""The report's page before anything is filled in: its style, and the script that draws it.

`report.page_of` replaces the names between double underscores.
"""

from __future__ import annotations

PAGE = """<!DOCTYPE html>
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
