"""The phase plane along a way: joint limits kept, and ticks that end it exactly."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.target.profile import profile_of

DT = 0.004
WAYS = st.integers(0, 2**32 - 1).map(lambda seed: np.cumsum(
    np.random.default_rng(seed).normal(0.0, 0.05, (13, 7)), axis=0))


def ticks(profile, left):
    """The shares f that ticks take until the way is over."""
    shares = []
    while left > 1e-9:
        f = profile.speed_at(left, DT)
        stretch = min(int((1.0 - left / profile.left[0]) * 12), 11)
        before = shares[-1] if shares else 0.0
        f = min(f, before + 0.8 * profile.rising[stretch] * DT)
        shares.append(f)
        left -= f * DT
        assert len(shares) < 5000
    assert left > -1e-9
    return np.array(shares)


@given(WAYS, st.floats(0.01, 5.0))
def test_ticks_end_at_rest_and_within_the_joints_limits(postures, length):
    speed_limit, limit = np.full(7, 2.0), np.full(7, 10.0)
    profile = profile_of(postures, length, speed_limit, limit)
    shares = ticks(profile, length)
    rates = np.abs(np.diff(postures, axis=0)) * 12 / length
    # At every moment a joint's velocity is its rate there times f.
    left = length - DT * np.concatenate(([0.0], np.cumsum(shares)[:-1]))
    at = np.minimum(((1.0 - left / length) * 12).astype(int), 11)
    assert (rates[at] * shares[:, None] <= 2.0 * (1.0 + 1e-9)).all()
    change = np.diff(np.concatenate((shares, [0.0]))) / DT
    inside = np.diff(np.concatenate((at, [11]))) == 0
    assert (np.abs(change)[:, None] * rates[at] <= limit)[inside].all()


def test_a_straight_joint_path_takes_the_time_of_a_triangle():
    """Of 1 rad at 0.8 · 10 rad/s²: 2 √(1 / 8) s."""
    postures = np.outer(np.linspace(0.0, 1.0, 13), np.ones(7))
    profile = profile_of(postures, 0.2, np.full(7, 100.0), np.full(7, 10.0))
    expected = 2.0 * np.sqrt(1.0 / 8.0)
    assert DT * len(ticks(profile, 0.2)) == pytest.approx(expected, rel=0.03)
    times, shares = profile.times(0.0)
    assert times[-1] == pytest.approx(expected, rel=0.03)
    assert shares[0] == shares[-1] == 0.0


@pytest.mark.parametrize('curvature', [-0.9, -0.5, 0.0, 0.5, 0.9])
def test_a_joint_that_its_way_slows_down_still_keeps_its_limit_while_it_brakes(curvature):
    """Of q(σ) = σ + c σ²/2 over 1 s of way: q'' f² − q' b is its acceleration."""
    along, limit = np.linspace(0.0, 1.0, 13), 1.0
    path = along + 0.5 * curvature * along**2
    profile = profile_of(path[:, None], 1.0, np.array([10.0]), np.array([limit]))
    shares = ticks(profile, 1.0)
    left = 1.0 - DT * np.concatenate(([0.0], np.cumsum(shares)))
    positions = np.interp(1.0 - left, *(lambda x: (x, x + 0.5 * curvature * x**2))(
        np.linspace(0.0, 1.0, 2000)))
    acceleration = np.diff(positions, 2) / DT**2
    # Its rate is taken in the middle of a piece, and changes from tick to tick where one ends.
    braking = acceleration[int(shares.argmax()):]
    assert np.abs(np.convolve(braking, np.ones(5) / 5.0, 'valid')).max() < 1.1 * limit
