"""What ~/target calls a target is read again as the target that was meant."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.nodes.target_text import goal_of_text, text_of_target, text_of_tip

# A joint's name may have anything in it but spaces.
NAMES = ('a', 'b=c')
POSE = Pose(np.array([0.1, -0.2, 0.3]), np.asarray(pin.rpy.rpyToMatrix(0.4, -0.5, 2.0)))


def test_poses_and_joint_positions_are_read_as_they_were_written():
    found = goal_of_text(text_of_target(POSE, NAMES), NAMES)
    np.testing.assert_allclose(found.position, POSE.position, atol=1e-6)
    np.testing.assert_allclose(found.rotation, POSE.rotation, atol=5e-6)
    text = text_of_target(np.array([0.25, -1.5]), NAMES)
    np.testing.assert_array_equal(goal_of_text(text, NAMES), [0.25, -1.5])
    np.testing.assert_array_equal(goal_of_text(text, NAMES[::-1]), [-1.5, 0.25])
    assert goal_of_text(text, ('a', 'd')) is None


def test_each_of_several_tips_has_a_part():
    text = text_of_target({'left': POSE, 'middle': None, 'right': POSE}, NAMES)
    assert goal_of_text(text, NAMES) is None
    assert text_of_tip(text, 'middle') == ''
    for tip in ('left', 'right'):
        assert text_of_tip(text, tip) == text_of_target(POSE, NAMES)


@pytest.mark.parametrize('points', [np.array([[0.0, 0.0], [0.25, -1.5]]), (POSE, POSE)],
                         ids=['joints', 'poses'])
def test_a_chunk_is_no_goal_and_neither_is_anything_else(points):
    text = text_of_target(Chunk(np.array([0.0, 1.0]), points), NAMES)
    assert text.startswith('2 points within 1.000 s')
    for other in (text, '', '1 2 3', '1 2 3 0 0 0 x', 'a=x b=c=0'):
        assert goal_of_text(other, NAMES) is None
