"""Peaks of what was commanded do not come from jitter."""

from __future__ import annotations

import json

from bags import ns, paper_motion
from conftest import examples
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.commanded import Commands
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.tools.analyze_bag import main as analyze_bag

DT, LIMIT = 0.004, 5.0


def limited(random, count, n=2):
    """Return commands (k, n) whose acceleration per tick reaches the limit, and no more."""
    changes = random.uniform(-1.0, 1.0, (count, n))
    changes[count // 2] = 1.0
    return np.cumsum(LIMIT * DT * changes, axis=0)


def places(dq):
    """Return the positions (k, n) of commands, each a period's motion on."""
    return DT * np.cumsum(dq, axis=0)


@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 10**6), jitter=st.floats(0.0, 0.9), parts=st.integers(1, 5))
def test_stamps_that_jitter_add_no_acceleration(seed, jitter, parts):
    random = np.random.default_rng(seed)
    dq = limited(random, 200)
    stamps = 10.0 + DT * (np.arange(200) + jitter * random.uniform(0.0, 1.0, 200))
    commands = Commands(2, DT)
    for part in zip(*(np.array_split(one, parts) for one in (stamps, places(dq), dq))):
        commands.add(*part)
    changes = np.abs(np.diff(dq, axis=0)).max(axis=0) / DT
    assert commands.count == 200
    np.testing.assert_allclose(commands.peaks.velocity, np.abs(dq).max(axis=0))
    jerks = np.abs(np.diff(dq, 2, axis=0)).max(axis=0) / DT ** 2
    np.testing.assert_allclose(commands.peaks.acceleration, changes)
    np.testing.assert_allclose(commands.peaks.jerk, jerks)
    # However they came in.
    whole = Commands(2, DT)
    whole.add(stamps, places(dq), dq)
    np.testing.assert_allclose(commands.peaks.jerk, whole.peaks.jerk)
    velocities, accelerations = commands.at(stamps + 1e-6)
    np.testing.assert_array_equal(velocities, dq)
    np.testing.assert_array_equal(accelerations[1:], whole.at(stamps + 1e-6)[1][1:])


def test_regular_commands_have_their_differences():
    dq = limited(np.random.default_rng(1), 100)
    commands = Commands(2, None)
    commands.add(DT * np.arange(100), places(dq), dq)
    acceleration = np.diff(dq, axis=0) / DT
    np.testing.assert_allclose(
        commands.peaks.acceleration, np.abs(acceleration).max(axis=0), rtol=1e-9)
    np.testing.assert_allclose(
        commands.peaks.jerk, np.abs(np.diff(acceleration, axis=0)).max(axis=0) / DT, rtol=1e-9)


def test_pauses_backward_stamps_and_missing_velocities_count_for_nothing():
    commands = Commands(1, DT)
    for stamps, dq in (([0.0, DT], [[0.0], [0.01]]), ([0.5 * DT, 2.0 * DT], [[9.0], [np.nan]]),
                       ([5.0, 5.0 + DT], [[1.0], [1.0]])):
        commands.add(np.array(stamps), np.zeros((2, 1)), np.array(dq))
    assert commands.count == 4
    assert commands.peaks.velocity[0] == 1.0
    assert commands.peaks.acceleration[0] == pytest.approx(0.01 / DT)
    assert np.isnan(commands.at(np.array([-1.0, 2.0]))[0]).all()
    assert np.isnan(Commands(1, DT).at(np.array([0.0]))[0]).all()


def test_a_command_that_was_lost_doubles_no_acceleration():
    """A bag over a bad network lacks some; the positions tell how many."""
    dq = LIMIT * DT * np.arange(1.0, 101.0)[:, None]
    kept = np.delete(np.arange(100), [40, 41, 60])
    commands = Commands(1, DT)
    commands.add(DT * kept, places(dq)[kept], dq[kept])
    np.testing.assert_allclose(commands.peaks.acceleration, LIMIT)
    assert commands.peaks.jerk[0] < 1e-6
    # Without positions the command after the gap is a late one: the peak is too high, not too low.
    blind = Commands(1, DT)
    blind.add(DT * kept, np.full((len(kept), 1), np.nan), dq[kept])
    assert blind.peaks.acceleration[0] == pytest.approx(3.0 * LIMIT)


@pytest.mark.long
def test_a_bag_of_jittering_messages_shows_what_was_commanded(tmp_path, capsys):
    robot, _, motion = paper_motion(0.1)
    random = np.random.default_rng(3)
    dq = np.cumsum(np.tile(robot.acceleration_max * DT, (50, 1)), axis=0) * 0.2
    with BagWriter(tmp_path / 'jitter') as bag:
        for topic in ('joint_states', 'joint_command'):
            bag.add_topic(f'/{topic}', 'sensor_msgs/msg/JointState')
        q = np.array(motion.positions[0])
        for i, velocity in enumerate(dq):
            late = ns(DT * (i + 0.8 * random.uniform()))
            bag.write_joints('/joint_states', late, robot.joint_names, q, velocity)
            bag.write_joints('/joint_command', late, robot.joint_names, q, velocity)
            q = q + DT * velocity
    found = analyse(tmp_path / 'jitter')
    told = 0.2 * robot.acceleration_max
    # Without a configuration the period is the median of the stamps'.
    assert (found.joints.peak_acceleration > 1.5 * told).any()
    assert (found.commanded.acceleration < 1.3 * told).all()
    assert analyze_bag([str(tmp_path / 'jitter'), '--json', str(tmp_path / 'a.json'),
                        '--csv', str(tmp_path / 'a.csv'), '--report', str(tmp_path / 'r')]) == 0
    printed = capsys.readouterr().out
    assert 'commanded' in printed and 'measured' in printed
    joint = json.loads((tmp_path / 'a.json').read_text())['bags'][0]['joints']['d1']
    assert joint['commanded_peak_acceleration'] < 1.3 * told[0]
    assert joint['commanded_peak_jerk'] > 0.0
    head = (tmp_path / 'a.csv').read_text().splitlines()[0]
    assert 'commanded_acceleration.d1' in head
    page = (tmp_path / 'r' / 'report.html').read_text()
    assert '<th scope="col">commanded</th>' in page and '>jerk</th>' in page
