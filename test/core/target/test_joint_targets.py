"""To joint positions: arrival of every joint, ways around things, and what cannot be reached."""

from __future__ import annotations

import re

from conftest import examples, make_paper_arm, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from target_run import DT, PANDA, Run, STILL, tip

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.target.progress import REACHED, TargetState

CAPSULES = capsules_of(PANDA)
# A wall beside the arm that a straight motion of the joints leads through.
WALL = Obstacle.box('wall', (0.5, 0.0, 0.25), (0.5, 0.04, 0.5))
LEFT = np.array([0.7, 0.6, 0.0, -1.9, 0.0, 2.4, 0.8])
RIGHT = LEFT * (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


@pytest.mark.long
@settings(max_examples=examples(8), derandomize=True)
@given(st.lists(st.floats(0.05, 0.95), min_size=7, max_size=7))
def test_every_joint_arrives_within_all_limits(shares):
    goal = PANDA.position_min + np.array(shares) * (PANDA.position_max - PANDA.position_min)
    run = Run()
    progress = run.to(goal, 15.0)
    if Motion.through(CAPSULES, goal[None]).to_itself().distance > 0.02:
        assert progress.state is TargetState.REACHED and progress.joint < REACHED
        np.testing.assert_allclose(run.q, goal, atol=REACHED)
    assert Motion.through(CAPSULES, np.array(run.positions)).to_itself().distance > 0.0
    run.assert_within_limits()


@pytest.mark.first_alone
@pytest.mark.parametrize('parameters', [
    {}, {'method': 'variational'}, {'target_path': 'straight'}])
def test_it_goes_around_a_wall(parameters):
    run = Run(start=LEFT, **parameters)
    assert run.to(RIGHT, 15.0, Scene.of([WALL])).state is TargetState.REACHED
    np.testing.assert_allclose(run.q, RIGHT, atol=REACHED)
    motion = Motion.through(CAPSULES, np.array(run.positions))
    assert motion.to_obstacles((WALL,), DT).distance > 0.008
    run.assert_within_limits()
    # And stays there, without creeping.
    before = run.q
    run.to(lambda _: RIGHT, 1.0, Scene.of([WALL]))
    np.testing.assert_allclose(run.q, before, atol=REACHED)


def test_the_way_is_straight_where_that_is_free():
    run = Run()
    goal = PANDA_READY + np.array([0.4, -0.2, 0.3, 0.2, -0.3, 0.2, 0.5])
    run.to(goal, 10.0)
    along = (goal - PANDA_READY) / np.linalg.norm(goal - PANDA_READY)
    off = np.array(run.positions) - PANDA_READY
    assert np.abs(off - np.outer(off @ along, along)).max() < 1e-3


def test_a_target_that_touches_something_is_waited_for():
    ball = Obstacle('ball', tip(PANDA, RIGHT).position, np.full(3, 0.1))
    run, scene = Run(start=LEFT), Scene.of([ball])
    progress = run.to(RIGHT, 3.0, scene)
    assert progress.state is TargetState.BLOCKED
    said = re.search(r"at the target '(\w+)' would be ([\d.]+) mm too near to an obstacle",
                     run.results[-1].reason)
    nearest = Motion.through(CAPSULES, RIGHT[None]).to_obstacles((ball,), 0.0)
    missing = PlannerParameters().clearance_margin - nearest.distance
    assert said[1] in str(nearest) and float(said[2]) == pytest.approx(1e3 * missing, abs=0.1)
    np.testing.assert_allclose(run.q, LEFT, atol=1e-3)
    assert run.to(RIGHT, 15.0).state is TargetState.REACHED
    run.assert_within_limits()


@pytest.mark.long
def test_an_arm_that_gives_way_steps_aside_and_comes_back():
    """What is at its target has to get past it to leave."""
    ball, cap = Obstacle('ball', tip(PANDA, RIGHT).position, np.full(3, 0.1)), 'makes way'
    patient, kind = Run(start=LEFT), Run(start=LEFT, target_gives_way=True)
    for run in (patient, kind):
        run.to(RIGHT, 8.0, Scene.of([ball]))
    assert not any(cap in result.reason for result in patient.results)
    assert any(cap in result.reason for result in kind.results)
    away = [np.linalg.norm(run.tips[-1] - ball.center) for run in (patient, kind)]
    assert away[1] > away[0] + 0.1
    assert kind.to(RIGHT, 20.0).state is TargetState.REACHED
    np.testing.assert_allclose(kind.q, RIGHT, atol=REACHED)
    kind.assert_within_limits()


@pytest.mark.long
def test_targets_of_both_kinds_and_a_twist_take_turns_on_the_way():
    run = Run(start=LEFT)
    run.to(lambda _: RIGHT, 0.7)
    run.to(lambda _: tip(PANDA, LEFT), 0.7)
    run.to(lambda _: PANDA_READY, 0.7)
    run.let_go()
    run.to(lambda _: RIGHT, 0.7)
    assert run.to(PANDA_READY, 15.0).state is TargetState.REACHED
    np.testing.assert_allclose(run.q, PANDA_READY, atol=REACHED)
    run.assert_within_limits()


def test_an_arm_that_is_pushed_comes_back():
    run = Run()
    goal = PANDA_READY + 0.3
    run.to(goal, 10.0)
    run.q = run.q + 0.05
    run.positions = [run.q]
    for _ in range(1500):
        result = run.planner.step(run.q, STILL, Scene.of(()), DT, target=goal)
        run.q = run.q + DT * result.dq
    np.testing.assert_allclose(run.q, goal, atol=REACHED)
    assert not result.dq.any()


def test_an_arm_on_rails_slides_and_turns_to_its_target():
    robot = make_paper_arm()
    low, high = robot.position_min, robot.position_max
    start, goal = low + 0.4 * (high - low), low + 0.55 * (high - low)
    run = Run(robot, start)
    assert run.to(goal, 15.0).state is TargetState.REACHED
    np.testing.assert_allclose(run.q, goal, atol=REACHED)
    run.assert_within_limits()


def test_what_no_joint_can_do_is_refused_by_name():
    planner = Planner(PANDA, PlannerParameters())
    beyond = PANDA_READY.copy()
    beyond[3] = 0.5
    for target, reason in ((beyond, "the target of joint 'panda_joint4' is 0.5; it must be"),
                           (PANDA_READY[:6], 'posture has shape'),
                           (PANDA_READY * np.nan, 'is not a finite number')):
        with pytest.raises(StateError, match=reason):
            planner.step(PANDA_READY, STILL, Scene.of(()), DT, target=target)


def test_the_margin_of_the_limits_is_kept():
    limits = {'limits_position_margin': 0.05}
    run, goal = Run(**limits), PANDA_READY.copy()
    goal[5] = PANDA.position_max[5]
    assert run.to(goal, 10.0).state is TargetState.REACHED
    np.testing.assert_allclose(run.q[5], PANDA.position_max[5] - 0.05, atol=2 * REACHED)
