"""Ranges narrower than the URDF's, and an arm that is found beyond one."""

from __future__ import annotations

from closed_loop import drive, DT
from conftest import make_panda, make_planar, PANDA_READY
import numpy as np
import pytest
from target_run import moved, Run, tip

from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.target.progress import TargetState

MARGIN = PlannerParameters().limits_position_margin


def test_a_twist_leads_no_joint_beyond_a_range_that_a_parameter_narrows():
    ranges = {'panda_joint4': (-2.4, -2.3), 'panda_joint6': (1.5, 1.65)}
    robot = make_panda(position_limits=[f'{n}={a}..{b}' for n, (a, b) in ranges.items()])
    for direction in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1)):
        twist = np.concatenate((0.2 * np.array(direction, dtype=float), np.zeros(3)))
        postures, _ = drive(Planner(robot, PlannerParameters()), PANDA_READY, twist, seconds=2.0)
        assert np.abs(postures[-1] - PANDA_READY).max() > 0.02
        for name, (low, high) in ranges.items():
            q = postures[:, robot.joint_names.index(name)]
            assert low + MARGIN / 2.0 <= q.min() and q.max() <= high - MARGIN / 2.0


def test_a_range_stops_a_continuous_joint():
    robot = make_planar(position_limits={'joint3': (-0.6, 0.5)})
    start = np.array([0.3, 0.5, 0.4])
    free, bound = (drive(Planner(arm, PlannerParameters()), start,
                         np.array([-0.2, 0.1, 0, 0, 0, 0]), seconds=4.0)[0][:, 2]
                   for arm in (make_planar(), robot))
    assert free.max() > 0.55 and bound.max() <= 0.5 - MARGIN / 2.0


@pytest.mark.first_alone
@pytest.mark.parametrize('beyond', [0.005, 0.3])
@pytest.mark.parametrize('twist', [
    (0.1, 0, 0, 0, 0, 0), (-0.1, 0, 0, 0, 0, 0), (0, 0, 0.1, 0, 0, 0), (0, 0, -0.1, 0, 0, 0),
    (0, 0.1, 0, 0, 0, 0.3), (0, 0, 0, 0.3, -0.3, 0)])
def test_a_joint_found_beyond_its_range_moves_inwards_only(beyond, twist):
    """It need not come in at once; what counts is that it never gets worse."""
    robot = make_panda(position_limits=[f'panda_joint4={-2.356 + beyond}..-0.1'])
    postures, results = drive(Planner(robot, PlannerParameters()), PANDA_READY,
                              np.array(twist, dtype=float), seconds=3.0)
    q = postures[:, 3]
    inside = q > -2.356 + beyond
    assert (np.diff(q)[~inside[:-1]] >= -1e-12).all()
    # Once it is in, it stays in.
    assert not (np.diff(inside.astype(int)) < 0).any()
    change = np.diff([result.dq for result in results], axis=0) / DT
    assert (np.abs(change) <= robot.acceleration_max * (1.0 + 1e-6)).all()
    # Where the tip cannot go without that joint, the reason names it.
    if np.abs(postures[-1] - PANDA_READY).max() < 0.01:
        assert 'panda_joint4' in results[-1].reason


def test_targets_are_reached_from_beyond_a_range():
    robot = make_panda(position_limits=['panda_joint4=-2.1..-0.1'])
    goal = PANDA_READY.copy()
    goal[3] = -1.9
    for target in (goal, moved(tip(robot, goal), (0.02, 0.05, 0.02, 0, 0, 0))):
        run = Run(robot)
        assert run.to(target, 8.0).state is TargetState.REACHED
        q = np.array(run.positions)[:, 3]
        assert (np.diff(q)[q[:-1] < -2.1] >= -1e-12).all() and q[-1] >= -2.1
