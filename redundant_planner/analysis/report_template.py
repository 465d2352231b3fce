"""The report's page before anything is filled in.

`report.page_of` replaces the names between double underscores.
"""

from __future__ import annotations

from redundant_planner.analysis.report_charts import CHARTS
from redundant_planner.analysis.report_scene import SCENE
from redundant_planner.analysis.report_style import STYLE

PAGE = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>__TITLE__</title>
<style>{STYLE}</style></head><body>
<header><h1>__TITLE__</h1><button id="theme" aria-label="light or dark"></button></header>
<main>
__BODY__
<div class="bar">
<button id="play0" aria-label="play or pause">&#9654; play</button>
<input id="slider0" type="range" min="0" max="1" step="1" value="0" aria-label="time">
<span id="clock0"></span>
<label><input id="whole" type="checkbox"> whole recording</label>
<label><input id="limits" type="checkbox"> scale to the limits</label>
</div>
</main>
<script>__PLOTLY__</script>
<script>
const REPORT = __DATA__;
{CHARTS}{SCENE}</script></body></html>
"""
