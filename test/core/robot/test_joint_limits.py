"""Limits of joints: a parameter's, or else the URDF's, or else a default; each says which."""

from __future__ import annotations

from conftest import planar_urdf
import numpy as np
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.core.robot.model import Robot

# Case 7 of the inputs that users have, with a joint of each kind beside it.
TEXT = planar_urdf(('revolute', 'revolute', 'revolute')).replace(
    'velocity="2"', 'velocity="2" acceleration="3" jerk="77"', 1)


def arm(text=TEXT, **limits):
    return Robot(text, 'tip', axes=('vx', 'vy'), capsules=[], **limits)


def test_acceleration_and_jerk_come_from_the_urdf_and_defaults_where_it_has_none():
    robot = arm()
    np.testing.assert_array_equal(robot.acceleration_max, [3.0, 5.0, 5.0])
    np.testing.assert_array_equal(robot.jerk_max, [77.0, 500.0, 500.0])
    assert robot.limit_sources.acceleration == ('URDF', 'default', 'default')
    assert robot.limit_sources.jerk == ('URDF', 'default', 'default')
    assert robot.limit_sources.velocity == robot.limit_sources.position == ('URDF',) * 3


def test_parameters_override_one_limit_and_leave_the_others():
    robot = arm(acceleration_max=2.0)
    np.testing.assert_array_equal(robot.acceleration_max, 2.0)
    np.testing.assert_array_equal(robot.jerk_max, [77.0, 200.0, 200.0])
    assert robot.limit_sources.acceleration == ('parameter',) * 3
    assert robot.limit_sources.jerk == ('URDF', 'default', 'default')
    robot = arm(jerk_max=[10.0, 20.0, np.inf], velocity_max=1.0)
    np.testing.assert_array_equal(robot.jerk_max, [10.0, 20.0, np.inf])
    assert robot.limit_sources.jerk == robot.limit_sources.velocity == ('parameter',) * 3


@pytest.mark.parametrize(('written', 'acceleration', 'jerk'), [
    ('acceleration="4" deceleration="3"', 3.0, 300.0), ('deceleration="3"', 3.0, 300.0),
    ('acceleration="inf"', 5.0, 500.0), ('jerk="inf"', 5.0, np.inf),
    ('acceleration="inf" deceleration="inf" jerk="60"', 5.0, 60.0)])
def test_the_smaller_of_both_accelerations_counts_and_infinite_ones_are_none(
        written, acceleration, jerk):
    robot = arm(planar_urdf().replace('velocity="2"', f'velocity="2" {written}', 1))
    assert (robot.acceleration_max[0], robot.jerk_max[0]) == (acceleration, jerk)


@pytest.mark.parametrize('velocity', ['velocity="0"', 'velocity="inf"', ''])
def test_a_joint_without_a_velocity_limit_is_named(velocity):
    text = planar_urdf().replace('velocity="2"', velocity, 1)
    with pytest.raises(RobotError, match=(
            r"^joint 'joint1' of the URDF has no velocity limit; give velocity_max$")):
        arm(text)
    assert arm(text, velocity_max=1.5).velocity_max[0] == 1.5


@pytest.mark.parametrize(('text', 'limits', 'message'), [
    (TEXT.replace('"3"', '"1e7"', 1), {},
     r"^acceleration of the limit of joint 'joint1' of the URDF is 10000000.0; it must lie in "
     r'\[1e-06, 1e\+06\]; acceleration_max replaces it$'),
    (TEXT.replace('"77"', '"5"', 1), {},
     "^jerk of the limit of joint 'joint1' of the URDF is 5.0; beside an acceleration_max of 3 it "
     'must be 6 or more, so that .* within 1 s; jerk_max replaces it$'),
    (TEXT, {'jerk_max': 1.0}, "^jerk_max of joint 'joint1' is 1.0; beside an acceleration_max of"),
])
def test_numbers_that_the_planner_cannot_keep_are_named_with_what_replaces_them(
        text, limits, message):
    with pytest.raises(RobotError, match=message):
        arm(text, **limits)


def test_ranges_narrow_the_joints_that_they_name_and_give_a_continuous_one_a_range():
    robot = arm(planar_urdf(), position_limits={'joint2': (-1.0, 2.5), 'joint3': (-3.0, 3.5)})
    np.testing.assert_array_equal(robot.position_min, [-2.5, -1.0, -3.0])
    np.testing.assert_array_equal(robot.position_max, [2.5, 2.5, 3.5])
    assert robot.limit_sources.position == ('URDF', 'parameter', 'parameter')


def test_links_that_can_meet_are_the_same_in_narrower_ranges():
    """An arm may be found beyond them."""
    text = planar_urdf(('revolute',) * 4, (0.3,) * 4)
    whole, narrow = (
        Robot(text, 'tip', axes=('vx', 'vy'), link_radius=0.04, position_limits=limits)
        for limits in ({}, {f'joint{i}': (-0.1, 0.1) for i in range(1, 5)}))
    assert len(whole.self_pairs) > 0
    np.testing.assert_array_equal(narrow.self_pairs, whole.self_pairs)


@pytest.mark.parametrize(('limits', 'message'), [
    ({'joint9': (0.0, 1.0)}, "^position_limits name joint 'joint9'; the chain has 'joint1', 'jo"),
    ({'joint1': (1.0, 1.0)}, r"^position_limits of joint 'joint1' are 1..1; the first must be"),
    ({'joint1': (1.0, -1.0)}, r'are 1..-1; the first must be less than the second'),
    ({'joint1': (np.nan, 1.0)}, r'are nan..1; the first must be less'),
    ({'joint3': (-1e5, 1.0)}, r"joint 'joint3' are -100000..1; .* both must lie within ±10000"),
    ({'joint1': (-2.6, 1.0)}, r"^position_limits of joint 'joint1' are -2.6..1; they must lie "
                              r"within the URDF's, -2.5..2.5$"),
    ({'joint1': (0.0, 2.51)}, "they must lie within the URDF's"),
])
def test_ranges_that_cannot_be_are_refused(limits, message):
    with pytest.raises(RobotError, match=message):
        arm(planar_urdf(), position_limits=limits)
