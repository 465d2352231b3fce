"""The demo as a user starts it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
import os
import signal
import subprocess
import sys
import time

from live_helpers import children_of, LIVE, PATIENCE
import pytest

from redundant_planner.nodes.child_processes import die_with
from redundant_planner.tools.demo import main

pytestmark = LIVE
COMMAND = [sys.executable, '-m', 'redundant_planner.tools.demo']


def start(tmp_path, *arguments):
    marker = f'DEMO_TEST={tmp_path}'
    environment = dict(os.environ, DEMO_TEST=str(tmp_path))
    return marker, subprocess.Popen(
        [*COMMAND, '--out', str(tmp_path / 'out'), *arguments], env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def wait_for_children(marker, enough, patience=PATIENCE):
    deadline = time.monotonic() + patience
    while not enough(len(children_of(marker))):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.long
def test_it_ends_by_itself_and_leaves_a_report_and_nothing_else(tmp_path):
    marker, demo = start(tmp_path)
    out, err = demo.communicate(timeout=2.0 * PATIENCE)
    assert demo.returncode == 0, out + err
    for text in ('displacement', 'smallest distance of a link', 'joint_command period'):
        assert text in out
    assert (tmp_path / 'out' / 'paper.png').stat().st_size > 20_000
    assert list((tmp_path / 'out' / 'paper').glob('*.mcap'))
    assert (tmp_path / 'out' / 'report' / 'report.html').stat().st_size < 8_000_000
    assert not children_of(marker)


@pytest.mark.long
def test_with_physics_the_arm_touches_nothing(tmp_path):
    marker, demo = start(tmp_path, '--physics')
    out, err = demo.communicate(timeout=2.0 * PATIENCE)
    assert demo.returncode == 0, out + err
    row = {line.split('│')[1].strip(): line.split('│')[2].strip()
           for line in out.splitlines() if line.count('│') == 3}
    assert row['contacts'] == '0'
    share, joint = row['largest torque asked for'].split('% of its limit ')
    assert 0 < int(share) < 90 and joint.startswith('(panda_joint')
    assert (tmp_path / 'out' / 'panda_obstacles.png').stat().st_size > 20_000
    assert not children_of(marker)


def test_a_viewer_takes_physics(tmp_path):
    _, demo = start(tmp_path, '--viewer')
    _, err = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 2 and 'give --physics as well' in err


@pytest.mark.long
def test_interrupted_it_leaves_no_process_behind(tmp_path):
    """By Ctrl-C in the motion, and by others in the start."""
    def interrupt(number):
        marker, demo = start(tmp_path / number.name)
        # The demo, arm and planner; then the player as well.
        enough = 4 if number == signal.SIGINT else 3
        wait_for_children(marker, lambda count: count >= enough)
        demo.send_signal(number)
        _, err = demo.communicate(timeout=PATIENCE)
        assert demo.returncode != 0, number
        assert 'Traceback' not in err, number
        wait_for_children(marker, lambda count: not count)

    with ThreadPoolExecutor() as pool:
        list(pool.map(interrupt, (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)))


def test_a_child_whose_parent_died_before_it_was_set_up_ends_at_once():
    gone = subprocess.Popen(['true'])
    gone.wait()
    child = subprocess.Popen(['sleep', '60'], preexec_fn=partial(die_with, gone.pid))
    assert child.wait(timeout=PATIENCE) != 0


@pytest.mark.parametrize(('arguments', 'message'), [
    (['--scenario', '/no/such.yaml'], "'/no/such.yaml' is not a file"),
    (['--urdf', '/no/such.urdf'], "'/no/such.urdf' is not a file"),
])
def test_bad_input_is_one_readable_line(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.setattr(signal, 'signal', lambda number, handler: None)
    assert main(['--out', str(tmp_path / 'out'), *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err and 'Traceback' not in err
