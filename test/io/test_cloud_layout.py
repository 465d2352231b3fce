"""PointCloud2 messages of every layout are read, and those that contradict themselves refused."""

from __future__ import annotations

import re
import struct

from builtin_interfaces.msg import Time
from hypothesis import given, strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from redundant_planner.io.cloud_layout import cloud_layout, CloudError, MOST_POINTS, points_of
from redundant_planner.io.cloud_writer import cloud_bytes

KINDS = {PointField.FLOAT32: 'f4', PointField.FLOAT64: 'f8'}


def serialised(cloud) -> bytes:
    return bytes(serialize_message(cloud))


@st.composite
def clouds(draw):
    """A message with any layout, and the coordinates in it."""
    height, width = draw(st.integers(0, 4)), draw(st.integers(0, 5))
    order = draw(st.sampled_from('<>'))
    names = draw(st.permutations(['x', 'y', 'z', 'rgb', 'intensity', '']))
    cloud = PointCloud2(height=height, width=width, is_bigendian=order == '>')
    # ROS strings end at the first zero character.
    cloud.header.frame_id = draw(st.text(
        st.characters(min_codepoint=1, codec='utf-8'), max_size=9))
    cloud.header.stamp.sec = draw(st.integers(-2**31, 2**31 - 1))
    cloud.header.stamp.nanosec = draw(st.integers(0, 999_999_999))
    at, places = 0, {}
    for name in names:
        at += draw(st.integers(0, 5))
        kind = draw(st.sampled_from(sorted(KINDS)))
        cloud.fields.append(PointField(name=name, offset=at, datatype=kind, count=1))
        places[name] = at, order + KINDS[kind]
        at += int(KINDS[kind][1])
    cloud.point_step = at + draw(st.integers(0, 7))
    cloud.row_step = width * cloud.point_step + draw(st.integers(0, 9))
    data = np.frombuffer(draw(st.binary(min_size=height * cloud.row_step,
                                        max_size=height * cloud.row_step)), np.uint8).copy()
    points = np.empty((3, height, width))
    for axis, name in enumerate('xyz'):
        offset, kind = places[name]
        for row in range(height):
            for column in range(width):
                value = draw(st.floats(width=32))
                begin = row * cloud.row_step + column * cloud.point_step + offset
                data[begin:begin + int(kind[2])] = np.frombuffer(
                    np.array(value, kind).tobytes(), np.uint8)
                points[axis, row, column] = value
    cloud.data = data.tobytes()
    return cloud, points.reshape(3, -1)


@given(clouds())
def test_any_layout_is_read(made):
    cloud, points = made
    raw = serialised(cloud)
    layout = cloud_layout(raw)
    stamp = cloud.header.stamp
    assert layout.stamp_ns == stamp.sec * 10**9 + stamp.nanosec
    assert layout.frame == cloud.header.frame_id
    assert (layout.height, layout.width) == (cloud.height, cloud.width)
    np.testing.assert_array_equal(points_of(raw, layout), points)
    room = np.full((3, cloud.height * cloud.width), np.nan)
    assert points_of(raw, layout, room) is room
    np.testing.assert_array_equal(room, points)


def test_a_message_in_the_other_byte_order_is_read():
    """A CDR in big-endian; rclpy here writes little-endian alone."""
    point = struct.pack('>3f', 1.0, 2.0, 3.0)
    fields = b''.join(struct.pack('>I2s2xIB3xI', 2, name, offset, 7, 1)
                      for name, offset in ((b'x', 0), (b'y', 4), (b'z', 8)))
    raw = (b'\0\0\0\0' + struct.pack('>iII4s', 5, 6, 4, b'eye') + struct.pack('>III', 1, 1, 3)
           + fields + struct.pack('>B3xIII', 1, 12, 12, 12) + point + b'\1')
    layout = cloud_layout(raw)
    assert (layout.stamp_ns, layout.frame) == (5_000_000_006, 'eye')
    np.testing.assert_array_equal(points_of(raw, layout), [[1.0], [2.0], [3.0]])


def good_cloud(**changes) -> PointCloud2:
    cloud = PointCloud2(height=2, width=3, point_step=12, row_step=36, data=bytes(72))
    cloud.fields = [PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
                    for i, name in enumerate('xyz')]
    for name, value in changes.items():
        setattr(cloud, name, value)
    return cloud


def with_field(index, **changes):
    cloud = good_cloud()
    for name, value in changes.items():
        setattr(cloud.fields[index], name, value)
    return cloud


@pytest.mark.parametrize(('cloud', 'said'), [
    (good_cloud(data=bytes(71)), 'its data has 71 bytes; 2 rows of 36 bytes take 72'),
    (good_cloud(data=bytes(73)), 'its data has 73 bytes; 2 rows of 36 bytes take 72'),
    (good_cloud(point_step=0), 'its point_step is 0'),
    (good_cloud(row_step=35, data=bytes(70)),
     'its row_step is 35; a row of 3 points of 12 bytes takes 36'),
    (good_cloud(fields=[]), "no field 'x', 'y', 'z'; it must have x, y and z, and has none"),
    (with_field(2, name='w'), "no field 'z'; it must have x, y and z, and has 'x', 'y', 'w'"),
    (with_field(1, name='x'), "no field 'y'"),
    (with_field(1, datatype=PointField.INT32), "'y' has datatype 5 (INT32); it must be 7"),
    (with_field(1, datatype=99), "'y' has datatype 99 (unknown)"),
    (with_field(2, offset=9), "'z' ends at byte 13 of a point, and point_step is 12"),
    (with_field(2, datatype=PointField.FLOAT64), "'z' ends at byte 16"),
    (with_field(0, count=3), "'x' has count 3; it must be 1"),
    (good_cloud(height=2**16, width=2**16), f'up to {MOST_POINTS} are read'),
    (good_cloud(fields=[*good_cloud().fields, PointField(name='x', datatype=7, count=1)]),
     "'x' appears 2 times"),
    (good_cloud(fields=1001 * [PointField()]), 'it has 1001 fields'),
    # A second later its seconds no longer fit into the voxels' stamp.
    (good_cloud(header=Header(stamp=Time(sec=2**31 - 1, nanosec=10**9))),
     'the nanosec of its stamp is 1000000000; below 1000000000 is right'),
])
def test_a_cloud_that_contradicts_itself_is_refused_by_name(cloud, said):
    with pytest.raises(CloudError, match=re.escape(said)):
        cloud_layout(serialised(cloud))


def test_a_message_cut_short_is_refused_wherever_it_ends():
    raw = serialised(good_cloud())
    assert cloud_layout(raw)
    for end in range(len(raw) - 4):  # is_dense and padding come last, and do not count
        with pytest.raises(CloudError):
            cloud_layout(raw[:end])


@given(st.binary(max_size=200), st.integers(0, 200))
def test_any_bytes_are_read_or_refused(noise, at):
    raw = serialised(good_cloud())
    changed = raw[:at % len(raw)] + noise + raw[at % len(raw) + len(noise):]
    try:
        layout = cloud_layout(changed)
    except CloudError:
        return
    assert points_of(changed, layout).shape == (3, layout.height * layout.width)


@given(st.text(st.characters(min_codepoint=1, codec='utf-8'), max_size=12),
       st.integers(1, 4), st.integers(1, 4))
def test_what_is_written_is_a_point_cloud_to_ros_and_to_the_reader(frame, height, width):
    points = np.random.default_rng(0).normal(size=(height, width, 3)).astype('f4').astype(float)
    points[0, 0] = np.nan
    raw = cloud_bytes(points, frame, 1_700_000_000_123_456_789)
    cloud = deserialize_message(raw, PointCloud2)
    assert (cloud.header.frame_id, cloud.height, cloud.width) == (frame, height, width)
    assert (cloud.header.stamp.sec, cloud.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert not cloud.is_dense and [field.name for field in cloud.fields] == ['x', 'y', 'z']
    assert cloud.point_step == 16 and cloud.row_step == 16 * width
    assert bytes(cloud.data) == raw[-1 - len(cloud.data):-1]
    layout = cloud_layout(raw)
    np.testing.assert_array_equal(points_of(raw, layout).T.reshape(points.shape), points)
