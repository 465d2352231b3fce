"""Boxes, cylinders, capsules and half-spaces: against dense sampling, coal and closed forms."""

from __future__ import annotations

import coal
from conftest import examples
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest

from redundant_planner.core.obstacles import shapes
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.clearance_gradients import slope_of
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, HALF_SPACE, Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.shapes import flat_stretch, nearest_on_segment
from redundant_planner.core.robot.se3 import Place

SOLID = [BOX, CYLINDER, CAPSULE]
RADIUS = 0.05
# Round numbers make segments that touch, lie in faces and meet corners.
coordinates = st.one_of(
    st.floats(-1.0, 1.0), st.sampled_from([0.0, 0.1, -0.1, 0.2, -0.2, 0.3, -0.3, 0.5]))
points = arrays(float, 3, elements=coordinates)
halves = arrays(float, 3, elements=st.sampled_from([0.1, 0.2, 0.3]))
kinds = st.sampled_from([BOX, CYLINDER, CAPSULE, HALF_SPACE])


def made(shape, center, half, quaternion=(0.0, 0.0, 0.0, 1.0)):
    place = {'orientation': quaternion}
    if shape == BOX:
        return Obstacle.box('o', center, 2.0 * half, **place)
    if shape == CYLINDER:
        return Obstacle.cylinder('o', center, half[0], 2.0 * half[2], **place)
    if shape == CAPSULE:
        return Obstacle.capsule('o', center, half[0], 2.0 * half[2], **place)
    return Obstacle.half_space('o', center, **place)


def distance_of(obstacle, start, end, radius=RADIUS):
    pairs = link_clearance(
        inflated_obstacles(Scene.of([obstacle]), [radius]), start[None], end[None])
    return float(pairs.distance[0, 0])


def distances_at(obstacle, places):
    """Signed distances of points (k, 3)."""
    maps = inflated_obstacles(Scene.of([obstacle]), np.zeros(len(places)))
    return link_clearance(maps, places, places).distance[:, 0]


@settings(deadline=None, max_examples=examples(300))
@given(kinds, halves, points, points)
def test_the_smallest_distance_along_a_segment_is_exact(shape, half, start, end):
    obstacle = made(shape, np.zeros(3), half)
    maps = inflated_obstacles(Scene.of([obstacle]), [0.0])
    pairs = link_clearance(maps, start[None], end[None])
    distance, t = pairs.distance[0, 0], pairs.parameter[0, 0]
    assert 0.0 <= t <= 1.0
    assert distance == pytest.approx(distances_at(obstacle, start + t * (end[None] - start))[0])
    sampled = distances_at(obstacle, start + np.linspace(0.0, 1.0, 401)[:, None] * (end - start))
    assert distance <= sampled.min() + 1e-9
    # Where a bound from below is enough, it is one.
    far = inflated_obstacles(Scene.of([obstacle, obstacle]), [0.0])
    bounded = link_clearance(far, start[None], end[None], enough=-np.inf)
    assert bounded.distance[0, 0] == distance >= bounded.distance[0, 1] - 1e-12


@settings(deadline=None, max_examples=examples(300))
@given(kinds, halves, points, arrays(float, 3, elements=st.floats(-1.0, 1.0)))
def test_the_slope_leads_out_by_the_shortest_way(shape, half, at, step):
    obstacle = made(shape, np.zeros(3), half)
    maps = inflated_obstacles(Scene.of([obstacle]), [0.0])
    away = maps.smallest[0, 0] * np.array(
        slope_of(maps, 0, 0, Place(*at), Place(*at), 0.0))
    here, there, further = distances_at(obstacle, np.array([at, at + step, at + 0.05 * away]))
    assert np.linalg.norm(away) == pytest.approx(1.0)
    # Convex, with a slope of 1 at most; going along the direction uses all of it.
    assert there >= here + away @ step - 1e-9
    assert there <= here + np.linalg.norm(step) + 1e-9
    assert further == pytest.approx(here + 0.05)


def coal_shape(obstacle):
    x, y, z = (2.0 * obstacle.half_extents).tolist()
    return {BOX: lambda: coal.Box(x, y, z), CYLINDER: lambda: coal.Cylinder(0.5 * x, z),
            CAPSULE: lambda: coal.Capsule(0.5 * x, z - x)}[obstacle.shape]()


def coal_distance(obstacle, start, end):
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    turned = np.column_stack((across, np.cross(axis, across), axis))
    request = coal.DistanceRequest()
    request.gjk_tolerance = 1e-9
    return coal.distance(
        coal.Capsule(RADIUS, float(np.linalg.norm(end - start))),
        coal.Transform3s(turned, 0.5 * (start + end)), coal_shape(obstacle),
        coal.Transform3s(obstacle.rotation, obstacle.center), request, coal.DistanceResult())


def test_coal_finds_the_same_distances():
    """10 000 pairs; coal's own accuracy is 1e-6 at best. Inside it measures something else."""
    random, outside = np.random.default_rng(0), 0
    for _ in range(10_000):
        quaternion = random.normal(size=4)
        obstacle = made(SOLID[random.integers(3)], random.uniform(-0.5, 0.5, 3),
                        random.uniform(0.02, 0.4, 3), quaternion / np.linalg.norm(quaternion))
        start, end = random.uniform(-0.8, 0.8, (2, 3))
        found, expected = distance_of(obstacle, start, end), coal_distance(obstacle, start, end)
        assert (found > 0.0) == (expected > 0.0) or abs(expected) < 1e-6
        if expected > 0.0:
            outside += 1
            assert found == pytest.approx(expected, abs=2e-5)
    assert outside > 4000


@pytest.mark.parametrize(('shape', 'start', 'end', 'expected'), [
    (BOX, (-1, 0, 0.5), (1, 0, 0.5), 0.2),  # parallel to a face
    (BOX, (0.1, 0.2, 0.3), (0.1, 0.2, 0.3), 0.0),  # a point on a corner
    (BOX, (0.1, -1, 0.3), (0.1, 1, 0.3), 0.0),  # along an edge
    (BOX, (0, 0, 0), (0, 0, 0), -0.1),  # in the middle
    (BOX, (-1, 0, 0), (1, 0, 0), -0.1),  # through the middle, by its own depth there
    (BOX, (0.1, 0.2, 1), (0.1, 0.2, 2), 0.7),  # above an edge
    (CYLINDER, (0.5, 0, -1), (0.5, 0, 1), 0.4),  # parallel to the axis
    (CYLINDER, (0, 0, 0.4), (1, 0, 0.4), 0.1),  # over an end
    (CYLINDER, (0, 0, -1), (0, 0, 1), -0.1),  # in the axis
    (CYLINDER, (0.4, 0, 0.7), (0.4, 0, 0.7), 0.5),  # off the rim: 3, 4, 5
    (CAPSULE, (0, 0, -2), (0, 0, 2), -0.1),  # in the axis
    (CAPSULE, (0, 0, 0.6), (0, 1, 0.6), 0.2),  # over a round end
    (HALF_SPACE, (0, 0, 0.3), (1, 0, -0.2), -0.2)])
def test_special_places(shape, start, end, expected):
    obstacle = made(shape, np.zeros(3), np.array([0.1, 0.2, 0.3]))
    found = distance_of(obstacle, np.array(start, float), np.array(end, float), 0.0)
    assert found == pytest.approx(expected, abs=1e-9)


def test_a_stretch_ends_where_the_face_does():
    core, begin = Place(0.1, 0.2, 0.3), Place(-1.0, 0.0, 0.35)
    for tilt in (0.0, 0.005, -0.005):
        way = Place(2.0, 0.0, tilt)
        distance, _ = nearest_on_segment(shapes.BOX, core, begin, way)
        first, last = flat_stretch(shapes.BOX, core, begin, way, distance)
        assert (first, last) == pytest.approx((0.45, 0.55))


def test_a_scene_gives_its_obstacles_back():
    quaternion = np.array([0.1, -0.2, 0.3, 0.5])
    quaternion /= np.linalg.norm(quaternion)
    obstacles = [made(shape, np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, 0.3]), quaternion)
                 for shape in (*SOLID, HALF_SPACE)]
    obstacles.append(Obstacle('o', (0, 0, 1), (0.1, 0.2, 0.3), velocity=(1, 0, 0),
                              angular_velocity=(0, 2, 0)))
    for before, after in zip(obstacles, Scene.of(obstacles).obstacles(), strict=True):
        assert after.shape == before.shape and after.name == before.name
        for field in ('center', 'half_extents', 'orientation', 'velocity', 'angular_velocity'):
            np.testing.assert_allclose(getattr(after, field), getattr(before, field), atol=1e-12)


def test_what_turns_is_as_fast_as_its_corners():
    box = Obstacle.box('o', (0, 0, 0), (0.6, 0.8, 0.0001), angular_velocity=(0, 0, 2.0),
                       velocity=(0, 0, 1.0))
    assert Scene.of([box]).speeds[0] == pytest.approx(1.0 + 2.0 * 0.5)
    turned = box.after(0.25)
    np.testing.assert_allclose(turned.center, [0, 0, 0.25])
    np.testing.assert_allclose(turned.rotation[:, 0], [np.cos(0.5), np.sin(0.5), 0], atol=1e-12)
