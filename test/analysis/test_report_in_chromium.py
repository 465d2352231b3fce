"""The report in a headless Chromium, where one is installed: a script of the test looks around."""

from __future__ import annotations

import json

from bags import paper_motion, write
from chromium import browser, Chromium
import pytest

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.report import page_of

pytestmark = pytest.mark.skipif(browser() is None, reason='there is no Chromium on PATH')

BEFORE = """<script>
const troubles = [];
addEventListener('error', event => troubles.push(String(event.message)));
addEventListener('unhandledrejection', event => troubles.push(String(event.reason)));
</script>"""
# What stands out beyond the right edge, but for what scrolls by itself.
AFTER = """<script>setTimeout(() => {
  const asked = document.documentElement.getBoundingClientRect().right;
  const outside = [...document.querySelectorAll('main *, header *')].filter(one =>
    !one.closest('.scroll, .view, svg') && one.getBoundingClientRect().right > asked + 1);
  const before = {clock: clock0.textContent, cursor: cursorPlace(),
                  traces: document.getElementById('view0').data.map(
                    trace => trace.x.filter(Number.isFinite).length)};
  whole.click();
  const ticks = document.querySelectorAll('#charts-velocity .chart')[0].textContent;
  whole.click();
  play0.click();
  let looks = 0;
  const watch = setInterval(() => {
    if (clock0.textContent === before.clock && ++looks < 200) return;
    clearInterval(watch);
    document.title = 'SEEN' + JSON.stringify({
    before, ticks, troubles, width: asked,
    scrollWidth: document.documentElement.scrollWidth,
    outside: outside.map(one => one.className + ' ' + one.tagName), clock: clock0.textContent,
    cursor: cursorPlace(), background: getComputedStyle(document.body).backgroundColor,
    canvases: document.querySelectorAll('#view0 canvas').length,
    views: document.querySelectorAll('.view canvas').length,
    cut: [...document.querySelectorAll('.chart b')].filter(
      one => one.scrollWidth > one.clientWidth).map(one => one.textContent),
    curves: [...document.querySelectorAll('path.curve')].map(one => one.getAttribute('d').length),
    bad: document.querySelectorAll('.chart svg *').length
      && document.querySelector('.charts').innerHTML.includes('NaN')})}, 300);
}, 3000);
const cursorPlace = () => document.querySelector('.now').getAttribute('transform');
</script>"""


def seen(tmp_path, page, width, scheme='light'):
    """Open a page and return what the script saw."""
    file = tmp_path / 'page.html'
    file.write_text(page.replace('</head>', BEFORE + '</head>', 1).replace(
        '</body></html>', AFTER + '</body></html>'), encoding='utf-8')
    with Chromium() as chromium:
        tab = chromium.open('about:blank')
        tab.call('Emulation.setDeviceMetricsOverride', width=width, height=900,
                 deviceScaleFactor=1, mobile=False)
        tab.call('Emulation.setEmulatedMedia',
                 features=[{'name': 'prefers-color-scheme', 'value': scheme}])
        tab.go_to(file.as_uri())
        tab.wait_for("document.title.startsWith('SEEN')")
        return json.loads(tab.value('document.title').removeprefix('SEEN'))


@pytest.fixture(scope='module')
def analyses(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bags')
    found = []
    for name, method in (('dynamic_factor', 'dynamic_factor'), ('other' * 12, 'variational')):
        robot, parameters, motion = paper_motion(1.0, method)
        found.append(analyse(write(folder / name, robot, parameters, motion)))
    return found


@pytest.mark.parametrize('bags', [1, 2])
@pytest.mark.parametrize('width', [400, 1280])
def test_it_fits_is_drawn_at_once_and_plays(analyses, tmp_path, bags, width):
    result = seen(tmp_path, page_of(analyses[:bags]), width)
    assert result['troubles'] == []
    assert result['width'] <= width and result['outside'] == []
    assert result['cut'] == []  # titles
    assert result['scrollWidth'] <= width
    # Links, chain, obstacles, tip, trail so far, whole trail and first posture, before it plays.
    counts = result['before']['traces']
    assert len(counts) == 7 and all(count > 0 for count in counts) and counts[5] > 100
    assert result['views'] >= bags and result['canvases'] > 0
    assert result['before']['clock'] == '0.00 s' != result['clock']
    assert result['before']['cursor'] != result['cursor']
    # Three diagrams of the arm; of each joint one of its position, velocity, acceleration.
    assert len(result['curves']) == bags * (3 + 7 * 4)
    assert min(result['curves']) > 50 and not result['bad']


@pytest.mark.long
def test_light_and_dark_follow_the_system(analyses, tmp_path):
    page = page_of(analyses[:1])
    assert seen(tmp_path, page, 800)['background'] == 'rgb(255, 255, 255)'
    dark = seen(tmp_path, page, 800, 'dark')
    assert dark['background'] == 'rgb(18, 22, 28)'
