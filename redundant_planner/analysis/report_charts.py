"""The report's script, first part: the diagrams and the bar that moves through time.

Texts from a bag reach the page by `textContent` alone.
"""

from __future__ import annotations

CHARTS = """
const root = document.documentElement, byId = id => document.getElementById(id);
const numbers = text => new Float32Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const bags = REPORT.bags.map(bag => Object.assign({}, bag, {time: numbers(bag.time)}));
const state = {whole: false, limits: false, playing: null,
               now: Math.min(...bags.map(bag => bag.motion[0]))};
const range = () => {
  const key = state.whole ? 'whole' : 'shown';
  return [Math.min(...bags.map(b => b[key][0])), Math.max(...bags.map(b => b[key][1]))];
};
const WIDE = 46, LOW = 18, HIGH = 8, RIGHT = 6, TALL = 118;

function niceStep(span, count) {
  const rough = span / Math.max(count, 1), power = Math.pow(10, Math.floor(Math.log10(rough)));
  return power * [1, 2, 5, 10].find(m => m * power >= rough * 0.999);
}
function ticks(low, high, count) {
  const step = niceStep(high - low, count), found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++)
    found.push(i * step);
  return {at: found, digits: Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 8)};
}
const shown = (value, digits) => (Math.abs(value) < 1e-12 ? 0 : value).toFixed(digits)
  .replace('-', '\\u2212');
function sample(time, at) {
  let best = 0;
  for (let i = 0; i < time.length; i++) if (time[i] <= at) best = i;
  return best;
}

// The vertical range: the curves', and a limit's where that leaves the curves a fifth of it.
function verticalRange(chart, t0, t1) {
  let low = Infinity, high = -Infinity;
  for (const curve of chart.curves) {
    const time = bags[curve.bag].time;
    curve.values.forEach((v, i) => {
      if (isFinite(v) && time[i] >= t0 && time[i] <= t1) {
        low = Math.min(low, v); high = Math.max(high, v);
      }
    });
  }
  if (low > high) { low = 0; high = chart.panel.least; }
  const spare = chart.panel.least - (high - low);
  if (spare > 0) { low -= spare / 2; high += spare / 2; }
  const span = high - low;
  for (const {at: limit} of chart.panel.limits) {
    const wide = Math.max(high, limit) - Math.min(low, limit);
    if (state.limits || span >= 0.2 * wide) {
      low = Math.min(low, limit); high = Math.max(high, limit);
    }
  }
  const margin = 0.06 * (high - low);
  return [low - margin, high + margin];
}

function draw(chart) {
  const width = Math.max(chart.box.clientWidth, 160), [t0, t1] = range();
  const [low, high] = verticalRange(chart, t0, t1);
  const x = t => WIDE + (width - WIDE - RIGHT) * (t - t0) / Math.max(t1 - t0, 1e-9);
  const y = v => HIGH + (TALL - HIGH - LOW) * (high - v) / (high - low);
  const line = (name, x0, y0, x1, y1) =>
    `<line class="${name}" x1="${x0}" y1="${y0}" x2="${x1}" y2="${y1}"/>`;
  let drawn = '';
  const levels = ticks(low, high, 3), moments = ticks(t0, t1, width / 60);
  for (const v of levels.at)
    drawn += line(Math.abs(v) < 1e-12 ? 'zero' : 'grid', WIDE, y(v), width - RIGHT, y(v))
      + `<text x="${WIDE - 5}" y="${y(v) + 3.5}" text-anchor="end">`
      + `${shown(v, levels.digits)}</text>`;
  for (const t of moments.at)
    drawn += `<text x="${x(t)}" y="${TALL - 4}" text-anchor="middle">`
      + `${shown(t, moments.digits)} s</text>`;
  for (const limit of chart.panel.limits) {
    if (limit.at < low || limit.at > high) continue;
    const level = y(limit.at), edge = limit.side > 0 ? HIGH : TALL - LOW;
    drawn += `<rect class="over" x="${WIDE}" width="${width - WIDE - RIGHT}" `
      + `y="${Math.min(edge, level)}" height="${Math.abs(edge - level)}"/>`
      + line('limit', WIDE, level, width - RIGHT, level)
      + `<text class="limit-text" x="${(WIDE + width - RIGHT) / 2}" text-anchor="middle" `
      + `y="${level + (level < 30 ? 11 : -4)}">${limit.label}</text>`;
  }
  for (const curve of chart.curves) {
    const time = bags[curve.bag].time;
    let path = '', down = false;
    curve.values.forEach((v, i) => {
      const inside = isFinite(v) && time[i] >= t0 && time[i] <= t1;
      if (inside) path += (down ? 'L' : 'M') + x(time[i]).toFixed(1) + ' ' + y(v).toFixed(1);
      down = inside;
    });
    drawn += `<path class="curve s${curve.bag % 6} ${curve.style}" d="${path}"/>`;
  }
  chart.svg.setAttribute('viewBox', `0 0 ${width} ${TALL}`);
  chart.svg.innerHTML = drawn + line('now', 0, HIGH, 0, TALL - LOW);
  chart.cursor = chart.svg.lastElementChild;
  chart.x = x;
  chart.time = px => t0 + (t1 - t0) * (px - WIDE) / (width - WIDE - RIGHT);
}

function mark(chart, at) {
  const place = chart.x(at), [t0, t1] = range();
  chart.cursor.setAttribute('transform', `translate(${place} 0)`);
  chart.cursor.style.display = at < t0 || at > t1 ? 'none' : '';
  const told = chart.curves.some(c => c.style === 'commanded') ? 'commanded' : 'measured';
  const values = chart.curves.filter(c => c.style === told).map(c => {
    const value = c.values[sample(bags[c.bag].time, at)];
    if (!isFinite(value)) return '\\u2013';
    return `${Number(Number(value.toPrecision(3)).toFixed(4))}`
      .replace('-', '\\u2212');
  });
  chart.read.textContent = values.join(' | ');
}

function newChart(panel) {
  const box = document.createElement('figure'), head = document.createElement('figcaption');
  const title = document.createElement('b'), read = document.createElement('span');
  const note = document.createElement('small');
  box.className = 'chart';
  title.textContent = `${panel.title} [${panel.unit.replace(/[\\[\\]]/g, '')}]`;
  note.textContent = panel.note;
  head.append(title, note, read);
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
  box.append(head, svg);
  byId('charts-' + panel.group).append(box);
  // Measured curves lie as broad dashes below the commanded ones.
  const curves = panel.curves.map(c => Object.assign({}, c, {values: numbers(c.values)}));
  curves.sort((a, b) => (b.style === 'measured') - (a.style === 'measured'));
  const chart = {panel, box, svg, read, curves};
  const at = event => {
    const place = svg.getBoundingClientRect();
    return chart.time((event.clientX - place.left) * svg.viewBox.baseVal.width / place.width);
  };
  svg.addEventListener('pointermove', event => {
    if (event.buttons) { stop(); seek(at(event)); } else markAll(at(event));
  });
  svg.addEventListener('pointerdown', event => { stop(); seek(at(event)); });
  svg.addEventListener('pointerleave', () => markAll(state.now));
  return chart;
}

const charts = REPORT.panels.map(newChart), listeners = [];
const markAll = at => charts.forEach(chart => mark(chart, at));
const slider = byId('slider0'), button = byId('play0'), clock = byId('clock0');

function seek(at) {
  const [t0, t1] = range();
  state.now = Math.min(Math.max(at, t0), t1);
  slider.value = Math.round(1000 * state.now);
  clock.textContent = shown(state.now, 2) + ' s';
  markAll(state.now);
  listeners.forEach(show => show(state.now));
}
function drawAll() {
  const [t0, t1] = range();
  slider.min = Math.floor(1000 * t0);
  slider.max = Math.ceil(1000 * t1);
  charts.forEach(draw);
  seek(state.now);
}
function stop() {
  if (state.playing !== null) cancelAnimationFrame(state.playing);
  state.playing = null;
  button.textContent = '\\u25b6 play';
}
function play() {
  const [t0, t1] = range();
  if (state.now >= t1 - 1e-3) seek(t0);
  const begin = performance.now() - 1000 * state.now;
  button.textContent = '\\u23f8 pause';
  const step = now => {
    seek((now - begin) / 1000);
    if (state.now >= range()[1]) stop(); else state.playing = requestAnimationFrame(step);
  };
  state.playing = requestAnimationFrame(step);
}
button.onclick = () => state.playing === null ? play() : stop();
slider.oninput = () => { stop(); seek(slider.value / 1000); };
byId('whole').onchange = event => { state.whole = event.target.checked; drawAll(); };
byId('limits').onchange = event => { state.limits = event.target.checked; drawAll(); };
let drawnWidth = 0;
new ResizeObserver(() => {
  const width = document.body.clientWidth;
  if (width !== drawnWidth) { drawnWidth = width; requestAnimationFrame(drawAll); }
}).observe(document.body);
"""
