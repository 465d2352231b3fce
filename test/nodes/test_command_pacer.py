"""Commands are due on an even beat, whatever the ticks do."""

from __future__ import annotations

import time

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.nodes.command_pacer import CommandPacer

PERIOD = 0.001


@given(st.lists(st.floats(0.0, 0.9), min_size=1, max_size=50), st.integers(0, 10**6))
def test_late_ticks_leave_the_beat_alone(delays, start):
    """After one that begins on time; and none is asked to wait for longer than its lead."""
    beat, lead = CommandPacer(PERIOD), 0.5 * PERIOD
    begins = (start + np.arange(len(delays) + 1)) * PERIOD
    begins[1:] += np.array(delays) * PERIOD
    due = np.array([beat.begin(begin) for begin in begins])
    np.testing.assert_allclose(due, (start + np.arange(len(due))) * PERIOD + lead,
                               atol=0.01 * PERIOD)
    assert (due <= begins + lead).all()


@given(st.lists(st.integers(1, 5), min_size=1, max_size=30))
def test_missed_ticks_are_left_out(steps):
    beat = CommandPacer(PERIOD)
    first = beat.begin(0.0)
    counts = np.cumsum(steps)
    due, missed = zip(*((beat.begin(count * PERIOD), beat.missed) for count in counts))
    assert list(missed) == [step - 1 for step in steps]
    np.testing.assert_allclose(due, first + counts * PERIOD, atol=1e-3 * PERIOD)


def test_an_earlier_tick_shows_where_the_beat_is():
    beat = CommandPacer(PERIOD)
    late = beat.begin(0.5 * PERIOD)
    on_time = beat.begin(PERIOD)
    assert on_time - late == pytest.approx(0.5 * PERIOD)
    assert beat.begin(2.0 * PERIOD) - on_time == pytest.approx(PERIOD)


def test_a_beat_that_was_put_too_early_is_found_again():
    beat = CommandPacer(PERIOD)
    beat.begin(-1.2 * PERIOD)
    due = [beat.begin(i * PERIOD) - i * PERIOD for i in range(5000)]
    assert due[0] == pytest.approx(0.3 * PERIOD, rel=0.01)
    np.testing.assert_allclose(due[3000:], 0.5 * PERIOD, atol=1e-9)


@pytest.mark.parametrize('latest, awake', [(5e-6, 20e-6), (100e-6, 95e-6), (1e-3, 150e-6)])
def test_it_sleeps_as_much_as_the_system_wakes_late(latest, awake, monkeypatch):
    """Wakings are up to so late, and the processor is busy for the rest of a wait."""
    random, now, slept = np.random.default_rng(1), [0.0], []

    def sleep(seconds):
        slept.append(seconds)
        now[0] += seconds + random.uniform(0.0, latest)

    def monotonic():
        now[0] += 1e-7
        return now[0]

    monkeypatch.setattr(time, 'sleep', sleep)
    monkeypatch.setattr(time, 'monotonic', monotonic)
    beat, late = CommandPacer(PERIOD), []
    for i in range(4000):
        now[0] = i * PERIOD
        due = beat.begin(now[0])
        beat.wait()
        late.append(now[0] - due)
    waits = 0.5 * PERIOD - np.array(slept[2000:])
    assert np.mean(waits) == pytest.approx(awake, rel=0.1)
    if awake < 150e-6:
        assert np.mean(np.array(late[2000:]) > 1e-6) == pytest.approx(0.05, abs=0.05)


def test_who_is_early_waits_and_who_is_late_does_not():
    beat = CommandPacer(0.02)
    beat.wait()
    assert beat.waited == 0.0
    due = beat.begin(time.monotonic())
    beat.wait()
    assert time.monotonic() >= due
    assert 0.0 < beat.waited <= 7e-4
    overdue = CommandPacer(0.02)
    overdue.begin(time.monotonic() - 1.0)
    overdue.wait()
    assert overdue.waited == 0.0


def test_what_is_left_until_the_next_tick():
    beat = CommandPacer(10.0)
    assert beat.left == np.inf
    begin = time.monotonic()
    beat.begin(begin)
    assert 0.0 <= begin + 10.0 - time.monotonic() - beat.left + 0.1 < 0.2
    assert not beat.is_due(time.monotonic() + beat.left - 0.01)
    assert beat.is_due(time.monotonic() + beat.left + 0.01)
