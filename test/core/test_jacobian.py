"""∂J/∂q against finite differences, and the two ways to it against each other."""

from __future__ import annotations

from conftest import central_difference, random_postures
import numpy as np

from redundant_planner.core.jacobian import jacobian_derivative


def test_tensor_matches_finite_differences(robot):
    for q in random_postures(robot, 20):
        expected = central_difference(lambda p: robot.kinematics(p).tip_jacobian, q)
        actual = jacobian_derivative(robot.kinematics(q).tip_jacobian)
        np.testing.assert_allclose(actual, expected.transpose(2, 0, 1), atol=1e-7)


def test_product_matches_finite_differences_in_either_frame(robot):
    random = np.random.default_rng(2)
    for q in random_postures(robot, 20):
        dq = random.normal(size=robot.n)
        expected = central_difference(lambda p, dq=dq: robot.kinematics(p).jacobian @ dq, q)
        np.testing.assert_allclose(
            robot.jacobian_derivative_times(robot.kinematics(q), dq), expected, atol=1e-7)


def test_product_is_the_tensor_times_dq(robot):
    random = np.random.default_rng(1)
    for q in random_postures(robot, 20):
        dq = random.normal(size=robot.n)
        arm = robot.kinematics(q)
        if robot.command_frame == 'base':
            expected = (jacobian_derivative(arm.tip_jacobian) @ dq).T
            rows = robot.task_rows(np.arange(6)).astype(int)
            np.testing.assert_allclose(
                robot.jacobian_derivative_times(arm, dq), expected[rows], atol=1e-12)


def test_the_rate_is_the_product_along_the_motion(robot):
    random = np.random.default_rng(3)
    for q in random_postures(robot, 20):
        dq = random.normal(size=robot.n)
        arm = robot.kinematics(q)
        np.testing.assert_allclose(
            robot.jacobian_rate_times(arm, dq),
            robot.jacobian_derivative_times(arm, dq) @ dq, atol=1e-12)
