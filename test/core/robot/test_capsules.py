"""Link shapes, how fast they can move and which can collide."""

from __future__ import annotations

from conftest import random_postures
import numpy as np
import pytest

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.robot.capsules import Capsule


def test_lever_arm_bounds_bound_the_speed_of_every_capsule_end(robot):
    random = np.random.default_rng(3)
    for q in random_postures(robot, 50):
        arm = robot.kinematics(q)
        dq = random.normal(size=robot.n)
        for i in range(len(robot.capsules)):
            for point in (arm.segment_start[i], arm.segment_end[i]):
                moves = arm.joint_screws[:3] + np.cross(arm.joint_screws[3:].T, point).T
                speed = np.linalg.norm(moves @ (dq * robot.supports[i]))
                assert speed <= np.abs(dq) @ robot.lever_arm_bounds[i] + 1e-12


@pytest.mark.parametrize(('start', 'radius'), [
    ([0.0, 0.0], 0.1), ([0.0, 0.0, np.nan], 0.1), ([0.0, 0.0, 0.0], -0.1),
    ([0.0, 0.0, 1e300], 0.1), ('abc', 0.1), (None, 0.1), ([[0.0] * 9] * 9, 0.1), ({}, 0.1),
    ([0.0, 0.0, 0.0], 'thick'), ([0.0, 0.0, 0.0], [0.1]), ([0.0, 0.0, 0.0], 1e300)])
def test_bad_capsules_are_refused(start, radius):
    with pytest.raises(ObstacleError, match="capsule 'arm'"):
        Capsule('arm', 'link1', start, np.ones(3), radius)


def test_neighbours_and_what_always_touches_are_left_out(panda):
    names = [c.name for c in panda.capsules]
    pairs = {frozenset((names[i], names[j])) for i, j in panda.self_pairs}
    assert frozenset(('link1', 'hand')) in pairs
    assert frozenset(('link3', 'hand')) in pairs
    assert frozenset(('link1', 'link2')) not in pairs
    assert frozenset(('hand', 'fingers')) not in pairs
