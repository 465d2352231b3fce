"""The posture to plan from: neither late nor noisy, and where the arm is."""

from __future__ import annotations

from collections import deque

from conftest import examples, make_panda, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.joint_observer import JointObserver

N, DT = 3, 0.004


class Drives:
    """Joints with lag and dead time, integrated in fine steps."""

    def __init__(self, lag, dead_time, steps=50):
        self.q, self.dq = np.zeros(N), np.zeros(N)
        self.lag, self.step, self.steps = lag, DT / steps, steps
        self.late = deque([np.zeros(N)] * round(dead_time / self.step))

    def move(self, dq):
        for _ in range(self.steps):
            self.late.append(dq)
            wanted = self.late.popleft()
            self.dq = wanted if not self.lag else (
                self.dq + (wanted - self.dq) * self.step / self.lag)
            self.q = self.q + self.step * self.dq


def swing(i):
    return 0.5 * np.sin(0.02 * i) * np.array([1.0, -0.5, 0.2])


@settings(max_examples=examples(25), deadline=None)
@given(lag=st.sampled_from([0.0, 0.01, 0.03]), dead_time=st.floats(0.0, 0.03),
       noise=st.sampled_from([0.0, 1e-4]), seed=st.integers(0, 10**6))
def test_it_is_where_the_commands_lead_for_a_drive_that_is_known(lag, dead_time, noise, seed):
    random = np.random.default_rng(seed)
    observer, drives = JointObserver(N, lag, dead_time), Drives(lag, dead_time)
    led, moves = np.zeros(N), []
    before = None
    for i in range(400):
        measured = drives.q + noise * random.normal(size=N)
        q = observer.sense(measured, DT)
        # Euler's steps and the fraction of a tick cost a little; noise enters at 2/s.
        assert np.abs(q - led).max() < 2e-4 + 5.0 * noise
        if before is not None:
            moves.append(q - before - DT * swing(i - 1))
        before = q
        observer.commanded(swing(i), DT)
        drives.move(swing(i))
        led = led + DT * swing(i)
        assert np.abs(observer.strayed).max() < 5e-4
    # Per tick, next to none of the noise reaches what is planned from.
    assert np.abs(moves).max() < 2e-5 + 0.06 * noise


def test_an_ideal_arm_is_taken_as_measured():
    observer, q = JointObserver(N, 0.0, 0.0), np.array([0.1, -0.2, 0.3])
    for i in range(100):
        np.testing.assert_allclose(observer.sense(q, DT), q, atol=1e-13)
        observer.commanded(swing(i), DT)
        q = q + DT * swing(i)


def test_an_ideal_arm_is_taken_as_measured_however_long_the_ticks_are():
    """The command under way when the period changes counts, too."""
    observer, q = JointObserver(N, 0.0, 0.0), np.array([0.1, -0.2, 0.3])
    for i in range(100):
        dt = DT * (1 + i // 2 % 3)
        np.testing.assert_allclose(observer.sense(q, dt), q, atol=1e-13)
        np.testing.assert_allclose(observer.ahead, q, atol=1e-13)
        observer.commanded(swing(i), dt)
        q = q + dt * swing(i)


@pytest.mark.parametrize('push', [0.005, 0.05])
def test_an_arm_that_is_pushed_is_followed(push):
    observer, q = JointObserver(N, 0.03, 0.012), np.zeros(N)
    observer.sense(q, DT)
    observer.commanded(np.zeros(N), DT)
    q = np.array([push, 0.0, 0.0])
    first = observer.sense(q, DT)
    # What is further away than a hundredth counts at once.
    assert abs(first[0] - push) <= 0.01 + 1e-12
    for _ in range(100):
        observer.commanded(np.zeros(N), DT)
        posture = observer.sense(q, DT)
    # Meanwhile the arm counts as that much off its way.
    assert 0.5 * abs(posture[0] - push) < observer.strayed[0] < 2.0 * abs(posture[0] - push)
    for _ in range(600):
        observer.commanded(np.zeros(N), DT)
        posture = observer.sense(q, DT)
    np.testing.assert_allclose(posture, q, atol=2e-4)


def test_the_posture_does_not_run_ahead_of_an_arm_that_is_held():
    observer = JointObserver(N, 0.03, 0.012)
    for _ in range(300):
        posture = observer.sense(np.zeros(N), DT)
        observer.commanded(np.full(N, 0.5), DT)
        # The way that a free arm would still make for these commands, and what it may be late.
        assert np.abs(posture).max() <= 0.5 * (0.03 + 0.012 + 0.1) + 0.01 + 1e-9


def test_being_late_on_the_way_is_not_being_off_it():
    """A drive twice as slow as it is thought to be."""
    observer, drives = JointObserver(N, 0.02, 0.0), Drives(0.04, 0.0)
    command = np.array([0.4, -0.2, 0.1])
    for _ in range(500):
        observer.sense(drives.q, DT)
        observer.commanded(command, DT)
        drives.move(command)
    assert np.abs(observer.strayed).max() < 1e-6


def test_another_period_and_a_reset_are_taken_up():
    observer = JointObserver(N, 0.03, 0.012)
    observer.sense(np.zeros(N), DT)
    observer.commanded(np.ones(N), DT)
    assert np.isfinite(observer.sense(np.zeros(N), 0.001)).all()
    observer.reset()
    np.testing.assert_array_equal(observer.sense(np.ones(N), 0.001), np.ones(N))
    np.testing.assert_array_equal(observer.strayed, 0.0)


@pytest.mark.parametrize(('lag', 'dead_time'), [(0.0, 0.0), (0.03, 0.01)])
def test_a_measurement_that_is_none_loses_no_command(lag, dead_time):
    """It is refused, and then the planner goes on as if it had not come."""
    parameters = PlannerParameters(drive_lag=lag, drive_dead_time=dead_time)
    planners = Planner(make_panda(), parameters), Planner(make_panda(), parameters)
    q, twist, scene = PANDA_READY.copy(), np.array([0.1, 0.0, 0.05, 0.0, 0.0, 0.2]), Scene.of()
    for i in range(60):
        if i in (0, 30):
            with pytest.raises(StateError, match='not a finite number'):
                planners[0].step(np.where(np.arange(7) == 3, np.nan, q), twist, scene, DT)
        dq, expected = (planner.step(q, twist, scene, DT).dq for planner in planners)
        np.testing.assert_array_equal(dq, expected)
        q = q + DT * dq
    assert np.abs(dq).max() > 0.01
