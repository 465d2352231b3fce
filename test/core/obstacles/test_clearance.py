"""Whole-link clearance against closed forms, dense sampling and finite differences."""

from __future__ import annotations

from closed_loop import random_scene
from conftest import central_difference, random_postures
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.clearance import (
    clearance_gradients,
    inflated_ellipsoids,
    inflated_semi_axes,
    link_clearance,
    near_pairs_along,
    pseudo_distance,
    Scene,
)
from redundant_planner.core.obstacles.obstacle import Obstacle

coordinates = st.floats(-2.0, 2.0)
points = arrays(float, 3, elements=coordinates)
axes = arrays(float, 3, elements=st.floats(0.01, 0.5))
quaternions = arrays(float, 4, elements=st.floats(-1.0, 1.0)).filter(
    lambda q: np.linalg.norm(q) > 0.1).map(lambda q: q / np.linalg.norm(q))


def equation_6(obstacle, point):
    """S(X) = XᵀQX + BX + C in the ellipsoid's own axes."""
    local = obstacle.rotation.T @ (point - obstacle.center)
    return np.sum((local / obstacle.semi_axes) ** 2) - 1.0


def pairs_of(obstacle, start, end, radius=0.0):
    maps = inflated_ellipsoids(Scene.of([obstacle]), [radius])
    return link_clearance(maps, start[None], end[None])


def test_what_moves_is_larger_by_its_way():
    start, end = np.zeros(3), np.array([0.0, 0.0, 0.5])
    resting = Obstacle('o', np.array([0.4, 0.1, 0.2]), np.array([0.1, 0.05, 0.2]))
    moving = Obstacle('o', resting.center, resting.semi_axes, velocity=np.array([0.3, 0.0, -0.4]))
    maps = inflated_ellipsoids(Scene.of([moving, resting]), [0.05], 0.2)
    found = link_clearance(maps, start[None], end[None]).clearance[0]
    assert found[0] == link_clearance(
        inflated_ellipsoids(Scene.of([resting]), [0.05 + 0.2 * 0.5]),
        start[None], end[None]).clearance
    assert found[1] == pairs_of(resting, start, end, 0.05).clearance


@given(points, points, points, axes, quaternions)
def test_a_segments_smallest_level_is_exact(start, end, center, semi_axes, quaternion):
    obstacle = Obstacle('o', center, semi_axes, quaternion)
    pairs = pairs_of(obstacle, start, end)
    t = np.linspace(0.0, 1.0, 401)[:, None]
    sampled = min(equation_6(obstacle, x) for x in start + t * (end - start))
    level = float(pseudo_distance(pairs.clearance)[0, 0])
    at = start + pairs.parameter[0, 0] * (end - start)
    assert level == pytest.approx(equation_6(obstacle, at), rel=1e-9, abs=1e-9)
    assert level <= sampled + 1e-9


@given(points, points, st.floats(0.01, 0.5), st.floats(0.0, 0.3))
def test_sphere_and_capsule_meet_where_geometry_says(start, end, sphere, radius):
    # A sphere inflated by r is the sphere of radius a + r: ρ = distance/(a + r) − 1.
    obstacle = Obstacle('ball', np.array([0.2, -0.1, 0.3]), np.full(3, sphere))
    pairs = pairs_of(obstacle, start, end, radius)
    along = end - start
    length = along @ along
    t = np.clip((obstacle.center - start) @ along / length, 0, 1) if length > 1e-300 else 0.0
    distance = np.linalg.norm(start + t * along - obstacle.center)
    assert pairs.clearance[0, 0] == pytest.approx(distance / (sphere + radius) - 1.0, abs=1e-9)


@given(axes, st.floats(0.0, 0.3), arrays(float, (2, 3), elements=st.floats(-1, 1)))
def test_inflation_contains_ellipsoid_plus_ball(semi_axes, radius, directions):
    inflated = inflated_semi_axes(semi_axes[None], np.full((1, 1), radius))[0, 0]
    norms = np.linalg.norm(directions, axis=1)
    if (norms < 1e-3).any():
        return
    on_ellipsoid = semi_axes * directions[0] / norms[0]
    on_ball = radius * directions[1] / norms[1]
    assert np.sum(((on_ellipsoid + on_ball) / inflated) ** 2) <= 1.0 + 1e-9
    # Trace-minimal: (√tr A² + √3 r)² exactly.
    expected = (np.sqrt(np.sum(semi_axes**2)) + np.sqrt(3.0) * radius) ** 2
    assert np.sum(inflated**2) == pytest.approx(expected, rel=1e-9)


def test_adding_the_radius_to_the_semi_axes_would_not_be_conservative():
    # The reason for the inflation: a long thin ellipsoid and a ball beside its shoulder.
    semi_axes, radius = np.array([1.0, 0.1, 0.1]), 0.3
    angles = np.linspace(0.0, np.pi / 2, 200)
    surface = np.stack((np.cos(angles), 0.1 * np.sin(angles)), axis=1)
    normals = np.stack((np.cos(angles), np.sin(angles) / 0.1), axis=1)
    touching = surface + radius * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    assert ((touching / (semi_axes[:2] + radius)) ** 2).sum(axis=1).max() > 1.1
    inflated = inflated_semi_axes(semi_axes[None], np.full((1, 1), radius))[0, 0]
    assert ((touching / inflated[:2]) ** 2).sum(axis=1).max() <= 1


def all_clearances(robot, q, obstacles):
    arm = robot.kinematics(q)
    maps = inflated_ellipsoids(Scene.of(obstacles), [c.radius for c in robot.capsules])
    return arm, maps, link_clearance(maps, arm.segment_start, arm.segment_end)


def test_gradients_match_finite_differences(robot):
    for seed, q in enumerate(random_postures(robot, 20)):
        obstacles = random_scene(robot, seed)
        arm, maps, pairs = all_clearances(robot, q, obstacles)
        links, which = np.nonzero(pairs.clearance > -0.9)
        gradient, rate = clearance_gradients(
            maps, pairs, (links, which), arm.segment_start, arm.segment_end, arm.columns,
            robot.moves)
        expected = central_difference(
            lambda p, o=obstacles: all_clearances(robot, p, o)[2].clearance, q)
        np.testing.assert_allclose(gradient, expected[links, which], rtol=1e-5, atol=1e-5)
        step = 1e-6
        ahead, behind = ([Obstacle(o.name, o.center + s * o.velocity, o.semi_axes, o.orientation)
                          for o in obstacles] for s in (step, -step))
        moved = (all_clearances(robot, q, ahead)[2].clearance
                 - all_clearances(robot, q, behind)[2].clearance) / (2 * step)
        np.testing.assert_allclose(rate, moved[links, which], rtol=1e-5, atol=1e-5)


def test_pairs_along_a_path_are_those_of_each_posture(robot):
    times, within = np.array([0.1, 0.5, 2.0]), 0.2
    for seed in range(10):
        postures, obstacles = random_postures(robot, 3, seed), random_scene(robot, seed)
        arms = robot.kinematics_along(postures)
        maps = inflated_ellipsoids(Scene.of(obstacles), [c.radius for c in robot.capsules])
        near = near_pairs_along(maps, arms.segment_start, arms.segment_end, arms.columns,
                                robot.moves, times, within)
        found, nearest = 0, np.inf
        for at, (q, time) in enumerate(zip(postures, times)):
            there = [Obstacle(o.name, o.center + time * o.velocity, o.semi_axes, o.orientation)
                     for o in obstacles]
            arm, maps, pairs = all_clearances(robot, q, there)
            chosen = (pairs.distance < within).nonzero()
            gradient, _ = clearance_gradients(
                maps, pairs, chosen, arm.segment_start, arm.segment_end, arm.columns,
                robot.moves)
            here = slice(found, found + len(gradient))
            assert (near.postures[here] == at).all()
            np.testing.assert_allclose(near.clearance[here], pairs.clearance[chosen], atol=1e-12)
            np.testing.assert_allclose(near.smallest[here], maps.smallest[chosen])
            np.testing.assert_allclose(near.gradient[here], gradient, atol=1e-9)
            found, nearest = here.stop, min(nearest, pairs.distance.min())
        assert found == len(near.clearance) and near.nearest == pytest.approx(nearest)


def test_the_centre_of_an_ellipsoid_gives_finite_numbers(planar):
    # The first link passes exactly through the centre.
    obstacle = Obstacle('o', np.array([0.25, 0.0, 0.0]), np.full(3, 0.1))
    arm, maps, pairs = all_clearances(planar, np.zeros(3), [obstacle])
    gradient, rate = clearance_gradients(
        maps, pairs, (np.array([0]), np.array([0])), arm.segment_start, arm.segment_end,
        arm.columns, planar.moves)
    assert pairs.clearance[0, 0] == pytest.approx(-1.0)
    assert np.isfinite(gradient).all() and np.isfinite(rate).all()


@pytest.mark.parametrize(('change', 'message'), [
    ({'semi_axes': [0.1, 0.0, 0.1]}, r'semi_axes are \[0.1, 0.0, 0.1\]; all three must be'),
    ({'semi_axes': [0.1, -0.1, 0.1]}, r'all three must be positive'),
    ({'semi_axes': [0.1, 0.1]}, r'it takes 3 finite numbers'),
    ({'center': [0.0, np.nan, 0.0]}, r'center is \[0.0, nan, 0.0\]'),
    ({'orientation': [0.0, 0.0, 0.0, 0.0]}, r'has length 0; it must be 1'),
    ({'orientation': [0.0, 0.0, 0.0, 2.0]}, r'has length 2; it must be 1'),
    ({'velocity': [np.inf, 0.0, 0.0]}, r'velocity'),
])
def test_bad_obstacles_are_refused_by_name(change, message):
    values = {'center': np.zeros(3), 'semi_axes': np.full(3, 0.1), **change}
    with pytest.raises(ObstacleError, match=f"obstacle 'column': .*{message}"):
        Obstacle('column', **values)


def test_an_obstacle_is_not_changed_from_outside():
    center = np.zeros(3)
    obstacle = Obstacle('o', center, np.ones(3))
    center[0] = 5.0
    assert obstacle.center[0] == 0.0
    with pytest.raises(ValueError, match='read-only'):
        obstacle.center[0] = 1.0
