"""The report's style sheet: light and dark, on a screen, a phone and paper."""

from __future__ import annotations

_LIGHT = """color-scheme: light; --paper: #ffffff; --card: #f6f8fa; --ink: #1c2430;
  --muted: #5b6675; --rule: #dde2e8; --grid: #e9edf1; --limit: #a3241c; --good: #00694f;
  --bad: #a3241c; --s0: #0b6bb3; --s1: #c44e12; --s2: #007a5e; --s3: #8f4a9e;
  --s4: #7a5c00; --s5: #5b6675; --arm: #6f8fb3; --bone: #1f3a5f; --obstacle: #d5703c;
  --path: #007a5e; --ghost: #98a4b3;"""
_DARK = """color-scheme: dark; --paper: #12161c; --card: #1b212a; --ink: #e6eaf0; --muted: #9aa6b5;
  --rule: #303945; --grid: #262e39; --limit: #ff8f85; --good: #5fd0aa; --bad: #ff8f85;
  --s0: #63b3ed; --s1: #f2935c; --s2: #5fd0aa; --s3: #c996d8; --s4: #dcb94a; --s5: #9aa6b5;
  --arm: #7fa3cc; --bone: #d3e1f2; --obstacle: #e08a58; --path: #5fd0aa; --ghost: #5f6d7e;"""

STYLE = f"""
:root, .on-paper {{ {_LIGHT} }}
@media screen and (prefers-color-scheme: dark) {{ :root:not([data-theme=light]) {{ {_DARK} }} }}
@media screen {{ :root[data-theme=dark] {{ {_DARK} }} }}
""" + """
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; margin: 0;
  color: var(--ink); background: var(--paper); font-variant-numeric: tabular-nums; }
header, main { max-width: 1180px; margin: 0 auto; padding: 0 20px; }
header { display: flex; justify-content: space-between; align-items: start; gap: 16px;
  padding-top: 28px; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0; overflow-wrap: anywhere;
  letter-spacing: -.01em; }
h2 { font-size: 1.15rem; margin: 40px 0 4px; } h3 { font-size: 1rem; margin: 24px 0 8px; }
h2, .legend span, .views > div, .facts td { overflow-wrap: anywhere; min-width: 0; }
p { margin: 0; } .lead { color: var(--muted); margin-bottom: 12px; max-width: 72ch; }
button, .bar label { font: inherit; color: inherit; }
button { background: var(--card); border: 1px solid var(--rule); border-radius: 6px;
  padding: 4px 12px; cursor: pointer; }
button:focus-visible, input:focus-visible { outline: 2px solid var(--s0); outline-offset: 2px; }

.tiles { list-style: none; margin: 24px 0 0; padding: 0; display: grid; gap: 12px;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 240px), 1fr)); }
.tile { background: var(--card); border-radius: 8px; border-left: 4px solid var(--rule);
  padding: 12px 14px; min-width: 0; }
.tile.good { border-left-color: var(--good); } .tile.bad { border-left: 4px double var(--bad);
  box-shadow: inset 0 0 0 1px var(--bad); }
.tile h3 { font-size: .82rem; font-weight: 600; color: var(--muted); margin: 0 0 4px; }
.tile .value b { font-size: 1.55rem; font-weight: 650; letter-spacing: -.02em; }
.tile .value span, .tile .verdict, .tile .detail { font-size: .82rem; color: var(--muted); }
.tile.good strong { color: var(--good); } .tile.bad strong { color: var(--bad); }
.tile .detail, .tile .difference { font-size: .78rem; overflow-wrap: anywhere; }
.tile .value + .verdict { line-height: 1.3; } .tile .value:not(:nth-child(2)) { margin-top: 6px; }
.tile .difference { margin-top: 8px; padding-top: 6px; border-top: 1px solid var(--rule); }
.key { font-style: normal; font-weight: 700; font-size: .72rem; padding: 1px 6px;
  border-radius: 4px; color: var(--paper); background: var(--s0); vertical-align: 2px; }
.s1 { --c: var(--s1); } .s2 { --c: var(--s2); } .s3 { --c: var(--s3); } .s4 { --c: var(--s4); }
.s5 { --c: var(--s5); } .s0 { --c: var(--s0); } .key, .swatch { background: var(--c); }

.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .88rem; }
td, th { padding: 4px 12px; text-align: right; border-bottom: 1px solid var(--rule);
  white-space: nowrap; font-weight: 400; }
thead th { color: var(--muted); font-weight: 600; vertical-align: bottom; white-space: normal;
  min-width: 84px; } th:first-child { text-align: left; padding-left: 0; }
.groups th { text-align: center; border-bottom: 0; padding-top: 0; }
.units td, .units th, .unit { color: var(--muted); font-size: .8rem; }
.units th { font-weight: 600; padding-top: 14px; } .beyond { color: var(--bad); font-weight: 700; }
.facts { margin-top: 16px; } .facts td { text-align: left; white-space: normal; }
.facts tr:first-child th { text-align: left; }
.facts td, .facts th { border: 0; padding: 2px 24px 2px 0; vertical-align: top; }
.facts th[scope=row] { color: var(--muted); min-width: 0; }
.notes { margin: 20px 0 0; padding: 10px 14px 10px 32px; border-left: 4px solid var(--s4);
  background: var(--card); border-radius: 8px; font-size: .88rem; overflow-wrap: anywhere; }

.motion { display: grid; gap: 8px 28px; } .motion .charts { align-content: start; }
@media screen and (min-width: 900px) { .motion:not(.several) { grid-template-columns: 5fr 3fr; }
  .motion:not(.several) .charts { grid-template-columns: 1fr; } }
.views:empty { display: none; } .motion:not(.several):has(.views:empty) { display: block; }
.views { display: grid; gap: 12px; grid-template-columns: repeat(auto-fit,
  minmax(min(100%, 420px), 1fr)); }
.views > div { min-width: 0; } .view { width: 100%; height: min(68vh, 540px); }
.picture { display: none; width: 100%; }
.legend { display: flex; flex-wrap: wrap; gap: 4px 18px; font-size: .82rem; color: var(--muted);
  margin-bottom: 8px; } .legend svg { vertical-align: middle; margin-right: 6px; }
.swatch { display: inline-block; width: 12px; height: 12px; border-radius: 3px;
  vertical-align: -1px; margin-right: 6px; }
.charts { display: grid; gap: 18px 20px; grid-template-columns: repeat(auto-fill,
  minmax(min(100%, 250px), 1fr)); }
.chart { min-width: 0; margin: 0; display: flex; flex-direction: column; }
.chart figcaption { font-size: .82rem; line-height: 1.35; min-height: 2.7em; display: grid;
  grid-template-columns: minmax(0, 1fr) auto; column-gap: 8px; margin-bottom: auto; }
.chart b { grid-column: 1 / -1; font-weight: 600; overflow-wrap: anywhere; }
.chart small { color: var(--muted); }
.chart svg { display: block; width: 100%; height: auto; touch-action: pan-y; cursor: crosshair; }
.chart text { fill: var(--muted); font-size: 10.5px; } .grid { stroke: var(--grid); }
.zero { stroke: var(--rule); stroke-width: 1.5; } .now { stroke: var(--ink); opacity: .55; }
.limit { stroke: var(--limit); stroke-width: 1.2; } .over { fill: var(--limit); opacity: .08; }
.chart .limit-text { fill: var(--limit); }
.curve { fill: none; stroke: var(--c); stroke-linejoin: round; }
.commanded { stroke-width: 1.5; }
.measured { stroke-width: 3.2; stroke-dasharray: 6 3; opacity: .6; }

.bar { position: sticky; bottom: 0; z-index: 2; background: var(--paper); margin-top: 24px;
  border-top: 1px solid var(--rule); padding: 10px 0; display: flex; flex-wrap: wrap;
  gap: 8px 14px; align-items: center; font-size: .88rem; }
.bar button { width: 5.2em; } .bar input[type=range] { flex: 1 1 160px; min-width: 0;
  accent-color: var(--s0); } #clock0 { min-width: 5.5em; text-align: right; }
.bar label { white-space: nowrap; } .bar input[type=checkbox] { accent-color: var(--s0); }
@media (max-width: 560px) { header, main { padding-left: 14px; padding-right: 14px; }
  .tiles { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 8px; }
  .tile { padding: 10px; } .tile .value b { font-size: 1.3rem; } h1 { font-size: 1.35rem; }
  .view { height: 360px; } .facts td { padding-right: 0; } }
@media print { @page { margin: 14mm; } body { font-size: 10.5pt; }
  .bar, #theme, .view { display: none; } .picture { display: block; }
  header, main { max-width: none; padding: 0; } .scroll { overflow: visible; }
  .views { grid-template-columns: repeat(auto-fit, minmax(80mm, 1fr)); }
  figcaption span { display: none; } table { font-size: 7.4pt; }
  td, th { padding: 2px 4px; white-space: normal; }
  thead th { min-width: 0; } .tiles { grid-template-columns: repeat(4, 1fr); }
  .charts { grid-template-columns: repeat(3, 1fr); } .now { display: none; }
  .tile, .chart, tr, .views > div { break-inside: avoid; } h2, h3 { break-after: avoid; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""
