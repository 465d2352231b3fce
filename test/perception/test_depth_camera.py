"""A ray ends where it first meets a surface, whatever the shape."""

from __future__ import annotations

from camera_views import arm_of, body, CAMERA, distances_to, in_base, looking, seen, together
from conftest import PANDA_READY
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.obstacles.obstacle import Obstacle, SHAPES as ALL_SHAPES
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.perception.depth_camera import bodies_of, DepthCamera, distances
from redundant_planner.perception.own_shape import own_shape

SHAPES = ALL_SHAPES[:4]  # all but walls without end


def one_ray(bodies, origin, direction, farthest=100.0):
    direction = np.array([direction], float)
    return distances(direction / np.linalg.norm(direction), np.array(origin, float), bodies,
                     farthest)[0]


@pytest.mark.parametrize(('shape', 'extents', 'origin', 'direction', 'expected'), [
    ('ellipsoid', (1, 2, 3), (5, 0, 0), (-1, 0, 0), 4.0),
    ('ellipsoid', (1, 2, 3), (0, 0, -5), (0, 0, 1), 2.0),
    ('ellipsoid', (1, 2, 3), (5, 0, 0), (1, 0, 0), np.inf),
    ('ellipsoid', (1, 2, 3), (5, 2.1, 0), (-1, 0, 0), np.inf),
    ('ellipsoid', (1, 2, 3), (0, 0, 0), (0, 1, 0), 2.0),
    ('box', (1, 2, 3), (5, 1.9, 2.9), (-1, 0, 0), 4.0),
    ('box', (1, 2, 3), (5, 2.1, 0), (-1, 0, 0), np.inf),
    ('box', (1, 2, 3), (4, 4, 0), (-1, -1, 0), 3.0 * np.sqrt(2.0)),
    ('box', (1, 2, 3), (0, 0, 0), (0, 0, -1), 3.0),
    ('cylinder', (1, 1, 3), (5, 0, 2.9), (-1, 0, 0), 4.0),
    ('cylinder', (1, 1, 3), (5, 0, 3.1), (-1, 0, 0), np.inf),
    ('cylinder', (1, 1, 3), (0.5, 0, 7), (0, 0, -1), 4.0),
    ('cylinder', (1, 1, 3), (1.5, 0, 7), (0, 0, -1), np.inf),
    ('capsule', (1, 1, 3), (0, 0, 7), (0, 0, -1), 4.0),
    ('capsule', (1, 1, 3), (5, 0, 1.9), (-1, 0, 0), 4.0),
    ('capsule', (1, 1, 3), (5, 0, 2.6), (-1, 0, 0), 5.0 - 0.8),  # 3-4-5 on the upper ball
    ('capsule', (1, 1, 3), (5, 0, 3.1), (-1, 0, 0), np.inf),
    ('capsule', (1, 1, 3), (0, 0, 0.5), (0, 0, 1), 2.5),
    ('capsule', (1, 1, 1), (5, 0, 0), (-1, 0, 0), 4.0),
])
def test_distances_in_closed_form(shape, extents, origin, direction, expected):
    alone = body(shape, (0, 0, 0), extents)
    assert one_ray(alone, origin, direction) == pytest.approx(expected)
    rotation = pin.exp3(np.array([0.4, -1.1, 0.7]))
    shift = np.array([0.3, -2.0, 1.0])
    moved = body(shape, shift, extents, rotation)
    assert one_ray(moved, rotation @ origin + shift, rotation @ direction) == pytest.approx(
        expected)


def level(shape, e, points):
    """Below 0 inside a shape, above it outside."""
    x, y, z = points.T
    radial = np.hypot(x, y)
    if shape == 'ellipsoid':
        return np.linalg.norm(points / e, axis=1) - 1.0
    if shape == 'box':
        return (np.abs(points) - e).max(axis=1)
    if shape == 'cylinder':
        return np.maximum(radial - e[0], np.abs(z) - e[2])
    return np.hypot(radial, np.maximum(np.abs(z) - (e[2] - e[0]), 0.0)) - e[0]


@pytest.mark.parametrize('shape', SHAPES)
def test_a_ray_ends_on_the_surface_and_passes_nothing_before(shape):
    random = np.random.default_rng(SHAPES.index(shape))
    hits = 0
    for _ in range(300):
        e = random.uniform(0.1, 0.6, 3)
        if shape in ('cylinder', 'capsule'):
            e[1] = e[0]
        if shape == 'capsule':
            e[2] += e[0]
        rotation, center = pin.exp3(random.uniform(-2, 2, 3)), random.normal(size=3)
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        origin = center - 3.0 * direction + random.normal(0.0, 0.3, 3)
        away = one_ray(body(shape, center, e, rotation), origin, direction)
        along = np.linspace(0.0, min(away, 6.0), 2000, endpoint=False)
        path = (origin + along[:, None] * direction - center) @ rotation
        assert (level(shape, e, path) > -1e-9).all()
        if away < np.inf:
            hits += 1
            end = (origin + away * direction - center) @ rotation
            assert level(shape, e, end[None])[0] == pytest.approx(0.0, abs=1e-9)
    assert 100 < hits < 300


def test_the_first_of_several_shapes_is_seen():
    bodies = together(body('box', (3, 0, 0), (0.5, 1, 1)),
                      body('ellipsoid', (1, 0, 0), (0.2,) * 3),
                      body('cylinder', (2, 0, 0), (0.3, 0.3, 1)))
    assert one_ray(bodies, (0, 0, 0), (1, 0, 0)) == pytest.approx(0.8)
    assert one_ray(bodies, (0, 0, 0.5), (1, 0, 0)) == pytest.approx(1.7)
    assert one_ray(bodies, (0, 0.5, 0), (1, 0, 0)) == pytest.approx(2.5)
    assert one_ray(bodies, (0, 0.5, 0), (1, 0, 0), farthest=2.4) == np.inf


def test_the_image_is_that_of_a_pinhole():
    """A wall 2 m ahead: flat, as wide as the field of view, and its middle straight ahead."""
    camera = DepthCamera(64, 48, 1.2, 5.0)
    pose = looking((1.0, 2.0, 3.0), (2.0, 2.0, 3.0))
    wall = body('box', (3.5, 2.0, 3.0), (0.5, 9.0, 9.0))
    points = camera.points(pose.origin, pose.axes, wall)
    assert points.shape == (48, 64, 3)
    np.testing.assert_allclose(points[:, :, 2], 2.0, atol=1e-12)
    half = 2.0 * np.tan(0.6)
    pixel = 2.0 * half / 64
    np.testing.assert_allclose(points[0, :, 0], np.linspace(-half, half, 65)[1:] - 0.5 * pixel)
    np.testing.assert_allclose(np.diff(points[:, 0, 1]), pixel)
    # Down in the image is down in the world.
    assert (points[-1, :] @ pose.axes.T)[:, 2].max() < (points[0, :] @ pose.axes.T)[:, 2].min()


def test_what_is_out_of_range_or_beside_is_nan():
    pose = looking((0, 0, 0), (1, 0, 0))
    points = seen(pose, body('ellipsoid', (2, 0, 0), (0.3,) * 3))
    hit = np.isfinite(points).all(axis=0)
    assert 0 < hit.sum() < points.shape[1]
    assert np.isnan(points[:, ~hit]).all()
    near = DepthCamera(160, 120, 1.2, 1.5)
    assert np.isnan(seen(pose, body('ellipsoid', (2, 0, 0), (0.3,) * 3), near)).all()


def test_noise_is_along_the_ray():
    pose, wall = looking((0, 0, 0), (1, 0, 0)), body('box', (2.5, 0, 0), (0.5, 9, 9))
    camera = DepthCamera(160, 120, 1.2, 5.0, noise=0.01)
    plain = camera.points(pose.origin, pose.axes, wall)
    noisy = camera.points(pose.origin, pose.axes, wall, np.random.default_rng(0))
    away = np.linalg.norm(noisy, axis=2) - np.linalg.norm(plain, axis=2)
    assert np.std(away) == pytest.approx(0.01, rel=0.05) and abs(away.mean()) < 5e-4
    np.testing.assert_allclose(np.cross(noisy, plain), 0.0, atol=1e-12)


PLACE = {'orientation': (0.0, 0.6, 0.0, 0.8)}
OBSTACLES = (
    Obstacle('ball', [0.5, 0.3, 0.4], [0.1, 0.15, 0.2], **PLACE),
    Obstacle.box('box', [0.5, 0.3, 0.4], [0.2, 0.3, 0.4], **PLACE),
    Obstacle.cylinder('can', [0.5, 0.3, 0.4], 0.1, 0.4, **PLACE),
    Obstacle.capsule('pipe', [0.5, 0.3, 0.4], 0.1, 0.2, **PLACE))


@pytest.mark.parametrize('obstacle', OBSTACLES, ids=lambda o: o.shape)
def test_the_arm_and_the_obstacles_of_a_scene_are_seen_where_they_are(panda, obstacle):
    pose = looking((1.5, 0.3, 1.2), (0.0, 0.0, 0.4))
    wall = Obstacle.half_space('wall', [0.0, 0.0, 0.0])
    points = in_base(seen(pose, together(
        arm_of(panda, PANDA_READY), bodies_of(Scene.of([obstacle, wall])))), pose)
    own = own_shape(panda, PANDA_READY, np.zeros(7), 0.0, 0.0)
    to_arm = np.abs(distances_to(own, points, own.radius))
    to_obstacle = np.abs(level(obstacle.shape, obstacle.half_extents,
                               (points - obstacle.center) @ obstacle.rotation))
    assert np.minimum(to_arm, to_obstacle).max() < 1e-9
    assert (to_arm < 1e-9).sum() > 300 and (to_obstacle < 1e-9).sum() > 100
    assert CAMERA.width * CAMERA.height > len(points)
