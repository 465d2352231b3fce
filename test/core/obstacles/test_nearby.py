"""Leaving obstacles out changes nothing that the planner decides."""

from __future__ import annotations

from conftest import examples, make_panda, make_paper_arm, random_postures
from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.obstacles import nearby
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.nearby import surroundings
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.watch import ObstacleWatch
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner

PANDA = make_panda()
RADII = np.array([capsule.radius for capsule in PANDA.capsules])
LEAD, COURSE = 0.1, 2.0
KEPT = nearby.Kept(RADII, 0.0, LEAD)


def cloud(count, seed, extent=1.5, speed=0.0):
    random = np.random.default_rng(seed)
    return Scene.of(
        Obstacle(f'o{i}', random.uniform(-extent, extent, 3), random.uniform(0.01, 0.1, 3),
                 velocity=speed * random.normal(size=3)) for i in range(count))


@settings(deadline=None, max_examples=examples(60))
@given(st.integers(0, 10**6), st.floats(0.0, 0.3), st.floats(0.01, 0.4))
def test_what_is_left_out_is_out_of_reach_as_long_as_it_holds(seed, step, reach):
    """Against all distances, at postures that random motion leads to."""
    random = np.random.default_rng(seed)
    scene = cloud(60, seed, speed=0.2)
    maps = inflated_obstacles(scene, RADII, LEAD)
    (q,) = random_postures(PANDA, 1, seed)
    arm = PANDA.kinematics(q)
    limit = np.full(len(RADII), reach) * random.uniform(0.5, 1.0, len(RADII))
    around = surroundings(scene, KEPT, arm, limit, COURSE)
    assert around.hold(scene, arm, limit, to_spare=True)
    left_out = ~np.isin(np.arange(60), around.near)
    for _ in range(20):
        q = q + step * random.normal(size=7) * 0.1
        arm = PANDA.kinematics(q)
        pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
        if around.hold(scene, arm, limit):
            assert (pairs.distance[:, left_out] > limit[:, None] - 1e-9).all()
        else:
            assert not around.hold(scene, arm, limit, to_spare=True)
    assert not around.hold(cloud(60, seed, speed=0.2), arm, limit)


@settings(deadline=None, max_examples=examples(40))
@given(st.integers(0, 10**6), st.integers(1, 40), st.floats(0.0, 3.0))
def test_of_too_many_the_deepest_are_taken_and_no_other_is_nearer_than_told(seed, most, reach):
    scene = cloud(60, seed, speed=0.2)
    (q,) = random_postures(PANDA, 1, seed)
    arm = PANDA.kinematics(q)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nearby, 'MOST_NEAR', most)
        patch.setattr(nearby, 'MOST_AHEAD', most)
        around = surroundings(scene, KEPT, arm, np.full(len(RADII), reach), COURSE)
    assert 1 <= len(around.near) <= most and len(around.nearest) == most
    distance = link_clearance(
        inflated_obstacles(scene, RADII, LEAD), arm.segment_start, arm.segment_end).distance
    left_out = ~np.isin(np.arange(60), around.near)
    assert (distance[:, left_out] > around.range[:, None] - 1e-9).all()
    assert around.crowded or not left_out.any() or (distance[:, left_out] > reach).all()
    np.testing.assert_array_equal(around.maps.centers.T, scene.centers[around.near])
    np.testing.assert_array_equal(around.ahead.centers.T, scene.centers[around.nearest])
    # Round ones are exactly in the order of their distance.
    balls = Scene.of(Obstacle(o.name, o.center, np.full(3, o.half_extents[0]))
                     for o in scene.obstacles())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nearby, 'MOST_AHEAD', most)
        nearest = surroundings(
            balls, KEPT, arm, np.full(len(RADII), reach), COURSE).nearest
    least = link_clearance(
        inflated_obstacles(balls, RADII, LEAD),
        arm.segment_start, arm.segment_end).distance.min(axis=0)
    assert least[nearest].max() <= np.delete(least, nearest).min() + 1e-9


@settings(deadline=None, max_examples=examples(30))
@given(st.integers(0, 10**6), st.floats(0.01, 0.4))
def test_what_is_left_out_is_as_far_as_it_says(seed, reach):
    """What moves is nearer by its way within the lead."""
    scene = cloud(60, seed, speed=1.0)
    maps = inflated_obstacles(scene, RADII, LEAD)
    arm = PANDA.kinematics(random_postures(PANDA, 1, seed)[0])
    around = surroundings(scene, KEPT, arm, np.full(len(RADII), reach), COURSE)
    left_out = ~np.isin(np.arange(60), around.near)
    pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
    further = pairs.distance[:, left_out] - around.range[:, None]
    assert (further[PANDA.moved] > -1e-9).all()


def plank_rod_or_pin(name, kind, random):
    turned = random.normal(size=4)
    place = {'orientation': turned / np.linalg.norm(turned), 'velocity': random.normal(size=3)}
    center, short, long = random.uniform(-1.5, 1.5, 3), *random.uniform((0.01, 0.1), (0.1, 1.5))
    if kind == 0:
        return Obstacle.box(name, center, (long, short, random.uniform(short, long)), **place)
    if kind == 1:
        return Obstacle.cylinder(name, center, short, long, **place)
    return Obstacle.capsule(name, center, short, long, **place)


def chosen(scene, arm, reach, most, most_ahead):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nearby, 'MOST_NEAR', most)
        patch.setattr(nearby, 'MOST_AHEAD', most_ahead)
        return surroundings(scene, KEPT, arm, reach, COURSE)


@settings(deadline=None, max_examples=examples(40))
@given(st.integers(0, 10**6), st.integers(1, 40), st.integers(1, 40))
@example(1205, 1, 1)
def test_long_ones_are_chosen_as_if_each_were_alone(seed, most, most_ahead):
    """A ball around a plank says little. Better bounds are sought only where they may decide."""
    random = np.random.default_rng(seed)
    count = 60
    scene = Scene.of(plank_rod_or_pin(f'o{i}', i % 3, random) for i in range(count))
    arm = PANDA.kinematics(random_postures(PANDA, 1, seed)[0])
    reach = np.full(len(RADII), random.uniform(0.1, 1.0))
    around = chosen(scene, arm, reach, most, most_ahead)
    # Of one that is there twice, the second is left out for one: how deep it is in the reach.
    depths = np.array([
        (chosen(Scene.of([one, one]), arm, reach, 1, 1).range - reach)[0]
        for one in scene.obstacles()])
    depths -= nearby._EXTRA_RANGE
    is_within = depths < -1e-9
    if is_within.sum() > most:
        assert around.near.tolist() == sorted(np.argsort(depths)[:most])
        np.testing.assert_allclose(
            around.range - reach - nearby._EXTRA_RANGE, np.sort(depths)[most - 1], atol=1e-12)
    elif is_within.any():
        assert around.near.tolist() == np.flatnonzero(is_within).tolist()
    # With room for all of them each has its best bound.
    assert around.nearest.tolist() == chosen(
        scene, arm, reach, count, most_ahead).nearest.tolist()


@pytest.mark.first_alone
@pytest.mark.parametrize('speed', [0.0, 0.2])
@pytest.mark.parametrize('make', [make_panda, make_paper_arm])
def test_the_planner_decides_the_same_with_all_of_them(make, speed, monkeypatch):
    """A hall full of obstacles, some on the way; tick by tick to round-off.

    Without looking ahead, which dynamic_factor does among few obstacles only, and without bounds
    on how many a tick takes in. Nor does other work wait while it chooses.
    """
    monkeypatch.setattr(ObstacleWatch, 'chose', property(lambda _: False, lambda _, value: None),
                        raising=False)
    monkeypatch.setattr(nearby, 'MOST_NEAR', 10**9)
    monkeypatch.setattr(nearby, 'MOST_AHEAD', 10**9)
    robot = make()
    random = np.random.default_rng(1)
    start = random_postures(robot, 1, 5)[0]
    arm = robot.kinematics(start)
    scene = cloud(400, 2, extent=2.0, speed=speed)
    radii = np.array([capsule.radius + 0.03 for capsule in robot.capsules])
    free = (link_clearance(inflated_obstacles(scene, radii), arm.segment_start, arm.segment_end)
            .normalized_distance > 0.0).all(axis=0)
    scene = Scene.of(o for o, is_free in zip(scene.obstacles(), free) if is_free)
    twists = 0.2 * random.normal(size=(6, 6))

    def run():
        planner, q, decided = Planner(robot, PlannerParameters(horizon_look_ahead=0.0)), start, []
        for i in range(360):
            result = planner.step(q, twists[i // 60], scene, 0.004)
            q = q + 0.004 * result.dq
            decided.append((result.dq, result.scale, result.stage))
        return decided

    quick = run()
    monkeypatch.setattr('redundant_planner.core.obstacles.watch.FEW', 10**9)
    for (dq, scale, stage), (all_dq, all_scale, all_stage) in zip(quick, run()):
        np.testing.assert_allclose(dq, all_dq, atol=1e-7)
        assert scale == pytest.approx(all_scale, abs=1e-6) and stage == all_stage
    assert any(stage.name != 'DESIRED' for _, _, stage in quick)
    assert len(scene.names) > nearby.FEW


@pytest.mark.first_alone
@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
@pytest.mark.parametrize('count', [60, 600])
def test_to_prepare_changes_nothing_but_when_it_chooses(count, method, monkeypatch):
    """Among few and among too many obstacles, with now and then a new scene."""
    scenes = [cloud(count, seed, extent=2.0, speed=0.1) for seed in range(4)]
    (start,) = random_postures(PANDA, 1, 3)
    twists = 0.3 * np.random.default_rng(1).normal(size=(6, 6))
    chosen_in = []

    def noted(*arguments):
        chosen_in.append(where)
        return surroundings(*arguments)

    monkeypatch.setattr('redundant_planner.core.obstacles.watch.surroundings', noted)
    planners = [Planner(PANDA, PlannerParameters(method=method)) for _ in range(2)]
    q = start
    for i in range(240):
        scene = scenes[i // 30 % 4]
        where = 'prepare'
        planners[0].prepare(scene)
        where = 'step'
        prepared = planners[0].step(q, twists[i // 40], scene, 0.004)
        where = 'unprepared'
        result = planners[1].step(q, twists[i // 40], scene, 0.004)
        np.testing.assert_array_equal(prepared.dq, result.dq)
        assert prepared.reason == result.reason
        q = q + 0.004 * result.dq
    assert chosen_in.count('step') == 1  # the first, before which there was no posture
    assert chosen_in.count('prepare') == chosen_in.count('unprepared') - 1 > 7
