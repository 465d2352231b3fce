"""Whatever the scene, a tick does so much and no more; what it leaves out is not run into."""

from __future__ import annotations

from conftest import make_panda, make_planar, PANDA_READY
import daqp
import numpy as np
import pytest

from redundant_planner.core.horizon import path_qp
from redundant_planner.core.horizon.horizon import Horizon
from redundant_planner.core.horizon.look_ahead import OLDEST_PATH_CHOOSING
from redundant_planner.core.obstacles import nearby
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.near_pairs import MOST_ACTING, MOST_AHEAD_PAIRS
from redundant_planner.core.obstacles.nearby import MOST_NEAR
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.qp import MOST_ITERATIONS_WITH_SLACK

PANDA = make_panda()
RADII = np.array([capsule.radius for capsule in PANDA.capsules])
DT = 0.004


def crowd(q, count, seed, gap, size=0.03):
    """Balls around the arm, that far from its links and further."""
    random, arm, found = np.random.default_rng(seed), PANDA.kinematics(q), []
    while len(found) < count:
        link = random.integers(len(RADII))
        point = arm.segment_start[link] + random.random() * (
            arm.segment_end[link] - arm.segment_start[link])
        away = random.normal(size=3)
        center = point + away / np.linalg.norm(away) * (
            RADII[link] + size + gap + 0.3 * random.random() ** 2)
        ball = Obstacle(f'o{len(found)}', center, np.full(3, size))
        clear = link_clearance(inflated_obstacles(Scene.of([ball]), RADII), arm.segment_start,
                               arm.segment_end).distance
        if clear.min() > gap:
            found.append(ball)
    return Scene.of(found)


@pytest.mark.first_alone
@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('seed', [0, 1])
def test_an_arm_hits_none_of_more_obstacles_than_a_tick_takes_in(method, seed):
    random = np.random.default_rng(seed)
    scene = crowd(PANDA_READY, 3 * MOST_NEAR, seed, 0.03)
    maps = inflated_obstacles(scene, RADII)
    planner, q, previous = Planner(PANDA, PlannerParameters(method=method)), PANDA_READY, 0.0
    least, fallbacks, way = np.inf, set(), 0.0
    for i in range(350):
        if i % 70 == 0:
            twist = 0.4 * random.normal(size=6)
        result = planner.step(q, twist, scene, DT)
        assert (np.abs(result.dq) <= PANDA.velocity_max + 1e-9).all()
        assert (np.abs(result.dq - previous) <= PANDA.acceleration_max * DT + 1e-9).all()
        q, previous = q + DT * result.dq, result.dq
        way += DT * np.abs(result.dq).sum()
        arm = PANDA.kinematics(q)
        least = min(least, link_clearance(maps, arm.segment_start, arm.segment_end)
                    .distance.min())
        fallbacks.add(result.fallback.partition(':')[0])
        assert result.fallback in result.reason
    assert least > 0.009, 'the clearance margin'
    assert way > 0.01
    assert 'slower among more obstacles than a tick takes in' in ' '.join(fallbacks)


@pytest.mark.parametrize('method', METHODS)
def test_obstacles_that_appear_around_the_links_make_no_problem_larger_than_it_may_be(
        method, monkeypatch):
    """Four hundred of them, while a joint path is followed: it once took minutes to solve."""
    problems, solve = [], daqp.solve

    def watched(hessian, linear, constraints, *rest, **options):
        answer = solve(hessian, linear, constraints, *rest, **options)
        problems.append((constraints.shape[0], options['iter_limit'], answer[3]['iterations']))
        return answer

    monkeypatch.setattr(daqp, 'solve', watched)
    near = crowd(PANDA_READY, 40, 2, 0.02)
    scenes = [near, *(crowd(PANDA_READY, count, 3, -0.02) for count in (50, 400)), near]
    planner, q = Planner(PANDA, PlannerParameters(method=method)), PANDA_READY
    twist = np.array([0.1, 0.1, -0.05, 0.0, 0.0, 0.2])
    for scene in scenes:
        for _ in range(25):
            problems.clear()
            result = planner.step(q, twist, scene, DT)
            assert np.isfinite(result.dq).all()
            q = q + DT * result.dq
            assert len(problems) <= 6, 'five problems of the filter and a step of the path ahead'
            for rows, limit, iterations in problems:
                assert iterations <= limit <= max(
                    MOST_ITERATIONS_WITH_SLACK, path_qp._MOST_ITERATIONS)
                links = len(PANDA.self_pairs)
                assert rows <= 6 + max(MOST_ACTING + 4 + links + 2, MOST_AHEAD_PAIRS + 12 * 7)


def test_a_few_obstacles_are_all_seen_at_any_speed():
    scene = crowd(PANDA_READY, MOST_ACTING // len(RADII), 4, 0.02)
    planner, q = Planner(PANDA, PlannerParameters()), PANDA_READY
    for _ in range(50):
        result = planner.step(q, np.array([0.3, 0.0, -0.2, 0.0, 0.3, 0.0]), scene, DT)
        assert 'more obstacles' not in result.fallback
        q = q + DT * result.dq


@pytest.mark.parametrize('size', [5e-324, 2e-162, 1e-30, 1e300])
@pytest.mark.parametrize('method', METHODS)
def test_commands_of_any_size_give_finite_velocities_within_the_limits(method, size):
    ball = Obstacle('ball', np.array([0.45, 0.05, 0.45]), np.array([0.05, 0.04, 0.08]))
    planner, q, previous = Planner(PANDA, PlannerParameters(method=method)), PANDA_READY, 0.0
    for i in range(40):
        factor = 1.0 + 0.5 * (i % 3)
        twist = size * factor * np.array([1.0, 0.0, 0.2, 0.0, 0.0, 0.1]) if i % 10 else np.zeros(6)
        dq = planner.step(q, twist, Scene.of([ball]), DT).dq
        assert np.isfinite(dq).all()
        assert (np.abs(dq - previous) <= PANDA.acceleration_max * DT + 1e-9).all()
        q, previous = q + DT * dq, dq


@pytest.mark.parametrize('method', METHODS)
def test_an_arm_with_fewer_joints_than_axes_moves_as_far_as_it_can(method):
    arm = make_planar(axes=('vx', 'vy', 'vz', 'wx', 'wy', 'wz'))
    planner, q = Planner(arm, PlannerParameters(
        method=method, singularity_margin=0.0)), np.array([0.3, 0.6, 0.4])
    for _ in range(20):
        dq = planner.step(q, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.1]), Scene.of(), DT).dq
        assert np.isfinite(dq).all() and (np.abs(dq) <= arm.velocity_max).all()
        q = q + DT * dq


def test_a_tick_that_chooses_from_many_obstacles_leaves_the_first_joint_path_to_the_next():
    planner = Planner(make_panda(), PlannerParameters(method='variational'))
    scene = Scene.of(
        Obstacle(f'o{i}', [0.0, 2.0 + 0.1 * i, 0.5], [0.03] * 3) for i in range(nearby.FEW))
    twist = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    first, second = (planner.step(PANDA_READY, twist, scene, 0.004) for _ in range(2))
    assert 'no joint path ahead' in first.fallback
    assert not second.fallback


@pytest.mark.parametrize('period', [1, 2])
def test_a_tick_that_chooses_plans_no_joint_path_unless_that_is_very_old(period, monkeypatch):
    """New obstacles come with every tick, or with every other one."""
    planner = Planner(PANDA, PlannerParameters(method='variational'))
    scenes = [Scene.of(Obstacle(f'o{i}', [0.0, 2.0 + 0.1 * i + shift, 0.5], [0.03] * 3)
                       for i in range(nearby.FEW)) for shift in (0.0, 0.01)]
    planned, advance = [], Horizon.advance

    def noted(*arguments):
        planned.append(tick)
        return advance(*arguments)

    monkeypatch.setattr(Horizon, 'advance', noted)
    twist = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    for tick in range(60):
        planner.step(PANDA_READY, twist, scenes[tick // period % 2], DT)
    if period == 1:
        np.testing.assert_array_equal(np.diff(planned[1:]), round(OLDEST_PATH_CHOOSING / DT))
    else:
        assert planned == [1, *range(5, 60, 2)]
