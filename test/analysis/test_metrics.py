"""Measures against closed forms."""

from __future__ import annotations

from conftest import make_planar
import numpy as np
import pytest

from redundant_planner.analysis import metrics
from redundant_planner.core.obstacles.obstacle import Obstacle


def test_displacement_and_path_differ_when_a_joint_turns_back():
    positions = np.array([[0.0, 0.0], [1.0, -0.5], [0.5, -1.0]])
    np.testing.assert_allclose(metrics.displacement(positions), [0.5, 1.0])
    np.testing.assert_allclose(metrics.joint_path(positions), [1.5, 1.0])


def test_effort_of_a_constant_velocity():
    times = np.linspace(0.0, 2.0, 21)
    assert metrics.effort(np.full((21, 2), 0.5), times) == pytest.approx(2 * 0.25 * 2.0)


def test_smallest_clearance_over_links_and_over_joints():
    # A stretched planar arm along x; a ball above the middle of its first link (0.5 m long).
    robot = make_planar()
    ball = Obstacle('ball', np.array([0.25, 0.2, 0.0]), np.full(3, 0.1))
    postures = np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.5, 0.0, 0.0]])
    links = metrics.smallest_clearance(robot, postures[1:], [ball])
    assert links.level == pytest.approx((0.2 / 0.1) ** 2 - 1.0)
    assert (links.link, links.obstacle, links.sample) == ('joint1_link', 'ball', 0)
    joints = metrics.smallest_clearance(robot, postures[1:], [ball], points='joints')
    assert joints.level == pytest.approx((0.25**2 + 0.2**2) / 0.01 - 1.0)
    assert metrics.smallest_clearance(robot, postures, []).level == np.inf


def test_distance_to_a_path():
    path = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]])
    points = np.array([[0.5, 0.1, 0], [1.2, 0.5, 0], [-0.3, 0, 0.4]])
    np.testing.assert_allclose(metrics.distance_to_path(points, path), [0.1, 0.2, 0.5])
    np.testing.assert_allclose(
        metrics.distance_to_path(points[:1], path[:1].repeat(2, axis=0)), [np.hypot(0.5, 0.1)])


def test_commanded_path_of_a_held_twist():
    robot = make_planar()
    twists = np.array([[0.1, 0, 0, 0, 0, 0], [0, 0.2, 0, 0, 0, 0], [9, 9, 9, 0, 0, 0]])
    path = metrics.commanded_path(robot, np.zeros(3), np.array([0.0, 1.0, 1.5]), twists)
    np.testing.assert_allclose(path - path[0], [[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0]])


def test_periods():
    result = metrics.periods(np.array([0.0, 0.004, 0.008, 0.013]))
    assert result.median == pytest.approx(0.004) and result.longest == pytest.approx(0.005)
