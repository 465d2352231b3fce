"""Serialised previews as arrays, against rclpy's own reading of them."""

from __future__ import annotations

import contextlib
import time

from geometry_msgs.msg import Transform, Twist
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rclpy.serialization import serialize_message

from redundant_planner.core.errors import StateError
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.io.preview_reader import MOST_POINTS, read_preview
from redundant_planner.nodes.messages import preview_to_message


def serialised(message):
    return bytes(serialize_message(message))


def preview_message(points, seed=0):
    random = np.random.default_rng(seed)
    return preview_to_message(Preview(
        np.sort(random.uniform(-1.0, 9.0, points)), random.normal(size=(points, 6))))


@settings(deadline=None)
@given(st.data())
def test_any_preview_reads_as_rclpy_reads_it(data):
    """Names, transforms and accelerations, which do not count, change where the rest lies."""
    message = preview_message(data.draw(st.integers(1, 6)), data.draw(st.integers(0, 9)))
    message.header.frame_id = data.draw(st.sampled_from(['', 'base', 'a frame']))
    message.header.stamp.sec = data.draw(st.integers(-2**31, 2**31 - 1))
    message.joint_names = data.draw(st.lists(st.sampled_from(['', 'tip', 'joint']), max_size=3))
    for point in message.points:
        point.transforms = [Transform()] * data.draw(st.integers(0, 2))
        point.accelerations = [Twist()] * data.draw(st.integers(0, 2))
    stamp, preview = read_preview(serialised(message))
    assert stamp == message.header.stamp.sec
    np.testing.assert_allclose(preview.times, [
        p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])
    for twist, point in zip(preview.twists, message.points):
        v = point.velocities[0]
        assert twist.tolist() == [v.linear.x, v.linear.y, v.linear.z, v.angular.x, v.angular.y,
                                  v.angular.z]


def test_a_bad_preview_is_refused_with_the_reason():
    message = preview_message(3)
    message.points[1].velocities = []
    with pytest.raises(StateError, match='point 1 of the preview has 0 velocities'):
        read_preview(serialised(message))
    message.points[1].velocities = [Twist(), Twist()]
    with pytest.raises(StateError, match='point 1 of the preview has 2 velocities'):
        read_preview(serialised(message))
    message = preview_message(3)
    for bad in (np.nan, np.inf, 1e308):
        message.points[2].velocities[0].angular.z = bad
        with pytest.raises(StateError, match=r'twist of point 2 .* must be finite, up to 1000'):
            read_preview(serialised(message))
    message = preview_message(3)
    message.points[0].time_from_start.sec = 2**31 - 1
    with pytest.raises(StateError, match='times of the preview go backwards'):
        read_preview(serialised(message))
    message.points = []
    with pytest.raises(StateError, match='has 0 times'):
        read_preview(serialised(message))


def test_too_many_points_are_refused_whole():
    raw = serialised(preview_message(1))
    at = raw.index((1).to_bytes(4, 'little'), 20)
    with pytest.raises(StateError, match=f'has {MOST_POINTS + 1} points; up to {MOST_POINTS}'):
        read_preview(raw[:at] + (MOST_POINTS + 1).to_bytes(4, 'little') + raw[at + 4:])


def test_what_is_cut_or_lies_about_its_length_is_refused_at_once():
    message = preview_message(3)
    message.joint_names = ['tip']
    raw = serialised(message)
    for length in range(len(raw)):
        with pytest.raises(StateError):
            read_preview(raw[:length])
    begin = time.process_time()
    for at in range(0, len(raw) - 3, 4):
        for count in (2**31, 2**32 - 1, MOST_POINTS):
            with contextlib.suppress(StateError):
                read_preview(raw[:at] + count.to_bytes(4, 'little') + raw[at + 4:])
    assert time.process_time() - begin < 2.0
