"""Targets of tips that a bag holds are the same objects from tick to tick, as in the planner."""

from __future__ import annotations

import numpy as np

from redundant_planner.core.robot.se3 import Pose
from redundant_planner.io.latest_chunks import LatestChunks
from redundant_planner.io.recorded_target import RecordedTarget


def targets():
    return {'left': Pose(np.array([0.1, 0.2, 0.3]), np.eye(3)), 'right': None}


def test_targets_stay_the_same_object_until_something_else_commands():
    """A planner keeps tips without a target where they were due when its object came."""
    chunks = LatestChunks()
    first = chunks.recorded(RecordedTarget(targets()))
    assert chunks.recorded(RecordedTarget(targets())) is first
    assert chunks.recorded(RecordedTarget(None)) is None
    again = chunks.recorded(RecordedTarget(targets()))
    assert again is not first and again.keys() == first.keys()
