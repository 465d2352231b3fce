"""An arm keeps off its own base, and obstacles may touch that base as they like."""

from __future__ import annotations

import itertools

from conftest import EXAMPLE_ROBOTS
import numpy as np
import pytest
from target_run import DT, Run

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from redundant_planner import Robot
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.contacts import AllowedContacts, contacts
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot import model
from redundant_planner.core.target.progress import TargetState

TIP = 'j2s6s200_end_effector'
JACO = Robot.from_urdf(EXAMPLE_ROBOTS / 'kinova_description' / 'robots' / 'kinova.urdf', TIP)
# Between these the straight motion of the joints leads through the base.
ONE = np.array([0.94, 1.76, 5.59, 1.83, 1.28, -1.68])
OTHER = np.array([0.39, 1.85, 5.67, -2.25, 5.32, 0.87])
# It stands around the foot of the arm, as tables do.
TABLE = Obstacle.box('table', (0.0, 0.0, -0.05), (1.2, 1.2, 0.11))


def to_itself(run):
    """How near the arm's links, its base among them, came to each other [m]."""
    return Motion.through(capsules_of(JACO), np.array(run.positions)).to_itself().distance


def test_the_base_has_a_shape_that_no_joint_moves():
    assert [c.name for c in itertools.compress(JACO.capsules, ~JACO.moved)] == [
        'j2s6s200_link_base']


@pytest.mark.first_alone
def test_a_target_beyond_the_base_is_reached_around_it():
    run = Run(JACO, ONE)
    assert run.to(OTHER, 12.0).state is TargetState.REACHED
    assert to_itself(run) > 0.0
    run.assert_within_limits()
    unprotected = Run(model.Robot(
        JACO.urdf, TIP, capsules=list(itertools.compress(JACO.capsules, JACO.moved))), ONE)
    unprotected.to(OTHER, 12.0)
    assert to_itself(unprotected) < -0.01


@pytest.mark.first_alone
@pytest.mark.parametrize('count', [1, 60])
def test_what_touches_the_base_stops_nothing(count):
    """Also among so many obstacles that a tick chooses from them."""
    far = [Obstacle(f'ball {i}', (2.0 + 0.2 * i, 1.0, 0.5), np.full(3, 0.05))
           for i in range(count - 1)]
    scene, start = Scene.of([TABLE, *far]), JACO.ready
    arm = JACO.kinematics(start)
    maps = inflated_obstacles(scene, [c.radius for c in JACO.capsules], moved=JACO.moved)
    pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
    assert np.isinf(pairs.distance[~JACO.moved]).all()
    assert np.isfinite(pairs.distance[JACO.moved]).all()
    everywhere = inflated_obstacles(scene, [c.radius for c in JACO.capsules])
    touching = link_clearance(everywhere, arm.segment_start, arm.segment_end)
    assert touching.distance[~JACO.moved].min() < 0.0
    assert contacts(JACO, arm, scene, AllowedContacts((), JACO)) == ()
    run = Run(JACO, start)
    twist = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    for _ in range(250):
        result = run.planner.step(run.q, twist, scene, DT)
        run.q = run.q + DT * result.dq
    assert result.reason == '' and result.nearest.link != 'j2s6s200_link_base'
    moved = JACO.kinematics(run.q).tip_position - arm.tip_position
    np.testing.assert_allclose(moved, (0.0, 0.05, 0.0), atol=4e-3)
