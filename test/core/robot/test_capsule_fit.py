"""Capsules around bodies: everything inside, and not much larger than it has to be."""

from __future__ import annotations

from conftest import examples
from hypothesis import given, settings, strategies as st
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.robot.capsule_fit import (
    convex_hull,
    distances,
    fit_body,
    fit_capsule,
    fit_closely,
    merged,
    Shape,
)

RANDOM = np.random.default_rng(0)


def inside(points, shapes):
    return np.min([distances(points, s) - s.radius for s in shapes], axis=0).max() <= 1e-9


def box(*half, at=(0.0, 0.0, 0.0)):
    signs = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T
    return signs * half + at


def within_hull(points, count=4000):
    """Random convex combinations of points: the body between them, not only its corners."""
    weights = RANDOM.exponential(size=(count, len(points))) ** 3
    return weights / weights.sum(axis=1, keepdims=True) @ points


def test_a_capsules_own_surface_gives_the_capsule_back():
    truth = Shape(np.array([0.1, 0.0, 0.2]), np.array([0.3, 0.2, 0.5]), 0.07)
    directions = RANDOM.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    along = RANDOM.uniform(size=(2000, 1))
    axis = (truth.end - truth.start) / np.linalg.norm(truth.end - truth.start)
    aside = directions - (directions @ axis)[:, None] * axis
    side = truth.start + along * (truth.end - truth.start) + 0.07 * aside / np.linalg.norm(
        aside, axis=1)[:, None]
    points = np.vstack((truth.start + 0.07 * directions, truth.end + 0.07 * directions, side))
    found = fit_capsule(points)
    assert inside(points, [found])
    assert found.volume == pytest.approx(truth.volume, rel=0.02)


def test_a_long_cylinder_needs_little_more_than_its_own_volume():
    """Around a cylinder of radius 1 and length 20, the best capsule has some 10 % more."""
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    points = np.vstack([np.column_stack((np.cos(turn), np.sin(turn), np.full(40, z)))
                        for z in (0.0, 20.0)])
    points = points @ pin.exp3(np.array([0.3, -0.5, 0.9])).T
    found = fit_capsule(points)
    assert inside(points, [found]) and found.volume < 1.15 * np.pi * 20.0


@settings(deadline=None, max_examples=examples(30))
@given(st.integers(0, 10**6), st.integers(1, 60), st.floats(1e-4, 1e2))
def test_no_point_is_ever_outside(seed, count, size):
    """Clouds of any number of points, flat, straight and single ones included."""
    random = np.random.default_rng(seed)
    points = size * random.normal(size=(count, 3)) * random.choice([0.0, 0.1, 1.0], size=3)
    assert inside(points, [fit_capsule(points)])
    shapes = [shape for shape, _ in fit_body(convex_hull(points))]
    # The body between the points as well, where capsules share it.
    assert inside(np.vstack((points, within_hull(points, 200))), shapes)


def test_a_plate_gets_several_capsules_that_leave_nothing_out():
    corners = box(0.4, 0.25, 0.02)
    parts = fit_body(convex_hull(corners))
    assert len(parts) > 1
    assert inside(within_hull(corners), [shape for shape, _ in parts])
    assert sum(s.volume for s, _ in parts) < 0.75 * fit_capsule(corners).volume


def test_small_neighbours_become_one_and_distant_ones_stay_two():
    def group(*at):
        points = box(0.01, 0.01, 0.02, at=at)
        return fit_capsule(points), points

    together = merged([group(0.0, 0.0, 0.0), group(0.03, 0.0, 0.0), group(0.8, 0.0, 0.0)])
    members = sorted(entry[2] for entry in together)
    assert members == [[0, 1], [2]]
    for shape, points, _ in together:
        assert inside(points, [shape])


def test_the_hull_of_a_box_has_its_volume_and_its_corners():
    hull = convex_hull(np.vstack((box(0.1, 0.2, 0.3), within_hull(box(0.1, 0.2, 0.3), 50))))
    assert len(hull.corners) == 8 and hull.volume == pytest.approx(8 * 0.1 * 0.2 * 0.3)
    assert convex_hull(box(0.1, 0.2, 0.0)).volume == 0.0


@pytest.mark.parametrize('half', [(0.2, 0.2, 0.2), (0.1, 0.25, 0.4), (0.3, 0.3, 0.12)])
def test_what_stands_still_is_covered_by_capsules_that_stick_out_by_little(half):
    body = convex_hull(box(*half))
    shapes = [shape for shape, _ in fit_closely(body)]
    assert inside(RANDOM.uniform(-1.0, 1.0, (500, 3)) * half, shapes)
    directions = RANDOM.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for shape in shapes:
        for end in (shape.start, shape.end):
            surface = end + shape.radius * directions
            assert (np.abs(surface) - half).max() <= 0.1 + 1e-9
