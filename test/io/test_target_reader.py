"""Serialised targets: read as rclpy reads them after any header; all else is refused."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY
from geometry_msgs.msg import PoseStamped
from hypothesis import given, strategies as st
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from redundant_planner.core.errors import StateError
from redundant_planner.io.target_reader import read_joint_target, read_target

PANDA = make_panda()


def message(frame='base_link', position=(0.1, -0.2, 0.3), quaternion=(0.0, 0.0, 0.6, 0.8)):
    found = PoseStamped()
    found.header.frame_id = frame
    found.header.stamp.sec, found.header.stamp.nanosec = 12, 500_000_000
    p, o = found.pose.position, found.pose.orientation
    p.x, p.y, p.z = position
    o.x, o.y, o.z, o.w = quaternion
    return bytes(serialize_message(found))


@given(st.text('abcü/_', max_size=30))
def test_it_reads_stamp_frame_and_pose_after_any_frame(frame):
    stamp, name, pose = read_target(message(frame))
    assert (stamp, name) == (12.5, frame)
    np.testing.assert_allclose(pose.position, (0.1, -0.2, 0.3))
    np.testing.assert_allclose(
        pose.rotation, [[0.28, -0.96, 0.0], [0.96, 0.28, 0.0], [0.0, 0.0, 1.0]], atol=1e-12)


def test_a_quaternion_that_is_nearly_of_length_1_is_made_so():
    pose = read_target(message(quaternion=(0.0, 0.0, 0.6003, 0.8)))[2]
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(('change', 'what'), [
    ({'position': (np.nan, 0.0, 0.0)}, 'position'), ({'position': (0.0, 2e3, 0.0)}, '1000 m'),
    ({'quaternion': (0.0, 0.0, 0.0, 0.0)}, 'length 0'),
    ({'quaternion': (0.0, 0.0, 0.0, 2.0)}, 'length 2'),
    ({'quaternion': (np.inf, 0.0, 0.0, 0.0)}, 'quaternion')])
def test_what_is_no_pose_is_refused(change, what):
    with pytest.raises(StateError, match=what):
        read_target(message(**change))


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_or_read(raw):
    try:
        pose = read_target(raw)[2]
    except StateError:
        return
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-9)


@given(st.integers(0, len(message()) - 1))
def test_every_shorter_message_is_refused(length):
    with pytest.raises(StateError):
        read_target(message()[:length])


def joint_message(names, positions):
    return bytes(serialize_message(JointState(name=names, position=positions)))


def test_joints_come_in_any_order_and_those_not_named_stay():
    raw = joint_message(['panda_joint6', 'panda_joint2'], [2.0, 0.3])
    expected = PANDA_READY.copy()
    expected[[5, 1]] = 2.0, 0.3
    _, found = read_joint_target(raw, PANDA, PANDA_READY)
    np.testing.assert_array_equal(found, expected)
    every = joint_message(list(PANDA.joint_names)[::-1], PANDA_READY[::-1].tolist())
    np.testing.assert_array_equal(read_joint_target(every, PANDA)[1], PANDA_READY)
    # A joint that is measured a little beyond its limit does not spoil the target of another.
    beyond = PANDA_READY.copy()
    beyond[0] = PANDA.position_max[0] + 1e-3
    assert read_joint_target(raw, PANDA, beyond)[1][0] == PANDA.position_max[0]


@pytest.mark.parametrize(('names', 'positions', 'what'), [
    ([], [], 'it names no joint; the joints are'), (['elbow'], [0.1], "it names 'elbow'; the"),
    (['panda_joint1', 'panda_joint1'], [0.1, 0.2], "joint names appear twice: 'panda_joint1'"),
    (['panda_joint1'], [np.nan], "joint 'panda_joint1' is not a finite number"),
    (['panda_joint1'], [9.0], "the target of joint 'panda_joint1' is 9; it must be -2.89")])
def test_joints_that_there_are_not_or_cannot_go_there_are_refused(names, positions, what):
    with pytest.raises(StateError, match=what):
        read_joint_target(joint_message(names, positions), PANDA, PANDA_READY)
    with pytest.raises(StateError, match='joints are missing|' + what):
        read_joint_target(joint_message(names, positions), PANDA)


@given(st.binary(max_size=200))
def test_any_bytes_are_no_target_of_the_joints_or_a_sound_one(raw):
    try:
        _, q = read_joint_target(raw, PANDA, PANDA_READY)
    except StateError:
        return
    assert (q >= PANDA.position_min).all() and (q <= PANDA.position_max).all()
