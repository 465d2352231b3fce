"""The report opens from disk, in a browser without a network, and its 3-D view moves."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
import json
from pathlib import Path
import re
import subprocess
import sys
from xml.sax.saxutils import quoteattr

from bags import paper_motion, write
from live_helpers import LIVE
import matplotlib.image
import numpy as np
import pytest

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.report import _for_script, page_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import build_robot
from redundant_planner.tools.analyze_bag import main as analyze_bag

# A joint's name, as nobody names a joint.
MEAN = '</script><script>document.title="__DATA__"</script><!--&amp;<b>'


class Page(HTMLParser):
    """Collects what is in the page."""

    def __init__(self):
        """Begin without any."""
        super().__init__()
        self.scripts, self.texts, self.in_script = [], [], False

    def handle_starttag(self, tag, attrs):
        self.in_script = tag == 'script'

    def handle_endtag(self, tag):
        self.in_script = False

    def handle_data(self, data):
        (self.scripts if self.in_script else self.texts).append(data)


def mean_arm(robot):
    """The paper's arm, one joint of which has a mean name."""
    file = share_directory() / 'config' / 'robots' / 'paper_2p5r.yaml'
    parameters, capsules = read_robot_parameters(file)
    return build_robot(parameters, robot.urdf.replace('"theta4"', quoteattr(MEAN)), capsules)


def data_line(script):
    """The data that the page's script draws, as JSON."""
    line = next(line for line in script.splitlines() if line.startswith('const REPORT = '))
    return line.removeprefix('const REPORT = ').rstrip(';')


def data_of(page):
    parsed = Page()
    parsed.feed(page)
    return json.loads(data_line(parsed.scripts[1]))


@pytest.fixture(scope='module')
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp('report')
    robot, parameters, motion = paper_motion(3.0)
    bag = write(folder / 'motion', mean_arm(robot), parameters, motion)
    assert analyze_bag([str(bag), '--report', str(folder / 'out')]) == 0
    return folder / 'out'


def test_it_is_one_file_that_asks_for_nothing(report):
    page = report / 'report.html'
    assert page.stat().st_size < 8_000_000
    ours = re.sub(r'<script>/\*\*.*?</script>', '', page.read_text(), flags=re.DOTALL)
    assert not re.search(r'(src|href)\s*=\s*["\']?(https?:)?//', ours)
    for kind in ('motion', 'displacement', 'velocity', 'acceleration'):
        for suffix in ('png', 'svg'):
            assert (report / f'motion_{kind}.{suffix}').stat().st_size > 10_000


def test_names_from_a_bag_are_text_and_nothing_else(report):
    page = Page()
    page.feed((report / 'report.html').read_text(encoding='utf-8'))
    assert len(page.scripts) == 2 and 'Plotly.newPlot' in page.scripts[1]
    # The tables show the name; the script's data hold it, and it becomes text and no markup.
    assert MEAN in page.texts
    line = data_line(page.scripts[1])
    assert not set('<>&') & set(line)
    assert MEAN in [panel['title'] for panel in json.loads(line)['panels']]
    assert '.innerHTML = drawn' in page.scripts[1] and page.scripts[1].count('innerHTML') == 1


def test_data_stay_within_their_script():
    data = ['</script>', '<!--', '&', '\u2028\u2029', '"']
    text = _for_script(data)
    assert not set('<>&\u2028\u2029') & set(text)
    assert json.loads(text) == data


def test_of_ten_thousand_obstacles_the_page_shows_the_nearest(tmp_path):
    """And of those that are as large as a planet, or as far away, none."""
    robot, parameters, motion = paper_motion(0.4)
    places = np.random.default_rng(1).uniform(-1.5, 1.5, (2000, 3))
    obstacles = [Obstacle(str(i), place, np.full(3, 0.02)) for i, place in enumerate(places)]
    obstacles += [Obstacle('planet', np.array([1e7, 0.0, 0.0]), np.full(3, 9.9e6)),
                  Obstacle('far', np.full(3, 1e300), np.full(3, 0.1))]
    found = analyse(write(tmp_path / 'motion', robot, parameters, motion))
    scenes = tuple((0.005 * i, Scene.of(obstacles)) for i in range(80))
    page = page_of([replace(found, curves=replace(found.curves, scenes=scenes))])
    assert len(page) < 40_000_000
    assert 'the 3-D view leaves out up to' in page


@pytest.mark.long
@LIVE
@pytest.mark.parametrize(('width', 'height'), [(1200, 900), (400, 800)])
def test_the_view_plays_without_an_error_on_a_screen_and_on_a_phone(
        report, tmp_path, width, height):
    pytest.importorskip('PySide6.QtWebEngineCore', reason='pip install ".[browser]" brings it',
                        exc_type=ImportError)
    done = subprocess.run(
        [sys.executable, str(Path(__file__).parent.parent / 'browser.py'),
         str(report / 'report.html'), str(width), str(height), str(tmp_path)],
        capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen['errors'] == []
    assert seen['scripts'] == 2
    assert seen['scroll_width'] <= width
    assert 0.3 < float(seen['clock'].split()[0]) < 3.1
    before, after = (matplotlib.image.imread(seen[key])[:, :, :3] for key in ('before', 'after'))
    view = slice(100, int(0.6 * height))
    # The arm's dark line is there, and elsewhere after a second and a half.
    dark = [(shot[view].max(axis=2) < 0.45) for shot in (before, after)]
    assert all(shot.sum() > 100 for shot in dark)
    assert (dark[0] != dark[1]).sum() > 50
    # And the obstacle is red.
    red = (after[view, :, 0] > 0.6) & (after[view, :, 1:].max(axis=2) < 0.55)
    assert red.sum() > 30
