"""benchmark.streams: what is sent, and what it says of it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmark.robots import make_robot
from benchmark.sent_motions import Input, INPUTS, messages, motion
from benchmark.streams import judged, main, run_stream, start_of
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.se3 import Pose

ROBOT = make_robot('panda', 6)
START = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_motions_begin_where_the_arm_is_at_rest(seed):
    arm, signal = ROBOT.kinematics(START), motion(ROBOT, START, seed, joints=False)
    np.testing.assert_allclose(signal(0.0).position, arm.tip_position, atol=5e-4)
    np.testing.assert_allclose(signal(0.0).rotation, arm.tip_rotation, atol=1e-12)
    assert np.linalg.norm(signal(0.004).position - signal(0.0).position) < 1e-4
    swing = motion(ROBOT, START, seed, joints=True)
    np.testing.assert_allclose(swing(0.0), START)


def test_messages_are_as_their_input_says():
    signal = motion(ROBOT, START, 0, joints=False)
    plain = messages(signal, Input(30), 0)
    assert [m.arrival for m in plain] == [m.stamp for m in plain] and len(plain) == 331
    bursts = messages(signal, Input(72, burst=0.2), 0)
    assert all(0.0 <= m.arrival - m.stamp < 0.2 for m in bursts)
    assert len({m.arrival for m in bursts}) == 56
    gaps = np.diff([m.stamp for m in messages(signal, Input(72, gaps=True), 0)])
    assert sorted(gaps)[-6] < 0.02 and gaps.max() > 0.14
    wrong = [m for m in messages(signal, Input(30, wrong=True), 0) if isinstance(m.target, Pose)
             and np.linalg.norm(m.target.position - signal(m.stamp).position) > 0.1]
    assert len(wrong) == 5


def test_an_arm_that_is_hardly_fast_enough_does_not_swing_about_a_stream():
    """A hand as fast as the joints can accelerate, and a millimetre of noise.

    An arm that takes more speed to make good what it is behind than it can lose again swings:
    42 mm off, once.
    """
    parameters = PlannerParameters()
    start, signal, own = start_of(ROBOT, parameters, 8, joints=False)
    sent = messages(signal, INPUTS['72 Hz noise'], 8)
    ran = run_stream(ROBOT, parameters, start, sent, stamped=True)
    found = judged(ROBOT, signal, *ran, own, circle=False)
    assert found.farthest < 0.02
    assert found.violation == 0.0


@pytest.mark.long
def test_the_command_writes_all_its_numbers(tmp_path):
    out = tmp_path / 'json'
    assert main(['--count', '1', '--seed', '0', '--input', '30 Hz', '--input', 'joints 10 Hz',
                 '--json', str(out)]) == 0
    found = json.loads(out.read_text())
    assert set(found) == {'30 Hz', 'joints 10 Hz'} < set(INPUTS)
    for entry in found.values():
        assert set(entry) == {
            'reversals_median', 'reversals_max', 'lag_s', 'rms_mm', 'radius_error', 'thinking',
            'rest_share', 'violations', 'outlier_mm'}
        assert (entry['thinking'], entry['rest_share'], entry['violations']) == (0, 0, 0)
        assert entry['reversals_max'] <= 20 and entry['rms_mm'] < 2.0
    assert found['30 Hz']['lag_s'] < 0.1 and found['30 Hz']['radius_error'] < 0.02
