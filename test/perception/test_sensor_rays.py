"""A voxel is free if enough rays pass through it and none ends at it or before."""

from __future__ import annotations

from camera_views import body, CAMERA, looking, seen, together
import numpy as np
import pytest

from redundant_planner.perception.sensor_rays import fill_rays, no_rays, seen_through

AHEAD = looking((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
WALL = body('box', (2.5, 0, 0), (0.5, 9, 9))
SIZE = 0.05


def free(bodies, centers, needed=2.0, size=SIZE, pose=AHEAD):
    """Which cubes in the base frame are free, of what a camera sees."""
    rays = no_rays()
    fill_rays(seen(pose, bodies), rays)
    centers = np.array(centers, float).reshape(-1, 3)
    return (seen_through((centers - pose.origin) @ pose.axes, size, needed, rays) > 0.0).tolist()


def test_what_lies_before_a_wall_is_free_and_what_lies_in_or_behind_it_is_not():
    assert free(WALL, [[1, 0, 0], [1.5, 0.3, 0.2], [1.9, 0, 0], [2.0, 0, 0], [2.03, 0, 0],
                       [2.5, 0, 0], [3, 0, 0]]) == [True, True, True, False, False, False, False]


def test_what_lies_before_nothing_stays():
    """A ray that meets nothing may as well have failed."""
    assert free(body('ellipsoid', (2, 5, 0), (0.1,) * 3), [[1, 0, 0]]) == [False]


def test_what_something_hides_stays():
    bodies = together(WALL, body('ellipsoid', (0.8, 0, 0), (0.1,) * 3))
    assert free(bodies, [[1.2, 0, 0], [1.2, 0.4, 0], [0.5, 0, 0]]) == [False, True, True]


def test_a_cube_that_a_thin_thing_stands_in_is_not_free():
    pole = body('cylinder', (1.0, 0.01, 0.0), (0.01, 0.01, 1.0))
    assert free(together(WALL, pole), [[1, 0, 0], [1, 0.2, 0]]) == [False, True]


def test_as_many_rays_are_needed_as_points():
    """A pixel of this camera is 1 cm wide at 1.2 m."""
    assert free(WALL, [[1.2, 0, 0]], needed=10.0) == [True]
    assert free(WALL, [[1.2, 0, 0]], needed=200.0) == [False]


@pytest.mark.parametrize('at', [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0.3, 0.2, 1),
                                (0.2, -0.4, -1), (-1, 0.5, 0.3)])
def test_it_works_in_every_direction(at):
    """Within a ball, with a sensor that sees all around it in its own frame."""
    directions = np.random.default_rng(0).normal(size=(3, 400_000))
    directions *= 3.0 / np.linalg.norm(directions, axis=0)
    rays = no_rays()
    fill_rays(directions, rays)
    centers = np.array([at, 2.95 * np.array(at) / np.linalg.norm(at)], float)
    assert seen_through(centers, 0.1, 2.0, rays).tolist() == [1.0, 0.0]


def test_at_the_sensor_and_at_an_edge_of_the_cube_of_directions_nothing_is_said():
    directions = np.random.default_rng(0).normal(size=(3, 100_000))
    rays = no_rays()
    fill_rays(9.0 * directions / np.linalg.norm(directions, axis=0), rays)
    assert not seen_through(np.array([[0, 0, 0], [0.05, 0, 0], [1, 1, 0]], float), 0.1, 1.0,
                            rays).any()


def test_points_that_are_none_and_old_rays_do_not_count():
    rays = no_rays()
    fill_rays(seen(AHEAD, WALL), rays)
    assert rays[:, 1].sum() == CAMERA.width * CAMERA.height
    nothing = np.array([[np.nan, np.inf, 0.0, 1e200], [0.0, 1.0, 0.0, 1e200],
                        [1.0, 0.0, 0.0, -1e200]])
    fill_rays(nothing, rays)
    assert rays[:, 1].sum() == 0.0 and np.isinf(rays[:, 0]).all()
