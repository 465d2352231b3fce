"""The demo as a user starts it."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

COMMAND = [sys.executable, '-m', 'redundant_planner.analysis.demo']


def children_of(marker: str) -> list[str]:
    """Command lines of live processes of this package that carry a marker in their environment."""
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        try:
            if marker.encode() in (process / 'environ').read_bytes():
                found.append((process / 'cmdline').read_text())
        except OSError:
            continue
    return found


def start(tmp_path, *arguments):
    marker = f'DEMO_TEST={tmp_path}'
    environment = dict(os.environ, DEMO_TEST=str(tmp_path))
    return marker, subprocess.Popen(
        [*COMMAND, '--out', str(tmp_path / 'out'), *arguments], env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def test_it_ends_by_itself_and_leaves_a_report_and_nothing_else(tmp_path):
    marker, demo = start(tmp_path)
    out, err = demo.communicate(timeout=60)
    assert demo.returncode == 0, out + err
    for text in ('displacement', 'smallest whole-link clearance', 'joint_command period'):
        assert text in out
    assert (tmp_path / 'out' / 'paper.png').stat().st_size > 20_000
    assert list((tmp_path / 'out' / 'paper').glob('*.mcap'))
    assert (tmp_path / 'out' / 'report' / 'report.html').stat().st_size < 8_000_000
    assert not children_of(marker)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_interrupted_it_leaves_no_process_behind(tmp_path, number):
    marker, demo = start(tmp_path)
    deadline = time.monotonic() + 30.0
    while len(children_of(marker)) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(children_of(marker)) >= 4  # demo, arm, planner, player
    demo.send_signal(number)
    _, err = demo.communicate(timeout=20)
    assert demo.returncode != 0
    assert 'Traceback' not in err
    while children_of(marker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not children_of(marker)


@pytest.mark.parametrize(('arguments', 'message'), [
    (['--scenario', '/no/such.yaml'], "'/no/such.yaml' is not a file"),
    (['--urdf', '/no/such.urdf'], "'/no/such.urdf' is not a file"),
])
def test_bad_input_is_one_readable_line(tmp_path, arguments, message):
    _, demo = start(tmp_path, *arguments)
    _, err = demo.communicate(timeout=30)
    assert demo.returncode == 2
    assert message in err and 'Traceback' not in err
