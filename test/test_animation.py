"""The README's moving picture shows what it says, and a command of the project makes it."""

from __future__ import annotations

from pathlib import Path
import sys

import numpy as np
from PIL import Image
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark import animation
from benchmark.robots import make_robot

TOP = Path(__file__).resolve().parent.parent


def test_plain_inverse_kinematics_runs_into_an_obstacle_and_the_planner_does_not():
    robot, motion = make_robot('panda', 6), animation.task()
    plain = animation.plain_inverse_kinematics(robot, motion)
    planned = animation.planned(robot, motion)
    ends = [robot.kinematics(postures[-1]).tip_position for postures in (plain, planned)]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)  # both hands arrive
    deepest = [min(animation.depths(robot, motion.obstacles, q).min() for q in postures[::10])
               for postures in (plain, planned)]
    assert deepest[0] < -0.1 and deepest[1] > 0.0


@pytest.mark.first_alone
@pytest.mark.parametrize('suffix', ['.gif', '.webp'])
def test_the_command_writes_a_moving_picture(tmp_path, monkeypatch, suffix):
    path = tmp_path / f'small{suffix}'
    monkeypatch.setattr(
        sys, 'argv', ['animation', '--out', str(path), '--frames', '3', '--width', '240'])
    animation.main()
    with Image.open(path) as picture:
        assert picture.n_frames == 3
        assert picture.size[0] == 240


def test_the_picture_in_the_docs_is_small_and_moves():
    path = TOP / 'docs' / 'passing_obstacles.gif'
    assert path.stat().st_size < 3e6
    with Image.open(path) as picture:
        assert picture.n_frames > 30
