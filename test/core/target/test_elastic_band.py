"""Ways of the joints that are pulled tight: shorter, as free as before, always the same."""

from __future__ import annotations

from itertools import pairwise

from conftest import examples, make_panda
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from test_free_space import answer, crowd, space_among

from redundant_planner.core.horizon.least_squares import Squares
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.target import elastic_band
from redundant_planner.core.target.elastic_band import (
    Band,
    look_at_nodes,
    new_band,
    pulled_tight,
    solve_step,
)
from redundant_planner.core.target.straight_motion import COST_OF_CALL

PANDA = make_panda()
SEEDS = st.integers(0, 2**32 - 1)
WALL = Obstacle.box('wall', (0.5, 0.0, 0.25), (0.5, 0.04, 0.5))
LEFT = np.array([0.7, 0.6, 0.0, -1.9, 0.0, 2.4, 0.8])
RIGHT = LEFT * (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
OVER = np.array([0.0, -0.3, 0.0, -1.5, 0.0, 1.8, 0.8])


def tight(space, postures, room=0.002):
    return answer(pulled_tight(space, [space.place(q) for q in postures], room))


def length(postures):
    return np.linalg.norm(np.diff(postures, axis=0), axis=1).sum()


def random_band(space, random, count=6):
    q = random.uniform(0.7 * PANDA.position_min, 0.7 * PANDA.position_max, (count + 2, 7))
    return new_band(q, np.tile(space.asked(0.01), (count, 1)))


def free_polygon(space, random):
    """Corners with free motions between them, None if there are none."""
    corners = [space.place(q) for q in random.uniform(
        0.8 * PANDA.position_min, 0.8 * PANDA.position_max, (60, 7))]
    corners = [place for place in corners if (place.room >= space.asked(0.002)).all()]
    way = corners[:1]
    for place in corners[1:]:
        if answer(space.is_free_between(way[-1], place, space.asked(0.002))):
            way.append(place)
    return np.array([place.q for place in way[:5]]) if len(way) > 2 else None


@settings(max_examples=examples(20), deadline=None)
@given(SEEDS)
def test_a_way_pulled_tight_is_shorter_and_free(seed):
    random = np.random.default_rng(seed)
    space = space_among(crowd(random))
    polygon = free_polygon(space, random)
    found = None if polygon is None else tight(space, polygon)
    if found is None:
        return
    postures = np.array([place.q for place in found])
    np.testing.assert_array_equal(postures[[0, -1]], polygon[[0, -1]])
    assert length(postures) < length(polygon)
    for place in found:
        np.testing.assert_allclose(np.minimum(place.room, 0.3), np.minimum(
            space.place(place.q).room, 0.3), atol=1e-9)
    for one, other in pairwise(postures):
        assert (space.rooms(np.linspace(one, other, 60)) > 0.0).all()


def test_most_ways_are_pulled_tight():
    """The test above would pass if none were."""
    outcomes = []
    for seed in range(12):
        random = np.random.default_rng(seed)
        space = space_among(crowd(random))
        polygon = free_polygon(space, random)
        if polygon is not None:
            outcomes.append(tight(space, polygon) is not None)
    assert len(outcomes) > 5 and np.mean(outcomes) > 0.7


def test_without_obstacles_a_band_is_straight():
    corners = np.array([LEFT, OVER, RIGHT])
    found = np.array([place.q for place in tight(space_among([]), corners)])
    assert length(found) == pytest.approx(np.linalg.norm(RIGHT - LEFT), rel=1e-3)
    steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
    assert steps.max() < 1.02 * steps.min()


def test_a_band_forgets_where_it_began():
    """Over the wall it is the same way, however far about: shortcuts alone stay about it."""
    space, lengths = space_among([WALL]), []
    for corner in (OVER, (0.0, -0.6, 0.0, -1.5, 0.0, 1.8, 0.8),
                   (0.0, -0.8, 0.6, -1.2, 0.0, 1.8, 0.8), (0.0, -0.9, 0.9, -1.0, 0.0, 1.8, 0.8)):
        found = np.array([place.q for place in tight(space, [LEFT, np.array(corner), RIGHT])])
        lengths.append(length(found))
        assert space.rooms(found[1:-1]).min() < 0.01, 'the wall is not in the way'
    assert max(lengths) < 1.05 * min(lengths)


@settings(max_examples=examples(20), deadline=None)
@given(SEEDS)
def test_rows_are_rooms_with_their_gradients(seed):
    random = np.random.default_rng(seed)
    space = space_among(crowd(random))
    band = random_band(space, random)
    look_at_nodes(band, 0, len(band.nodes), space.arena)
    for node, q in enumerate(band.nodes):
        rows = slice(band.rows[node])
        if band.rows[node] == 0:
            continue
        worst = int(np.argmin(band.spare[node, rows]))
        spare = space.rooms(q[None])[0] - space.asked(0.01)
        k = int(np.argmin(spare))
        assert band.spare[node, worst] == pytest.approx(spare[k], abs=1e-9)
        if spare[k] + 0.01 < 1e-3:
            continue  # inside an obstacle other points of a link take turns in being the deepest
        step = 1e-6 * np.eye(7)
        slope = (space.rooms(q + step)[:, k] - space.rooms(q - step)[:, k]) / 2e-6
        np.testing.assert_allclose(band.gradients[node, worst], slope, atol=2e-3)


def test_of_too_many_rows_the_most_urgent_are_kept():
    random = np.random.default_rng(0)
    space = space_among([
        Obstacle.box(f'b{i}', random.uniform((0.1, -0.6, 0.0), (0.7, 0.6, 0.9)), (0.1,) * 3)
        for i in range(60)])
    many = random_band(space, random)

    def with_rows(most):
        shape = (len(many.nodes), most)
        band = Band(many.nodes, many.ends, many.asked, np.empty((*shape, 7)), np.empty(shape),
                    np.empty(shape), many.rows.copy(), many.squares, many.step)
        look_at_nodes(band, 0, len(band.nodes), space.arena)
        return [np.sort(spare[:rows]) for spare, rows in zip(band.spare, band.rows)]

    all_rows, few = with_rows(600), with_rows(5)
    assert min(map(len, all_rows)) > 5
    for known, kept in zip(all_rows, few):
        np.testing.assert_array_equal(kept, known[:5])


@settings(max_examples=examples(20), deadline=None)
@given(SEEDS)
def test_a_step_solves_the_problem(seed):
    """Against the normal equations of all squares that act, built row by row with NumPy."""
    random = np.random.default_rng(seed)
    space = space_among(crowd(random))
    band, scaling = random_band(space, random), random.uniform(0.5, 2.0, 7)
    look_at_nodes(band, 0, len(band.nodes), space.arena)
    acted, solutions = band.acts.copy(), 0
    while solve_step(band, scaling):
        acted, solutions = band.acts.copy(), solutions + 1
        if solutions == 6:
            break
    count, n = band.nodes.shape
    rows, wanted = [], []
    path = np.vstack((band.ends[:1], band.nodes, band.ends[1:]))
    for i in range(count + 1):
        block = np.zeros((n, count, n))
        for j in range(n):
            if i < count:
                block[j, i, j] = 1.0 / scaling[j]
            if i > 0:
                block[j, i - 1, j] = -1.0 / scaling[j]
        rows.append(np.sqrt(count + 1) * block.reshape(n, -1))
        wanted.append(-np.sqrt(count + 1) * (path[i + 1] - path[i]) / scaling)
    for i in range(count):
        for row in np.flatnonzero(acted[i, :band.rows[i]] == 1.0):
            block = np.zeros((count, n))
            block[i] = band.gradients[i, row]
            weight = np.sqrt(elastic_band._PRICE * (count + 1))
            rows.append(weight * block.reshape(1, -1))
            wanted.append([-weight * band.spare[i, row]])
    best = np.linalg.lstsq(np.vstack(rows), np.concatenate(wanted), rcond=None)[0]
    np.testing.assert_allclose(band.step.ravel(), best, atol=1e-6)
    assert isinstance(band.squares, Squares)


def test_small_pieces_of_work_come_to_the_same():
    space = space_among([WALL])
    ways = []
    for space.piece in (COST_OF_CALL + 1, 50_000, 100_000_000):
        ways.append(np.array([place.q for place in tight(space, [LEFT, OVER, RIGHT])]))
    np.testing.assert_array_equal(ways[0], ways[1])
    np.testing.assert_array_equal(ways[0], ways[2])


def test_a_cup_stays_in_its_cone():
    """The band keeps what the tip may lean, which the corner of the way uses up."""
    corner = np.array([0.0, -0.3, 0.0, -1.5, 0.0, 1.3, 0.8])
    upright = space_among([WALL], cone_angle=0.35, cone_direction=(0.0, 0.0, -1.0))
    paths = [np.array([place.q for place in tight(space, [LEFT, corner, RIGHT])])
             for space in (upright, space_among([WALL]))]
    assert (upright.rooms(paths[0]) > 0.0).all()
    assert not (upright.rooms(paths[1]) > 0.0).all(), 'the cone does not matter: test another'
