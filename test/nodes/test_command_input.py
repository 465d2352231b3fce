"""Commands and their ages, on clocks that the test holds."""

from __future__ import annotations

from geometry_msgs.msg import TwistStamped
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rclpy.time import Time

from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.nodes.command_input import CommandInput
from redundant_planner.nodes.messages import preview_to_message, twist_to_message

TIPS = Poses.of(Pose(np.zeros(3), np.eye(3)))
TWIST = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.2])


def serialised(message):
    return bytes(serialize_message(message))


class Clocks:
    """A loop clock, a ROS clock, and what was said."""

    def __init__(self):
        self.loop, self.ros, self.said = 100.0, 5000.0, []
        self.input = CommandInput(
            {'base_link': 'base', 'tool0': 'tool'}, 'base', lambda: self.loop, lambda: self.ros,
            self.said.append)

    def send(self, stamp=None, frame=''):
        message = TwistStamped(twist=twist_to_message(TWIST))
        if stamp is not None:
            message.header.stamp = Time(nanoseconds=round(stamp * 1e9)).to_msg()
        message.header.frame_id = frame
        self.input.on_twist_stamped(serialised(message))

    @property
    def moving(self):
        return self.input.moves(0.1)


@pytest.fixture
def clocks():
    return Clocks()


def test_a_command_ages_by_receipt(clocks):
    clocks.input.on_twist(serialised(twist_to_message(TWIST)))
    np.testing.assert_array_equal(clocks.input.twist(0.1, lambda: TIPS), TWIST)
    clocks.loop += 0.09
    assert clocks.moving
    clocks.loop += 0.02
    assert not clocks.moving


def test_no_stamp_counts_as_now_and_is_mentioned_once(clocks):
    clocks.send()
    assert clocks.moving
    clocks.send()
    assert len(clocks.said) == 1 and 'no stamp' in clocks.said[0]


def test_a_stamp_makes_a_command_older(clocks):
    clocks.send(stamp=clocks.ros - 0.06)
    assert clocks.moving
    clocks.loop += 0.05
    assert not clocks.moving and not clocks.said


def test_a_stale_stamp_is_refused_with_its_age(clocks):
    clocks.send(stamp=clocks.ros - 0.25)
    assert not clocks.moving and '0.250 s old' in clocks.said[0]


@pytest.mark.parametrize('offset', [-1000.0, 1000.0])
def test_clocks_that_disagree_cannot_move_the_arm(clocks, offset):
    clocks.send(stamp=clocks.ros + offset)
    assert not clocks.moving and clocks.said
    assert ('future' in clocks.said[0]) == (offset > 0.0)


def test_a_stamp_a_little_ahead_does_not_live_longer(clocks):
    clocks.send(stamp=clocks.ros + 0.05)
    assert clocks.moving
    clocks.loop += 0.11
    assert not clocks.moving


def test_a_clock_that_is_set_back_makes_a_command_old(clocks):
    clocks.send()
    clocks.loop -= 10.0
    assert not clocks.moving and clocks.input.ahead(0.1) is None


def test_frames_are_the_bases_or_the_tips(clocks):
    clocks.send(frame='tool0')
    assert clocks.moving and clocks.input.frame == 'tool'
    clocks.send(frame='base_link')
    assert clocks.input.frame == 'base'
    clocks.input.forget()
    clocks.send(frame='moon')
    assert not clocks.moving and "frame 'moon'" in clocks.said[-1]


def test_nothing_remains_after_forgetting(clocks):
    clocks.send()
    clocks.input.forget()
    assert not clocks.moving and clocks.input.ahead(0.1) is None


def test_a_preview_outlives_a_stop_but_not_a_jump_of_the_clock(clocks):
    preview = Preview(np.array([0.0, 2.0]), np.tile(TWIST, (2, 1)))
    clocks.input.on_preview(serialised(preview_to_message(preview)))
    assert clocks.input.ahead(0.1) is None  # nothing is commanded
    clocks.loop += 0.5
    clocks.send()
    np.testing.assert_allclose(clocks.input.ahead(0.1)(np.array([0.0, 1.4, 1.6, 2.0])),
                               [TWIST, 0.5 * TWIST, np.zeros(6)], atol=1e-12)
    clocks.input.forget()
    assert clocks.input.ahead(0.1) is None
    clocks.send()
    assert clocks.input.ahead(0.1) is not None
    clocks.input.forget_preview()
    assert clocks.input.ahead(0.1) is None


@pytest.mark.parametrize(('seconds', 'used'), [
    (-1.9, True), (-2.1, False), (5.0, True), (1e6, False), (-1e9, False)])
def test_a_preview_of_another_clock_counts_but_is_not_looked_at(clocks, seconds, used):
    message = preview_to_message(Preview(np.array([0.0, 2.0]), np.tile(TWIST, (2, 1))))
    clocks.ros = 1.5e9
    message.header.stamp = Time(nanoseconds=round((clocks.ros + seconds) * 1e9)).to_msg()
    clocks.input.on_preview(serialised(message))
    clocks.send()
    assert clocks.input.previews == 1 and used != any('same clock' in s for s in clocks.said)
    assert (clocks.input.ahead(0.1) is not None) == used


def test_bytes_that_are_no_message_change_nothing(clocks):
    clocks.send()
    for take in (clocks.input.on_twist, clocks.input.on_twist_stamped, clocks.input.on_preview):
        for raw in (b'', b'\0\1\0\0', b'nonsense' * 9):
            clocks.said.clear()
            take(raw)
            assert 'ignored: ' in clocks.said[0]
    np.testing.assert_array_equal(clocks.input.twist(0.1, lambda: TIPS), TWIST)
    assert clocks.input.previews == 0
