"""What may be of the arm is taken out, and nothing else."""

from __future__ import annotations

from camera_views import distances_to
from conftest import random_postures
import numpy as np
import pytest

from redundant_planner.perception.own_shape import (
    keep_outside,
    own_shape,
    reach_of,
    surface_distances,
)


def test_points_are_kept_exactly_if_they_are_outside_every_capsule(robot):
    random = np.random.default_rng(0)
    for q in random_postures(robot, 20):
        speed = random.uniform(0.0, 1.0, robot.n)
        own = own_shape(robot, q, speed, 0.03, 0.02)
        center, reach = reach_of(robot)
        points = center[:, None] + random.uniform(-reach, reach, (3, 3000))
        expected = points[:, distances_to(own, points.T, own.thick) > 0.0]
        count = keep_outside(points, own)
        np.testing.assert_array_equal(points[:, :count], expected)


def test_distances_are_those_from_the_nearest_capsule(robot):
    random = np.random.default_rng(1)
    own = own_shape(robot, random_postures(robot, 1)[0], np.ones(robot.n), 0.03, 0.02)
    points = random.uniform(-1.0, 1.0, (500, 3))
    found = surface_distances(points, own)
    np.testing.assert_allclose(found[:, 0], distances_to(own, points, own.radius), atol=1e-12)
    np.testing.assert_allclose(found[:, 1], distances_to(own, points, own.thick), atol=1e-12)


def test_no_link_moves_out_of_its_thick_capsule_within_the_uncertainty(robot):
    """The ends of the segments, at constant joint velocities."""
    random = np.random.default_rng(2)
    for q in random_postures(robot, 20):
        dq = random.uniform(-1.0, 1.0, robot.n)
        own = own_shape(robot, q, np.abs(dq), 0.0, 0.05)
        for later in (-0.05, -0.02, 0.03, 0.05):
            moved = robot.kinematics(q + later * dq)
            for here, there in ((own.start, moved.segment_start), (own.end, moved.segment_end)):
                assert (np.linalg.norm(there - here, axis=1)
                        <= own.thick - own.radius + 1e-9).all()


def test_nothing_of_the_arm_leaves_its_reach(robot):
    center, reach = reach_of(robot)
    farthest = 0.0
    for q in random_postures(robot, 300):
        own = own_shape(robot, q, np.zeros(robot.n), 0.0, 0.0)
        for ends in (own.start, own.end):
            farthest = max(farthest, (np.linalg.norm(ends - center, axis=1) + own.radius).max())
    assert 0.5 * reach < farthest <= reach


def test_a_margin_is_added_to_every_radius(panda):
    q = random_postures(panda, 1)[0]
    own = own_shape(panda, q, np.zeros(7), 0.04, 1.0)
    assert own.thick == pytest.approx(own.radius + 0.04)
    faster = own_shape(panda, q, np.eye(7)[6], 0.04, 0.01)
    assert faster.thick - own.thick == pytest.approx(0.01 * panda.lever_arm_bounds[:, 6])
