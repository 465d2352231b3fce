"""Clouds become the voxels of obstacles: all of them, and never the arm's own."""

from __future__ import annotations

from dataclasses import replace

from camera_views import (
    arm_of,
    body,
    CAMERA,
    distances_to,
    in_base,
    looking,
    seen,
    still,
    together,
)
from conftest import PANDA_READY, random_postures
import numpy as np
import pytest

from redundant_planner.io.perception_parameters import CloudParameters
from redundant_planner.perception import cloud_filter
from redundant_planner.perception.cloud_filter import CloudFilter
from redundant_planner.perception.depth_camera import DepthCamera
from redundant_planner.perception.own_shape import own_shape, reach_of
from redundant_planner.perception.voxel_grid import key_of

POSE = looking((1.6, 0.4, 1.1), (0.0, 0.0, 0.4))
EVERY_POINT = CloudParameters(min_points=1)
NOTHING = np.full((3, 1), np.nan)
BALL = body('ellipsoid', (0.5, 0.4, 0.6), (0.1, 0.1, 0.1))
BACKDROP = body('box', (-1.8, 0.0, 0.0), (0.1, 4.0, 4.0))


def views(robot, count):
    """Postures and cameras around the arm."""
    random = np.random.default_rng(3)
    for q in random_postures(robot, count, seed=5):
        angle, height = random.uniform(-np.pi, np.pi), random.uniform(0.1, 1.8)
        yield q, looking((1.7 * np.cos(angle), 1.7 * np.sin(angle), height),
                         random.normal(0.0, 0.1, 3) + [0.0, 0.0, 0.4])


def test_the_arm_never_sees_itself_in_200_postures(panda):
    """With the noise of a camera, and a stamp that is wrong while the arm moves."""
    random = np.random.default_rng(0)
    parameters = CloudParameters(min_points=1, self_margin=0.03, stamp_uncertainty=0.02)
    camera, points = DepthCamera(160, 120, 1.2, 5.0, noise=0.005), 0
    for q, pose in views(panda, 200):
        dq = random.uniform(-1.0, 1.0, 7) * panda.velocity_max
        cloud = seen(pose, arm_of(panda, q + random.uniform(-0.02, 0.02) * dq), camera, random)
        points += np.isfinite(cloud[0]).sum()
        found = CloudFilter(panda, parameters).see(cloud, pose, still(q, np.abs(dq)), 1.0)
        assert not len(found)
    assert points > 100_000


def test_without_its_margin_it_would_see_itself(panda):
    """So the test above can fail."""
    seeing = 0
    camera = DepthCamera(160, 120, 1.2, 5.0, noise=0.005)
    for q, pose in views(panda, 20):
        cloud = seen(pose, arm_of(panda, q), camera, np.random.default_rng(0))
        seeing += len(CloudFilter(panda, CloudParameters(self_margin=0.0)).see(
            cloud, pose, still(q), 1.0)) > 0
    assert seeing == 20


def test_no_point_of_an_obstacle_outside_the_thick_arm_is_lost(panda):
    """Every such point within reach lies in a voxel, and every voxel holds such a point."""
    random, checked, taken_out = np.random.default_rng(1), 0, 0
    center, reach = reach_of(panda)
    for q, pose in views(panda, 60):
        obstacles = [body(shape, random.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.2]),
                          random.uniform(0.03, 0.2, 3) if shape in ('ellipsoid', 'box')
                          else np.array([0.06, 0.06, 0.2]))
                     for shape in ('ellipsoid', 'box', 'cylinder', 'capsule')]
        dq = random.uniform(0.0, 0.5, 7)
        cloud = seen(pose, together(arm_of(panda, q), *obstacles))
        centers = CloudFilter(panda, EVERY_POINT).see(cloud, pose, still(q, dq), 1.0)
        size = EVERY_POINT.voxel_size
        voxels = {key_of(c, size) for c in centers}
        assert len(voxels) == len(centers)
        points = in_base(cloud, pose)
        own = own_shape(panda, q, dq, EVERY_POINT.self_margin, EVERY_POINT.stamp_uncertainty)
        away = distances_to(own, points, own.thick)
        inside = np.linalg.norm(points - center, axis=1) <= reach + EVERY_POINT.reach_margin
        expected = {key_of(p, size) for p in points[inside & (away > 1e-9)]}
        allowed = {key_of(p, size) for p in points[inside & (away > -1e-9)]}
        assert expected <= voxels <= allowed
        checked += len(expected)
        on_arm = np.abs(distances_to(own, points, own.radius)) < 1e-9
        taken_out += (inside & (away < 0.0) & ~on_arm).sum()
    assert checked > 5000 and taken_out > 100  # there were obstacles at the arm, too


def test_an_obstacle_that_goes_before_a_backdrop_is_free_at_once_and_before_nothing_later(panda):
    bodies = arm_of(panda, PANDA_READY)
    for backdrop, after in ((BACKDROP, 0.05), (None, 2.0)):
        rest = together(bodies, backdrop) if backdrop is not None else bodies
        world = CloudFilter(panda, CloudParameters())
        there = len(world.see(seen(POSE, together(rest, BALL)), POSE, still(PANDA_READY), 10.0))
        assert there > 20
        for stamp in np.arange(10.05, 12.5, 0.05):
            left = len(world.see(seen(POSE, rest), POSE, still(PANDA_READY), stamp))
            gone_after = stamp - 10.0
            if left == 0:
                break
            if backdrop is None:
                assert left == there
        assert gone_after == pytest.approx(after, abs=0.051 if backdrop is None else 1e-9)


def test_without_ray_clearing_it_stays_and_in_the_base_frame_too(panda):
    rest = together(arm_of(panda, PANDA_READY), BACKDROP)
    with_ball, without = seen(POSE, together(rest, BALL)), seen(POSE, rest)
    for parameters, pose in ((CloudParameters(ray_clearing=False), POSE),
                             (CloudParameters(), POSE._replace(at_sensor=False))):
        world = CloudFilter(panda, parameters)
        there = len(world.see(with_ball, pose, still(PANDA_READY), 10.0))
        assert len(world.see(without, pose, still(PANDA_READY), 10.1)) == there
        assert len(world.see(without, pose, still(PANDA_READY), 12.1)) == 0


def test_what_the_arm_hides_stays_until_its_time_is_over(panda):
    """Elsewhere the sensor sees through, and clears at once."""
    box = body('box', (-0.3, 0.0, 0.5), (0.05, 0.4, 0.4))
    world = CloudFilter(panda, CloudParameters(persistence=1.0))
    away, hiding = PANDA_READY + np.r_[2.0, np.zeros(6)], PANDA_READY
    pose = looking((1.8, 0.0, 0.7), (-0.3, 0.0, 0.6))
    before = world.see(seen(pose, together(arm_of(panda, away), box, BACKDROP)), pose,
                       still(away), 10.0)
    # The box goes, and the arm stands before where it was.
    def view(stamp):
        return world.see(seen(pose, together(arm_of(panda, hiding), BACKDROP)), pose,
                         still(hiding), stamp)
    hidden = view(10.1)
    assert 10 < len(hidden) < 0.7 * len(before)
    assert len(view(10.9)) == len(hidden)
    # But for those at the arm, which no cloud can show.
    own = own_shape(panda, hiding, np.zeros(7), 0.03 + 0.5 * np.sqrt(3.0) * 0.025, 0.0)
    at_arm = distances_to(own, hidden, own.thick) < 0.0
    np.testing.assert_array_equal(view(11.2), hidden[at_arm])
    assert 0 < at_arm.sum() < 0.5 * len(hidden)


def test_an_obstacle_does_not_vanish_as_the_arm_comes_near(panda):
    """Its points are within the arm's margin then, so that no cloud can show it."""
    own = own_shape(panda, PANDA_READY, np.zeros(7), 0.0, 0.0)
    hand = [c.name for c in panda.capsules].index('hand')
    # A small ball 1 cm from the hand, on the side of the camera.
    beside = 0.5 * (own.start[hand] + own.end[hand])
    way = (POSE.origin - beside) / np.linalg.norm(POSE.origin - beside)
    ball = body('ellipsoid', beside + (own.radius[hand] + 0.02) * way, (0.01,) * 3)
    world, far = CloudFilter(panda, EVERY_POINT), PANDA_READY + np.r_[1.5, np.zeros(6)]
    assert len(world.see(seen(POSE, together(arm_of(panda, far), ball)), POSE, still(far), 1.0))
    for stamp in np.arange(1.1, 9.0, 0.5):
        near = world.see(seen(POSE, together(arm_of(panda, PANDA_READY), ball)), POSE,
                         still(PANDA_READY), stamp)
        assert len(near)
    fresh = CloudFilter(panda, EVERY_POINT)
    assert not len(fresh.see(seen(POSE, together(arm_of(panda, PANDA_READY), ball)), POSE,
                             still(PANDA_READY), 1.0))


def test_noise_and_what_lies_outside_the_box_do_not_count(panda):
    pose = POSE._replace(origin=np.zeros(3), axes=np.eye(3))
    lone, pair = np.array([[0.61], [0.4], [0.9]]), np.array([[0.61, 0.615], [-0.4] * 2, [0.9] * 2])
    far = np.array([[2.0, 2.0], [0.0, 0.0], [0.5, 0.5]])
    cloud = np.concatenate([lone, pair, far, NOTHING], axis=1)
    world = CloudFilter(panda, CloudParameters())
    centers = world.see(cloud, pose, still(PANDA_READY), 1.0)
    np.testing.assert_allclose(centers, [[0.6125, -0.3875, 0.9125]])
    world.memory.clear()
    world.parameters = replace(world.parameters, crop_box=(-1.0, 0.0, 0.0, 1.0, 1.0, 1.0))
    assert not len(world.see(cloud, pose, still(PANDA_READY), 1.1))
    world.parameters = replace(world.parameters, crop_box=(), min_points=1, reach_margin=5.0)
    assert len(world.see(cloud, pose, still(PANDA_READY), 1.2)) == 3


def test_of_too_many_voxels_the_nearest_to_the_arm_count(panda, monkeypatch):
    monkeypatch.setattr(cloud_filter, 'MOST_VOXELS', 50)
    grid = np.stack(np.meshgrid(np.linspace(0.7, 1.0, 9), np.linspace(-0.3, 0.3, 9),
                                np.linspace(0.1, 0.7, 9)), axis=-1).reshape(-1, 3)
    pose = POSE._replace(origin=np.zeros(3), axes=np.eye(3), at_sensor=False)
    world = CloudFilter(panda, EVERY_POINT)
    few = world.see(np.ascontiguousarray(grid.T), pose, still(PANDA_READY), 1.0)
    assert len(few) == len(world.memory.keys) == 50
    own = own_shape(panda, PANDA_READY, np.zeros(7), 0.0, 0.0)
    all_of_them = CloudFilter(panda, EVERY_POINT)
    monkeypatch.setattr(cloud_filter, 'MOST_VOXELS', 20_000)
    every = all_of_them.see(np.ascontiguousarray(grid.T), pose, still(PANDA_READY), 1.0)
    assert world.left_out == len(every) - 50
    away = np.sort(distances_to(own, every, own.radius))
    assert distances_to(own, few, own.radius).max() <= away[50]


def test_an_empty_cloud_and_one_of_nothing_show_nothing(panda):
    world = CloudFilter(panda, CloudParameters())
    for cloud in (np.empty((3, 0)), NOTHING):
        assert world.see(cloud, POSE, still(PANDA_READY), 1.0).shape == (0, 3)
    assert CAMERA.farthest > 1.0
    assert set(world.times) == {'rays', 'crop', 'self filter', 'voxels', 'memory'}
