"""The theorem about Eq. 17, on the paper's arm and on a Panda."""

from __future__ import annotations

from conftest import central_difference, make_panda, make_paper_arm, random_postures
import numpy as np
import pytest

from redundant_planner.core.robot.jacobian import jacobian_derivative
from redundant_planner.paper import equation_17

ROBOTS = {'paper': make_paper_arm, 'panda': make_panda}


def cases(make, count=20):
    robot = make()
    random = np.random.default_rng(0)
    rows = robot.task_rows(np.arange(6)).astype(int)
    for q in random_postures(robot, count):
        jacobian = robot.kinematics(q).jacobian
        derivative = jacobian_derivative(robot.kinematics(q).tip_jacobian)[:, rows]
        yield robot, q, jacobian, derivative, random.normal(size=robot.m)


@pytest.mark.parametrize('make', ROBOTS.values(), ids=ROBOTS)
def test_derivatives_match_finite_differences(make):
    for robot, q, jacobian, derivative, _ in cases(make):
        def inverse(p, robot=robot):
            return np.linalg.pinv(robot.kinematics(p).jacobian)

        def projector(p, robot=robot):
            return inverse(p) @ robot.kinematics(p).jacobian

        for actual, function in (
                (equation_17.pseudo_inverse_derivative(jacobian, derivative), inverse),
                (equation_17.projector_derivative(jacobian, derivative), projector)):
            expected = central_difference(function, q).transpose(2, 0, 1)
            assert (np.linalg.norm(actual - expected)
                    <= 1e-5 * (1.0 + np.linalg.norm(expected)))


@pytest.mark.parametrize('make', ROBOTS.values(), ids=ROBOTS)
def test_the_identities_of_the_proof(make):
    for _, _, jacobian, derivative, twist in cases(make):
        inverse = np.linalg.pinv(jacobian)
        projector = np.eye(len(derivative)) - inverse @ jacobian
        change = equation_17.projector_derivative(jacobian, derivative)
        scale = 1.0 + np.abs(change).max()
        np.testing.assert_allclose(projector @ change @ projector / scale, 0.0, atol=1e-12)
        right = projector @ equation_17.pseudo_inverse_derivative(jacobian, derivative) @ twist
        np.testing.assert_allclose(right / scale, projector @ change @ inverse @ twist / scale,
                                   atol=1e-10)


def holds(result, robot, least):
    """What both readings have in common: J⁺ẋ solves the equation, and nothing gets past P."""
    size = 1.0 + np.linalg.norm(least)
    rows = np.linalg.pinv(result.matrix, rcond=1e-10) @ result.matrix
    np.testing.assert_allclose(result.gradient, rows @ least, atol=1e-8 * size)
    assert result.projected_norm < 1e-9 * size
    assert result.rank <= robot.m
    assert result.condition_number > 1e12


@pytest.mark.parametrize('make', ROBOTS.values(), ids=ROBOTS)
def test_the_tensor_reading_gives_the_least_norm_solution_and_nothing_else(make):
    for robot, _, jacobian, derivative, twist in cases(make):
        result = equation_17.as_tensor(jacobian, derivative, twist)
        least = np.linalg.pinv(jacobian) @ twist
        holds(result, robot, least)
        if result.rank == robot.m:
            np.testing.assert_allclose(result.gradient, least,
                                       atol=1e-8 * (1.0 + np.linalg.norm(least)))


def test_the_rank_is_full_on_the_papers_arm_and_short_by_one_on_a_panda():
    # The Panda's null-space direction does not change with its first and its last joint: the
    # equations see five of the six directions of J, and give J⁺ẋ's share of those.
    assert all(equation_17.as_tensor(j, d, t).rank == robot.m
               for robot, _, j, d, t in cases(make_paper_arm))
    assert all(equation_17.as_tensor(j, d, t).rank == robot.m - 1
               for robot, _, j, d, t in cases(make_panda))


@pytest.mark.parametrize('make', ROBOTS.values(), ids=ROBOTS)
def test_the_time_derivative_reading_gives_a_part_of_it(make):
    for robot, _, jacobian, derivative, twist in cases(make):
        least = np.linalg.pinv(jacobian) @ twist
        result = equation_17.as_time_derivative(jacobian, derivative, twist, least)
        assert result.rank <= min(robot.m, robot.n - robot.m)
        holds(result, robot, least)
