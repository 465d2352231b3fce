"""The report shows the motion, and not the time that the arm stood still before and after."""

from __future__ import annotations

from bags import KINDS, ns
import numpy as np
import pytest

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.motion_interval import (
    command_begin,
    motion_interval,
    shown_interval,
    shown_together,
)
from redundant_planner.io.bag_writer import BagWriter

DT = 0.01


def swing(path, before, moving, after, commands=True, noise=0.0, peak=0.2):
    """A joint at rest, then moving as a sine squared, then at rest."""
    random = np.random.default_rng(3)
    times = DT * np.arange(round((before + moving + after) / DT) + 1)
    phase = np.clip((times - before) / moving, 0.0, 1.0)
    speeds = peak * np.sin(np.pi * phase) ** 2
    positions = np.concatenate(((0.0,), np.cumsum(speeds[:-1]) * DT))
    with BagWriter(path) as bag:
        for topic in ('joint_states', 'joint_command'):
            bag.add_topic(f'/{topic}', KINDS[topic])
        for time, q, dq in zip(times, positions, speeds):
            bag.write_joints('/joint_states', ns(time), ('a',), np.array([q]),
                             np.array([dq + noise * random.standard_normal()]))
            if commands:
                bag.write_joints('/joint_command', ns(time), ('a',), np.array([q]),
                                 np.array([dq]))
    return analyse(path).curves


@pytest.mark.parametrize(('commands', 'noise'), [(True, 0.0), (False, 0.0), (True, 0.02)])
def test_it_is_the_time_in_which_the_joint_is_faster_than_a_hundredth_of_its_peak(
        tmp_path, commands, noise):
    curves = swing(tmp_path / 'bag', 2.0, 1.0, 3.0, commands, noise)
    # sin² is 0.01 where its argument is asin(0.1).
    late = np.arcsin(0.1) / np.pi
    np.testing.assert_allclose(
        motion_interval(curves), (2.0 + late, 3.0 - late), atol=1.01 * DT)
    begin, end = shown_interval(curves)
    assert begin == pytest.approx(motion_interval(curves)[0] - 0.1)
    assert end == pytest.approx(motion_interval(curves)[1] + 0.1)


def test_of_an_arm_that_never_moves_all_is_shown(tmp_path):
    curves = swing(tmp_path / 'bag', 1.0, 1.0, 1.0, peak=0.0)
    assert motion_interval(curves) == (0.0, pytest.approx(3.0))
    assert shown_interval(curves) == motion_interval(curves)


def test_the_margin_ends_with_the_recording(tmp_path):
    curves = swing(tmp_path / 'bag', 0.0, 1.0, 0.0)
    assert shown_interval(curves) == (0.0, pytest.approx(1.0))


def test_two_recordings_begin_together(tmp_path):
    """What is shown of both covers either one's motion, from the begin of each."""
    early = swing(tmp_path / 'early', 1.0, 1.0, 2.0)
    late = swing(tmp_path / 'late', 3.0, 2.0, 1.0)
    begin, end = shown_together([early, late])
    for curves in (early, late):
        one = np.array(shown_interval(curves)) - command_begin(curves)
        assert begin <= one[0] and end >= one[1]
    assert end - begin < 2.5
