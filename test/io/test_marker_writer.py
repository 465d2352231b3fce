"""The bytes of a CUBE_LIST are those that ROS writes."""

from __future__ import annotations

from geometry_msgs.msg import Point
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.io.marker_writer import cube_list_bytes


@pytest.mark.parametrize('frame', ['', 'a', 'base', 'panda_link0', 'größe'])
@pytest.mark.parametrize('count', [0, 1, 7])
def test_the_bytes_are_the_message_that_ros_reads(frame, count):
    centers = np.random.default_rng(count).normal(size=(count, 3))
    expected = Marker(ns='cloud', id=0, type=Marker.CUBE_LIST,
                      action=Marker.ADD if count else Marker.DELETE)
    expected.header.frame_id = frame
    expected.header.stamp.sec, expected.header.stamp.nanosec = 1_700_000_000, 123_456_789
    expected.pose.orientation.w = 1.0
    expected.scale.x = expected.scale.y = expected.scale.z = 0.025
    expected.points = [Point(x=x, y=y, z=z) for x, y, z in centers.tolist()]
    raw = cube_list_bytes('cloud', frame, 1_700_000_000_123_456_789, 0.025, centers)
    found = deserialize_message(raw, MarkerArray)
    expected.color = found.markers[0].color
    assert found.markers[0].color.a > 0.5
    assert found == MarkerArray(markers=[expected])
