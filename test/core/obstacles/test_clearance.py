"""Whole-link clearance against closed forms, dense sampling and finite differences."""

from __future__ import annotations

from closed_loop import mixed_scene, random_scene
from conftest import central_difference, random_postures
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest

from redundant_planner.core.kernels import compiled, Vector
from redundant_planner.core.obstacles.clearance import link_clearance, pseudo_distance
from redundant_planner.core.obstacles.clearance_gradients import bending, clearance_gradients
from redundant_planner.core.obstacles.inflation import inflated_obstacles, InflatedObstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.link_motions import link_motions

coordinates = st.floats(-2.0, 2.0)
points = arrays(float, 3, elements=coordinates)
axes = arrays(float, 3, elements=st.floats(0.01, 0.5))
quaternions = arrays(float, 4, elements=st.floats(-1.0, 1.0)).filter(
    lambda q: np.linalg.norm(q) > 0.1).map(lambda q: q / np.linalg.norm(q))


def equation_6(obstacle, point):
    """S(X) = XᵀQX + BX + C in the ellipsoid's own axes."""
    local = obstacle.rotation.T @ (point - obstacle.center)
    return np.sum((local / obstacle.half_extents) ** 2) - 1.0


def pairs_of(obstacle, start, end, radius=0.0):
    maps = inflated_obstacles(Scene.of([obstacle]), [radius])
    return link_clearance(maps, start[None], end[None])


def test_what_moves_is_larger_by_its_way():
    start, end = np.zeros(3), np.array([0.0, 0.0, 0.5])
    resting = Obstacle('o', np.array([0.4, 0.1, 0.2]), np.array([0.1, 0.05, 0.2]))
    moving = Obstacle('o', resting.center, resting.half_extents, velocity=[0.3, 0.0, -0.4])
    maps = inflated_obstacles(Scene.of([moving, resting]), [0.05], 0.2)
    found = link_clearance(maps, start[None], end[None]).normalized_distance[0]
    assert found[0] == link_clearance(
        inflated_obstacles(Scene.of([resting]), [0.05 + 0.2 * 0.5]),
        start[None], end[None]).normalized_distance
    assert found[1] == pairs_of(resting, start, end, 0.05).normalized_distance


@given(points, points, points, axes, quaternions)
def test_a_segments_smallest_level_is_exact(start, end, center, semi_axes, quaternion):
    obstacle = Obstacle('o', center, semi_axes, quaternion)
    pairs = pairs_of(obstacle, start, end)
    t = np.linspace(0.0, 1.0, 401)[:, None]
    sampled = min(equation_6(obstacle, x) for x in start + t * (end - start))
    level = float(pseudo_distance(pairs.normalized_distance)[0, 0])
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
    assert pairs.normalized_distance[0, 0] == pytest.approx(
        distance / (sphere + radius) - 1.0, abs=1e-9)


def test_beside_a_contact_the_nearest_that_may_not_touch_is_known_exactly():
    """Bounds do for what is further away; a contact, however deep, is not meant by that."""
    table = Obstacle.box('table', (0.0, 0.0, -0.05), (2.0, 2.0, 0.1))
    plank = Obstacle.box('plank', (0.0, 0.5, 0.3), (0.6, 0.04, 0.04))
    start, end = np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.6]])
    maps = inflated_obstacles(
        Scene.of([table, plank]), [0.03], contacts=np.array([[True, False]]))
    for enough in (np.inf, 0.0):
        found = link_clearance(maps, start, end, enough=enough).distance[0]
        assert found[0] < 0.0 and found[1] == pytest.approx(0.5 - 0.02 - 0.03)


def all_clearances(robot, q, obstacles):
    arm = robot.kinematics(q)
    maps = inflated_obstacles(Scene.of(obstacles), [c.radius for c in robot.capsules])
    return arm, maps, link_clearance(maps, arm.segment_start, arm.segment_end)


def test_gradients_match_finite_differences(robot):
    for seed, q in enumerate(random_postures(robot, 40)):
        obstacles = mixed_scene(seed) if seed % 2 else random_scene(robot, seed)
        arm, maps, pairs = all_clearances(robot, q, obstacles)
        links, which = np.nonzero(pairs.normalized_distance > -0.9)
        gradient, rate = clearance_gradients(maps, pairs, (links, which), robot.links(arm))
        expected = central_difference(
            lambda p, o=obstacles: all_clearances(robot, p, o)[2].normalized_distance, q)
        np.testing.assert_allclose(gradient, expected[links, which], rtol=1e-5, atol=1e-5)
        step = 1e-6
        ahead, behind = ([o.after(s) for o in obstacles] for s in (step, -step))
        moved = (all_clearances(robot, q, ahead)[2].normalized_distance
                 - all_clearances(robot, q, behind)[2].normalized_distance) / (2 * step)
        np.testing.assert_allclose(rate, moved[links, which], rtol=1e-5, atol=1e-5)


@compiled
def bending_from_the_first(
    obstacles: InflatedObstacles, link: int, t: float, links: Links, dq: Vector,
) -> float:
    """Return ∇ₓρ · ẍ of a link and the first obstacle."""
    return bending(obstacles, link, 0, t, links, link_motions(links, dq))


def test_over_a_flat_face_clearance_bends_as_the_links_way_does(robot):
    floor = Obstacle.box('floor', (0.0, 0.0, -3.0), (20.0, 20.0, 2.0))
    random, step = np.random.default_rng(8), 1e-4
    for q in random_postures(robot, 20):
        dq = random.uniform(-1.0, 1.0, robot.n)
        arm, maps, pairs = all_clearances(robot, q, [floor])
        before, after = (all_clearances(robot, q + way * step * dq, [floor])[2] for way in (-1, 1))
        for link in range(len(robot.capsules)):
            if before.parameter[link, 0] != after.parameter[link, 0]:
                continue  # another point of the link gets nearest
            rho = (x.normalized_distance[link, 0] for x in (before, pairs, after))
            expected = np.diff(list(rho), 2)[0] / step ** 2
            assert bending_from_the_first(
                maps, link, float(pairs.parameter[link, 0]), robot.links(arm), dq,
            ) == pytest.approx(expected, abs=1e-5)


def test_the_centre_of_an_ellipsoid_gives_finite_numbers(planar):
    # The first link passes exactly through the centre.
    obstacle = Obstacle('o', np.array([0.25, 0.0, 0.0]), np.full(3, 0.1))
    arm, maps, pairs = all_clearances(planar, np.zeros(3), [obstacle])
    gradient, rate = clearance_gradients(
        maps, pairs, (np.array([0]), np.array([0])), planar.links(arm))
    assert pairs.normalized_distance[0, 0] == pytest.approx(-1.0)
    assert np.isfinite(gradient).all() and np.isfinite(rate).all()


def test_obstacles_have_moved_by_the_time_a_node_is_reached(planar):
    ball = Obstacle('ball', np.array([0.3, 0.4, 0.0]), np.full(3, 0.1),
                    velocity=np.array([0.1, -0.2, 0.0]))
    postures, times = random_postures(planar, 3), np.array([0.0, 0.5, 2.0])
    arms = planar.kinematics_along(postures)
    radii = [c.radius for c in planar.capsules]
    ahead = link_clearance(
        inflated_obstacles(Scene.of([ball]), radii), arms.segment_start, arms.segment_end, times)
    for i, time in enumerate(times):
        there = ball.after(time)
        expected = link_clearance(inflated_obstacles(Scene.of([there]), radii),
                                  arms.segment_start[i], arms.segment_end[i])
        np.testing.assert_allclose(
            ahead.normalized_distance[i], expected.normalized_distance, atol=1e-12)
