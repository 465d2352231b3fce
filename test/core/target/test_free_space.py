"""Free motions, smooth curves and the search: what they promise, against dense samples."""

from __future__ import annotations

import itertools
from itertools import pairwise

from conftest import examples, make_panda, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from target_run import tip

from redundant_planner.core.constants import gains_of, limits_of, robot_constants
from redundant_planner.core.horizon.least_norm_path import path_joints
from redundant_planner.core.kernels import compiled, Matrix, OutMatrix
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.target.free_space import FreeSpace
from redundant_planner.core.target.goal_postures import goal_postures, off_poses, posture_at
from redundant_planner.core.target.joint_curve import JointCurve, resampled
from redundant_planner.core.target.path_search import PathSearch
from redundant_planner.core.target.straight_motion import (
    Arena,
    COST_OF_CALL,
    new_scratch,
    write_room,
)

PANDA = make_panda()
SEEDS = st.integers(0, 2**32 - 1)


def space_among(obstacles, contacts=None, **parameters):
    p = PlannerParameters(**parameters)
    constants = robot_constants(PANDA, p)
    joints = path_joints(constants, gains_of(p), limits_of(PANDA, p))
    radii = [c.radius + p.clearance_margin for c in PANDA.capsules]
    return FreeSpace(PANDA, constants, joints, inflated_obstacles(
        Scene.of(obstacles), radii, contacts=contacts, moved=PANDA.moved))


def crowd(random):
    return [Obstacle.box(f'{i}', random.uniform(-0.7, 0.7, 3) + (0.0, 0.0, 0.4),
                         random.uniform(0.05, 0.3, 3)) for i in range(4)]


def two_places(space, random):
    """Postures anywhere in the joints' ranges."""
    return (space.place(random.uniform(PANDA.position_min, PANDA.position_max))
            for _ in range(2))


def answer(work):
    """What a generator returns at its end."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value


@settings(max_examples=examples(30))
@given(SEEDS)
def test_a_motion_that_counts_as_free_has_room_everywhere(seed):
    random = np.random.default_rng(seed)
    space = space_among(crowd(random))
    one, other = two_places(space, random)
    if min(one.room.min(), other.room.min()) < 0.01:
        return
    needed = np.full(len(one.room), 0.01)
    free = answer(space.is_free_between(one, other, needed))
    between = space.rooms(np.linspace(one.q, other.q, 400)).min()
    assert between > 0.0 if free else between < 0.01


@compiled
def too_little_is_seen(
    postures: Matrix, least: float, arena: Arena, rooms: OutMatrix,
) -> tuple[int, int]:
    """Write rooms (N, k), left out below a bound; return how many were, and the work."""
    scratch, left_out = new_scratch(arena), 0
    scratch.least[:] = least
    for i in range(len(postures)):
        scratch.arm.q[:] = postures[i]
        if not write_room(arena, scratch, rooms[i]):
            rooms[i] = -1.0
            left_out += 1
    return left_out, scratch.work[0]


@given(SEEDS, st.floats(0.0, 0.05), st.sampled_from((
    {}, {'cone_angle': 1.5, 'cone_direction': (0.0, 0.0, -1.0)})))
def test_where_there_is_too_little_room_the_rest_is_left_out(seed, least, parameters):
    random = np.random.default_rng(seed)
    contacts = random.random((len(PANDA.capsules), 6)) < 0.3
    space = space_among([
        *crowd(random), Obstacle('ball', random.uniform(0.2, 0.6, 3), (0.1, 0.2, 0.1)),
        Obstacle.half_space('floor', (0.0, 0.0, -0.1))], contacts, **parameters)
    postures = random.uniform(PANDA.position_min, PANDA.position_max, (30, 7))
    # Links that are found too close to each other count as having no room.
    space.begin_at(postures[random.integers(30)])
    before = space.spent
    known, some = space.rooms(postures), np.empty((30, len(space.arena.reach)))
    left_out, work = too_little_is_seen(postures, least, space.arena, some)
    assert 0 < work <= space.spent - before
    np.testing.assert_array_equal(some[:, 0] == -1.0, (known < least).any(axis=1))
    free = (known >= least).all(axis=1)
    assert left_out == 30 - free.sum()
    np.testing.assert_array_equal(some[free], known[free])


@settings(max_examples=examples(30))
@given(SEEDS)
def test_a_motion_is_judged_alike_in_small_pieces_and_large_ones(seed):
    random = np.random.default_rng(seed)
    space = space_among(crowd(random))
    one, other = two_places(space, random)
    needed, answers, work = space.asked(0.01), [], []
    for space.piece in (COST_OF_CALL + 1, 100_000_000):
        before, pieces = space.spent, 1
        looking = space.is_free_between(one, other, needed)
        while True:
            try:
                next(looking)
            except StopIteration as over:
                answers.append(over.value)
                break
            pieces += 1
        work.append(space.spent - before - COST_OF_CALL * pieces)
    assert answers[0] == answers[1] and work[0] == work[1]


def test_of_a_motion_of_a_thousand_turns_nobody_says_that_it_is_free():
    space = space_among([])
    here = space.place(PANDA_READY)
    far = here._replace(q=PANDA_READY + np.array([6e3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert not answer(space.is_free_between(here, far, space.asked(0.01)))


def test_obstacles_get_all_the_room_that_is_asked_for_and_pairs_of_links_less():
    """Such as a Panda's hand and its link5, which are close to each other in most motions."""
    random, space = np.random.default_rng(0), space_among([])
    links, found = len(PANDA.capsules), 0
    asked = space.asked(0.01)
    np.testing.assert_array_equal(asked[:links], 0.01)
    np.testing.assert_array_equal(space.asked(1e-3), 1e-3)
    while found < 5:
        one, other = two_places(space, random)
        between = space.rooms(np.linspace(one.q, other.q, 400)).min()
        if min(one.room.min(), other.room.min()) > 0.01 and 0.004 < between < 0.009:
            found += 1
            assert answer(space.is_free_between(one, other, asked))
            assert not answer(space.is_free_between(one, other, np.full(len(asked), 0.01)))


@given(SEEDS)
def test_links_that_do_not_move_have_all_the_room(seed):
    """A box around the base is nothing to the links that never get there."""
    random = np.random.default_rng(seed)
    space = space_among([Obstacle.box('base', (0.0, 0.0, 0.0), (0.1, 0.1, 0.1))])
    q = random.uniform(PANDA.position_min, PANDA.position_max)
    fixed = ~PANDA.lever_arm_bounds.any(axis=1)
    assert np.isinf(space.rooms(q[None])[0][:len(fixed)][fixed]).all()


@given(SEEDS, st.integers(2, 9))
def test_a_curve_begins_and_ends_with_its_polygon_and_bends_smoothly(seed, corners):
    polygon = np.random.default_rng(seed).uniform(-1.0, 1.0, (corners, 7))
    curve = JointCurve(polygon)
    np.testing.assert_allclose(curve.at(np.array([0.0, curve.spans])), polygon[[0, -1]],
                               atol=1e-12)
    u = np.linspace(0.0, curve.spans, 2000)
    points, step = curve.at(u), u[1]
    assert (points <= polygon.max(axis=0) + 1e-9).all()
    assert (points >= polygon.min(axis=0) - 1e-9).all()
    # Continuous to the second derivative: its differences shrink with the step.
    second = np.diff(points, 2, axis=0) / step**2
    assert np.abs(np.diff(second, axis=0)).max() < 30.0 * step


@given(SEEDS, st.floats(0.02, 0.5))
def test_resampled_corners_come_no_closer_than_asked(seed, spacing):
    polygon = np.random.default_rng(seed).uniform(-1.0, 1.0, (4, 7))
    points = resampled(polygon, np.ones(7), spacing)
    np.testing.assert_allclose(points[[0, -1]], polygon[[0, -1]])
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= spacing + 1e-9


@pytest.mark.parametrize('parameters', [
    {}, {'cone_angle': 0.2, 'cone_direction': (0.0, 0.0, -1.0)}], ids=['free', 'in a cone'])
def test_a_search_ends_at_the_pose_and_its_way_is_free(parameters):
    wall = Obstacle.box('wall', (0.45, 0.0, 0.3), (0.6, 0.04, 0.4))
    space = space_among([wall], **parameters)
    start = PANDA_READY + np.array([0.8, 0.4, 0.0, 0.0, 0.0, 0.4, 0.0])
    goal = start * (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    pose = tip(PANDA, goal)
    search = PathSearch(space, start, pose, gives_way=True)
    work = search.work()
    while search.rounds < 2:
        next(work)
    way = np.array([place.q for place in search.way])
    np.testing.assert_array_equal(way[0], start)
    assert np.abs(se3.pose_error(pose, tip(PANDA, way[-1]), False)).max() < 2e-3
    for one, other in pairwise(way):
        assert space.rooms(np.linspace(one, other, 200)).min() > 0.0
    assert search.length(search.way) == pytest.approx(
        np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    first = search.length(search.way)
    while search.rounds < 5:
        next(work)
    # A way with more room may be longer by this factor.
    assert search.length(search.way) <= 1.3 * first


def test_out_of_reach_is_known_after_a_while():
    space = space_among([])
    far = se3.displaced(tip(PANDA, PANDA_READY), np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]), False)
    search = PathSearch(space, PANDA_READY, far, gives_way=False)
    work = search.work()
    for _ in range(3000):
        next(work)
        if search.goals.out_of_reach:
            break
    assert search.goals.out_of_reach and search.way is None


@pytest.mark.parametrize('goal', [
    PANDA_READY,
    # Shoulder and wrist aligned, the elbow nearly stretched: damped steps seldom end there.
    (1.449, 0.0, 0.0, -0.445, 0.0, 1.868, -2.173)], ids=['ready', 'near singular'])
def test_goal_postures_are_found_near_singularities_too(goal):
    space, pose = space_among([]), tip(PANDA, np.array(goal))
    random, (low, high) = np.random.default_rng(5), space.joint_ranges(np.array(goal))
    postures = [posture_at(space, random.uniform(low, high), Poses.of(pose)) for _ in range(100)]
    found = [q for q in postures if q is not None]
    assert len(found) >= 15
    for q in found:
        assert np.abs(se3.pose_error(pose, tip(PANDA, q), False)).max() < 2e-5
        assert (q >= space.joints.position_min).all() and (q <= space.joints.position_max).all()


@pytest.mark.parametrize('goal', [
    PANDA_READY, (-0.42, 1.417, -2.432, -0.43, -2.724, 1.251, -1.796)],
    ids=['ready', 'near singular'])
def test_postures_along_the_null_space_are_right_at_the_goal(goal):
    """Near a singularity a tip could not go the rest in a line."""
    q = np.array(goal)
    space, pose = space_among([]), tip(PANDA, q)
    found = []
    for places in itertools.islice(
            goal_postures(space, q, Poses.of(pose), np.random.default_rng(3)), 200):
        found += places or []
    assert len(found) > 30 and space.spent > 0
    for place in found:
        assert off_poses(PANDA, place.q, Poses.of(pose)) < 2e-5
    # They are others than the posture that they begin from.
    assert max(np.abs(place.q - q).max() for place in found) > 0.5
