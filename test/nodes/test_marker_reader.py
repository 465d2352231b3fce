"""Serialised MarkerArrays as arrays, against rclpy's own reading of them."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray, UVCoordinate

from redundant_planner.core.errors import StateError
from redundant_planner.nodes.marker_reader import MarkerReader, read_markers

# ROS strings end at the first zero character.
NAMES = st.text(st.characters(min_codepoint=1, codec='utf-8'), max_size=9)
NUMBERS = st.floats(width=64, allow_nan=False)


@st.composite
def markers(draw):
    marker = Marker(ns=draw(NAMES), id=draw(st.integers(-2**31, 2**31 - 1)),
                    type=draw(st.integers(0, 11)), action=draw(st.integers(0, 3)),
                    text=draw(NAMES), mesh_resource=draw(NAMES))
    marker.header.frame_id = draw(NAMES)
    marker.header.stamp = Time(sec=draw(st.integers(0, 2**31 - 1)),
                               nanosec=draw(st.integers(0, 10**9 - 1)))
    marker.lifetime = Duration(sec=draw(st.integers(0, 10**6)), nanosec=5)
    p, o, s = marker.pose.position, marker.pose.orientation, marker.scale
    p.x, p.y, p.z, o.x, o.y, o.z, o.w, s.x, s.y, s.z = (draw(NUMBERS) for _ in range(10))
    marker.points = [Point(x=1.0)] * draw(st.integers(0, 2))
    marker.colors = [ColorRGBA(r=1.0)] * draw(st.integers(0, 2))
    marker.uv_coordinates = [UVCoordinate(u=1.0)] * draw(st.integers(0, 2))
    marker.texture.format = draw(NAMES)
    marker.texture.data = [7] * draw(st.integers(0, 3))
    marker.mesh_file.data = [7] * draw(st.integers(0, 3))
    return marker


def check(message):
    raw = serialize_message(message)
    read, expected = read_markers(raw), deserialize_message(raw, MarkerArray).markers
    assert read.frames == [m.header.frame_id for m in expected]
    assert read.namespaces == [m.ns for m in expected]
    assert read.ids.tolist() == [m.id for m in expected]
    assert read.types.tolist() == [m.type for m in expected]
    assert read.actions.tolist() == [m.action for m in expected]
    for i, m in enumerate(expected):
        p, o, s = m.pose.position, m.pose.orientation, m.scale
        assert read.positions[i].tolist() == [p.x, p.y, p.z]
        assert read.quaternions[i].tolist() == [o.x, o.y, o.z, o.w]
        assert read.scales[i].tolist() == [s.x, s.y, s.z]
        assert read.stamps[i] == m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        assert read.lifetimes[i] == m.lifetime.sec + 1e-9 * m.lifetime.nanosec


@settings(deadline=None, max_examples=60)
@given(st.lists(markers(), max_size=6))
def test_any_mixture_of_markers_reads_as_rclpy_reads_it(listed):
    check(MarkerArray(markers=listed))


@pytest.mark.parametrize('namespace', ['', 'a', 'ab', 'abc', 'abcd', 'ball{}'])
def test_long_arrays_of_one_layout_or_of_two(namespace):
    """Sizes that are odd multiples of four bytes make every second marker's layout the same."""
    random = np.random.default_rng(0)
    message = MarkerArray()
    for i in range(120):
        marker = Marker(ns=namespace.format(i), id=i, type=Marker.SPHERE)
        marker.header.frame_id = 'base'
        marker.pose.position.x, marker.scale.z = random.normal(size=2).tolist()
        message.markers.append(marker)
    check(message)


def test_what_is_no_marker_array_is_refused():
    whole = serialize_message(MarkerArray(markers=[Marker(ns='a')]))
    for raw in (whole[:80], whole[:4], b'\x00\x01\x00\x00\xff\xff\xff\xff'):
        with pytest.raises(StateError, match='no MarkerArray'):
            read_markers(raw)


@settings(deadline=None)
@given(st.lists(markers(), max_size=4), st.data())
def test_one_message_after_another_reads_like_each_alone(listed, data):
    """Whatever changes in between: a number, a name, or how many there are."""
    reader, message = MarkerReader(), MarkerArray(markers=listed)
    for _ in range(6):
        raw = bytes(serialize_message(message))
        read, alone = reader.read(raw), read_markers(raw)
        for name in alone._fields:
            np.testing.assert_array_equal(getattr(read, name), getattr(alone, name))
        before = read.ids
        change = data.draw(st.sampled_from(['number', 'number', 'id', 'name', 'fewer']))
        if not message.markers or change == 'fewer':
            message.markers = message.markers[1:]
            continue
        marker = message.markers[data.draw(st.integers(0, len(message.markers) - 1))]
        if change == 'number':
            marker.pose.position.y, marker.scale.z = data.draw(NUMBERS), data.draw(NUMBERS)
            marker.header.stamp.sec, marker.lifetime.nanosec = data.draw(st.integers(0, 9)), 3
            marker.color.g = 0.5
            assert reader.read(bytes(serialize_message(message))).ids is before
        elif change == 'id':
            marker.id = data.draw(st.integers(0, 3))
        else:
            marker.ns = data.draw(NAMES)
