"""The benchmark of several tips: what it measures, and that it can tell."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmark import tips
from benchmark.generator import generate
from benchmark.judge import accelerations, reversals
from benchmark.tip_bodies import arms_of, BODIES, make_body
from benchmark.tips import DT
from redundant_planner.core import planner as planner_module
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.target.progress import TargetState

KEYS = {'count', 'arrived', 'contacts', 'violations', 'relative_mm_max', 'time_median',
        'tick_us_median'}


@pytest.mark.first_alone
@pytest.mark.parametrize('arguments', [
    ('--body', 'lift'), ('--body', 'lift', '--coupled'), ('--body', 'base'),
    ('--body', 'baxter'), ('--body', 'baxter', '--separate'), ('--body', 'tiago_dual')])
def test_bodies_get_to_their_targets(arguments, tmp_path):
    file = tmp_path / 'found.json'
    tips.main([*arguments, '--count', '2', '--seed', '3', '--jobs', '1', '--json', str(file)])
    found = json.loads(file.read_text())
    assert set(found) >= KEYS and found['count'] == 2
    assert found['arrived'] == 1.0 and found['contacts'] == found['violations'] == 0
    assert found['relative_mm_max'] < 0.2


def test_bodies_have_their_tips():
    for name in BODIES:
        robot = make_body(name)
        assert len(robot.tips) == (1 if name == 'base' else 2)
        assert robot.m == 6 * len(robot.tips)


def test_the_judge_sees_a_touch_and_a_limit_that_is_exceeded():
    robot = make_body('lift')
    problem = tips.problem_of(robot, 0, on_a_base=False)
    hand = robot.kinematics(problem.start).tip_positions[1]
    ball = Obstacle('ball', hand, np.full(3, 0.05))
    postures = np.array([problem.start, problem.start])
    velocities = np.zeros((1, robot.n))
    velocities[0, 3] = 2.0 * robot.velocity_max[3]
    found = tips.judged(robot, problem._replace(obstacles=(ball,)), 0, TargetState.REACHED,
                        postures, velocities, [1e-4])
    assert found.clearance < 0.0 and 'ball' in found.nearest and found.violation > 0.9


@pytest.mark.parametrize('how', ['--coupled', '--separate'])
def test_a_base_has_no_two_hands(how):
    with pytest.raises(SystemExit):
        tips.main(['--body', 'base', how])


def test_arms_by_themselves_are_where_the_body_has_them():
    robot = make_body('lift')
    q = tips.problem_of(robot, 0, on_a_base=False).start
    whole = robot.kinematics(q)
    for tip, (arm, own) in enumerate(arms_of(robot, q)):
        assert arm.joint_names == tuple(np.array(robot.joint_names)[own])
        found = arm.kinematics(q[own])
        assert np.allclose(found.tip_positions[0], whole.tip_positions[tip])
        assert np.allclose(found.tip_rotations[0], whole.tip_rotations[tip])
        # The lift is held; of the other arm there is only the foot that stands on it.
        own_name, other_foot = (('left', 'right_base'), ('right', 'left_base'))[tip]
        chosen = [i for i, capsule in enumerate(robot.capsules)
                  if capsule.name.startswith(own_name) or capsule.name == other_foot]
        assert [capsule.name for capsule in arm.capsules] == [
            robot.capsules[i].name for i in chosen]
        assert np.allclose(found.segment_end, whole.segment_end[chosen])


def test_what_slows_one_arm_down_does_not_shake_the_other(monkeypatch):
    moves, wish = [], planner_module.wish

    def noted(start, world, setup):
        desired = wish(start, world, setup)
        moves.append(np.abs(start.arm.jacobian @ desired.motions[2]).max())
        return desired

    monkeypatch.setattr(planner_module, 'wish', noted)
    # Both arms hang on the base: the left one is held up by an obstacle, the right one by nothing.
    # Without the shapes of its body, which would make another scene of this seed.
    whole = make_body('baxter')
    robot = Robot(whole.urdf, tips=whole.tips, base_frame=whole.base_frame,
                  acceleration_max=whole.acceleration_max, jerk_max=whole.jerk_max,
                  capsules=list(itertools.compress(whole.capsules, whole.moved)))
    task = generate(robot, 9058)
    planner, scene, q = Planner(robot), Scene.of(task.obstacles), task.start
    velocities, shares = [], []
    for tick in range(1000):
        result = planner.step(q, task.twist_at(tick * DT).reshape(-1, 6), scene, DT)
        q = q + DT * result.dq
        velocities.append(result.dq)
        shares.append([tip.scale for tip in result.tips])
    left, right = np.array(shares[100:]).min(axis=0)
    assert left < 0.9 and right > 0.99
    assert max(moves) < 1e-9  # by null-space motion, which is slowed arm by arm
    of_right = robot.chain.tip_supports[1] > 0.0
    found = accelerations(np.array(velocities), DT)[:, of_right]
    assert reversals(found, robot.acceleration_max[of_right]) < 20
