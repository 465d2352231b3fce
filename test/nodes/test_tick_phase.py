"""Commands find the middle between the measurements of a controller manager."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.nodes.tick_phase import delay_to_middle

T = 0.004


@given(phase=st.floats(0.0, 1.0), jitter=st.floats(0.0, 0.15), drift=st.floats(-1e-4, 1e-4),
       seed=st.integers(0, 1000))
def test_after_the_delay_commands_are_far_from_both_measurements(phase, jitter, drift, seed):
    random = np.random.default_rng(seed)
    measured = 50.0 + T * ((1.0 + drift) * np.arange(200) + phase
                           + random.uniform(-jitter, jitter, 200))
    due = 50.0 + 150 * T
    delay = delay_to_middle(measured, due, T)
    assert 0.0 <= delay <= T
    after = ((50.0 + T * ((1.0 + drift) * 200 + phase) - due - delay) / T) % 1.0
    assert abs(after - 0.5) < 0.15 + 0.05 + 200 * abs(drift)


@pytest.mark.parametrize('measured', [
    T * np.arange(20), 0.01 * np.arange(200), 0.001 * np.arange(200),
    T * (np.arange(200) + np.random.default_rng(1).uniform(-0.5, 0.5, 200))], ids=[
        'few', 'rarely', 'often', 'without a beat'])
def test_where_there_is_no_beat_of_its_own_period_it_stays(measured):
    assert delay_to_middle(measured, 0.0013, T) == 0.0


def test_nothing_was_commanded_yet():
    assert delay_to_middle(T * np.arange(200), np.inf, T) == 0.0
