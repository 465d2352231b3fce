"""Stepping aside for what moves: how far the tip leaves its path, and when."""

from __future__ import annotations

from closed_loop import DT
from conftest import make_panda, make_paper_arm, PANDA_READY
import numpy as np
import pytest

from benchmark.judge import reversals
from redundant_planner.core.horizon import evasive_plan
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.stage import Stage


class Passing:
    """A ball that passes through a link of an arm, while the tip shall stay or follow a twist."""

    def __init__(self, link, velocity, *, radius=0.05, seconds=6.0, after=2.0, robot=None,
                 start=PANDA_READY, twist=(0.0,) * 6, planner=None, **parameters):
        robot = robot or make_panda()
        planner = planner or Planner(robot, PlannerParameters(**parameters))
        q, velocity = np.array(start), np.array(velocity)
        arm = robot.kinematics(q)
        index = [c.name for c in robot.capsules].index(link)
        middle = 0.5 * (arm.segment_start[index] + arm.segment_end[index])
        ball = Obstacle('ball', middle - after * velocity, [radius] * 3, velocity=velocity)
        self.postures, self.results, self.clearances = [q], [], []
        for i in range(round(seconds / DT)):
            scene = Scene.of([ball.after(i * DT)])
            self.results.append(planner.step(q, np.array(twist), scene, DT))
            q = q + DT * self.results[-1].dq
            self.postures.append(q)
            arm = robot.kinematics(q)
            self.clearances.append(link_clearance(
                inflated_obstacles(scene, [c.radius for c in robot.capsules]),
                arm.segment_start, arm.segment_end).distance.min())
        self.off = np.array([np.linalg.norm(r.path_error) for r in self.results])
        self.robot = robot

    def assert_limits_kept(self):
        robot, velocities = self.robot, np.array([r.dq for r in self.results])
        changes = np.diff(velocities, axis=0, prepend=np.zeros((1, robot.n)))
        assert (np.abs(velocities) <= robot.velocity_max + 1e-9).all()
        assert (np.abs(changes) <= robot.acceleration_max * DT + 1e-9).all()
        assert (np.array(self.postures) <= robot.position_max + 1e-9).all()
        assert (np.array(self.postures) >= robot.position_min - 1e-9).all()


@pytest.fixture(scope='module')
def through_the_hand():
    return Passing('hand', [0.0, -0.25, 0.0])


def test_the_tip_steps_aside_in_time_and_comes_back(through_the_hand):
    run = through_the_hand
    run.assert_limits_kept()
    assert min(run.clearances) > 0.0
    # The ball and the hand together are 11 cm thick: who goes hardly further than that steps
    # aside, and is not driven along in front of it.
    assert 0.02 < run.off.max() < 0.2
    assert run.off[-1] < 1e-3
    first = next(r for r in run.results if r.stage is Stage.YIELDING)
    assert "in the course of obstacle 'ball'" in first.reason


def test_it_leaves_its_path_less_far_than_one_that_only_keeps_away(through_the_hand, monkeypatch):
    monkeypatch.setattr(evasive_plan.EvasivePlan, 'aside', lambda *_: None)
    driven = Passing('hand', [0.0, -0.25, 0.0])
    assert driven.off.max() > 1.1 * through_the_hand.off.max()


@pytest.mark.first_alone
@pytest.mark.parametrize('link, velocity', [
    ('hand', [0.0, -0.25, 0.0]), ('link4', [0.2, 0.1, 0.0]), ('link6', [0.1, 0.2, 0.1])])
def test_it_goes_out_and_back_without_shaking(link, velocity):
    """Out, to a stop, back, to a stop again: a joint's acceleration turns three times or so."""
    run = Passing(link, velocity)
    assert run.off.max() > 0.01
    change = np.diff([r.dq for r in run.results], axis=0) / DT
    assert reversals(change, run.robot.acceleration_max) < 7 * run.robot.n


def test_what_null_space_motion_gets_past_does_not_take_the_tip_off_its_path():
    run = Passing('link4', [0.0, 0.25, 0.0], radius=0.03)
    run.assert_limits_kept()
    assert min(run.clearances) > 0.0
    assert run.off.max() < 2e-3
    assert max(np.abs(r.homogeneous).max() for r in run.results) > 0.1


def test_the_same_inputs_give_the_same_outputs_also_after_a_reset(through_the_hand):
    robot = make_panda()
    planner = Planner(robot, PlannerParameters())
    Passing('link4', [0.2, 0.1, 0.0], seconds=1.5, after=1.0, robot=robot, planner=planner)
    planner.reset()
    again = Passing('hand', [0.0, -0.25, 0.0], robot=robot, planner=planner)
    np.testing.assert_array_equal(again.postures, through_the_hand.postures)


def test_along_a_command_the_path_goes_on_behind_the_ball():
    run = Passing('hand', [0.0, -0.25, 0.0], twist=(0.0, 0.0, 0.03, 0.0, 0.0, 0.0))
    run.assert_limits_kept()
    assert min(run.clearances) > 0.0
    assert run.off[-1] < 1e-3
    tips = [run.robot.kinematics(q).tip_position for q in (run.postures[0], run.postures[-1])]
    way = tips[1] - tips[0]
    assert 0.1 < way[2] <= 0.03 * 6.0 + 1e-3 and np.abs(way[:2]).max() < 2e-3


@pytest.mark.parametrize('change', [{'path_priority': 'strict'},
                                    {'clearance_evasion_horizon': 0.0}])
def test_it_can_be_switched_off(change, monkeypatch):
    def never(*_):
        raise AssertionError('it was asked')
    monkeypatch.setattr(evasive_plan.EvasivePlan, 'aside', never)
    Passing('hand', [0.0, -0.25, 0.0], seconds=0.1, after=0.5, **change)


def test_nothing_that_stands_still_is_stepped_aside_for(monkeypatch):
    def never(*_):
        raise AssertionError('it was asked')
    monkeypatch.setattr(evasive_plan.EvasivePlan, 'aside', never)
    Passing('hand', [0.0, 0.0, 0.0], seconds=0.1)


def test_an_arm_on_a_rail_evades_too():
    robot = make_paper_arm()
    start = 0.5 * (np.maximum(robot.position_min, -1.0) + np.minimum(robot.position_max, 1.0))
    link = robot.capsules[-1].name
    run = Passing(link, [0.1, -0.2, 0.05], radius=0.04, robot=robot, start=start)
    run.assert_limits_kept()
    assert min(run.clearances) > -1e-6
    assert run.off[-1] < 2e-3


def test_obstacles_may_come_and_go_between_its_steps():
    """What it names is no longer there, or another one by then."""
    robot = make_panda()
    planner, q = Planner(robot, PlannerParameters()), np.array(PANDA_READY)
    random = np.random.default_rng(3)
    tip = robot.kinematics(q).tip_position
    for _ in range(300):
        count = random.integers(0, 4)
        scene = Scene.of([Obstacle(
            f'o{random.integers(9)}', tip + random.uniform(-0.4, 0.4, 3), [0.04] * 3,
            velocity=random.uniform(-0.3, 0.3, 3)) for _ in range(count)]) if count else Scene.of()
        result = planner.step(q, np.zeros(6), scene, 0.001)
        assert np.isfinite(result.dq).all()
        q = q + 0.001 * result.dq


def test_numbers_without_end_leave_it_without_a_path():
    robot = make_panda()
    planner, q = Planner(robot, PlannerParameters()), np.array(PANDA_READY)
    far = Obstacle('far', [1e160, 0.0, 0.0], [1e155] * 3, velocity=[-1e159, 0.0, 0.0])
    with np.errstate(all='ignore'):
        for _ in range(20):
            result = planner.step(q, np.zeros(6), Scene.of([far]), DT)
            q = q + DT * result.dq
    assert np.isfinite(q).all()
