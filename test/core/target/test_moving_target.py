"""A target between two messages."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.moving_target import (
    MovingTarget,
    numbers_of,
    POSE_GATE,
    pose_of,
    twist_of,
)

DT, LAG = 0.004, 0.08
ORIGIN = Pose(np.zeros(3), np.eye(3))
TWIST = np.array([0.1, -0.05, 0.2, 0.3, 0.0, -0.2])


def along(t):
    return se3.integrate(ORIGIN, TWIST, t, False)


class Sent:
    """Poses that are given tick by tick."""

    def __init__(self, lag=LAG):
        self.target, self._before = MovingTarget(lag, POSE_GATE), None

    def tick(self, *poses, ages=None, resumes=True):
        news = []
        for i, pose in enumerate(poses):
            self._before = numbers_of(pose, self._before)
            news.append((self._before, None if ages is None else ages[i]))
        self.target.sense(news, DT, lambda numbers: resumes)
        return None if self.target.estimate is None else pose_of(self.target.estimate.value)


@pytest.mark.parametrize('every', [1, 2, 8, 25, 80])
def test_a_steady_stream_is_known_between_its_messages_one_lag_behind(every):
    sent = Sent()
    for now in range(1000):
        found = sent.tick(*([along(now * DT)] if now % every == 0 else []))
    lag = max(LAG, 1.4 * every * DT)
    assert sent.target.moves
    value, velocity = sent.target.estimate[:2]
    np.testing.assert_allclose(twist_of(value, velocity), TWIST, rtol=0.02, atol=2e-3)
    np.testing.assert_allclose(found.position, along(now * DT - lag).position, atol=1e-3)
    np.testing.assert_allclose(found.rotation, along(now * DT - lag).rotation, atol=1e-3)


def test_noise_is_averaged_and_the_lag_is_longer_for_it():
    """A millimetre of noise at 30 Hz: within 0.6 mm, at an acceleration that an arm can have."""
    random, sent, found = np.random.default_rng(1), Sent(), []
    for now in range(4000):
        poses = []
        if int(now * DT * 30.0) != int((now - 1) * DT * 30.0):
            t = int(now * DT * 30.0) / 30.0
            poses = [se3.displaced(along(t), random.normal(size=6) * 1e-3, False)]
        sent.tick(*poses, ages=[now * DT - t for _ in poses])
        if now > 2000:
            value, _, acceleration, _ = sent.target.estimate
            found.append((*(value[:3] - along(now * DT).position), *acceleration[:3]))
    off, acceleration = np.split(np.array(found), 2, axis=1)
    lag = -(off @ TWIST[:3]).mean() / (TWIST[:3] @ TWIST[:3])
    assert 1.2 * LAG < lag < 1.35 * LAG
    assert (off + lag * TWIST[:3]).std(axis=0).max() < 6e-4
    assert acceleration.std(axis=0).max() < 0.2


@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6), st.floats(-0.5, 0.5))
def test_the_twist_is_the_rate_of_the_numbers(twist, angle):
    """Against the exact motion of a rigid body."""
    pose = se3.integrate(ORIGIN, np.array((0.1, 0.2, 0.3, angle, 0.4, -angle)), 1.0, False)
    step = 1e-5
    before, after = (se3.integrate(pose, np.array(twist), dt, False) for dt in (-step, step))
    numbers = numbers_of(pose, None)
    rates = (numbers_of(after, numbers) - numbers_of(before, numbers)) / (2.0 * step)
    np.testing.assert_allclose(twist_of(numbers, rates), twist, atol=1e-6)
    # Of any length, and of either sign.
    np.testing.assert_allclose(twist_of(np.r_[numbers[:3], -2.0 * numbers[3:]],
                                        np.r_[rates[:3], -2.0 * rates[3:]]), twist, atol=1e-6)


def test_single_targets_are_no_stream():
    sent = Sent()
    for now in range(500):
        sent.tick(*([along(now * DT)] if now % 150 == 0 else []))
        assert not sent.target.moves
    # Nor are two that are far apart, nor one that is sent again.
    for pose in (along(0.0), se3.integrate(along(0.0), np.eye(6)[0], 0.2, False)):
        for _ in range(3):
            sent.tick(pose)
            sent.tick()
    assert not sent.target.moves


def test_a_silent_stream_stands_at_its_last_pose_and_is_taken_up_again():
    sent = Sent()
    for now in range(100):
        sent.tick(along(now * DT))
    last = along(99 * DT)
    for _ in range(400):
        found = sent.tick()
    np.testing.assert_allclose(found.position, last.position, atol=1e-9)
    assert sent.target.moves and not sent.target.estimate.velocity.any()
    sent.tick(along(0.0), resumes=True)
    assert sent.target.moves
    for _ in range(400):
        sent.tick()
    sent.tick(along(9.0), resumes=False)
    assert not sent.target.moves


def test_after_some_seconds_it_is_a_single_target():
    sent = Sent()
    for now in range(100):
        sent.tick(along(now * DT))
    for _ in range(800):
        sent.tick()
    assert not sent.target.moves and sent.target.estimate is None


@pytest.mark.parametrize('every', [1, 8, 25])
def test_one_wrong_frame_moves_nothing_and_two_are_a_leap(every):
    sent, away = Sent(), np.zeros(3)
    for i in range(150):
        wrong = 0.2 if i == 75 else 0.0
        pose = along(i * every * DT)
        found = sent.tick(Pose(pose.position + wrong, pose.rotation))
        for _ in range(every - 1):
            found = sent.tick()
        if i > 70:
            lag = max(LAG, 1.4 * every * DT)
            away = np.maximum(away, np.abs(
                found.position - along((i + 1) * every * DT - DT - lag).position))
    assert away.max() < 0.01
    for i in range(100):
        pose = along((150 + i) * every * DT)
        found = sent.tick(Pose(pose.position + 0.5, pose.rotation))
        for _ in range(every - 1):
            found = sent.tick()
    assert np.abs(found.position - 0.5 - along(
        250 * every * DT - DT - max(LAG, 1.4 * every * DT)).position).max() < 0.01


def test_stamps_tell_when_frames_of_a_burst_were_taken_whatever_their_clock_says():
    sent, waiting, worst = Sent(), [], 0.0
    for now in range(1500):
        if now % 4 == 0:
            waiting.append(now)
        if now % 50 == 0:  # once in 0.2 s
            found = sent.tick(*(along(i * DT) for i in waiting),
                              ages=[1e6 + (now - i) * DT for i in waiting])
            waiting = []
        else:
            found = sent.tick()
        if now > 750:
            value, velocity = sent.target.estimate[:2]
            worst = max(worst, np.abs(twist_of(value, velocity) - TWIST).max())
    assert worst < 0.02
    # As late as the latest of a burst, and not as a lag more.
    np.testing.assert_allclose(found.position, along(now * DT - 0.215).position, atol=5e-3)


@pytest.mark.parametrize('ages', [
    lambda now: now * DT,  # always the same stamp
    lambda now: 1e9 * (now % 7),  # nonsense
])
def test_stamps_that_are_none_do_not_count(ages):
    sent = Sent()
    for now in range(500):
        found = sent.tick(*([along(now * DT)] if now % 4 == 0 else []), ages=[ages(now)])
    np.testing.assert_allclose(found.position, along(now * DT - LAG).position, atol=5e-3)


def test_without_a_lag_it_is_where_it_should_be_by_now():
    sent = Sent(0.0)
    for now in range(500):
        found = sent.tick(*([along(now * DT)] if now % 8 == 0 else []))
    np.testing.assert_allclose(found.position, along(now * DT).position, atol=1e-4)
