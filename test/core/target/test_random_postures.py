"""Postures that trees grow towards: those through which a way may still become shorter."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
from target_run import PANDA, tip
from test_free_space import space_among
from test_path_search_pieces import LEFT, RIGHT, WALL

from redundant_planner.core.target import free_goals, path_search
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
    most = longer * np.linalg.norm((goals - start) / scaling, axis=1)
    samples = informed_samples(random, 200, start, goals, most, scaling)
    ways = np.linalg.norm((samples - start) / scaling, axis=1)[:, None] + np.linalg.norm(
        (samples[:, None] - goals) / scaling, axis=2)
    assert (ways <= most * (1.0 + 1e-9)).any(axis=1).all()


def test_samples_fill_all_of_the_ellipsoid():
    random, most = np.random.default_rng(1), 1.5
    start, goal, ones = np.zeros(3), np.array([1.0, 0.0, 0.0]), np.ones(3)
    samples = informed_samples(random, 40_000, start, goal[None], np.array([most]), ones)
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
        np.random.default_rng(2), 1000, start, start[None], np.array([0.4]), np.ones(2))
    assert 0.19 < np.linalg.norm(samples - start, axis=1).max() <= 0.2


def with_goals(monkeypatch, space, goals, **options):
    """A search that knows these goals and no other."""
    def found(*_):
        yield [space.place(q) for q in goals]
        while True:
            yield None

    monkeypatch.setattr(free_goals, 'goal_postures', found)
    return PathSearch(space, LEFT, tip(PANDA, RIGHT), gives_way=False, **options)


def test_a_straight_motion_to_a_far_goal_does_not_hide_a_nearer_one(monkeypatch):
    """A wall stands before the nearer goal; the way around it is shorter than to the other."""
    space, far = space_among([WALL]), LEFT + np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.9])
    straight = float(space.distance(LEFT, far))
    for seed in range(3):
        search = with_goals(monkeypatch, space, [far, RIGHT], seed=seed)
        work = search.work()
        while not search.shortened:
            next(work)
        assert search.price == straight and not search.good
        while search.rounds < 12:
            next(work)
        assert search.price < 0.95 * straight
        np.testing.assert_array_equal(search.way[-1].q, RIGHT)


def test_goals_count_by_their_price(monkeypatch):
    """The nearest goal costs more than a farther one that is nearer to the preferred posture."""
    space = space_among([], posture_preferred=('panda_joint1=-2.0',), posture_weight=2.0)
    near, better = LEFT.copy(), LEFT.copy()
    near[0] += 0.3
    better[0] -= 0.4
    assert space.price_of_end(better) + 0.1 < space.price_of_end(near)
    search = with_goals(monkeypatch, space, [near, better])
    work = search.work()
    while search.way is None:
        next(work)
    for _ in range(200):
        next(work)
    np.testing.assert_array_equal(search.way[-1].q, better)


def test_trees_grow_towards_ways_to_every_goal(monkeypatch):
    space, goals = space_among([WALL]), []
    monkeypatch.setattr(path_search, 'informed_samples',
                        lambda *args: goals.append(args[3]) or informed_samples(*args))
    search = with_goals(monkeypatch, space, [RIGHT, RIGHT + 0.1])
    work = search.work()
    while search.rounds < 6:
        next(work)
    assert goals and all(0 < len(given) <= 2 for given in goals)
    start, ends = np.zeros(2), np.array([[1.0, 0.0], [0.0, 1.0]])
    samples = informed_samples(
        np.random.default_rng(0), 400, start, ends, np.full(2, 1.001), np.ones(2))
    # Near trees goes every other aim: both goals keep some of the rest.
    assert (samples[1::2] @ (1.0, -1.0) > 0.2).any() and (
        samples[1::2] @ (1.0, -1.0) < -0.2).any()


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
    assert 0 < space.spent - spent <= 25 * path_search._COST_OF_PRICE
