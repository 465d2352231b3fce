"""The posture of a stamp, between measurements."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.perception.posture_buffer import (
    Fit,
    LONGEST_GAP,
    PostureBuffer,
    PosturesInParts,
)


def buffer_of(stamps, velocity_max=10.0, dq=None):
    """Joint i moves at the speed i + 1."""
    buffer = PostureBuffer(np.full(2, velocity_max))
    for stamp in stamps:
        buffer.add(stamp, np.array([1.0, 2.0]) * stamp, dq)
    return buffer


def test_postures_are_interpolated_and_speeds_are_those_of_the_motion():
    buffer = buffer_of(np.arange(100.0, 101.0, 0.01))
    for stamp in (100.0, 100.003, 100.01, 100.5049, 100.99):
        found = buffer.at(stamp)
        assert found.fit is Fit.KNOWN
        np.testing.assert_allclose(found.q, [stamp, 2.0 * stamp])
        if stamp > 100.0:
            np.testing.assert_allclose(found.speed, [1.0, 2.0], rtol=1e-6)


def test_the_largest_speed_counts_whichever_way_it_was_measured():
    np.testing.assert_allclose(
        buffer_of([0.0, 0.02], dq=np.array([-3.0, 0.5])).at(0.01).speed, [3.0, 2.0])
    # Differences of postures whose stamps are close together say nothing.
    np.testing.assert_allclose(buffer_of([0.0, 0.02], velocity_max=1.5).at(0.01).speed, [1.0, 1.5])


def test_what_is_not_known_is_said():
    empty = PostureBuffer(np.ones(2))
    assert empty.at(1.0).fit is Fit.TOO_EARLY_TO_SAY and empty.at(1.0).away == np.inf
    buffer = buffer_of([10.0, 10.0 + 1.5 * LONGEST_GAP, 10.0 + 2.0 * LONGEST_GAP])
    late = buffer.at(10.5)
    assert late.fit is Fit.TOO_EARLY_TO_SAY
    assert late.away == pytest.approx(0.5 - 2.0 * LONGEST_GAP)
    early = buffer.at(9.75)
    assert early.fit is Fit.TOO_OLD and early.away == pytest.approx(0.25)
    gap = buffer.at(10.05)
    assert gap.fit is Fit.GAP and gap.away == pytest.approx(1.5 * LONGEST_GAP)
    assert buffer.at(10.0).fit is buffer.at(10.0 + 1.5 * LONGEST_GAP).fit is Fit.KNOWN
    assert buffer.at(10.0 + 1.7 * LONGEST_GAP).fit is Fit.KNOWN


def test_measurements_out_of_order_do_not_count_and_a_clock_set_back_begins_anew():
    buffer = buffer_of([10.0, 10.02])
    assert not buffer.add(10.01, np.zeros(2), None) and not buffer.add(10.02, np.zeros(2), None)
    np.testing.assert_allclose(buffer.at(10.01).q, [10.01, 20.02])
    assert buffer.add(3.0, np.zeros(2), None) and len(buffer) == 1
    assert buffer.at(3.0).fit is Fit.KNOWN and buffer.at(10.0).fit is Fit.TOO_EARLY_TO_SAY


def test_old_measurements_go():
    buffer = buffer_of(np.arange(0.0, 100.0, 0.004))
    assert len(buffer) < 10.1 / 0.004
    assert buffer.at(95.0).fit is Fit.KNOWN and buffer.at(80.0).fit is Fit.TOO_OLD
    crowded = buffer_of(np.arange(0.0, 0.003, 1e-7))
    assert len(crowded) <= 20_001


def test_parts_are_each_interpolated_between_their_own_measurements():
    parts = PosturesInParts(np.array([5.0, 5.0]))
    assert parts.at(1.0).fit is Fit.TOO_EARLY_TO_SAY
    one, other = np.array([0]), np.array([1])
    for i in range(11):
        parts.add(1.0 + 0.01 * i, one, np.array([0.1 * i]), None)
        if i % 5 == 0:
            parts.add(1.0 + 0.01 * i, other, np.array([-0.2 * i]), np.array([-3.0]))
    found = parts.at(1.033)
    assert found.fit is Fit.KNOWN
    np.testing.assert_allclose(found.q, [0.33, -0.66], atol=1e-9)
    np.testing.assert_allclose(found.speed, [5.0, 5.0])  # at most what joints can do
    # As long as one part may still come, the moment is too early.
    parts.add(1.11, one, np.array([1.1]), None)
    assert parts.at(1.105).fit is Fit.TOO_EARLY_TO_SAY
    parts.add(1.15, other, np.array([-3.0]), None)
    assert parts.at(1.105).fit is Fit.KNOWN
    # A gap of one part is a gap, whatever the other says.
    for i in range(100):
        parts.add(1.15 + 0.01 * i, one, np.array([0.0]), None)
    parts.add(2.1, other, np.array([-3.0]), None)
    assert parts.at(1.6).fit is Fit.GAP
    assert parts.at(0.5).fit is Fit.TOO_OLD


def test_a_publisher_of_all_joints_takes_the_place_of_two():
    parts = PosturesInParts(np.array([5.0, 5.0]))
    for i in range(5):
        parts.add(1.0 + 0.01 * i, np.array([0]), np.array([0.0]), None)
        parts.add(1.0 + 0.01 * i, np.array([1]), np.array([0.0]), None)
    for i in range(5):
        parts.add(2.0 + 0.01 * i, np.array([0, 1]), np.array([1.0, 2.0]), None)
    np.testing.assert_array_equal(parts.at(2.015).q, [1.0, 2.0])
