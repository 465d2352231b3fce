"""Where a body with several hands starts: all of them in front, apart, and the lift half way."""

from __future__ import annotations

from conftest import HANDS, make_two_handed, random_postures
import numpy as np
import pytest

from benchmark.tip_bodies import make_body
from redundant_planner.core.constants import robot_constants
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.target.start_posture import start_posture

MAKERS = {'two_handed': make_two_handed, 'baxter': lambda: make_body('baxter'),
          'tiago_dual': lambda: make_body('tiago_dual'), 'lift': lambda: make_body('lift')}


@pytest.mark.parametrize('name', ['two_handed', *(
    pytest.param(name, marks=pytest.mark.long) for name in list(MAKERS)[1:])])
def test_hands_are_in_front_and_apart_and_can_move(name):
    robot = MAKERS[name]()
    q = start_posture(robot)
    arm, constants = robot.kinematics(q), robot_constants(robot, PlannerParameters())
    left, right = arm.tip_positions
    supports = robot.chain.tip_supports > 0.0
    shared, points = supports.all(axis=0), robot.joint_points(q)
    shoulders = [points[int((own & ~shared).argmax())] for own in supports]
    for tip, shoulder in zip((left, right), shoulders):
        assert tip[0] > shoulder[0] + 0.1, 'in front'
        assert abs(tip[1] - shoulder[1]) < tip[0] - shoulder[0], 'rather than beside'
    across = (shoulders[0] - shoulders[1]) / np.linalg.norm(shoulders[0] - shoulders[1])
    assert (left - right) @ across > 0.25, 'each on its side'
    span = robot.position_max - robot.position_min
    assert (np.minimum(q - robot.position_min, robot.position_max - q) >= 0.1 * span).all()
    assert link_distances(arm.segment_start, arm.segment_end, constants.radii,
                          constants.self_pairs).distance.min() > 0.0
    smallest = [np.linalg.svd(robot.kinematics(at).jacobian, compute_uv=False)[-1]
                for at in (q, *random_postures(robot, 200))]
    assert smallest[0] > np.median(smallest[1:])


def test_what_moves_all_tips_is_at_zero_or_half_way():
    robot = make_two_handed()
    assert dict(zip(robot.joint_names[:2], start_posture(robot))) == {'lift': 0.2, 'waist': 0.0}


def test_tips_on_one_arm_have_a_posture_too():
    robot = make_two_handed(tips=(HANDS[0], 'left_link4'))
    q = start_posture(robot)
    assert (q >= robot.position_min).all() and (q <= robot.position_max).all()
    assert np.abs(q).sum() > 0.0
