"""The benchmark of chunks: trajectories are what they are said to be, and runs are judged."""

from __future__ import annotations

from pathlib import Path
import sys

from conftest import make_panda
import numpy as np
import pytest

from redundant_planner.core.parameters import PlannerParameters

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark.bodies import capsules_of
from benchmark.chunks import along_trajectory, by_policy, chunks_of, curve_of, DT, trajectory_of
from benchmark.closest_approach import Motion

ROBOT = make_panda()


@pytest.mark.parametrize('hits', [False, True])
def test_trajectories_are_within_all_limits_and_hit_something_or_nothing(hits):
    chunk, obstacles = trajectory_of(ROBOT, 3, hits)
    curve, t = curve_of(chunk), np.linspace(0.0, chunk.times[-1], 2000)
    assert np.abs(curve(t[[0, -1]], 1)).max() < 1e-9
    assert (np.abs(curve(t, 1)) <= ROBOT.velocity_max).all()
    assert (np.abs(curve(t, 2)) <= 1.2 * ROBOT.acceleration_max).all()
    speeds = [np.linalg.norm((ROBOT.kinematics(q).tip_jacobian @ dq)[:3])
              for q, dq in zip(curve(t[::20]), curve(t[::20], 1))]
    assert max(speeds) <= 1.02 * PlannerParameters().twist_speeds[0]
    distance = Motion.through(capsules_of(ROBOT), curve(t)).to_obstacles(obstacles, DT).distance
    assert distance < 0.0 if hits else distance > 0.0299
    assert len(obstacles) == 4


def test_a_free_trajectory_is_followed_and_one_that_hits_is_held_up():
    free, hits = (along_trajectory(ROBOT, 3, hits) for hits in (False, True))
    assert free['state'] == 'reached' and free['off_rad'] < 2e-3 and free['time_ratio'] < 1.05
    assert hits['state'] == 'blocked' and hits['clearance_m'] > 0.005 and hits['reason']
    assert free['violation'] == hits['violation'] == 0.0


@pytest.mark.first_alone
@pytest.mark.parametrize('tip', [False, True])
def test_chunks_of_a_policy_disagree_and_the_arm_does_not_shake(tip):
    policy = chunks_of(ROBOT, np.random.default_rng(1), tip)
    one, other = policy(0.0), policy(0.0)
    first, second = ((chunk.points[0].position if tip else chunk.points[0])
                     for chunk in (one, other))
    assert 1e-3 < np.abs(first - second).max() < 0.2
    outcome = by_policy(ROBOT, 3, tip)
    assert outcome['violation'] == 0.0 and outcome['reversals_per_10_s'] <= 20
