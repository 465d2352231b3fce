"""An arm on a base: its URDF, its limits, and the base's twist in its own axes."""

from __future__ import annotations

from conftest import PANDA_URDF, ROBOTS
from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import ParameterError
from redundant_planner.io.mobile_base import (
    BASE_JOINTS,
    ODOM,
    on_base,
    own_twist,
    with_base,
    world_rates,
)
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.robot_files import load_robot

NUMBERS = st.floats(-2.0, 2.0)
BASE = RobotParameters(base='holonomic')


def panda(**changes):
    return load_robot(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF), base='holonomic', **changes)


def test_the_base_moves_all_that_the_arm_is():
    robot = panda()
    assert robot.joint_names[:3] == BASE_JOINTS and robot.n == 10 and robot.base_frame == ODOM
    q = np.array([0.4, -0.3, 0.5 * np.pi, 0.0, -0.8, 0.0, -2.4, 0.0, 1.6, 0.8])
    moved = robot.kinematics(q).tip_position
    there = robot.kinematics(np.concatenate((np.zeros(3), q[3:]))).tip_position
    np.testing.assert_allclose(moved, [0.4 - there[1], -0.3 + there[0], there[2]], atol=1e-12)


def test_limits_and_weights_of_the_base_are_its_own():
    robot = panda(base_speed=(0.3, 0.7), base_acceleration=(0.2, 0.4), base_weight=9.0)
    alone = load_robot(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF))
    np.testing.assert_array_equal(robot.velocity_max, [0.3, 0.3, 0.7, *alone.velocity_max])
    np.testing.assert_array_equal(
        robot.acceleration_max, [0.2, 0.2, 0.4, *alone.acceleration_max])
    np.testing.assert_array_equal(robot.weights, [9.0] * 3 + [1.0] * 7)
    assert robot.position_max[0] == 5.0 and np.isinf(robot.position_max[2])


def test_one_limit_is_for_the_arm_alone():
    assert with_base((5.0,), (1.0, 1.0, 2.0), 6) == (1.0, 1.0, 2.0, 5.0, 5.0, 5.0)
    assert with_base((5.0, 6.0, 7.0), (1.0,), 4) == (1.0, 5.0, 6.0, 7.0)
    assert with_base((5.0, 6.0, 7.0, 8.0), (1.0,), 4) == (5.0, 6.0, 7.0, 8.0)


def test_a_base_is_added_once():
    urdf = on_base(PANDA_URDF.read_text(), BASE)
    assert on_base(urdf, BASE) == urdf
    assert on_base(urdf, RobotParameters()) == urdf


@pytest.mark.parametrize(('change', 'message'), [
    ({'mount_frame': 'cell'}, 'what stands on a base stands nowhere else'),
    ({'base_speed': (0.5,)}, "'base.speed' has 1 numbers; it takes two"),
])
def test_parameters_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ParameterError, match=message):
        RobotParameters(base='holonomic', **change)


def test_names_that_are_taken_are_named():
    with pytest.raises(ParameterError, match=r"names \['odom'\]"):
        on_base('<robot name="r"><link name="odom"/></robot>', BASE)


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_a_twist_in_the_bases_own_axes_and_back(x, y, turning, yaw):
    twist = np.array((x, y, turning))
    np.testing.assert_allclose(own_twist(world_rates(twist, yaw), yaw), twist, atol=1e-12)
    # Ahead is where the base looks.
    ahead = world_rates(np.array((1.0, 0.0, 0.0)), yaw)
    np.testing.assert_allclose(ahead, (np.cos(yaw), np.sin(yaw), 0.0), atol=1e-12)
