"""The links after a motion, from the screws before it, against the kinematics there."""

from __future__ import annotations

from conftest import random_postures
import numpy as np

from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.links_after import links_after


def test_links_after_a_motion_are_those_of_the_kinematics_there(robot):
    random = np.random.default_rng(5)
    for scale in (1e-7, 0.05, 1.0):
        for q in random_postures(robot, 20):
            motion = random.uniform(-scale, scale, robot.n)
            here, there = robot.kinematics(q), robot.kinematics(q + motion)
            found = links_after(Links(
                here.segment_start, here.segment_end, here.joint_screws,
                robot.supports.copy(), robot.chain.parents), motion)
            np.testing.assert_allclose(found.start, there.segment_start, atol=1e-12)
            np.testing.assert_allclose(found.end, there.segment_end, atol=1e-12)
            np.testing.assert_allclose(found.joint_screws, there.joint_screws, atol=1e-12)
