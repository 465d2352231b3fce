"""The tip poses due along a path."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.core.horizon.poses_ahead import node_times, poses_ahead
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose


@pytest.mark.parametrize('in_tool', [False, True])
def test_poses_ahead_are_those_of_the_twist_integrated(in_tool):
    random = np.random.default_rng(0)
    start = Pose(random.normal(size=3), np.eye(3))
    twist = random.normal(size=6)
    times = node_times(2.0, 5)
    poses = poses_ahead(start, np.tile(twist, (5, 1)), times, in_tool)
    for i, time in enumerate(times[1:]):
        expected = se3.integrate(start, twist, time, in_tool)
        np.testing.assert_allclose(poses.position[i], expected.position, atol=1e-12)
        np.testing.assert_allclose(poses.rotation[i], expected.rotation, atol=1e-12)
