"""The simulated arm and the position command."""

from __future__ import annotations

from conftest import examples, planar_urdf, ROBOTS
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.core.robot.simulated_arm import joint_ranges, SimulatedArm
from redundant_planner.core.safety.limits import Limits
from redundant_planner.core.safety.position_command import has_jumped, integrated, PositionCommand

N = 2


def make_arm(**start):
    return SimulatedArm(joint_ranges(planar_urdf()), start, command_timeout=0.1)


def test_ranges_are_those_of_the_urdf():
    ranges = joint_ranges((ROBOTS / 'paper_2p5r.urdf').read_text())
    assert ranges.names == ('d1', 'd2', 'theta3', 'theta4', 'theta5', 'theta6', 'theta7')
    np.testing.assert_array_equal(ranges.position_max[:3], [0.4, 0.4, 2.0944])
    planar = joint_ranges(planar_urdf())
    assert np.isinf(planar.position_max[2]) and planar.velocity_max[2] == 2.0


@given(st.lists(st.floats(0.001, 0.09), min_size=1, max_size=20))
def test_motion_is_the_integral_however_often_it_is_looked_at(steps):
    arm = make_arm()
    arm.advance(0.0)
    now = 0.0
    for step in steps:
        arm.command(now, np.array([0.1, -0.2, 0.3]))
        now += step
        arm.advance(now)
    np.testing.assert_allclose(arm.q, np.array([0.1, -0.2, 0.3]) * now, atol=1e-12)


def test_it_holds_still_when_commands_stop():
    arm = make_arm()
    arm.command(0.0, np.full(3, 0.5))
    arm.advance(10.0)
    np.testing.assert_allclose(arm.q, 0.05)  # for as long as the timeout, then no more
    np.testing.assert_array_equal(arm.dq, 0.0)


@given(st.lists(st.tuples(st.floats(0.0, 0.2), st.floats(-1e9, 1e9)), max_size=50))
def test_limits_are_never_left(moves):
    arm, now = make_arm(), 0.0
    for step, speed in moves:
        arm.command(now, np.full(3, speed))
        before = arm.q
        now += step
        arm.advance(now)
        assert (np.abs(arm.q[:2]) <= 2.5).all()
        assert (np.abs(arm.q - before) <= 2.0 * step + 1e-9).all()


def test_a_clock_that_goes_back_moves_nothing():
    arm = make_arm()
    arm.command(5.0, np.full(3, 0.5))
    arm.advance(5.05)
    before = arm.q
    arm.advance(1.0)
    np.testing.assert_array_equal(arm.q, before)


@pytest.mark.parametrize(('start', 'message'), [
    ({'elbow': 0.0}, r"unknown joint 'elbow'; the URDF has 'joint1'"),
    ({'joint1': 3.0}, r"joint 'joint1' is 3.0; its limits are \[-2.5, 2.5\]"),
    ({'joint1': float('nan')}, r"joint 'joint1' is nan"),
])
def test_bad_starts_are_refused(start, message):
    with pytest.raises(RobotError, match=message):
        make_arm(**start)


@pytest.mark.parametrize('urdf', ['', '<robot', '<robot name="x"><link name="a"/></robot>'])
def test_bad_urdfs_are_refused(urdf):
    with pytest.raises(RobotError):
        joint_ranges(urdf)


LIMITS = Limits(np.array(([1.0] * N, [-1.0] * N)), np.full(N, 2.0), np.full(N, 10.0), 0.0)
DT = 0.004


def started(q, limits=LIMITS):
    command = PositionCommand(limits)
    command.start(np.array(q, dtype=float), 0.02)
    return command


def test_it_integrates_and_does_not_follow_the_lag():
    command = started([0.0, 0.0])
    for i in range(1, 21):
        q = command.advance(np.array([0.02 * min(i, 10), 0.0]), DT, np.zeros(N), np.full(N, 0.5))
    np.testing.assert_allclose(q, [DT * 0.02 * (55 + 100), 0.0])


def test_it_stays_within_the_range_and_pulls_no_arm_from_outside():
    command = started([0.999, 1.05])
    for _ in range(50):
        q = command.advance(np.array([0.5, 0.0]), DT)
    assert q.tolist() == [1.0, 1.05]
    assert command.advance(np.array([0.0, -0.01]), DT)[1] < 1.05
    q = integrated(np.array([0.999, 1.05]), np.ones(2), DT, *LIMITS.positions[::-1])
    assert q.tolist() == [1.0, 1.05]


@pytest.mark.parametrize(('away', 'stays'), [(0.019, True), (0.021, False)])
def test_it_goes_on_from_its_last_posture_if_the_arm_is_there(away, stays):
    command = started([0.1, 0.2])
    command.advance(np.zeros(N), DT)
    command.start(np.array([0.1 - away, 0.2]), 0.02)
    q = command.advance(np.zeros(N), DT)
    assert q.tolist() == ([0.1, 0.2] if stays else [0.1 - away, 0.2])


@settings(max_examples=examples(80), deadline=None)
@given(seed=st.integers(0, 10**6))
def test_steps_keep_velocity_and_acceleration_whatever_the_planned_posture_does(seed):
    """And where nothing moves any more, positions come to where they may be."""
    random = np.random.default_rng(seed)
    planned = random.uniform(-0.9, 0.9, N)
    command, q, speed, dq = started(planned), planned, np.zeros(N), np.zeros(N)
    for i in range(500):
        dq = dq + random.uniform(-1.0, 1.0, N) * LIMITS.acceleration_max * DT if i < 200 else (
            dq - np.clip(dq, -10.0 * DT, 10.0 * DT))
        dq = np.clip(dq, -1.5, 1.5)
        planned = planned + DT * dq
        if i < 250 and random.random() < 0.02:  # a push, or a joint that stands
            planned = planned + random.uniform(-0.1, 0.1, N)
        lead = random.uniform(0.0, 0.05) if i < 250 else 0.02
        before, q = q, command.advance(dq, DT, planned, np.full(N, lead))
        step = (q - before) / DT
        assert (np.abs(step) <= LIMITS.velocity_max * (1.0 + 1e-9)).all()
        inside = (np.abs(before) < 1.0) & (np.abs(q) < 1.0)
        assert (np.abs(step - speed)[inside] <= 10.0 * DT * (1.0 + 1e-6) + 1e-9).all()
        speed = step
    assert (np.abs(q - np.clip(planned, -1.0, 1.0)) <= 0.02 + 1e-9).all() or (
        np.abs(planned) > 1.0).any()


@pytest.mark.parametrize('speed', [1.0, 0.3, 0.0])
def test_it_comes_back_as_fast_as_the_limits_allow(speed):
    """It brakes for v/a, and the way back takes v_max/a and the rest of it at v_max, or less."""
    command, most = started([0.0, 0.0]), 10.0
    q = np.zeros(N)
    for i in range(100):
        q = command.advance(np.full(N, min(speed, most * DT * (i + 1))), DT)
    far = q[0] + speed**2 / (2.0 * most)
    back = min(2.0 * np.sqrt(far / most), far / 2.0 + 2.0 / most)
    before, last = q, np.full(N, speed)
    # As each of its parts takes whole ticks, it is late by a few of them.
    for _ in range(round((speed / most + back) / DT) + 5):
        before, q = q, command.come_back(np.zeros(N), DT)
        assert (np.abs((q - before) / DT - last) <= most * DT * (1.0 + 1e-6)).all()
        last = (q - before) / DT
    assert command.is_at(np.zeros(N)) and not last.any()


@pytest.mark.parametrize(('step', 'jumped'), [(0.05, False), (0.29, False), (0.31, True)])
def test_a_jump_is_more_than_the_arm_can_travel(step, jumped):
    after = np.array([0.0, -step])
    assert has_jumped(np.zeros(2), after, np.full(2, 2.0), 0.1, 0.1) is jumped
