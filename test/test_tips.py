"""The benchmark of several tips: what it measures, and that it can tell."""

from __future__ import annotations

import json
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmark import tips
from benchmark.tip_bodies import BODIES, make_body
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.target.progress import TargetState

KEYS = {'count', 'arrived', 'contacts', 'violations', 'relative_mm_max', 'time_median',
        'tick_us_median'}


@pytest.mark.first_alone
@pytest.mark.parametrize('arguments', [
    ('--body', 'lift'), ('--body', 'lift', '--coupled'), ('--body', 'base'),
    ('--body', 'baxter'), ('--body', 'tiago_dual')])
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


def test_a_base_has_no_hands_to_couple():
    with pytest.raises(SystemExit):
        tips.main(['--body', 'base', '--coupled'])
