"""Serialised MarkerArrays as arrays, against rclpy's own reading of them."""

from __future__ import annotations

import contextlib
import time

from builtin_interfaces.msg import Duration, Time
from conftest import examples
from geometry_msgs.msg import Point
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray, UVCoordinate

from redundant_planner.core.errors import StateError
from redundant_planner.io.marker_reader import MarkerReader, MOST_MARKERS

# ROS strings end at the first zero character.
NAMES = st.text(st.characters(min_codepoint=1, codec='utf-8'), max_size=9)
NUMBERS = st.floats(width=64, allow_nan=False)


TWISTS = st.lists(st.floats(), min_size=5, max_size=7).map(
    lambda numbers: 'twist ' + ' '.join(map(repr, numbers)))


@st.composite
def markers(draw):
    marker = Marker(ns=draw(NAMES), id=draw(st.integers(-2**31, 2**31 - 1)),
                    type=draw(st.integers(0, 11)), action=draw(st.integers(0, 3)),
                    text=draw(NAMES | TWISTS), mesh_resource=draw(NAMES))
    marker.header.frame_id = draw(NAMES)
    marker.header.stamp = Time(sec=draw(st.integers(0, 2**31 - 1)),
                               nanosec=draw(st.integers(0, 10**9 - 1)))
    marker.lifetime = Duration(sec=draw(st.integers(0, 10**6)), nanosec=5)
    p, o, s = marker.pose.position, marker.pose.orientation, marker.scale
    p.x, p.y, p.z, o.x, o.y, o.z, o.w, s.x, s.y, s.z = (draw(NUMBERS) for _ in range(10))
    marker.points = [Point(x=draw(NUMBERS), z=1.0)] * draw(st.integers(0, 2))
    marker.colors = [ColorRGBA(r=1.0)] * draw(st.integers(0, 2))
    marker.uv_coordinates = [UVCoordinate(u=1.0)] * draw(st.integers(0, 2))
    marker.texture.format = draw(NAMES)
    marker.texture.data = [7] * draw(st.integers(0, 3))
    marker.mesh_file.data = [7] * draw(st.integers(0, 3))
    return marker


def check(message):
    raw = serialize_message(message)
    read, expected = MarkerReader().read(raw), deserialize_message(raw, MarkerArray).markers
    assert read.listing.frames == [m.header.frame_id for m in expected]
    assert read.listing.namespaces == [m.ns for m in expected]
    assert read.listing.ids.tolist() == [m.id for m in expected]
    assert read.listing.types.tolist() == [m.type for m in expected]
    assert read.listing.actions.tolist() == [m.action for m in expected]
    for i, m in enumerate(expected):
        p, o, s = m.pose.position, m.pose.orientation, m.scale
        assert read.positions[i].tolist() == [p.x, p.y, p.z]
        assert read.quaternions[i].tolist() == [o.x, o.y, o.z, o.w]
        assert read.scales[i].tolist() == [s.x, s.y, s.z]
        assert read.stamps[i] == m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        assert read.points[i].tolist() == [[point.x, point.y, point.z] for point in m.points]
        assert read.lifetimes[i] == m.lifetime.sec + 1e-9 * m.lifetime.nanosec
        twist = np.full(6, np.nan) if read.twists is None else read.twists[i]
        if m.text.startswith('twist '):
            numbers = np.array(m.text.split()[1:], dtype=float)
            sound = len(numbers) == 6 and np.isfinite(numbers).all()
            assert twist.tolist() == (numbers.tolist() if sound else [np.inf] * 6)
        else:
            assert np.isnan(twist).all()


@settings(deadline=None, max_examples=examples(60))
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
    whole = bytes(serialize_message(MarkerArray(markers=[Marker(ns='a'), Marker(ns='b')])))
    for raw in (whole[:80], whole[:4], whole[:300], b'', b'\0', b'\x01' + whole[1:],
                whole[:1] + b'\x03' + whole[2:], whole[:4] + b'\xff' * 4 + whole[8:]):
        with pytest.raises(StateError, match='no MarkerArray'):
            MarkerReader().read(raw)


def test_lengths_that_lie_cost_nothing():
    """Any count in the message, replaced by one that no memory holds."""
    whole = bytes(serialize_message(MarkerArray(markers=[Marker(ns='abc')])))
    begin, reader = time.process_time(), MarkerReader()
    for at in range(4, len(whole) - 3, 4):
        for count in (2**31, 2**32 - 1, 2**28):
            lying = whole[:at] + count.to_bytes(4, 'little') + whole[at + 4:]
            with contextlib.suppress(StateError):
                reader.read(lying)
    assert time.process_time() - begin < 2.0


@pytest.mark.parametrize(('message', 'problem'), [
    ([Marker()] * (MOST_MARKERS + 1), f'has {MOST_MARKERS + 1} markers; up to {MOST_MARKERS}'),
    ([Marker(ns='n' * 256)], 'has 256 bytes; up to 255'),
])
def test_what_is_too_much_is_refused_whole(message, problem):
    with pytest.raises(StateError, match=problem):
        MarkerReader().read(bytes(serialize_message(MarkerArray(markers=message))))


def test_big_endian_bytes_are_read_as_well():
    marker = Marker(id=-7, type=2)
    marker.pose.position.x, marker.pose.orientation.w, marker.scale.z = 1.5, 1.0, 0.25
    marker.lifetime.sec = -3
    raw = bytes(serialize_message(MarkerArray(markers=[marker])))
    payload = np.frombuffer(raw, '<u4', (len(raw) - 4) // 4, 4).astype('>u4').tobytes()
    swapped = bytearray(raw[:1] + b'\0' + raw[2:4] + payload + b'\0')
    for at in range(44, 124, 8):  # position, orientation and scale
        swapped[at:at + 8] = raw[at:at + 8][::-1]
    read = MarkerReader().read(bytes(swapped))
    assert read.listing.ids.tolist() == [-7] and read.listing.types.tolist() == [2]
    assert read.positions.tolist() == [[1.5, 0.0, 0.0]] and read.scales[0, 2] == 0.25
    assert read.quaternions[0].tolist() == [0.0, 0.0, 0.0, 1.0] and read.lifetimes[0] == -3.0


@settings(deadline=None)
@given(st.lists(markers(), max_size=4), st.data())
def test_one_message_after_another_reads_like_each_alone(listed, data):
    """Whatever changes in between: a number, a name, or how many there are."""
    reader, message = MarkerReader(), MarkerArray(markers=listed)
    for _ in range(6):
        raw = bytes(serialize_message(message))
        read, alone = reader.read(raw), MarkerReader().read(raw)
        for name in alone.listing._fields:
            np.testing.assert_array_equal(
                getattr(read.listing, name), getattr(alone.listing, name))
        assert [p.tolist() for p in read.points] == [p.tolist() for p in alone.points]
        for name in (*alone._fields[1:6], 'twists'):
            np.testing.assert_array_equal(getattr(read, name), getattr(alone, name))
        before = read.listing
        change = data.draw(st.sampled_from(['number', 'number', 'id', 'name', 'fewer']))
        if not message.markers or change == 'fewer':
            message.markers = message.markers[1:]
            continue
        marker = message.markers[data.draw(st.integers(0, len(message.markers) - 1))]
        if change == 'number':
            marker.pose.position.y, marker.scale.z = data.draw(NUMBERS), data.draw(NUMBERS)
            marker.header.stamp.sec, marker.lifetime.nanosec = data.draw(st.integers(0, 9)), 3
            marker.color.g, marker.text = 0.5, data.draw(NAMES)
            assert reader.read(bytes(serialize_message(message))).listing is before
        elif change == 'id':
            marker.id = data.draw(st.integers(0, 3))
        else:
            marker.ns = data.draw(NAMES)
