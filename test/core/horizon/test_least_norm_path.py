"""Steps to a pose, against the formula."""

from __future__ import annotations

from conftest import random_postures
import numpy as np

from redundant_planner.core.horizon.least_norm_path import SQUARED_DAMPING, step_to_pose
from redundant_planner.core.redundancy.null_space import orthogonal_factors


def test_the_step_to_a_pose_is_the_damped_least_norm_one(robot):
    random = np.random.default_rng(0)
    for q in random_postures(robot, 10):
        jacobian, error = robot.kinematics(q).jacobian, random.normal(size=robot.m)
        expected = jacobian.T @ np.linalg.solve(
            jacobian @ jacobian.T + SQUARED_DAMPING * np.eye(robot.m), error)
        step = step_to_pose(*orthogonal_factors(jacobian), error, SQUARED_DAMPING)
        np.testing.assert_allclose(step, expected, atol=1e-9)
