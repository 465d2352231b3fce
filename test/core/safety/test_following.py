"""An arm that does not do what it is told is told from one that does it late or badly."""

from __future__ import annotations

from collections import deque
import itertools

from conftest import examples
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.safety.following import DEAD_TIME, Following, LAG

NAMES, DT = ('a', 'b', 'c'), 0.004
NEW = np.zeros(3)  # ages of joints that have been measured just now [s]


class Arm:
    """Joints that obey velocities late, and joint_states that are late and rare."""

    def __init__(self, lag=0.0, dead_time=0.0, noise=0.0, late=0.0, rate=250.0, gain=1.0,
                 play=0.0, seed=0):
        self.q, self.dq, self.shown = np.zeros(3), np.zeros(3), np.zeros(3)
        self._lag, self._gain, self._noise, self._play = lag, gain, noise, play
        self._told = deque([np.zeros(3)] * round(dead_time / DT))
        self._seen = deque([np.zeros(3)] * round(late / DT))
        self._every, self._ticks = max(round(1.0 / (rate * DT)), 1), 0
        self._random = np.random.default_rng(seed)
        self._motor = np.zeros(3)

    def move(self, dq):
        self._told.append(self._gain * dq)
        wanted = self._told.popleft()
        kept = np.exp(-DT / self._lag) if self._lag > 1e-4 else 0.0
        self.dq = wanted + (self.dq - wanted) * kept
        self._motor = self._motor + DT * self.dq
        half = 0.5 * self._play
        self.q = np.clip(self.q, self._motor - half, self._motor + half)
        self._seen.append(self.q + self._noise * self._random.normal(size=3))
        now, self._ticks = self._seen.popleft(), self._ticks + 1
        if self._ticks % self._every == 0:
            self.shown = now
        return self.shown


def swing(t, speed=0.6):
    """Velocities that begin, turn, stop for a while and begin again."""
    phase = t % 6.0
    return speed * np.array([np.sin(2.1 * phase), np.sign(np.sin(1.3 * phase)) * (phase < 4.0),
                             0.3 * np.sin(9.0 * phase)]) * min(phase / 0.1, 1.0)


def watched(arm, velocity, seconds, tolerance=0.02):
    """Return the first complaint and its time; '' and the end if there is none."""
    following = Following(NAMES, DT, tolerance)
    measured = arm.shown
    following.begin(measured)
    for i in range(round(seconds / DT)):
        dq = velocity(i * DT)
        measured = arm.move(dq)
        reason = following.tick(dq, measured, NEW)
        if reason:
            return reason, i * DT
    return '', seconds


def patience(speed, since=0.0):
    """How long a joint of constant speed may stand, if it has moved for a time before [s]."""
    t = np.arange(0.0, 3.0, DT)
    late = np.maximum(t + since - DEAD_TIME, 0.0)
    travel = np.minimum(t + since, DEAD_TIME) + LAG * (1.0 - np.exp(-late / LAG))
    return float(t[np.argmax(t > travel + 0.03 / speed)]) + 0.03


@pytest.mark.first_alone
@pytest.mark.parametrize('late', [
    {}, {'lag': 0.08}, {'lag': 0.08, 'dead_time': 0.04}, {'rate': 20.0, 'late': 0.1},
    {'lag': 0.08, 'dead_time': 0.04, 'late': 0.1}, {'noise': 5e-4}, {'play': 0.01},
    {'lag': 0.08, 'dead_time': 0.04, 'noise': 5e-4, 'play': 0.01}, {'gain': 0.95},
    {'gain': 1.05}], ids=str)
def test_a_late_noisy_or_loose_arm_follows(late):
    assert watched(Arm(**late), swing, 60.0)[0] == ''


@settings(max_examples=examples(30), deadline=None)
@given(lag=st.floats(0.0, 0.1), dead_time=st.floats(0.0, 0.06), late=st.floats(0.0, 0.1),
       noise=st.floats(0.0, 5e-4), speed=st.floats(0.05, 1.0), seed=st.integers(0, 1000))
def test_any_drive_within_the_window_follows(lag, dead_time, late, noise, speed, seed):
    arm = Arm(lag, dead_time, noise, late, seed=seed)
    assert watched(arm, lambda t: swing(t, speed), 12.0)[0] == ''


@pytest.mark.parametrize('speed', [0.1, 0.2, 0.6, 2.0])
def test_an_arm_that_stands_is_found_out_soon_and_named(speed):
    arm = Arm(noise=5e-4)
    arm.move = lambda dq: 5e-4 * np.random.default_rng(0).normal(size=3)
    reason, at = watched(arm, lambda t: np.array([0.0, speed, 0.1 * speed]), 3.0)
    assert reason.startswith("the arm does not follow: joint 'b' stays behind by 0.")
    assert 'is its controller active' in reason
    assert at <= patience(speed)


@pytest.mark.parametrize('speed', [0.1, 0.3, 1.0])
def test_an_arm_that_freezes_in_motion_is_found_out_soon(speed):
    arm, frozen = Arm(lag=0.03), []
    move = arm.move

    def freezing(dq):
        if len(frozen) < round(2.0 / DT):
            frozen.append(move(dq))
        return frozen[-1]

    arm.move = freezing
    reason, at = watched(arm, lambda t: np.full(3, speed), 5.0)
    assert reason and 2.0 < at <= 2.0 + patience(speed, since=2.0)


@settings(max_examples=examples(40), deadline=None)
@given(order=st.permutations(range(3)), lag=st.floats(0.0, 0.08), late=st.floats(0.0, 0.1),
       noise=st.floats(0.0, 5e-4), speed=st.floats(0.1, 1.0), seed=st.integers(0, 1000))
def test_joints_in_another_order_are_named_as_soon_as_they_move(
        order, lag, late, noise, speed, seed):
    arm = Arm(lag, noise=noise, late=late, seed=seed)
    move, velocity = arm.move, speed * np.array([1.0, -0.2, 0.5])
    arm.move = lambda dq: move(dq[order])
    reason, at = watched(arm, lambda t: velocity * min(t / 0.1, 1.0), 3.0)
    swapped = [i for i in range(3) if order[i] != i]
    assert bool(reason) == bool(swapped)
    for i in swapped:
        assert f"joint '{NAMES[i]}' moves as '{NAMES[order[i]]}' was told" in reason
    if swapped:
        assert 'another order' in reason
        assert at < 0.2 + lag + late + 0.1 / speed


@settings(max_examples=examples(60), deadline=None)
@given(delays=st.lists(st.floats(0.0, 0.19), min_size=3, max_size=3), lag=st.floats(0.0, 0.08),
       noise=st.floats(0.0, 5e-4), seed=st.integers(0, 10_000))
def test_joints_that_are_late_by_different_times_are_in_order(delays, lag, noise, seed):
    """They begin when they will, and go to and fro."""
    random = np.random.default_rng(seed)
    speeds, begins = random.uniform(-2.0, 2.0, (6, 3)), random.uniform(0.0, 0.5, 3)

    def velocity(t):
        return np.where(t > begins, speeds[int(t / 0.4) % 6], 0.0) * min(t / 0.1, 1.0)

    arms = [Arm(lag, delay, noise) for delay in delays]
    following, measured = Following(NAMES, DT, 0.02), np.zeros(3)
    following.begin(measured)
    for i in range(500):
        dq = velocity(i * DT)
        measured = np.array([arm.move(dq)[j] for j, arm in enumerate(arms)])
        assert 'another order' not in following.tick(dq, measured, NEW)


@pytest.mark.parametrize('told, done', [
    ((0.1, 1.0, 0.02), (1.0, 0.0, 1.0)), ((0.4, 0.5, 0.0), (1.0, 0.1, 1.0)),
    ((0.2, 1.0, 0.3), (1.0, 0.4, 0.4))], ids=str)
def test_joints_that_lag_or_stand_are_in_order(told, done):
    """Those that move do what they were told."""
    following, told, done = Following(NAMES, DT, 0.02), np.array(told), np.array(done)
    following.begin(np.zeros(3))
    reasons = [following.tick(told, DT * i * told * done, NEW) for i in range(1, 250)]
    assert any(reasons) and not any('another order' in reason for reason in reasons)


def test_a_leap_is_larger_than_the_tolerance():
    for tolerance, leaps in ((0.02, True), (0.2, False)):
        following = Following(NAMES, DT, tolerance)
        following.begin(np.zeros(3))
        reason = [following.tick(np.full(3, 0.01), np.full(3, q), NEW) for q in (0.0, 0.15)][-1]
        assert ("joint 'a', 'b', 'c' moved by" in reason) == leaps and bool(reason) == leaps


def test_a_load_that_pulls_joints_against_their_commands_is_no_other_order():
    arm, ticks = Arm(), itertools.count()
    arm.move = lambda dq: np.array([0.0, -0.4, 0.0]) * DT * next(ticks)
    reason, _ = watched(arm, lambda t: np.array([0.1, 0.1, 0.0]), 3.0)
    assert "joint 'b' moves without a command; is the load more than" in reason
    assert 'another order' not in reason


def test_an_arm_that_went_on_while_nobody_commanded_it_does_not_leap():
    """A stopped process just after the beginning: a velocity holds until the next one."""
    for slept in (False, True):
        following = Following(NAMES, DT, 0.02)
        following.begin(np.zeros(3))
        assert following.tick(np.full(3, 0.3), np.zeros(3), NEW) == ''
        if slept:
            following.slept()
        reason = following.tick(np.full(3, 0.3), np.full(3, 0.19), NEW)
        assert ('as soon as the arm was commanded' in reason) == (not slept)


@pytest.mark.parametrize('push', [0.02, 0.1, -0.1])
def test_a_push_is_no_fault_and_counts_as_moved_by_others_at_rest(push):
    arm = Arm(lag=0.03, noise=2e-4)
    following = Following(NAMES, DT, 0.02)
    following.begin(arm.shown)
    moved = []
    for i in range(1500):
        dq = 0.3 * np.array([1.0, -1.0, 0.0]) * (i < 750)
        if i in (300, 1200):
            arm.q = arm.q + push * np.array([1.0, 1.0, -1.0])
            arm._motor = arm.q
        assert following.tick(dq, arm.move(dq), NEW) == ''
        if i < 900:
            following.rest()
        moved.append(following.moved_by_others)
    assert max(moved[900:1190]) < 5e-3 < max(moved[1200:])


@pytest.mark.parametrize('moves', [True, False])
def test_a_joint_is_judged_when_it_is_measured(moves):
    """One joint's part of joint_states pauses for longer than a joint may be behind."""
    arm, following = Arm(lag=0.03), Following(NAMES, DT, 0.02)
    following.begin(arm.shown)
    dq, ages, measured = np.full(3, 0.6), np.zeros(3), np.zeros(3)
    complaints = []
    for i in range(500):
        told = dq if moves or i < 200 else dq * [0.0, 1.0, 1.0]
        now = arm.move(told)
        ages[0] = ages[0] + DT if 200 <= i < 400 else 0.0
        measured = np.where(ages > 0.0, measured, now)
        complaints.append(following.tick(dq, measured, ages))
    assert not any(complaints[:400])
    assert any(complaints[400:]) is not moves
    if not moves:
        assert "joint 'a' stays behind" in complaints[400]


def test_half_the_gain_is_found_out_and_zero_switches_it_off():
    assert watched(Arm(gain=0.5), lambda t: np.full(3, 0.3), 5.0)[0]
    for gain in (0.0, 1.0):
        assert watched(Arm(gain=gain), lambda t: np.full(3, 0.3), 5.0, tolerance=0.0)[0] == ''


def test_a_first_small_motion_shows_that_it_follows():
    for gain, follows in ((1.0, True), (0.0, False)):
        arm, following = Arm(lag=0.05, gain=gain), Following(NAMES, DT, 0.02)
        following.begin(arm.shown)
        seen = False
        for _ in range(125):
            dq = np.array([0.05, 0.0, 0.0])
            following.tick(dq, arm.move(dq), NEW)
            seen = seen or following.has_followed
        assert seen is follows


@pytest.mark.parametrize('late', [{}, {'lag': 0.08, 'dead_time': 0.04}, {'noise': 5e-4}], ids=str)
def test_an_arm_sets_off_until_it_is_seen_to_move_and_again_after_a_rest(late):
    arm, following = Arm(**late), Following(NAMES, DT, 0.02)
    following.begin(arm.shown)

    def soon(dq, seconds):
        """Return how long it sets off within a time [s]."""
        seen = []
        for _ in range(round(seconds / DT)):
            following.tick(dq, arm.move(dq), NEW)
            seen.append(following.sets_off)
        assert not any(np.diff(np.array(seen, int)) > 0) or not dq.any()
        return DT * sum(seen)

    for _ in range(2):
        assert 0.01 < soon(np.array([0.3, 0.1, 0.0]), 1.0) < 0.05 + LAG + DEAD_TIME
        assert 0.1 < soon(np.zeros(3), 1.0) < 0.6
