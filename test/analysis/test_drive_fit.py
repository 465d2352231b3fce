"""Lag and dead time of simulated drives are found again."""

from __future__ import annotations

from dataclasses import replace

from conftest import examples
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.signal import lfilter

from redundant_planner.analysis.drive_fit import drive_fit, longest_motion, Motion
from redundant_planner.core.errors import StateError
from redundant_planner.tools.to_and_fro import swing

NAMES = ('a', 'b', 'still')
DT, FINE = 0.004, 1e-4


def driven(lag, dead_time, noise=0.0, seed=0, jitter=0.0, drift=0.0, seconds=4.0):
    """Return what drives with lag and dead time make of a motion, integrated in fine steps."""
    random = np.random.default_rng(seed)
    count = round(seconds / DT)
    command_times = DT * (np.arange(count) + jitter * random.uniform(0.0, 0.5, count))
    speed = np.array([swing(0.3, seconds, DT * i) for i in range(count)])
    commands = np.outer(speed, [1.0, -0.4, 0.0])
    fine = np.arange(0.0, seconds + 0.3, FINE)
    obeyed = np.searchsorted(command_times, fine - dead_time, side='right') - 1
    wanted = np.where((obeyed >= 0)[:, None], commands[obeyed], 0.0)
    share = 1.0 - np.exp(-FINE / lag) if lag > 0.0 else 1.0
    velocities = lfilter([share], [1.0, share - 1.0], wanted, axis=0)
    positions = np.cumsum(velocities, axis=0) * FINE + [0.1, -0.2, 0.3] + drift * fine[:, None]
    times = np.sort(random.uniform(0.0, seconds + 0.2, 1000))
    measured = np.column_stack([np.interp(times, fine, column) for column in positions.T])
    return Motion(command_times, commands, times,
                  measured + noise * random.normal(size=measured.shape))


@settings(max_examples=examples(25), deadline=None)
@given(lag=st.sampled_from([0.0, 0.01, 0.03, 0.08]), dead_time=st.floats(0.0, 0.06),
       jitter=st.floats(0.0, 1.0), seed=st.integers(0, 10**6))
def test_lag_and_dead_time_are_found_through_noise(lag, dead_time, jitter, seed):
    whole, joints = drive_fit(driven(lag, dead_time, 1e-4, seed, jitter, 1e-3), NAMES)
    assert set(joints) == {'a', 'b'} and whole.joints == 2
    for fit in (whole, *joints.values()):
        assert abs(fit.lag - lag) < 2e-3 + 4.0 * (fit.lag_error or 0.0)
        assert abs(fit.dead_time - dead_time) < 2e-3 + 4.0 * (fit.dead_time_error or 0.0)
        # Their sum is what matters most, and is known best.
        assert abs(fit.lag + fit.dead_time - lag - dead_time) < 1.5e-3
        assert 0.5e-4 < fit.noise < 2e-4
    for time, error in ((whole.lag, whole.lag_error), (whole.dead_time, whole.dead_time_error)):
        assert time == 0.0 if error is None else time > 2.0 * error and error < 5e-3


@pytest.mark.first_alone
@pytest.mark.parametrize('noise', [0.0, 1e-4, 1e-3])
def test_a_time_that_cannot_be_told_from_none_is_none(noise):
    """The other one alone is known well then."""
    for seed in range(3):
        at_once, _ = drive_fit(driven(0.0, 0.0, noise, seed), NAMES)
        assert (at_once.lag, at_once.dead_time) == (0.0, 0.0)
        assert at_once.lag_error is None and at_once.dead_time_error is None
        late, _ = drive_fit(driven(0.0, 0.03, max(noise, 1e-4), seed), NAMES)
        assert late.lag == 0.0 and late.lag_error is None
        assert late.dead_time == pytest.approx(0.03, abs=5e-4) and late.dead_time_error < 1e-3
        slow, _ = drive_fit(driven(0.03, 0.0, max(noise, 1e-4), seed), NAMES)
        assert slow.lag == pytest.approx(0.03, abs=5e-4) and slow.lag_error < 1e-3
        assert slow.dead_time == 0.0 and slow.dead_time_error is None


def test_the_motion_with_most_in_it_is_taken():
    short, long = driven(0.03, 0.01, seconds=1.0), driven(0.03, 0.01, seconds=4.0)
    both = Motion(*(np.concatenate((a, b)) for a, b in (
        (short.command_times, long.command_times + 10.0), (short.commands, long.commands),
        (short.times, long.times + 10.0), (short.positions, long.positions + 1.0))))
    assert longest_motion(both).command_times[0] == pytest.approx(10.0)
    assert drive_fit(both, NAMES)[0].lag == pytest.approx(0.03, abs=2e-3)


def test_what_tells_nothing_is_refused():
    motion = driven(0.03, 0.01)
    still = replace(motion, commands=1e-3 * motion.commands)
    with pytest.raises(StateError, match=r'move no joint by 0\.005'):
        drive_fit(still, NAMES)
    held = replace(motion, positions=np.full_like(motion.positions, 0.2))
    with pytest.raises(StateError, match='of the motion is not explained'):
        drive_fit(held, NAMES)
    with pytest.raises(StateError, match='there are no commands'):
        drive_fit(replace(motion, command_times=motion.command_times[:1],
                          commands=motion.commands[:1]), NAMES)
    with pytest.raises(StateError, match='same clock'):
        drive_fit(replace(motion, times=motion.times + 100.0), NAMES)


def test_a_swing_ends_where_it_began():
    times = np.linspace(-0.5, 4.5, 50_001)
    speed = np.array([swing(0.03, 4.0, t) for t in times])
    way = np.cumsum(speed) * (times[1] - times[0])
    assert abs(way[-1]) < 1e-6 and 0.02 < np.abs(way).max() <= 0.0301
    assert speed[0] == speed[-1] == 0.0
