"""The report opens from disk, in a browser without a network, and its 3-D view moves."""

from __future__ import annotations

import json
from pathlib import Path
import re
import subprocess
import sys

from bags import paper_motion, write
from live_helpers import LIVE
import matplotlib.image
import pytest

from redundant_planner.analysis.analyze_bag import main as analyze_bag


@pytest.fixture(scope='module')
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp('report')
    bag = write(folder / 'motion', *paper_motion(3.0))
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


@LIVE
@pytest.mark.parametrize(('width', 'height'), [(1200, 900), (400, 800)])
def test_the_view_plays_without_an_error_on_a_screen_and_on_a_phone(
        report, tmp_path, width, height):
    pytest.importorskip('PySide6.QtWebEngineCore', reason='pip install ".[browser]" brings it',
                        exc_type=ImportError)
    done = subprocess.run(
        [sys.executable, str(Path(__file__).parent / 'browser.py'),
         str(report / 'report.html'), str(width), str(height), str(tmp_path)],
        capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen['errors'] == []
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
