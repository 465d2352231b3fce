"""The benchmark of targets: the planner and other libraries run alike and are judged alike."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
import sys

from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.target.progress import TargetState

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark import targets
from benchmark.peers import missing
from benchmark.target_problems import Problem
from benchmark.targets import DT, judged, planned, Ride, servoed

ROBOT, PARAMETERS = make_panda(), PlannerParameters()
GOAL = PANDA_READY + np.array([0.9, 0.1, 0.0, -0.1, 0.0, 0.1, 0.0])
TIP = ROBOT.kinematics(GOAL).tip_position
FAR = Obstacle('far', np.array([-0.6, 0.0, 0.2]), np.full(3, 0.05))
MINK = pytest.mark.skipif(bool(missing('mink')), reason=missing('mink'))


@pytest.mark.long
@pytest.mark.parametrize('method', ['planner', pytest.param('mink', marks=MINK)])
def test_a_goal_in_the_open_is_reached_and_one_inside_something_is_not(method):
    at_it = Obstacle('at it', TIP, np.full(3, 0.05))
    for obstacle, reached in ((FAR, True), (at_it, False)):
        problem = Problem(PANDA_READY, GOAL, (obstacle,))
        ride = (planned(ROBOT, problem, PARAMETERS) if method == 'planner' else
                servoed(ROBOT, problem, method))
        outcome = judged(ROBOT, problem, PARAMETERS, 0, ride)
        assert (outcome.state == TargetState.REACHED.value) == reached
        assert outcome.clearance > 0.0
        np.testing.assert_allclose(np.diff(ride.postures, axis=0), DT * ride.velocities,
                                   atol=1e-12)
        if reached:
            assert outcome.distance < 1e-3 and outcome.path > 0.1
        else:
            assert outcome.distance > 0.01


@MINK
def test_another_library_sees_what_moves_where_it_is():
    """A ball that lies at the goal, and goes away: where it was at first nothing is left."""
    size = np.full(3, 0.06)
    ball = Obstacle('ball', TIP, size, velocity=np.array([0.0, 0.3, 0.1]))
    problem = Problem(PANDA_READY, GOAL, (FAR,), (ball,))
    ride = servoed(ROBOT, problem, 'mink')
    assert ride.state is TargetState.REACHED
    # The run goes on until the ball is past.
    assert len(ride.velocities) * DT >= 3.0


def test_a_ride_is_judged_by_what_it_did():
    problem = Problem(PANDA_READY, GOAL, (Obstacle('in the way', TIP, np.full(3, 0.03)),))
    ticks = 500
    postures = PANDA_READY + np.linspace(0.0, 1.0, ticks + 1)[:, None] * (GOAL - PANDA_READY)
    ride = Ride(postures, np.diff(postures, axis=0) / DT, TargetState.REACHED, 0.4)
    outcome = judged(ROBOT, problem, PARAMETERS, 7, ride)
    assert outcome.seed == 7 and outcome.distance < 1e-9
    # It ends with its hand in the ball, and begins with a jump of the velocity.
    assert outcome.clearance < 0.0 and outcome.violation > 0.0
    assert outcome.path == pytest.approx(np.linalg.norm(GOAL - PANDA_READY))
    assert outcome.seconds == pytest.approx(ticks * DT - 0.4)


def test_the_length_of_a_detour_is_compared_with_the_shortest_way():
    pytest.importorskip('casadi')
    from benchmark.problem_sets.problem import Problem as StaticProblem
    from benchmark.problem_sets.shortest import path_ratio
    aside = PANDA_READY + np.array([-0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    straight, detour = (
        np.vstack([np.linspace(a, b, 101) for a, b in pairwise(corners)])
        for corners in ((PANDA_READY, GOAL), (PANDA_READY, aside, GOAL)))
    problem = StaticProblem('p', 'f', (FAR,), PANDA_READY, GOAL)
    long, short = (path_ratio(ROBOT, problem, path, 0.01) for path in (detour, straight))
    assert short >= 1.0 - 1e-3 and long > 1.5 * short


def test_the_optimum_knows_nothing_that_moves(capsys):
    with pytest.raises(SystemExit):
        targets.main(['--optimum', '--moving'])
    assert '--optimum knows obstacles that stand still' in capsys.readouterr().err
