"""The simulated controllers follow the rules that were measured on the real ones."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.ros2_control import Manager, Point, POSITION, Settings, TRAJECTORY, VELOCITY

NAMES, T = ('finger', 'a', 'b'), 0.004
START = np.array([0.01, 0.5, -0.5])


def manager(controller, joints=('a', 'b'), **settings):
    return Manager(NAMES, START, controller, joints, T, Settings(**settings))


def run(arm, cycles):
    """Return the velocities in each of some cycles."""
    velocities = []
    for _ in range(cycles):
        arm.cycle()
        velocities.append(arm.dq)
    return np.array(velocities)


def change(arm, **settings):
    arm.settings = Settings(**settings)


def test_a_velocity_is_carried_out_one_cycle_later_and_stays_for_ever():
    arm = manager(VELOCITY)
    arm.forward([0.1, -0.2])
    velocities = run(arm, 1001)
    assert not velocities[0].any()
    np.testing.assert_allclose(velocities[1:], np.tile([0.0, 0.1, -0.2], (1000, 1)), atol=1e-9)
    np.testing.assert_allclose(arm.q, START + 4.0 * np.array([0.0, 0.1, -0.2]))
    change(arm, active=False)
    assert run(arm, 100)[-1] == pytest.approx([0.0, 0.1, -0.2])


def test_numbers_go_to_the_joints_in_the_controllers_order():
    arm = manager(VELOCITY, ('b', 'a'))
    arm.forward([0.1, -0.2])
    assert run(arm, 2)[-1] == pytest.approx([0.0, -0.2, 0.1])
    arm.forward([0.1, 0.2, 0.3])
    assert arm.refused == 1 and run(arm, 2)[-1] == pytest.approx([0.0, -0.2, 0.1])


@pytest.mark.parametrize('controller', [VELOCITY, POSITION])
def test_an_inactive_controller_ignores_messages_and_waits_for_the_next_when_activated(controller):
    arm = manager(controller, active=False)
    arm.forward(START[1:] + 0.1)
    assert not run(arm, 10).any()
    change(arm)
    assert not run(arm, 10).any()
    arm.forward(START[1:] + 0.1)
    assert run(arm, 2)[-1].any()


def test_a_position_far_away_is_a_leap():
    arm = manager(POSITION)
    arm.forward(START[1:] + 0.1)
    assert run(arm, 3)[:, 1] == pytest.approx([0.0, 0.1 / T, 0.0])


def test_a_trajectory_is_interpolated_from_where_the_arm_is_and_then_held():
    arm = manager(TRAJECTORY)
    arm.cycle()
    arm.trajectory(('b', 'a'), [Point(4 * T, [-0.5, 0.54])])
    assert run(arm, 7)[:, 1] == pytest.approx([0, *[0.01 / T] * 4, 0, 0])
    assert arm.q == pytest.approx([0.01, 0.54, -0.5])
    arm.trajectory(('a', 'b'), [Point(2 * T, [0.56, -0.5]), Point(4 * T, [0.56, -0.46])])
    velocities = run(arm, 6)
    assert velocities[:, 1] == pytest.approx([0, 0.01 / T, 0.01 / T, 0, 0, 0])
    assert velocities[:, 2] == pytest.approx([0, 0, 0, 0.02 / T, 0.02 / T, 0])


@pytest.mark.parametrize('joints, points, word', [
    (('a',), [Point(T, [0.5])], 'joints'),
    (('a', 'c'), [Point(T, [0.5, 0.5])], 'joints'),
    (('a', 'b'), [], 'increasing'),
    (('a', 'b'), [Point(T, [0.5, 0.5]), Point(T, [0.5, 0.5])], 'increasing'),
    (('a', 'b'), [Point(T, [0.5])], 'mismatch'),
    (('a', 'b'), [Point(T, [0.5, 0.5], [0.0, 1e-6])], 'not zero')])
def test_what_the_trajectory_controller_refuses(joints, points, word):
    arm = manager(TRAJECTORY)
    arm.trajectory(joints, points)
    assert arm.refused == 1 and word in arm.error
    assert not run(arm, 5).any()


def test_a_velocity_at_the_end_is_taken_on_request_and_led_to_by_a_cubic():
    arm = manager(TRAJECTORY, allow_nonzero_velocity_at_trajectory_end=True)
    arm.cycle()
    arm.trajectory(('a', 'b'), [Point(100 * T, [0.6, -0.5], [0.5, 0.0])])
    velocities = run(arm, 103)[:, 1]
    assert not arm.refused and arm.q[1] == pytest.approx(0.6)
    assert velocities[1] == pytest.approx(0.0, abs=0.01)
    assert velocities[100] == pytest.approx(0.5, abs=0.01) and velocities[102] == 0.0


def test_activated_it_holds_where_the_arm_is():
    arm = manager(TRAJECTORY, active=False)
    arm.trajectory(('a', 'b'), [Point(2 * T, [1.0, 1.0])])
    arm.cycle()
    change(arm, active=False, moved={'a': 0.5})
    assert run(arm, 100)[-1] == pytest.approx([0.0, 0.5, 0.0])
    change(arm)
    assert not run(arm, 100).any()


@pytest.mark.parametrize('controller', [VELOCITY, POSITION, TRAJECTORY])
def test_frozen_hardware_stands_and_dead_hardware_says_so_alone(controller):
    def command(arm, i):
        if controller == VELOCITY:
            arm.forward([0.5, 0.0])
        elif controller == POSITION:
            arm.forward([0.5 + i * 0.5 * T, -0.5])
        else:
            arm.trajectory(('a', 'b'), [Point(2 * T, [0.5 + (i + 1) * 0.5 * T, -0.5])])
        arm.cycle()

    for trouble in ('frozen', 'dead'):
        arm = manager(controller)
        for i in range(100):
            command(arm, i)
        assert arm.dq == pytest.approx([0.0, 0.5, 0.0])
        change(arm, **{trouble: True})
        q, measured = arm.q.copy(), arm.measured.copy()
        for i in range(100, 110):
            command(arm, i)
        assert (arm.measured == measured).all()
        assert (arm.q[1] > q[1] + 0.001) == (trouble == 'dead')


@pytest.mark.parametrize('controller', [VELOCITY, POSITION])
def test_gain_stuck_joints_lag_and_dead_time(controller):
    def follow(cycles, **settings):
        arm = manager(controller, **settings)
        for i in range(cycles):
            arm.forward([0.5, 0.2] if controller == VELOCITY else START[1:] + np.array(
                [0.5, 0.2]) * T * (i + 1))
            arm.cycle()
        return arm.q - START, arm.dq

    told = 250 * T * np.array([0.0, 0.5, 0.2])
    for factor in (0.5, 1.5):
        moved, _ = follow(251, gain={'a': factor})
        assert moved == pytest.approx(told * [1.0, factor, 1.0])
    moved, _ = follow(251, stuck=('b',))
    assert moved == pytest.approx(told * [1.0, 1.0, 0.0])
    moved, velocities = follow(501, lag=0.05, dead_time=0.04)
    assert velocities == pytest.approx([0.0, 0.5, 0.2], rel=1e-3)
    late = 2.0 - moved[1] / 0.5
    assert late == pytest.approx(0.09, abs=T)


def test_a_position_drive_returns_from_a_push_and_leaps_when_a_joint_comes_loose():
    arm = manager(POSITION, pushed={'a': 0.5}, lag=0.02)
    run(arm, 10)
    assert arm.q[1] > 0.508
    change(arm, lag=0.02)
    run(arm, 100)
    assert arm.q == pytest.approx(START, abs=1e-6)
    change(arm, stuck=('a',))
    arm.forward([0.6, -0.5])
    assert not run(arm, 10)[:, 1].any()
    change(arm)
    assert run(arm, 1)[-1][1] == pytest.approx(0.1 / T)


def test_backlash_and_noise():
    arm = manager(VELOCITY, backlash=0.01)
    arm.forward([0.5, 0.0])
    run(arm, 26)
    assert arm.q[1] == pytest.approx(0.5 + 25 * 0.5 * T - 0.005)
    arm.forward([-0.5, 0.0])
    assert np.count_nonzero(run(arm, 26)[:, 1]) == pytest.approx(26 - 5, abs=1)
    change(arm, noise=5e-4)
    measured = np.array([(arm.cycle(), arm.measured - arm.q)[1] for _ in range(1000)])
    assert measured.std(axis=0) == pytest.approx([5e-4] * 3, rel=0.1)
