"""∂J/∂q against finite differences, and the two ways to it against each other."""

from __future__ import annotations

from functools import partial

from conftest import central_difference, random_postures
import numpy as np

from redundant_planner.core.robot.jacobian import (
    derivative_between,
    derivative_times,
    jacobian_derivative,
    jdot_qdot,
)


def product(robot, q, dq, function=derivative_times):
    arm = robot.kinematics(q)
    return function(arm.tip_jacobian, dq, arm.tip_rotations, robot.in_tool, robot.rows)


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
        np.testing.assert_allclose(product(robot, q, dq), expected, atol=1e-7)


def test_product_is_the_tensor_times_dq(robot):
    random = np.random.default_rng(1)
    for q in random_postures(robot, 20):
        dq = random.normal(size=robot.n)
        arm = robot.kinematics(q)
        if robot.command_frame == 'base':
            expected = (jacobian_derivative(arm.tip_jacobian) @ dq).T
            np.testing.assert_allclose(product(robot, q, dq), expected[robot.rows], atol=1e-12)


def test_the_rate_is_the_product_along_the_motion(robot):
    random = np.random.default_rng(3)
    for q in random_postures(robot, 20):
        dq = random.normal(size=robot.n)
        np.testing.assert_allclose(
            product(robot, q, dq, jdot_qdot), product(robot, q, dq) @ dq, atol=1e-12)


def test_products_between_two_directions(robot):
    random = np.random.default_rng(4)
    for q in random_postures(robot, 20):
        left, dq = random.normal(size=robot.m), random.normal(size=robot.n)
        np.testing.assert_allclose(
            product(robot, q, dq, partial(derivative_between, left)),
            left @ product(robot, q, dq), atol=1e-12)
