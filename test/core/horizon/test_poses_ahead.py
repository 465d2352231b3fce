"""The tip poses due along a path."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.core.horizon.poses_ahead import node_times, poses_ahead
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose, Poses


@pytest.mark.parametrize('in_tool', [False, True])
def test_poses_ahead_are_those_of_the_twist_integrated(in_tool):
    random = np.random.default_rng(0)
    starts = Poses.of(*(Pose(random.normal(size=3), np.eye(3)) for _ in range(2)))
    twists = random.normal(size=12)
    times = node_times(2.0, 5)
    poses = poses_ahead(starts, np.tile(twists, (5, 1)), times, in_tool)
    for i, time in enumerate(times[1:]):
        for t, (start, twist) in enumerate(zip(starts.each, twists.reshape(2, 6))):
            expected, found = se3.integrate(start, twist, time, in_tool), Poses(
                *(part.reshape(5, 2, *part.shape[1:])[i] for part in poses))
            np.testing.assert_allclose(found.position[t], expected.position, atol=1e-12)
            np.testing.assert_allclose(found.rotation[t], expected.rotation, atol=1e-12)
