"""After a stream of joint positions, and one that leaves reach."""

from __future__ import annotations

from dataclasses import replace

from conftest import make_panda, make_planar, PANDA_READY
import numpy as np
import pytest
from target_run import DT, EMPTY, moved, PANDA, Run, STILL, tip

from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.target.moving_target import Sighting
from redundant_planner.core.target.progress import TargetState

LAG = 0.08
SWING = np.array([0.3, 0.1, -0.2, 0.2, 0.3, -0.2, 0.5])


def swung(t):
    """Return a slow sine that begins gently."""
    return PANDA_READY + SWING * (1.0 - np.cos(1.5 * t))


def sampled(signal, rate):
    return lambda t: signal(np.floor(t * rate + 1e-9) / rate)


@pytest.mark.first_alone
@pytest.mark.parametrize('rate', [250, 30, 10, 3])
def test_it_is_followed_one_lag_behind_without_a_stop_or_a_thought(rate):
    run = Run()
    run.to(sampled(swung, rate), 6.0)
    run.assert_within_limits()
    lag = max(LAG, 1.4 / rate)
    off = [np.abs(q - swung(max(i * DT - lag, 0.0))).max() for i, q in enumerate(run.positions)]
    assert max(off[500:]) < (0.05 if rate == 3 else 0.01)
    assert {r.progress.state for r in run.results[200:]} <= {TargetState.MOVING,
                                                             TargetState.REACHED}


def test_it_is_held_where_it_ends_and_taken_up_where_it_goes_on():
    run = Run()
    run.to(sampled(lambda t: swung(min(t, 2.0)), 30), 4.0)
    np.testing.assert_allclose(run.q, swung(2.0), atol=1e-6)
    assert not run.results[-1].dq.any()
    assert run.results[-1].progress.state is TargetState.REACHED
    run.to(sampled(lambda t: swung(2.5 + t), 30), 2.0)
    assert np.abs(run.q - swung(2.5 + 2.0 - LAG)).max() < 0.01
    run.assert_within_limits()


def test_an_obstacle_in_its_way_is_waited_for_and_then_it_comes_back():
    run = Run()
    begin = tip(PANDA, PANDA_READY)
    wall = Scene.of([Obstacle.box('wall', begin.position + (0.0, 0.25, 0.0), (1.0, 0.02, 1.0))])
    turn = np.eye(7)[0]

    def away(t):
        return PANDA_READY + 1.2 * np.sin(min(0.5 * t, 2.0)) * turn

    progress = run.to(sampled(away, 30), 6.0, wall)
    assert progress.state is TargetState.BLOCKED and run.results[-1].reason
    assert min(r.nearest.beyond_margin for r in run.results if r.nearest) > 0.0
    run.to(sampled(lambda t: PANDA_READY + 0.1 * np.sin(t) * turn, 30), 4.0, wall)
    assert np.abs(run.q - PANDA_READY - 0.1 * np.sin(4.0 - LAG) * turn).max() < 0.01
    run.assert_within_limits()


def test_a_joint_that_turns_without_end_goes_on_across_its_seam():
    robot = make_planar()
    planner, q = Planner(robot, PlannerParameters()), np.array([0.3, 0.4, 3.0])
    for i in range(500):
        angle = 3.0 + 0.5 * np.floor(i / 8) * 8 * DT
        target = np.array([0.3, 0.4, (angle + np.pi) % (2.0 * np.pi) - np.pi])
        q = q + DT * planner.step(q, np.zeros(6), EMPTY, DT, target=target).dq
    assert abs(q[2] - (3.0 + 0.5 * (500 * DT - LAG))) < 0.02


def test_a_burst_of_stamped_poses_is_as_good_as_all_of_them_in_time():
    """Once in 0.2 s, twelve poses: the tip moves evenly."""
    planner, q = Planner(PANDA, PlannerParameters()), PANDA_READY
    begin, tips, waiting = tip(PANDA, PANDA_READY), [], []
    target = None
    for i in range(1250):
        if i % 4 == 0:
            waiting.append((i, moved(begin, (0.0, 0.05 * i * DT, 0.0, 0.0, 0.0, 0.0))))
        news = ()
        if i % 50 == 0:
            news = tuple(Sighting(pose, (i - at) * DT) for at, pose in waiting)
            target, waiting = waiting[-1][1], []
        q = q + DT * planner.step(q, STILL, EMPTY, DT, target=target, news=news).dq
        tips.append(tip(PANDA, q).position[1])
    speed = np.diff(tips)[600:] / DT
    assert np.abs(speed - 0.05).max() < 2e-3


@pytest.mark.parametrize(('news', 'what'), [
    ([Sighting(PANDA_READY)], 'news has a target of another kind'),
    ([Sighting(tip(PANDA, PANDA_READY), np.nan)], 'news has a target of age nan'),
    ([Sighting(tip(PANDA, PANDA_READY)._replace(position=np.full(3, np.inf)))],
     'the position of the pose is')])
def test_news_that_is_none_is_refused_by_name(news, what):
    planner = Planner(PANDA, PlannerParameters())
    with pytest.raises(StateError, match=what):
        planner.step(PANDA_READY, STILL, EMPTY, DT, target=tip(PANDA, PANDA_READY), news=news)


@pytest.mark.parametrize('changed', [{'limits_linear_speed': 0.5}, {'target_lag': 0.12}])
def test_parameters_that_change_do_not_stop_it(changed):
    run, begin = Run(make_panda()), tip(PANDA, PANDA_READY)

    def pose(t):
        return moved(begin, (0.0, 0.05 * t, 0.0, 0.0, 0.0, 0.0))

    run.to(sampled(pose, 10), 2.0)
    run.planner.parameters = replace(run.planner.parameters, **changed)
    run.to(sampled(lambda t: pose(2.0 + t), 10), 2.0)
    assert {r.progress.state for r in run.results[100:]} == {TargetState.MOVING}
    assert np.abs(np.diff(run.tips, axis=0)[250:, 1] / DT - 0.05).max() < 0.01
    run.assert_within_limits()


def test_a_clutch_moves_the_arm_in_a_line_back_to_its_stream():
    """Silent for 2 s, and on from 0.2 m away: no search, no stall, no limit exceeded."""
    run, begin = Run(make_panda()), tip(PANDA, PANDA_READY)

    def pose(t, away=0.0):
        return moved(begin, (0.0, away + 0.05 * np.sin(2.0 * t), 0.0, 0.0, 0.0, 0.0))

    run.to(sampled(pose, 72), 2.0)
    run.to(pose(2.0 - 1.0 / 72), 2.0)
    before = len(run.results)
    run.to(sampled(lambda t: pose(t, 0.2), 72), 2.0)
    states = [r.progress.state for r in run.results[before:]]
    assert TargetState.THINKING not in states and TargetState.BLOCKED not in states
    assert abs(run.tips[-1][1] - pose(2.0 - LAG, 0.2).position[1]) < 5e-3
    run.assert_within_limits()


def test_a_stream_out_of_reach_comes_back_without_a_stall():
    run, begin = Run(), tip(PANDA, PANDA_READY)

    def pose(t):
        return moved(begin, (0.0, 1.2 * np.sin(0.5 * t) ** 2, 0.0, 0.0, 0.0, 0.0))

    run.to(sampled(pose, 72), 2.0 * np.pi)
    assert TargetState.THINKING not in {r.progress.state for r in run.results}
    assert np.linalg.norm(run.tips[-1] - pose(2.0 * np.pi - LAG).position) < 0.02
    run.assert_within_limits()
