"""The views of Pinocchio's memory show what copies show."""

from __future__ import annotations

from conftest import random_postures
import numpy as np

from redundant_planner.core.robot import joint_frames
from redundant_planner.core.robot.joint_frames import JointFrames


def test_views_and_copies_show_the_same(robot, monkeypatch):
    views = JointFrames(robot.model)
    monkeypatch.setattr(joint_frames, '_placement_views', lambda data: None)
    copies = JointFrames(robot.model)
    assert views._views is not None and copies._views is None
    for q in random_postures(robot, 5):
        for seen, copied in zip(views.at(q), copies.at(q)):
            np.testing.assert_array_equal(seen, copied)
