"""Ways that the arm has gone: found again there and back, and only where they are still free."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from target_run import DT, PANDA, Run, STILL, tip
from test_free_space import space_among

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.target.past_ways import PastWays
from redundant_planner.core.target.path_search import PathSearch
from redundant_planner.core.target.progress import TargetState

SEEDS = st.integers(0, 2**32 - 1)
WALL = Obstacle.box('wall', (0.5, 0.0, 0.25), (0.5, 0.04, 0.5))
BEHIND_WALL = Scene.of([WALL])
LEFT = np.array([0.7, 0.6, 0.0, -1.9, 0.0, 2.4, 0.8])
RIGHT = LEFT * (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
ONES = np.ones(3)


def length(way):
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def shortest(past, start, goals, scaling=ONES):
    found = [part for part in past.parts(start, goals, scaling) if part is not None]
    return min(found, key=lambda part: part.length, default=None)


@settings(max_examples=200, deadline=None)
@given(SEEDS)
def test_the_part_of_a_way_that_leads_on_is_found_there_and_back(seed):
    random = np.random.default_rng(seed)
    way = np.cumsum(random.normal(size=(30, 3)), axis=0)
    past = PastWays()
    past.note(way)
    first, last = sorted(random.choice(30, 2, replace=False))
    far = np.full((1, 3), 1e3)
    for one, other in ((first, last), (last, first)):
        part = shortest(past, way[one], np.vstack((far, way[other])))
        np.testing.assert_array_equal(
            part.postures, way[first:last + 1] if one < other else way[first:last + 1][::-1])
        assert part.goal == 1
        assert part.length == pytest.approx(length(way[first:last + 1]))
    assert shortest(past, way[first], far) is None
    assert shortest(past, far[0], way[last:last + 1]) is None
    assert shortest(past, way[first], np.empty((0, 3))) is None


@settings(max_examples=200, deadline=None)
@given(SEEDS, st.floats(0.0, 0.5))
def test_what_leads_onto_a_way_and_off_it_is_short_and_counted(seed, off):
    random = np.random.default_rng(seed)
    scaling = random.uniform(0.5, 2.0, 3)
    way = np.linspace(np.zeros(3), random.uniform(0.5, 2.0, 3), 10)
    start, goal = way[0] + (off, 0.0, 0.0), way[-1] - (0.0, off, 0.0)
    past = PastWays()
    past.note(way)
    part = shortest(past, start, goal[None], scaling)
    if part is not None:
        joined = np.vstack((start, part.postures, goal)) / scaling
        assert part.length == pytest.approx(length(joined))
        assert length(joined) <= 1.1 * length(part.postures / scaling) + 1e-9
    if off == 0.0:
        assert part is not None


def test_of_ways_between_the_same_ends_the_latest_is_remembered():
    past, ends = PastWays(), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    past.note(np.insert(ends, 1, (0.5, 0.5, 0.0), axis=0))
    past.note(np.insert(ends, 1, (0.5, 0.1, 0.0), axis=0)[::-1] + 0.01)
    assert len(past.ends) == 2
    assert shortest(past, ends[0], ends[1:]).length < 1.1
    for step in range(20):
        past.note(ends + (2.0 + step, 0.0, 0.0))
        past.note(ends[:1] + (np.zeros(3), np.full(3, 0.04)))  # one that was left at once
    assert len(past.ends) == 16
    np.testing.assert_array_equal(past.ends[0], ends[1] + (21.0, 0.0, 0.0))
    assert shortest(past, ends[0], ends[1:]) is None


def searched(obstacles, past):
    """The first way of a search from the left to the right, and how much work it was [ns]."""
    space = space_among(obstacles)
    before = space.spent
    search = PathSearch(space, LEFT, tip(PANDA, RIGHT), gives_way=False, past=past)
    for _ in search.work():
        if search.shortened:
            break
    return search, space.spent - before, space


def over_the_wall():
    past = PastWays()
    search, _, _ = searched([WALL], None)
    past.note(np.array([place.q for place in search.way]))
    return past


def test_a_way_that_is_still_free_is_taken_again():
    past = over_the_wall()
    search, work, space = searched([WALL], past)
    assert search.went_before
    assert 2 * work < searched([WALL], None)[1]
    for one, other in pairwise(search.way):
        assert space.rooms(np.linspace(one.q, other.q, 200)).min() > 0.0


def test_a_way_that_is_blocked_now_is_not_taken():
    past = over_the_wall()
    tip_half_way = tip(PANDA, past._ways[0][len(past._ways[0]) // 2]).position
    search, _, space = searched([WALL, Obstacle('ball', tip_half_way, (0.05,) * 3)], past)
    assert not search.went_before
    for one, other in pairwise(search.way):
        assert space.rooms(np.linspace(one.q, other.q, 200)).min() > 0.0


def test_where_nothing_is_in_the_way_any_more_the_arm_goes_straight():
    search, _, _ = searched([], over_the_wall())
    assert search.went_before and len(search.way) == 2


def test_it_thinks_less_when_it_goes_there_and_back_again():
    run, thought = Run(start=LEFT), []
    for target in [tip(PANDA, RIGHT), tip(PANDA, LEFT)] * 2:
        first = len(run.results)
        assert run.to(target, 15.0, BEHIND_WALL).state is TargetState.REACHED
        thought.append(sum(result.progress.state is TargetState.THINKING
                           for result in run.results[first:]))
    assert 2 * sum(thought[1:]) < 3 * thought[0]
    clearance = Motion.through(capsules_of(PANDA), np.array(run.positions))
    assert clearance.to_obstacles([WALL], 0.004).distance > 0.008
    run.assert_within_limits()


def test_after_a_reset_it_is_as_new():
    target = tip(PANDA, RIGHT)
    run, new = Run(start=LEFT), Run(start=LEFT)
    run.to(target, 15.0, BEHIND_WALL)
    run.planner.reset()
    run.q = LEFT
    first = len(run.results)
    run.to(target, 15.0, BEHIND_WALL)
    new.to(target, 15.0, BEHIND_WALL)
    np.testing.assert_array_equal(
        [result.dq for result in run.results[first:]], [result.dq for result in new.results])


def test_other_parameters_do_not_make_it_forget():
    run = Run(start=LEFT)
    run.to(tip(PANDA, RIGHT), 15.0, BEHIND_WALL)
    run.planner.parameters = replace(run.planner.parameters, feedback_gain=1.5)
    back = len(run.results)
    run.to(tip(PANDA, LEFT), 15.0, BEHIND_WALL)
    thinking = [result.progress.state is TargetState.THINKING for result in run.results]
    assert sum(thinking[back:]) < sum(thinking[:back])


def test_a_way_on_which_the_arm_was_stopped_is_not_taken_again():
    """Something that nobody sees holds it: other ways are tried then."""
    run, back = Run(start=LEFT), tip(PANDA, LEFT)
    run.to(tip(PANDA, RIGHT), 15.0, BEHIND_WALL)
    way = run.planner._aiming._way._free
    run.to(back, 0.5, BEHIND_WALL)
    assert way._finder.search.went_before
    while way._searches == 1:
        run.planner.step(run.q, STILL, BEHIND_WALL, DT, target=back)
    for _ in range(100):
        run.planner.step(run.q, STILL, BEHIND_WALL, DT, target=back)
    assert not way._finder.search.went_before
    assert run.to(back, 15.0, BEHIND_WALL).state is TargetState.REACHED


def test_a_way_that_is_left_half_way_is_remembered_as_far_as_it_was_gone():
    run = Run(start=LEFT)
    run.to(tip(PANDA, RIGHT), 0.8, BEHIND_WALL)
    way = run.planner._aiming._way._free
    run.to(tip(PANDA, LEFT), 15.0, BEHIND_WALL)
    ends = way._past.ends
    np.testing.assert_allclose(ends[-1], LEFT, atol=1e-6)
    assert np.abs(ends[-2] - RIGHT).max() > 0.1
    assert np.abs(np.array(run.positions) - ends[-2]).max(axis=1).min() < 0.05
