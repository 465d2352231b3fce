"""The report's script, second part: the 3-D views (plotly), and the switch of light and dark."""

from __future__ import annotations

SCENE = """
function triangles(count, ribs, sides) {
  const i = [], j = [], k = [];
  for (let s = 0; s < count; s++)
    for (let r = 0; r < ribs - 1; r++)
      for (let t = 0; t < sides - 1; t++) {
        const a = (s * ribs + r) * sides + t;
        i.push(a, a + 1); j.push(a + 1, a + sides + 1); k.push(a + sides, a + sides);
      }
  return {i: i, j: j, k: k};
}
const axis = (data, from, count, k) => Array.from(
  {length: count / 3}, (_, i) => data[from + 3 * i + k]);
const xyz = (data, from, count) => [0, 1, 2].map(k => axis(data, from, count, k));

// A bag's view: what moves as a function of the posture, and the colours of a piece of the page.
function newView(view) {
  const frames = view.times.length, points = numbers(view.vertices), chain = numbers(view.chain);
  const tips = numbers(view.tips), obstacles = view.obstacles.map(numbers);
  const size = points.length / frames, links = chain.length / frames;
  const moving = f => [
    xyz(points, f * size, size), xyz(chain, f * links, links),
    xyz(obstacles[view.scene[f]], 0, obstacles[0].length),
    xyz(tips, 3 * f, 3), xyz(tips, 3 * view.first, 3 * Math.max(f - view.first + 1, 1))];
  const sides = view.range.map(([a, b]) => b - a), longest = Math.max(...sides);
  const traces = (f, place) => {
    const style = getComputedStyle(place), color = name => style.getPropertyValue(name).trim();
    const at = moving(f), [px, py, pz] = xyz(tips, 3 * view.first, tips.length - 3 * view.first);
    const [sx, sy, sz] = xyz(chain, view.first * links, links);
    const where = n => ({x: at[n][0], y: at[n][1], z: at[n][2], hoverinfo: 'skip'});
    const light = {ambient: 0.65, diffuse: 0.6, specular: 0.05};
    return [
      {type: 'mesh3d', color: color('--arm'), opacity: 0.5, lighting: light, ...where(0),
       ...triangles(view.capsules, ...view.grid)},
      {type: 'scatter3d', mode: 'lines+markers', line: {color: color('--bone'), width: 6},
       marker: {size: 3.5, color: color('--bone')}, ...where(1)},
      {type: 'mesh3d', color: color('--obstacle'), opacity: 0.9, lighting: light, ...where(2),
       ...triangles(obstacles[0].length / 3 / (view.ball[0] * view.ball[1]), ...view.ball)},
      {type: 'scatter3d', mode: 'markers', marker: {size: 5, color: color('--path')},
       ...where(3)},
      {type: 'scatter3d', mode: 'lines', line: {color: color('--path'), width: 8}, ...where(4)},
      {type: 'scatter3d', mode: 'lines', x: px, y: py, z: pz, hoverinfo: 'skip',
       line: {color: color('--path'), width: 3}},
      {type: 'scatter3d', mode: 'lines', x: sx, y: sy, z: sz, hoverinfo: 'skip',
       line: {color: color('--ghost'), width: 3, dash: 'dash'}}];
  };
  const layout = (place, camera) => {
    const style = getComputedStyle(place), color = name => style.getPropertyValue(name).trim();
    const axisOf = (name, k) => ({
      title: {text: name + ' [m]', font: {size: 11}}, range: view.range[k],
      tickfont: {size: 10}, nticks: 5, gridcolor: color('--rule'), zeroline: false,
      color: color('--muted'), showbackground: false, showspikes: false});
    return {
      margin: {l: 0, r: 0, t: 0, b: 0}, showlegend: false, uirevision: 'same',
      paper_bgcolor: 'rgba(0,0,0,0)', font: {color: color('--muted')},
      scene: {aspectmode: 'manual', camera: camera || {eye: {x: 1.1, y: -1.05, z: 0.4},
                center: {x: 0, y: 0, z: -0.04}},
              aspectratio: {x: sides[0] / longest, y: sides[1] / longest, z: sides[2] / longest},
              xaxis: axisOf('x', 0), yaxis: axisOf('y', 1), zaxis: axisOf('z', 2)}};
  };
  const frame = at => {
    let f = 0;
    while (f < frames - 1 && view.times[f + 1] <= at + 1e-9) f++;
    return f;
  };
  return {moving, traces, layout, frame, drawn: -1};
}

const views = [];
bags.forEach((bag, index) => {
  if (!bag.view) return;
  const view = newView(bag.view), place = byId('view' + index);
  views.push({view, place, picture: byId('picture' + index)});
  view.drawn = view.frame(state.now);
  Plotly.newPlot(place, view.traces(view.drawn, root), view.layout(root),
                 {responsive: true, displaylogo: false, displayModeBar: false});
  listeners.push(at => {
    const f = view.frame(at);
    if (f === view.drawn) return;
    view.drawn = f;
    const now = view.moving(f), part = k => now.map(one => one[k]);
    Plotly.restyle(place, {x: part(0), y: part(1), z: part(2)}, [0, 1, 2, 3, 4]);
  });
});

// Paper gets a picture of the view, in the colours of paper: a browser prints no WebGL.
async function takePictures() {
  for (const {view, place, picture} of views) {
    const camera = place.layout && place.layout.scene.camera;
    picture.src = await Plotly.toImage(
      {data: view.traces(view.drawn, picture), layout: view.layout(picture, camera)},
      {format: 'png', width: 900, height: 560, scale: 1.5});
  }
}
let waiting = null;
listeners.push(() => {
  clearTimeout(waiting);
  waiting = setTimeout(() => { if (state.playing === null) takePictures(); }, 700);
});

function repaint() {
  for (const {view, place} of views)
    Plotly.react(place, view.traces(view.drawn, root),
                 view.layout(root, place.layout.scene.camera));
}
const dark = matchMedia('(prefers-color-scheme: dark)'), theme = byId('theme');
const isDark = () => root.dataset.theme ? root.dataset.theme === 'dark' : dark.matches;
const name = () => { theme.textContent = isDark() ? '\\u2600 light' : '\\u263e dark'; };
theme.onclick = () => { root.dataset.theme = isDark() ? 'light' : 'dark'; name(); repaint(); };
dark.addEventListener('change', () => { name(); repaint(); });
name();
drawAll();
"""
