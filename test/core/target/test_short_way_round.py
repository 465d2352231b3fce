"""Joints that turn without end take the short way round to targets, and the long one if they must.

The arms are `kinova.urdf`, a Jaco with four continuous joints of six, and a planar arm.
"""

from __future__ import annotations

from conftest import EXAMPLE_ROBOTS, make_planar, planar_urdf
import numpy as np
import pytest
from target_run import DT, EMPTY, Run, tip

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.target.progress import TargetState

KINOVA_URDF = (EXAMPLE_ROBOTS / 'kinova_description' / 'robots' / 'kinova.urdf').read_text()
KINOVA = Robot(KINOVA_URDF, 'j2s6s200_end_effector', link_radius=0.03)
ENDLESS = np.isinf(KINOVA.position_max)
START = np.array([0.5, 3.0, 1.6, 3.0, 2.0, 3.0])


def turned(run):
    """The furthest that each joint was from where it began (n,) [rad]."""
    positions = np.array(run.positions)
    return np.abs(positions - positions[0]).max(axis=0)


@pytest.mark.parametrize('target, expected', [
    (3.5, 3.5), (-2.78, 2.0 * np.pi - 2.78), (3.5 + 20.0 * np.pi, 3.5), (-9.0, 4.0 * np.pi - 9.0)])
def test_a_joint_target_is_reached_the_short_way_round(target, expected):
    run = Run(KINOVA, START)
    wanted = START.copy()
    wanted[5] = target
    assert run.to(wanted, 10.0).state is TargetState.REACHED
    np.testing.assert_allclose(run.q, [*START[:5], expected], atol=1e-4)
    assert turned(run)[5] == pytest.approx(abs(expected - START[5]), abs=1e-3)
    run.assert_within_limits()


def test_an_arm_that_has_turned_often_goes_on_from_there():
    """Its target is given without the turns."""
    begin = START + 14.0 * np.pi * ENDLESS
    run = Run(KINOVA, begin)
    wanted = START + 0.4
    assert run.to(wanted, 10.0).state is TargetState.REACHED
    assert turned(run).max() < 0.41


@pytest.mark.first_alone
@pytest.mark.parametrize('seed', range(4))
def test_postures_at_a_pose_are_reached_without_turning_more_than_half(seed):
    random = np.random.default_rng(seed)
    low = np.where(ENDLESS, -3.0, KINOVA.position_min + 0.3)
    high = np.where(ENDLESS, 3.0, KINOVA.position_max - 0.3)
    goal = random.uniform(low, high)
    run = Run(KINOVA, START)
    if run.to(tip(KINOVA, goal), 12.0).state is TargetState.REACHED:
        assert turned(run)[ENDLESS].max() < np.pi + 0.1
    run.assert_within_limits()


def test_the_long_way_round_is_taken_where_something_is_in_the_short_one():
    """An arm that turns in a plane, and a post beside it."""
    arm = Robot(planar_urdf(('continuous',), (0.5,)), 'tip', axes=('vx',), link_radius=0.02)
    post = Obstacle('post', (0.3 * np.cos(1.0), 0.3 * np.sin(1.0), 0.0), (0.05, 0.05, 0.3))
    for scene, expected in ((Scene.of(), 2.0), (Scene.of([post]), 2.0 - 2.0 * np.pi)):
        run = Run(arm, np.zeros(1))
        assert run.to(np.array([2.0]), 15.0, scene).state is TargetState.REACHED
        assert run.q[0] == pytest.approx(expected, abs=1e-3)


def test_a_preferred_posture_is_the_nearest_turn_of_it():
    """Turns of the planar arm's last joint, of three that lead a tip with two axes, do nothing."""
    arm, ends = make_planar(), []
    parameters = PlannerParameters(posture_preferred=('joint3=0.2',), posture_weight=5.0)
    turns = np.array([0.0, 0.0, 6.0 * np.pi])
    for q in (np.array([0.3, 0.5, 1.2]), np.array([0.3, 0.5, 1.2]) + turns):
        planner = Planner(arm, parameters)
        for tick in range(2000):
            twist = np.array([0.1 if tick // 250 % 2 else -0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
            q = q + DT * planner.step(q, twist, EMPTY, DT).dq
        ends.append(q)
    assert abs(ends[0][2] - 0.2) < 0.6
    np.testing.assert_allclose(ends[1] - turns, ends[0], atol=1e-6)
