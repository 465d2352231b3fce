"""Postures at a pose: what a guess leads to, and what lies along the null space."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY
from hypothesis import given, strategies as st
import numpy as np
import pytest
from target_run import tip

from redundant_planner.core.constants import gains_of, limits_of, robot_constants
from redundant_planner.core.horizon.least_norm_path import path_joints
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.target.inverse_kinematics import are_apart, AT_POSE, self_motion, solve

PANDA = make_panda()
P = PlannerParameters()
JOINTS = path_joints(robot_constants(PANDA, P), gains_of(P), limits_of(PANDA, P))
SEEDS = st.integers(0, 2**32 - 1)


def off(q, pose):
    return np.abs(se3.pose_error(pose, tip(PANDA, q), False)).max()


def anywhere(random):
    return random.uniform(JOINTS.position_min, JOINTS.position_max)


@given(SEEDS)
def test_a_solution_is_within_the_limits_and_as_far_off_as_it_says(seed):
    random = np.random.default_rng(seed)
    guess, pose = anywhere(random), tip(PANDA, anywhere(random))
    before = guess.copy()
    found = solve(guess, Poses.of(pose), PANDA.chain, JOINTS)
    np.testing.assert_array_equal(guess, before)
    assert (found.q >= JOINTS.position_min).all() and (found.q <= JOINTS.position_max).all()
    assert abs(off(found.q, pose) - found.error) < 1e-9
    assert 0 <= found.steps <= 40 * PANDA.n


@pytest.mark.parametrize('at_limits', [0, 2])
def test_more_than_one_guess_in_three_leads_to_a_pose_in_reach(at_limits):
    """Also where joints have to stand at their limits: the others lead there."""
    random, found = np.random.default_rng(0), []
    for _ in range(1000):
        q, stand = anywhere(random), random.choice(PANDA.n, at_limits, replace=False)
        q[stand] = np.where(random.random(at_limits) < 0.5, JOINTS.position_min[stand],
                            JOINTS.position_max[stand])
        found.append(solve(anywhere(random), PANDA.kinematics(q).tips, PANDA.chain, JOINTS))
    assert sum(solution.error < AT_POSE for solution in found) > 360
    assert np.mean([solution.steps for solution in found]) < 12


def test_a_pose_that_is_nowhere_is_given_up_soon():
    far = se3.displaced(tip(PANDA, PANDA_READY), np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]), False)
    random = np.random.default_rng(0)
    found = [solve(anywhere(random), Poses.of(far), PANDA.chain, JOINTS) for _ in range(50)]
    assert min(solution.error for solution in found) > 0.1
    assert np.mean([solution.steps for solution in found]) < 15


@given(SEEDS)
def test_a_self_motion_leaves_the_tip_where_it_is(seed):
    random = np.random.default_rng(seed)
    q, size = anywhere(random), 0.25
    pose = tip(PANDA, q)
    postures, taken = self_motion(
        q, Poses.of(pose), random.normal(size=7), size, 6, PANDA.chain, JOINTS)
    steps = np.linalg.norm(np.diff(np.vstack((q, postures)), axis=0), axis=1)
    # At a joint's limit a step is shorter.
    assert len(postures) == 0 or steps.max() < 4.0 * size
    assert taken >= len(postures)
    assert (postures >= JOINTS.position_min).all() and (postures <= JOINTS.position_max).all()
    for posture in postures:
        assert off(posture, pose) < AT_POSE


def test_a_self_motion_goes_on_in_one_direction():
    pose, aside = tip(PANDA, PANDA_READY), np.ones(7)
    ahead, back = (self_motion(PANDA_READY, Poses.of(pose), way, 0.1, 5, PANDA.chain, JOINTS)[0]
                   for way in (aside, -aside))
    assert len(ahead) == len(back) == 5
    away = np.linalg.norm(np.vstack((ahead, back)) - PANDA_READY, axis=1)
    assert (np.diff(away[:5]) > 0.05).all() and (np.diff(away[5:]) > 0.05).all()
    assert (ahead[0] - PANDA_READY) @ (back[0] - PANDA_READY) < 0.0


@given(SEEDS)
def test_postures_are_apart_where_one_joint_is(seed):
    random = np.random.default_rng(seed)
    postures, others = random.random((6, 3)), random.random((int(random.integers(8)), 3))
    nearest = np.abs(postures[:, None] - others).max(axis=2).min(axis=1, initial=np.inf)
    np.testing.assert_array_equal(are_apart(postures, others, 0.4), nearest > 0.4)
