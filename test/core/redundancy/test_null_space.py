"""Identities of the least-norm and homogeneous solutions."""

from __future__ import annotations

from conftest import random_postures
from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.redundancy import null_space as ns


def test_undamped_identities(robot):
    random = np.random.default_rng(0)
    for q in random_postures(robot, 20):
        jacobian = robot.kinematics(q).jacobian
        parts = ns.decompose(jacobian)
        gains = ns.inverse_gains(parts.singular_values, 0.0, 0.0)
        projector = ns.null_space_projector(parts)
        np.testing.assert_allclose(jacobian @ projector, 0.0, atol=1e-12)
        np.testing.assert_allclose(projector @ projector, projector, atol=1e-12)
        np.testing.assert_allclose(projector, projector.T, atol=1e-15)
        np.testing.assert_allclose(ns.pseudo_inverse(parts, gains), np.linalg.pinv(jacobian),
                                   atol=1e-9)
        twist, gradient = random.normal(size=robot.m), random.normal(size=robot.n)
        least = ns.least_norm(parts, gains, twist)
        np.testing.assert_allclose(jacobian @ least, twist, atol=1e-9)
        projected = ns.project(parts, gradient)
        np.testing.assert_allclose(projected, projector @ gradient, atol=1e-12)
        assert abs(least @ projected) < 1e-9 * (1.0 + np.linalg.norm(least))


@given(st.integers(1, 6), st.integers(0, 3), st.floats(0.0, 0.2), st.integers(0, 10**6))
def test_damping_slows_the_tip_and_never_leaks(m, spare, smallest, seed):
    # J with a smallest singular value at will. ‖Jq̇ − ẋ‖ ≤ λ²/(σ_min² + λ²) ‖ẋ‖, and J P = 0 all
    # the same.
    random = np.random.default_rng(seed)
    left, _ = np.linalg.qr(random.normal(size=(m, m)))
    right, _ = np.linalg.qr(random.normal(size=(m + spare, m)))
    values = np.append(np.sort(random.uniform(0.3, 2.0, m - 1))[::-1], smallest)
    jacobian = left @ np.diag(values) @ right.T
    twist = random.normal(size=m)
    parts = ns.decompose(jacobian)
    threshold, damping = 0.1, 0.05
    gains = ns.inverse_gains(parts.singular_values, threshold, damping)
    dq = ns.least_norm(parts, gains, twist)
    squared = damping**2 * max(0.0, 1.0 - (smallest / threshold) ** 2)
    leak = squared / (smallest**2 + squared) if smallest < threshold else 0.0
    assert np.linalg.norm(jacobian @ dq - twist) <= leak * np.linalg.norm(twist) + 1e-9
    assert np.linalg.norm(dq) <= np.linalg.norm(twist) * max(gains.max(), 0.0) + 1e-12
    assert gains.max() <= max(1.0 / 0.3, 1.0 / threshold, 1.0 / damping) * 1.001
    if smallest > 1e-6:
        np.testing.assert_allclose(jacobian @ ns.null_space_projector(parts), 0.0, atol=1e-12)


def test_a_direction_without_any_gain_belongs_to_the_null_space():
    jacobian = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    parts = ns.decompose(jacobian)
    np.testing.assert_allclose(np.diag(ns.null_space_projector(parts)), [0.0, 1.0, 1.0])
    gains = ns.inverse_gains(parts.singular_values, 0.0, 0.0)
    np.testing.assert_allclose(ns.least_norm(parts, gains, np.array([2.0, 3.0])), [2.0, 0.0, 0.0])


@given(st.integers(1, 6), st.integers(0, 3), st.integers(0, 6), st.integers(0, 10**6))
def test_the_orthogonal_factors_make_up_a_jacobian_of_any_rank(m, spare, rank, seed):
    random = np.random.default_rng(seed)
    rank = min(rank, m)
    jacobian = random.normal(size=(m, rank)) @ random.normal(size=(rank, m + spare))
    orthogonal, upper = ns.orthogonal_factors(jacobian)
    np.testing.assert_allclose(orthogonal @ orthogonal.T, np.eye(m + spare), atol=1e-12)
    np.testing.assert_allclose(orthogonal[:, :m] @ upper, jacobian.T, atol=1e-12)
    np.testing.assert_allclose(jacobian @ orthogonal[:, m:], 0.0, atol=1e-12)
    assert (upper == np.triu(upper)).all()


def test_manipulability_is_the_root_of_the_determinant(panda):
    for q in random_postures(panda, 20):
        jacobian = panda.kinematics(q).jacobian
        expected = np.sqrt(np.linalg.det(jacobian @ jacobian.T))
        assert ns.manipulability(ns.decompose(jacobian)) == pytest.approx(expected, rel=1e-6)


@given(st.floats(0.0, 5.0), st.just(0.0) | st.floats(1e-100, 1e3),
       st.just(0.0) | st.floats(1e-100, 1e6))
def test_dynamic_factor_is_equation_2(k_alpha, least, projected):
    factor = ns.dynamic_factor(
        k_alpha, least * np.array([0.6, 0.0, 0.8]), projected * np.array([0.0, -1.0, 0.0]))
    if least + projected == 0.0:
        assert factor == 0.0
    else:
        assert factor == pytest.approx(k_alpha * least / (least + projected))
    # The homogeneous solution is never longer than kα times the least-norm one.
    assert factor * projected <= k_alpha * least * (1.0 + 1e-12) + 1e-300
