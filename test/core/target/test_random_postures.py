"""Postures that trees grow towards: those through which a way may still become shorter."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
from target_run import PANDA, tip
from test_free_space import space_among
from test_path_search_pieces import LEFT, RIGHT, WALL

from redundant_planner.core.target.path_search import PathSearch
from redundant_planner.core.target.random_postures import informed_samples

SEEDS = st.integers(0, 2**32 - 1)


def lengths_through(postures, start, goals, scaling):
    """The shortest way (count,) through each posture to any goal."""
    def apart(one, other):
        return np.linalg.norm((one - other) / scaling, axis=-1)
    return apart(start, postures) + apart(postures[:, None], goals).min(axis=1)


@given(SEEDS, st.integers(1, 14), st.integers(1, 5), st.floats(1.0001, 5.0))
def test_no_way_through_a_sample_is_too_long(seed, n, count, longer):
    random = np.random.default_rng(seed)
    start, goals = random.normal(size=n), random.normal(size=(count, n))
    scaling = random.uniform(0.3, 2.0, n)
    most = longer * float(np.linalg.norm((goals - start) / scaling, axis=1).max())
    samples = informed_samples(random, 200, start, goals, most, scaling)
    assert (lengths_through(samples, start, goals, scaling) <= most * (1.0 + 1e-9)).all()


def test_samples_fill_all_of_the_ellipsoid():
    random, most = np.random.default_rng(1), 1.5
    start, goal, ones = np.zeros(3), np.array([1.0, 0.0, 0.0]), np.ones(3)
    samples = informed_samples(random, 40_000, start, goal[None], most, ones)
    box = random.uniform((-0.3, -0.6, -0.6), (1.3, 0.6, 0.6), (200_000, 3))
    evenly = box[lengths_through(box, start, goal[None], ones) <= most]
    for moment in (np.mean, np.std):
        np.testing.assert_allclose(moment(samples, axis=0), moment(evenly, axis=0), atol=0.01)
    np.testing.assert_allclose(
        np.quantile(samples, (0.05, 0.95), axis=0), np.quantile(evenly, (0.05, 0.95), axis=0),
        atol=0.02)


def test_a_goal_where_the_arm_is_has_a_ball_around_it():
    start = np.array([0.1, 0.2])
    samples = informed_samples(
        np.random.default_rng(2), 1000, start, start[None], 0.4, np.ones(2))
    assert 0.19 < np.linalg.norm(samples - start, axis=1).max() <= 0.2


def test_a_straight_motion_to_a_far_goal_does_not_hide_nearer_ones():
    """Ways to goals that are further straight ahead than a way known is long are not looked at."""
    space, pose = space_among([WALL]), tip(PANDA, RIGHT)
    gains = []
    for seed in range(6):
        search = PathSearch(space, LEFT, pose, gives_way=False, seed=seed)
        work = search.work()
        while not search.shortened:
            next(work)
        first, rounds = search.price, search.rounds
        assert search.straight <= search.good
        while search.rounds < rounds + 8:
            next(work)
        assert search.price <= first
        gains.append(search.price / first)
    assert min(gains) < 0.95


def test_what_cannot_be_better_is_not_tried_and_costs_little():
    """A straight motion to the nearest goal: no tree grows, and each attempt is counted."""
    space = space_among([])
    search = PathSearch(space, LEFT, tip(PANDA, RIGHT), gives_way=False)
    work = search.work()
    while search.rounds < 1:
        next(work)
    assert search.straight and search.good
    spent, price = space.spent, search.price
    while search.rounds < 11:
        next(work)
    assert search.price == price
    assert 0 < space.spent - spent <= 50_000
