"""How far known obstacles ask a tip to leave its path (runs where CasADi is installed)."""

from __future__ import annotations

from pathlib import Path
import sys

from conftest import make_panda, make_planar
import numpy as np
import pytest

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.se3 import Pose

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
pytest.importorskip('casadi')
from benchmark.evasion_needed import Comparison, Deviation, deviation, DT, starts, summarise
from benchmark.generator import DURATION, path_poses, Task
from benchmark.least_deviation import LeastDeviation, Path as TipPath

ARM = make_planar(link_radius=0.03)
START = np.array([0.4, 0.7, 0.6])
TIP = ARM.kinematics(START).tip_position
MARGIN = PlannerParameters().clearance_margin
SECONDS, RADIUS, SPEED, PASSES = 4.8, 0.05, 0.25, 2.0


def passing(beside):
    """A resting arm, and a ball that passes its tip at a distance [m] from it, in its plane."""
    outwards = TIP / np.linalg.norm(TIP)
    across = np.cross([0.0, 0.0, 1.0], outwards)
    ball = Obstacle('ball', TIP + beside * outwards - PASSES * SPEED * across,
                    np.full(3, RADIUS), velocity=SPEED * across)
    return Task(0, START, np.zeros(6), (ball,))


def least(task, lever=0.0):
    """Return the computed motion's postures and what it came to."""
    own = np.tile(task.start, (round(SECONDS / DT) + 1, 1))
    motions = [own, own + np.linspace(0.0, 0.3, len(own))[:, None]]
    problem = LeastDeviation(ARM, task, SECONDS, motions, lever=lever)
    points = problem.best()
    postures = problem.postures(points, DT)
    return postures, deviation(ARM, task, postures, lever)


def test_what_never_comes_near_asks_for_nothing():
    _, found = least(passing(beside=0.3))
    assert found.largest < 1e-3 and found.clearance > 0.1


def test_what_sweeps_through_the_tip_asks_for_its_overlap_and_hardly_more():
    postures, found = least(passing(beside=0.0))
    # The ball's centre comes to where the tip is: that has to be as far off as both are thick.
    overlap = RADIUS + ARM.capsules[-1].radius + MARGIN
    assert overlap - 1e-3 < found.largest < 1.3 * overlap
    assert found.clearance > 0.9 * MARGIN and found.last < 1e-3
    # From rest, within the limits at every tick.
    assert found.excess == 0.0
    np.testing.assert_allclose(postures[0], START)


def test_what_grazes_the_tip_asks_for_less():
    beside = 0.06
    _, found = least(passing(beside))
    overlap = RADIUS + ARM.capsules[-1].radius + MARGIN
    assert overlap - beside - 1e-3 < found.largest < 0.7 * overlap


@pytest.mark.parametrize('lever', [0.0, 0.5])
def test_a_pose_of_the_path_is_on_it_and_another_is_as_far_as_it_was_moved(lever):
    robot = make_panda()
    task = Task(0, np.array([0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.7]),
                np.array([0.1, 0.05, -0.05, 0.1, 0.2, 0.0]), ())
    path = TipPath.of(robot, task)
    last = path_poses(robot, task, DT)[-1]
    np.testing.assert_allclose(path.start.position + path.way, last.position, atol=1e-6)
    assert path.deviations(robot, task.start[None], lever)[0] < 1e-9
    # The last joint turns the tip about its own axis only: by a chord of 2 sin ½θ.
    turned = task.start + np.array([0, 0, 0, 0, 0, 0, 0.6])
    still = path._replace(way=np.zeros(3), turn=np.zeros(3))
    expected = lever * 2.0 * np.sin(0.3)
    assert still.deviations(robot, turned[None], lever)[0] == pytest.approx(expected, abs=1e-9)
    away = path._replace(start=Pose(path.start.position + [0.0, 0.0, 0.2], path.start.rotation),
                         way=np.zeros(3), turn=np.zeros(3))
    assert away.deviations(robot, task.start[None], lever)[0] == pytest.approx(0.2)


def test_every_start_is_a_motion_from_where_the_arm_is():
    robot = make_panda()
    task = Task(3, np.array([0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.7]),
                np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0]), ())
    own = np.tile(task.start, (round(10.0 / DT) + 1, 1))
    begun = list(starts(robot, task, own))
    assert len({len(motion) for motion in begun}) == 1
    for motion in begun:
        np.testing.assert_allclose(motion[0], task.start)
    tips = [robot.kinematics(motion[-1]).tip_position for motion in begun]
    # One of them follows the twist to its end.
    whole = 0.05 * DURATION / 2.0
    assert min(np.linalg.norm(tip - tips[0] - [whole, 0, 0]) for tip in tips) < 2e-3


def test_medians_leave_out_what_has_no_computed_motion():
    def of(largest, last=0.0):
        return Deviation(largest, last, 0.01, 0.01, 0.0)

    result = summarise([
        Comparison(1, 'position', of(0.2), of(0.1), ()),
        Comparison(2, 'position', of(0.3, 0.05), of(0.1), ('x',)),
        # On its path, where nothing was asked for: as good as can be.
        Comparison(3, 'position', of(1e-4), of(1e-6), ()),
        Comparison(4, 'position', of(0.9), None, ())])
    assert result['count'] == 4 and result['solved'] == 3 and result['back'] == 3
    assert result['computed_median'] == 0.1 and result['planner_median'] == 0.2
    assert result['ratio_median'] == pytest.approx(2.0)
    assert [scene['ratio'] for scene in result['scenes'][:3]] == pytest.approx([2.0, 3.0, 1.0])
    assert result['scenes'][3]['ratio'] is None
