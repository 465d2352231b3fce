"""identify_delay: from a bag, and from a small motion of real nodes."""

from __future__ import annotations

import json
import subprocess
import sys

from bags import KINDS, ns
from conftest import PANDA_READY, PANDA_URDF, ROBOTS
from live_helpers import LIVE, PATIENCE, station
import numpy as np
import pytest

from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.tools.identify_delay import main as identify_delay
from redundant_planner.tools.to_and_fro import swing

DT, LATE = 0.004, 5
NAMES = ('a', 'b')


def write_bag(path, topics=('joint_states', 'joint_command'), held=False, late=LATE, noise=0.0):
    """Record an arm that follows its commands some ticks later, or does not follow."""
    random = np.random.default_rng(5)
    q = np.zeros(2)
    told = [np.zeros(2)] * late
    with BagWriter(path) as bag:
        for topic in topics:
            bag.add_topic(f'/{topic}', KINDS[topic])
        for i in range(1000):
            dq = np.array([1.0, -0.5]) * swing(0.2, 3.5, DT * i)
            if 'joint_states' in topics:
                bag.write_joints('/joint_states', ns(DT * i), NAMES,
                                 q + noise * random.normal(size=2), dq)
            if 'joint_command' in topics:
                bag.write_joints('/joint_command', ns(DT * i), NAMES, q, dq)
            told.append(dq)
            q = q + (0.0 if held else DT) * told.pop(0)
    return path


def test_a_bag_tells_how_late_the_arm_is(tmp_path, capsys):
    path, file = write_bag(tmp_path / 'run'), tmp_path / 'delay.json'
    assert identify_delay([str(path), '--json', str(file)]) == 0
    out = capsys.readouterr().out
    assert 'drive.lag: 0.00' in out and 'drive.dead_time: 0.0' in out
    found = json.loads(file.read_text())
    assert set(found['joints']) == set(NAMES)
    assert found['all']['lag'] + found['all']['dead_time'] == pytest.approx(DT * LATE, abs=1e-3)
    assert found['all']['dead_time'] == pytest.approx(DT * LATE, abs=3e-3)


def test_no_lag_is_said_to_be_none(tmp_path, capsys):
    path, file = write_bag(tmp_path / 'run', late=0, noise=1e-4), tmp_path / 'delay.json'
    assert identify_delay([str(path), '--json', str(file)]) == 0
    out = capsys.readouterr().out
    assert 'no lag that can be told from none' in out and '±' not in out
    assert 'drive.lag: 0.000' in out and 'drive.dead_time: 0.000' in out
    whole = json.loads(file.read_text())['all']
    assert whole['lag_error'] is None and whole['dead_time_error'] is None


@pytest.mark.parametrize('bag, message', [
    ({'topics': ('joint_states',)}, 'has no joint_command'),
    ({'topics': ('joint_command',)}, 'has no joint_states'),
    ({'held': True}, 'not explained'),
])
def test_what_tells_nothing_ends_in_a_sentence(tmp_path, capsys, bag, message):
    assert identify_delay([str(write_bag(tmp_path / 'run', **bag))]) == 2
    assert message in capsys.readouterr().err


def test_a_motion_is_asked_for_and_bounded(capsys):
    assert identify_delay(['--live', '--distance', '3']) == 2
    assert '(0, 0.2]' in capsys.readouterr().err
    # Without a terminal nobody can agree.
    done = subprocess.run(
        [sys.executable, '-m', 'redundant_planner.tools.identify_delay', '--live'],
        stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert done.returncode == 2 and '--yes moves without asking' in done.stderr


class TestLive:
    """With real nodes."""

    pytestmark = LIVE

    @pytest.mark.long
    def test_a_small_motion_tells_how_late_fake_hardware_is(self, tmp_path):
        names = [f'panda_joint{i}' for i in range(1, 8)]
        file = tmp_path / 'delay.json'
        with station() as (ros, processes):
            processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], {
                'urdf': PANDA_URDF, 'initial_joints': names, 'lag': 0.03,
                'initial_positions': list(PANDA_READY)})
            processes.start('planner_node', [ROBOTS / 'panda.yaml'], {'urdf': PANDA_URDF})
            ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')

            def run():
                return subprocess.run(
                    [sys.executable, '-m', 'redundant_planner.tools.identify_delay', '--live',
                     '--yes', '--duration', '3', '--json', str(file)], timeout=PATIENCE,
                    env=processes.environment, capture_output=True, text=True)

            other = run()
            assert other.returncode == 2 and 'somebody else publishes cmd_vel' in other.stderr
            ros.node.destroy_publisher(ros.twist)
            ros.wait_for(lambda: not ros.node.count_publishers('cmd_vel'), 'its end')
            done = run()
            assert done.returncode == 0, done.stderr
        found = json.loads(file.read_text())['all']
        # Beside its dead time, the way of the messages and up to a period of the states.
        assert 0.028 < found['lag'] + found['dead_time'] < 0.045
        assert found['joints'] >= 3
