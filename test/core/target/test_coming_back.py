"""After an evasion the tip comes back to its path, by a free way where it is stuck otherwise."""

from __future__ import annotations

from conftest import PANDA_READY
import numpy as np
import pytest
from target_run import AT_REST, DT, EMPTY, PANDA, tip

from benchmark.sweeps import run as sweep
from redundant_planner.core.constants import robot_constants
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Poses
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.target.coming_back import ComingBack


@pytest.mark.first_alone
@pytest.mark.parametrize('seed', [91076, 91062])
def test_an_arm_that_was_driven_into_its_limits_arrives_all_the_same(seed):
    """Two balls drive it into a corner that no straight way leads out of."""
    found = sweep(PANDA, seed, PlannerParameters())
    assert found.seconds < 14.0 and found.distance < 1e-3
    assert found.clearance > 0.0 and found.violation == 0.0
    assert found.off > 0.1  # else nothing was evaded


def coming_back(away, nearer, seconds, *, lost=False, goes=0.0):
    """Leave a path by `away` [m], come nearer at some speed [m/s]; what is asked for, and said.

    The tip goes on a free way at a speed `goes` [m/s].
    """
    back = ComingBack(PANDA, robot_constants(PANDA, PlannerParameters()))
    home, followed = tip(PANDA, PANDA_READY), np.zeros(6)
    asked = gave_up = False
    for i in range(round(seconds / DT)):
        off = max(away - nearer * i * DT, 0.0)
        there = se3.displaced(home, np.array([0.0, off, 0.0, 0.0, 0.0, 0.0]), False)
        followed[0] = 0.0 if back.target is None else goes
        gave_up = back.note(Poses.of(home), Poses.of(there), followed, DT, leaving=i == 0,
                            lost=lost) or gave_up
        asked = asked or back.target is not None
    return asked, gave_up, back


def test_a_free_way_is_asked_for_only_where_the_tip_does_not_come_nearer():
    asked, _, back = coming_back(0.1, 0.05, 4.0)
    assert not asked and back.target is None
    asked, _, back = coming_back(0.1, 0.0, 4.0)
    assert asked
    np.testing.assert_allclose(back.target.position, tip(PANDA, PANDA_READY).position)


def test_where_there_is_no_way_or_it_stands_still_the_path_goes_on_from_there():
    for way in ({'lost': True, 'goes': 0.1}, {'lost': False, 'goes': 0.0}):
        _, gave_up, back = coming_back(0.1, 0.0, 7.0, **way)
        assert gave_up and back.target is None
    assert not coming_back(0.1, 0.0, 7.0, goes=0.1)[1]


def test_after_a_reset_no_arm_comes_back_to_what_it_evaded():
    """A ball pushes the tip off its path; then the arm is found elsewhere, and stays there."""
    planner, q, still = Planner(PANDA, PlannerParameters()), np.array(PANDA_READY), np.zeros(6)
    home = tip(PANDA, PANDA_READY).position
    for i in range(round(4.0 / DT)):
        ball = Obstacle('ball', home + (0.0, 0.5 - 0.25 * i * DT, 0.0), np.full(3, 0.05),
                        velocity=(0.0, -0.25, 0.0))
        result = planner.step(q, still, Scene.of([ball]), DT)
        q = q + DT * result.dq
        if np.linalg.norm(result.path_error[:3]) > 0.03:
            break
    assert result.stage is Stage.YIELDING
    planner.reset()
    elsewhere = PANDA_READY + 0.2
    for _ in range(round(2.0 / DT)):
        result = planner.step(elsewhere, still, EMPTY, DT)
        assert not result.dq.any() and 'comes back' not in result.reason


def test_an_arm_on_its_path_is_left_alone():
    planner, q = Planner(PANDA, PlannerParameters()), np.array(PANDA_READY)
    for _ in range(250):
        result = planner.step(q, np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0]), EMPTY, DT)
        assert 'comes back' not in result.reason
        q = q + DT * result.dq
    assert np.abs(result.dq).max() > AT_REST
