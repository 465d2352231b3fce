"""JointStates by their bytes are what rclpy makes of them."""

from __future__ import annotations

import contextlib

from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from redundant_planner.core.errors import StateError
from redundant_planner.io.joint_layout import joint_layout, MOST_JOINTS
from redundant_planner.nodes.joint_messages import JointReader, JointWriter
from redundant_planner.nodes.messages import LARGEST, positions_from_message

NAMES = st.lists(st.text(st.characters(min_codepoint=48, max_codepoint=122), min_size=1,
                         max_size=9), min_size=1, max_size=9, unique=True)
NUMBERS = st.floats(-LARGEST, LARGEST)


@given(NAMES, st.integers(0, 2**31 * 10**9 - 1), st.data())
def test_written_messages_are_read_by_rclpy(names, stamp, data):
    writer = JointWriter(names)
    for _ in range(2):
        q, dq = (data.draw(arrays(float, len(names), elements=NUMBERS)) for _ in range(2))
        message = deserialize_message(writer.message(stamp, q, dq), JointState)
        assert message.name == names
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
        np.testing.assert_array_equal(message.position, q)
        np.testing.assert_array_equal(message.velocity, dq)


@given(NAMES, st.data())
def test_positions_are_read_as_rclpy_reads_them_whatever_else_is_there(names, data):
    wanted = data.draw(st.permutations(names))[:data.draw(st.integers(1, len(names)))]
    reader = JointReader(wanted)
    for _ in range(5):
        # Another sender now and then: another order, frame or length.
        order = data.draw(st.permutations(names)) if data.draw(st.booleans()) else names
        more = data.draw(st.sampled_from(['velocity', 'effort', None]))
        message = JointState(name=order, position=data.draw(
            st.lists(NUMBERS, min_size=len(names), max_size=len(names))))
        message.header.frame_id = data.draw(st.sampled_from(['', 'base']))
        if more:
            setattr(message, more, [1.0] * len(names))
        message.header.stamp.sec = data.draw(st.integers(0, 2**31 - 1))
        np.testing.assert_array_equal(
            reader.positions(bytes(serialize_message(message))),
            positions_from_message(message, wanted))


@given(NAMES, st.integers(0, 2**31 * 10**9 - 1), st.data())
def test_a_state_has_its_stamp_and_velocities_if_there_are_any(names, stamp, data):
    reader, order = JointReader(names), data.draw(st.permutations(names))
    for velocities in ([], data.draw(st.lists(NUMBERS, min_size=len(names),
                                              max_size=len(names)))):
        message = JointState(name=order, position=np.arange(len(names)), velocity=velocities)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        found_at, q, dq = reader.state(bytes(serialize_message(message)))
        assert found_at == stamp
        np.testing.assert_array_equal(q, [order.index(name) for name in names])
        if velocities:
            np.testing.assert_array_equal(dq, [velocities[order.index(n)] for n in names])
            message.velocity[0] = np.nan
            assert reader.state(bytes(serialize_message(message)))[2] is None
        else:
            assert dq is None


@pytest.mark.parametrize('names, positions, problem', [
    (['a', 'b'], [0.1, np.nan], r"position of joint 'b' is nan"),
    (['a', 'c'], [0.1, 0.2], r"joints are missing: 'b'"),
    (['a', 'b', 'a'], [0.1, 0.2, 0.3], r"joint names appear twice: 'a'"),
    (['a', 'b'], [0.1, -1e300], r"position of joint 'b' is -1e\+300; it must be finite"),
    (['a', 'b'], [0.1], r'2 joint names came with 1 position values'),
    (['a', 'b'] + [str(i) for i in range(MOST_JOINTS)], [], r'has 1002 joint names; up to 1000'),
    (['a', 'b', 'c' * 256], [0.1, 0.2, 0.3], r'has 256 bytes; up to 255'),
])
def test_what_is_wrong_is_said_also_once_the_layout_is_known(names, positions, problem):
    reader = JointReader(['a', 'b'])
    good = bytes(serialize_message(JointState(name=['a', 'b'], position=[0.1, 0.2])))
    bad = bytes(serialize_message(JointState(name=names, position=positions)))
    for _ in range(2):
        np.testing.assert_array_equal(reader.positions(good), [0.1, 0.2])
        with pytest.raises(StateError, match=problem):
            reader.positions(bad)


WHOLE = bytes(serialize_message(JointState(
    name=['a', 'b'], position=[0.1, 0.2], velocity=[0.3, 0.4], effort=[0.5, 0.6])))


@given(st.integers(0, len(WHOLE) - 1), st.booleans())
def test_a_message_that_is_cut_is_refused_also_once_the_layout_is_known(length, known):
    reader = JointReader(['a', 'b'])
    if known:
        reader.positions(WHOLE)
    with pytest.raises(StateError):
        reader.positions(WHOLE[:length])
    np.testing.assert_array_equal(reader.positions(WHOLE + b'more'), [0.1, 0.2])


@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(0, 255)), max_size=6))
def test_damaged_messages_are_read_or_refused(changes):
    damaged = bytearray(WHOLE)
    for at, byte in changes:
        damaged[at] = byte
    reader = JointReader(['a', 'b'])
    with contextlib.suppress(StateError):
        assert np.isfinite(reader.positions(bytes(damaged))).all()


def test_big_endian_positions_are_read_and_other_encodings_refused():
    message = JointState(name=['a', 'b'], position=[0.1, 0.2])
    raw = bytes(serialize_message(message))
    layout = joint_layout(raw)
    payload = np.frombuffer(raw, '<u4', (len(raw) - 4) // 4, 4).astype('>u4').tobytes()
    swapped = bytearray(b'\0\0\0\0' + payload)
    for at in range(layout.positions, layout.positions + 16, 8):
        swapped[at:at + 8] = raw[at:at + 8][::-1]
    for first, last in layout.fixed:
        if last - first in (6,):  # a length and 'a\0' or 'b\0'
            swapped[first + 4:last] = raw[first + 4:last]
    np.testing.assert_array_equal(JointReader(['b']).positions(bytes(swapped)), [0.2])
    for first in (b'\0\3', b'\0\7', b'\1\1'):
        with pytest.raises(StateError, match='plain CDR'):
            JointReader(['a']).positions(first + raw[2:])
