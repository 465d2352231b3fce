"""How links' points move, against differences of the kinematics along a steady motion."""

from __future__ import annotations

from conftest import random_postures
import numpy as np

from redundant_planner.core.kernels import compiled, Matrix, Vector
from redundant_planner.core.robot.kinematics import Links
from redundant_planner.core.robot.link_motions import acceleration_of, link_motions
from redundant_planner.core.robot.se3 import place

STEP = 1e-4  # [s]


@compiled
def accelerations_of_starts(links: Links, dq: Vector) -> Matrix:
    """Return ẍ (c, 3) of the first end of every link."""
    motions, found = link_motions(links, dq), np.empty((len(links.start), 3))
    for link in range(len(found)):
        found[link] = acceleration_of(motions, link, place(links.start, link))
    return found


def test_points_are_accelerated_as_differences_say(robot):
    random = np.random.default_rng(6)
    for q in random_postures(robot, 20):
        dq = random.uniform(-1.0, 1.0, robot.n)
        arm = robot.kinematics(q)
        links = Links(arm.segment_start, arm.segment_end, arm.joint_screws,
                      robot.supports.copy(), robot.chain.parents)
        before, after = (robot.kinematics(q + way * STEP * dq).segment_start for way in (-1, 1))
        expected = (after - 2.0 * arm.segment_start + before) / STEP ** 2
        np.testing.assert_allclose(
            accelerations_of_starts(links, dq), expected, atol=1e-6)
        twist = link_motions(links, dq).twist
        velocity = twist[:, :3] + np.cross(twist[:, 3:], arm.segment_start)
        np.testing.assert_allclose(velocity, (after - before) / (2.0 * STEP), atol=1e-7)
