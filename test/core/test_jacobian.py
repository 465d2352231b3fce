"""∂J/∂q against finite differences."""

from __future__ import annotations

from conftest import central_difference, random_postures
import numpy as np

from redundant_planner.core.jacobian import (
    jacobian_derivative,
    jacobian_derivative_times,
    tool_derivative_times,
)


def test_tensor_matches_finite_differences(robot):
    for q in random_postures(robot, 20):
        expected = central_difference(lambda p: robot.kinematics(p).tip_jacobian, q)
        actual = jacobian_derivative(robot.kinematics(q).tip_jacobian)
        np.testing.assert_allclose(actual, expected.transpose(2, 0, 1), atol=1e-7)


def test_product_is_the_tensor_times_dq(robot):
    random = np.random.default_rng(1)
    for q in random_postures(robot, 20):
        dq = random.normal(size=robot.n)
        jacobian = robot.kinematics(q).tip_jacobian
        np.testing.assert_allclose(jacobian_derivative_times(jacobian, dq),
                                   (jacobian_derivative(jacobian) @ dq).T, atol=1e-12)


def test_tool_axes_match_finite_differences(robot):
    def in_tool_axes(p):
        arm = robot.kinematics(p)
        return np.vstack((arm.tip_rotation.T @ arm.tip_jacobian[:3],
                          arm.tip_rotation.T @ arm.tip_jacobian[3:]))

    random = np.random.default_rng(2)
    for q in random_postures(robot, 20):
        dq = random.normal(size=robot.n)
        arm = robot.kinematics(q)
        expected = central_difference(lambda p, dq=dq: in_tool_axes(p) @ dq, q)
        np.testing.assert_allclose(
            tool_derivative_times(arm.tip_jacobian, arm.tip_rotation, dq), expected, atol=1e-7)
