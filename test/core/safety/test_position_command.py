"""The simulated arm and the position command."""

from __future__ import annotations

from conftest import planar_urdf, ROBOTS
from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.core.robot.simulated_arm import joint_ranges, SimulatedArm
from redundant_planner.core.safety.position_command import has_jumped, PositionCommand


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


def test_position_command_integrates_and_does_not_follow_the_lag():
    command = PositionCommand(np.full(2, -1.0), np.full(2, 1.0), tolerance=0.1)
    measured = np.zeros(2)
    for i in range(1, 21):
        target = command.advance(measured, np.array([0.5, 0.0]), 0.01)
        np.testing.assert_allclose(target, [0.005 * i, 0.0])


def test_position_command_stays_inside_the_limits_and_starts_again_when_lost():
    command = PositionCommand(np.full(1, -1.0), np.full(1, 1.0), tolerance=0.1)
    assert command.advance(np.array([0.99]), np.array([5.0]), 0.01) == pytest.approx(1.0)
    assert command.advance(np.array([0.5]), np.array([1.0]), 0.01) == pytest.approx(0.51)
    command.reset()
    assert command.advance(np.array([0.2]), np.array([0.0]), 0.01) == pytest.approx(0.2)


def test_position_command_does_not_pull_an_arm_found_outside_its_limits():
    command = PositionCommand(np.full(1, -1.0), np.full(1, 1.0), tolerance=0.1)
    assert command.advance(np.array([1.05]), np.array([0.0]), 0.01) == pytest.approx(1.05)


@pytest.mark.parametrize(('step', 'jumped'), [(0.05, False), (0.29, False), (0.31, True)])
def test_a_jump_is_more_than_the_arm_can_travel(step, jumped):
    after = np.array([0.0, -step])
    assert has_jumped(np.zeros(2), after, np.full(2, 2.0), 0.1, 0.1) is jumped
