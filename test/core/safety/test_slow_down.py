"""Slower near people: the speed of every link stays below the one for its distance."""

from __future__ import annotations

from conftest import examples, make_panda, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from target_run import DT, PANDA, Run, STILL, tip

from redundant_planner.core import planner as planner_module
from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.barriers import barrier_bounds, barriers_in
from redundant_planner.core.safety.limits import stopping_time
from redundant_planner.core.safety.stage import Stage

RADII = np.array([capsule.radius for capsule in PANDA.capsules])
# Beside the way of the hand, which passes it.
PERSON = Obstacle('person/1', (0.45, 0.55, 0.5), np.full(3, 0.1))
ACROSS = np.array([0.0, 0.25, 0.0, 0.0, 0.0, 0.0])


def drive(twist, scene, seconds, **parameters):
    """Follow a twist; the postures and the results."""
    planner = Planner(PANDA, PlannerParameters(**parameters))
    postures, results = [np.array(PANDA_READY)], []
    for i in range(round(seconds / DT)):
        results.append(planner.step(
            postures[-1], twist, scene(i * DT) if callable(scene) else scene, DT))
        postures.append(postures[-1] + DT * results[-1].dq)
    return np.array(postures), results


def speeds(postures):
    """The fastest of the links' ends and the tip between every two postures [m/s]."""
    arms = [PANDA.kinematics(q) for q in postures]
    points = np.array([np.vstack((a.segment_start, a.segment_end, a.tip_position)) for a in arms])
    return np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1) / DT


def distances(postures, ball):
    """Of any link to a ball [m], by sampling the capsules' segments."""
    share = np.linspace(0.0, 1.0, 101)[:, None, None]
    found = []
    for q in postures[:-1]:
        arm = PANDA.kinematics(q)
        points = arm.segment_start + share * (arm.segment_end - arm.segment_start)
        away = np.linalg.norm(points - ball.center, axis=2) - RADII - ball.half_extents[0]
        found.append(away.min())
    return np.array(found)


@settings(max_examples=examples(6), deadline=None, derandomize=True)
@given(st.floats(0.1, 0.3), st.floats(0.3, 2.0))
def test_no_link_is_faster_than_its_distance_allows_and_the_path_is_kept(keep, time):
    scene = Scene.of([PERSON])
    postures, results = drive(ACROSS, scene, 3.0, slow_down=(f'person={keep}:{time}',))
    allowed = np.maximum((distances(postures, PERSON) - keep) / time, 0.0)
    # Commands are the mean of 10 ms of plans.
    assert (speeds(postures) <= np.maximum(allowed, allowed.max() * 0.01) * 1.05 + 2e-3).all()
    assert any("slower near 'person/1'" in r.reason for r in results)
    assert max(np.linalg.norm(r.path_error[:3]) for r in results) < 1e-3
    assert distances(postures, PERSON).min() > keep - 5e-3
    free, _ = drive(ACROSS, scene, 3.0)
    assert distances(free, PERSON).min() < keep


def test_others_do_not_matter_nor_do_those_far_away():
    postures, results = drive(ACROSS, Scene.of([PERSON]), 1.0, slow_down=('pers=0.3:1.0',))
    free, _ = drive(ACROSS, Scene.of([PERSON]), 1.0)
    np.testing.assert_array_equal(postures, free)
    assert not any('slower near' in r.reason for r in results)


def test_one_that_appears_makes_the_arm_brake_within_its_limits():
    beside = tip(PANDA, PANDA_READY).position + (0.0, 0.6, 0.1)
    near = Obstacle('person/1', beside, np.full(3, 0.1))
    postures, results = drive(ACROSS, lambda t: Scene.of([near] if t > 0.8 else []), 2.0,
                              slow_down=('person=0.5:1.0',))
    velocities = np.diff(postures, axis=0) / DT
    acceleration = np.diff(velocities, axis=0) / DT
    assert (np.abs(acceleration) <= PANDA.acceleration_max * (1 + 1e-6)).all()
    assert (np.abs(np.diff(acceleration, axis=0)) / DT <= PANDA.jerk_max * (1 + 1e-6)).all()
    assert np.abs(results[round(0.79 / DT)].dq).max() > 0.05
    assert np.abs(results[-1].dq).max() < 1e-3


def test_one_that_walks_counts_as_nearer_and_targets_slow_down_too():
    walking = Obstacle('person/1', PERSON.center, PERSON.half_extents, velocity=(0.2, 0.0, 0.0))
    still, _ = drive(ACROSS, Scene.of([PERSON]), 1.0, slow_down=('person=0.1:1.0',))
    moving, _ = drive(ACROSS, Scene.of([walking]), 1.0, slow_down=('person=0.1:1.0',))
    assert speeds(moving).max() < speeds(still).max() - 0.1
    run = Run(slow_down=('person=0.1:1.0',))
    goal = PANDA_READY + [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    for _ in range(250):
        result = run.planner.step(run.q, STILL, Scene.of([PERSON]), DT, target=goal)
        run.q = run.q + DT * result.dq
        run.positions.append(run.q)
    path = np.array(run.positions)
    allowed = np.maximum(distances(path, PERSON) - 0.1, 0.0)
    assert (speeds(path) <= 1.05 * allowed + 2e-3).all()


@settings(max_examples=examples(12), deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), speed=st.floats(0.05, 0.2),
       priority=st.sampled_from(['yield', 'strict', 'slide']))
def test_no_barrier_is_broken_near_a_person_that_is_kept_without(seed, speed, priority):
    """In every stage that keeps all barriers without a person near, they are kept with one."""
    random, found = np.random.default_rng(seed), []
    wish = planner_module.wish
    planner = Planner(PANDA, PlannerParameters(
        path_priority=priority, slow_down=('person=0.4:1.0',)))
    q = np.array(PANDA_READY)
    arm = PANDA.kinematics(q)
    way = random.normal(size=3)
    way /= np.linalg.norm(way)
    middle = 0.5 * (arm.segment_start[-4] + arm.segment_end[-4])
    twist = 0.2 * np.append(random.normal(size=3), np.zeros(3))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(planner_module, 'wish',
                        lambda *arguments: found.append(wish(*arguments)) or found[-1])
        for i in range(300):
            ball = Obstacle('ball', middle + (0.2 - speed * i * DT) * way, np.full(3, 0.04),
                            velocity=-speed * way)
            previous = planner._last.dq
            result = planner.step(q, twist, Scene.of([ball, PERSON]), DT)
            if result.stage in (Stage.DESIRED, Stage.SCALED, Stage.BRAKING, Stage.SLIDING):
                rows = barriers_in(planner._setup.value.rows, found[-1].rows_used)
                stop = stopping_time(previous, PANDA.acceleration_max)
                change = -DT if result.stage is Stage.BRAKING else DT
                bounds = barrier_bounds(
                    rows, planner.parameters.clearance_gain, max(stop + change, 0.0), DT)
                assert (rows.gradient @ planner._last.dq >= bounds - 1e-6).all()
            q = q + DT * result.dq


def test_a_slower_arm_gets_out_of_the_way_of_what_comes_at_it_all_the_same():
    arm = PANDA.kinematics(PANDA_READY)
    forearm = [capsule.name for capsule in PANDA.capsules].index('link5')
    middle = 0.5 * (arm.segment_start[forearm] + arm.segment_end[forearm])
    nearest = []
    for slow in ((), ('person=0.4:1.0',)):
        planner = Planner(PANDA, PlannerParameters(slow_down=slow, path_priority='strict'))
        q, least = np.array(PANDA_READY), np.inf
        for i in range(750):
            ball = Obstacle('ball', middle + [0.0, 0.3 - 0.1 * i * DT, 0.0], np.full(3, 0.05),
                            velocity=(0.0, -0.1, 0.0))
            q = q + DT * planner.step(q, 0.2 * ACROSS, Scene.of([ball, PERSON]), DT).dq
            least = min(least, distances([q, q], ball)[0])
        nearest.append(least)
    assert nearest[1] > nearest[0] - 1e-3


def test_where_the_path_cannot_be_kept_nobody_slows_the_arm_down():
    """A clearance that takes the tip from its path goes first: as if there was nobody near."""
    hand = tip(PANDA, PANDA_READY).position
    ball = Obstacle('ball', hand + [-0.1, 0.0, 0.0], np.full(3, 0.05), velocity=(0.2, 0.0, 0.0))
    person = Obstacle('person/1', hand + [0.0, 0.5, 0.1], np.full(3, 0.1))
    found = []
    for slow in ((), ('person=0.6:1.0',)):
        planner, q = Planner(PANDA, PlannerParameters(slow_down=slow)), np.array(PANDA_READY)
        results = []
        for i in range(40):
            scene = Scene.of([ball.after(i * DT), person])
            results.append(planner.step(q, ACROSS, scene, DT))
            q = q + DT * results[-1].dq
        assert {result.stage for result in results} <= {Stage.YIELDING, Stage.FORCED}
        assert not any('slower near' in result.reason for result in results)
        found.append([result.dq for result in results])
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize('entry', ['person', 'person=1', 'person=a:b', '=0.3:1', 'person=0.3:0',
                                   'person=-1:1', 'person=0.3:nan'])
def test_what_is_no_separation_is_refused(entry):
    with pytest.raises(ParameterError, match=r"'slow_down' has .* as 'person=0\.3:0\.5'"):
        Planner(make_panda(), PlannerParameters(slow_down=(entry,)))
