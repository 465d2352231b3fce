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
        which = reader.read(bytes(serialize_message(message)))
        np.testing.assert_array_equal(which, range(len(wanted)))
        np.testing.assert_array_equal(reader.posture, positions_from_message(message, wanted))


@given(NAMES, st.integers(0, 2**31 * 10**9 - 1), st.data())
def test_a_state_has_its_stamp_and_velocities_if_there_are_any(names, stamp, data):
    reader, order = JointReader(names), data.draw(st.permutations(names))
    for velocities in ([], data.draw(st.lists(NUMBERS, min_size=len(names),
                                              max_size=len(names)))):
        message = JointState(name=order, position=np.arange(len(names)), velocity=velocities)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        raw = bytes(serialize_message(message))
        reader.read(raw)
        dq = reader.velocities(raw)
        assert reader.stamp_ns(raw) == stamp
        np.testing.assert_array_equal(reader.posture, [order.index(name) for name in names])
        if velocities:
            np.testing.assert_array_equal(dq, [velocities[order.index(n)] for n in names])
            message.velocity[0] = np.nan
            assert reader.velocities(bytes(serialize_message(message))) is None
        else:
            assert dq is None


@pytest.mark.parametrize('names, positions, problem', [
    (['a', 'b'], [0.1, np.nan], r"position of joint 'b' is nan"),
    (['a', 'b', 'a', 'c', 'c'], [0.1, 0.2, 0.3, 0.4, 0.5], r"joint names appear twice: 'a'$"),
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
        reader.read(good)
        with pytest.raises(StateError, match=problem):
            reader.read(bad)
        np.testing.assert_array_equal(reader.posture, [0.1, 0.2])


WHOLE = bytes(serialize_message(JointState(
    name=['a', 'b'], position=[0.1, 0.2], velocity=[0.3, 0.4], effort=[0.5, 0.6])))


@given(st.integers(0, len(WHOLE) - 1), st.booleans())
def test_a_message_that_is_cut_is_refused_also_once_the_layout_is_known(length, known):
    reader = JointReader(['a', 'b'])
    if known:
        reader.read(WHOLE)
    with pytest.raises(StateError):
        reader.read(WHOLE[:length])
    reader.read(WHOLE + b'more')
    np.testing.assert_array_equal(reader.posture, [0.1, 0.2])


@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(0, 255)), max_size=6))
def test_damaged_messages_are_read_or_refused(changes):
    damaged = bytearray(WHOLE)
    for at, byte in changes:
        damaged[at] = byte
    reader = JointReader(['a', 'b'])
    with contextlib.suppress(StateError):
        which = reader.read(bytes(damaged))
        assert np.isfinite(reader.posture[which]).all()


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
    reader = JointReader(['b'])
    reader.read(bytes(swapped))
    np.testing.assert_array_equal(reader.posture, [0.2])
    for first in (b'\0\3', b'\0\7', b'\1\1'):
        with pytest.raises(StateError, match='plain CDR'):
            JointReader(['a']).read(first + raw[2:])


def raw_state(**joints):
    """A message with these joints."""
    return bytes(serialize_message(JointState(
        name=list(joints), position=list(joints.values()))))


def test_joints_come_in_any_parts_and_the_newest_of_each_counts():
    reader = JointReader(['a', 'b', 'c'])
    assert reader.missing == ('a', 'b', 'c')
    assert reader.read(raw_state(c=3.0, other=9.0)).tolist() == [2]
    assert reader.missing == ('a', 'b')
    assert reader.read(raw_state(b=2.0, a=1.0)).tolist() == [0, 1]
    np.testing.assert_array_equal(reader.posture, [1.0, 2.0, 3.0])
    kept = reader.posture
    for joints, newest in (({'c': 3.5}, [1.0, 2.0, 3.5]), ({'b': 2.5, 'c': 4.0}, [1.0, 2.5, 4.0]),
                           ({'a': 0.0, 'b': 0.0, 'c': 0.0}, [0.0, 0.0, 0.0])):
        for _ in range(2):
            reader.read(raw_state(**joints))
            np.testing.assert_array_equal(reader.posture, newest)
    np.testing.assert_array_equal(kept, [1.0, 2.0, 3.0])  # what was handed out stays


def test_a_part_with_one_bad_number_changes_nothing():
    reader = JointReader(['a', 'b'])
    reader.read(raw_state(a=1.0, b=2.0))
    with pytest.raises(StateError, match="position of joint 'b' is nan"):
        reader.read(raw_state(a=5.0, b=np.nan))
    np.testing.assert_array_equal(reader.posture, [1.0, 2.0])


@pytest.mark.parametrize('names, positions', [
    (['finger'], [0.1]), (['2024_a', '2024_b'], [0.1, 0.2]), (['finger', 'finger'], [0.1, 0.1]),
    (['wheel'], []), (['finger'], [np.nan])])
def test_messages_without_our_joints_are_nobodys_business(names, positions):
    """Not even where they are doubtful."""
    reader = JointReader(['a', 'b'])
    reader.read(raw_state(a=1.0, b=2.0))
    for _ in range(2):
        raw = bytes(serialize_message(JointState(name=names, position=positions)))
        assert not len(reader.read(raw))
        assert reader.others == tuple(names)
    np.testing.assert_array_equal(reader.posture, [1.0, 2.0])


def test_joints_with_a_prefix_are_never_ours():
    reader = JointReader(['a', 'b'])
    doubled = {'a': 1.0, 'b': 2.0, '20245301303_a': 7.0, '20245301303_b': 8.0}
    for _ in range(2):
        assert len(reader.read(raw_state(**doubled))) == 2
        np.testing.assert_array_equal(reader.posture, [1.0, 2.0])


def test_more_publishers_than_are_remembered_are_read_all_the_same():
    reader = JointReader(['a'])
    for _ in range(2):
        for i in range(40):
            reader.read(raw_state(**{'a': float(i), f'other{i}': 0.0}))
            assert reader.posture[0] == i

