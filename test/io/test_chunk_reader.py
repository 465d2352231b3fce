"""Serialised chunks: read as rclpy reads them, the short way round; others refused by name."""

from __future__ import annotations

import time

from conftest import make_panda, PANDA_READY
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings, strategies as st
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from redundant_planner.core.errors import StateError
from redundant_planner.core.target.chunk import Chunk, MOST_POINTS
from redundant_planner.io.chunk_reader import read_path, read_trajectory

PANDA = make_panda()
NAMES = list(PANDA.joint_names)


def serialised(message):
    return bytes(serialize_message(message))


def path(dues, frame='base_link', header=12.0, frames=None):
    """A path along x, one pose at each of these times [s]."""
    message = Path()
    message.header.frame_id = frame
    message.header.stamp.sec = int(header)
    for i, due in enumerate(dues):
        pose = PoseStamped()
        pose.header.frame_id = frame if frames is None else frames[i]
        pose.header.stamp.sec, pose.header.stamp.nanosec = int(due), round(due % 1.0 * 1e9)
        pose.pose.position.x, pose.pose.orientation.z, pose.pose.orientation.w = 0.1 * i, 0.6, 0.8
        message.poses.append(pose)
    return message


def trajectory(dues, positions, names=NAMES, velocities=None):
    message = JointTrajectory(joint_names=list(names))
    message.header.stamp.sec = 7
    for i, (due, q) in enumerate(zip(dues, positions)):
        point = JointTrajectoryPoint(positions=list(map(float, q)))
        if velocities is not None:
            point.velocities = list(map(float, velocities[i]))
        point.time_from_start.sec, point.time_from_start.nanosec = int(due), round(
            due % 1.0 * 1e9)
        message.points.append(point)
    return message


@settings(deadline=None)
@given(st.data())
def test_any_trajectory_reads_as_rclpy_reads_it(data):
    """Frames, accelerations and efforts, which do not count, change where the rest lies."""
    count, random = data.draw(st.integers(1, 5)), np.random.default_rng(data.draw(
        st.integers(0, 99)))
    names = data.draw(st.permutations(NAMES))[:data.draw(st.integers(1, 7))]
    positions, velocities = random.normal(size=(2, count, len(names)))
    moving = data.draw(st.booleans())
    message = trajectory(np.cumsum(random.integers(1, 9, count)) / 4.0, positions, names,
                         velocities if moving else None)
    message.header.frame_id = data.draw(st.sampled_from(['', 'base', 'a frame']))
    for point in message.points:
        point.accelerations = [1.0] * data.draw(st.integers(0, 2))
        point.effort = [2.0] * data.draw(st.integers(0, 3))
    found = read_trajectory(serialised(message), PANDA, PANDA_READY)
    assert (found.stamp, found.frame) == (7.0, '')
    np.testing.assert_allclose(found.times, [
        p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])
    for j, name in enumerate(NAMES):
        if name in names:
            np.testing.assert_array_equal(found.points[:, j], positions[:, names.index(name)])
        else:
            np.testing.assert_array_equal(found.points[:, j], PANDA_READY[j])
    if moving:
        np.testing.assert_array_equal(found.velocities[:, NAMES.index(names[0])],
                                      velocities[:, 0])
    else:
        assert found.velocities is None


def test_a_path_is_due_by_its_stamps():
    found = read_path(serialised(path([20.0, 20.25, 21.0])))
    assert (found.stamp, found.frame, found.velocities) == (20.0, 'base_link', None)
    np.testing.assert_allclose(found.times, [0.0, 0.25, 1.0])
    np.testing.assert_allclose([pose.position[0] for pose in found.points], [0.0, 0.1, 0.2])
    np.testing.assert_allclose(found.points[0].rotation[:2, :2], [[0.28, -0.96], [0.96, 0.28]])
    # Without a stamp of its own it begins as it arrives; the differences count.
    found = read_path(serialised(path([20.0, 20.25, 21.0], header=0.0)))
    assert found.stamp == 0.0
    np.testing.assert_allclose(found.times, [0.0, 0.25, 1.0])


def test_joints_without_limits_go_the_short_way_from_point_to_point():
    low, high = PANDA.position_min.copy(), PANDA.position_max.copy()
    low[6], high[6] = -np.inf, np.inf

    class Endless:
        joint_names, position_min, position_max = PANDA.joint_names, low, high

    rest = np.append(PANDA_READY[:6], 9.0)
    wrapped = [[2.9], [3.1], [-3.1], [-2.9]]
    found = read_trajectory(serialised(trajectory([1, 2, 3, 4], wrapped, NAMES[6:])),
                            Endless, rest)
    turn = 2.0 * np.pi
    np.testing.assert_allclose(
        found.points[:, 6], [2.9 + turn, 3.1 + turn, 2.0 * turn - 3.1, 2.0 * turn - 2.9])


@pytest.mark.parametrize(('message', 'reason'), [
    (path([]), 'it has 0 poses'),
    (path([0.0, 0.0]), 'its poses have no stamps; the stamp of each must say when it is due'),
    (path([1.0, 2.0], frames=['base_link', 'other']),
     "pose 1 is given in frame 'other', others in 'base_link'")])
def test_a_path_that_is_none_is_refused(message, reason):
    with pytest.raises(StateError, match=reason):
        read_path(serialised(message))


@pytest.mark.parametrize(('message', 'reason'), [
    (trajectory([], []), 'it has 0 points'),
    (trajectory([1.0], [[0.0]], ['elbow']), "names 'elbow'; the joints are"),
    (trajectory([1.0], [[]], []), 'it names no joint'),
    (trajectory([1.0], [[0.0, 0.0]], NAMES[:1] * 2), 'appear twice'),
    (trajectory([1.0, 2.0], [[0.0], []], NAMES[:1]), 'point 1 has 0 positions for 1 joints'),
    (trajectory([1.0], [[0.0]], NAMES[:1], [[0.0, 1.0]]), 'point 0 has 2 velocities for 1')])
def test_a_trajectory_that_is_none_is_refused(message, reason):
    with pytest.raises(StateError, match=reason):
        read_trajectory(serialised(message), PANDA, PANDA_READY)


def test_a_pose_that_is_none_is_refused_by_its_number():
    message = path([1.0, 2.0])
    message.poses[1].pose.orientation.w = 3.0
    with pytest.raises(StateError, match='pose 1: its orientation is the quaternion'):
        read_path(serialised(message))


def test_too_many_points_are_refused_whole():
    with pytest.raises(StateError, match=f'it takes 1 to {MOST_POINTS}'):
        read_path(serialised(path(np.arange(1.0, MOST_POINTS + 2.0))))


def test_what_is_cut_or_lies_about_its_length_is_refused_at_once():
    def read_both(raw):
        for reads in (read_path, lambda raw: read_trajectory(raw, PANDA, PANDA_READY)):
            try:
                found = reads(raw)
                Chunk(found.times, found.points, found.velocities)
            except StateError:
                continue

    raws = [serialised(path([1.0, 2.0])), serialised(
        trajectory([1.0, 2.0], np.zeros((2, 7)), velocities=np.zeros((2, 7))))]
    begin = time.process_time()
    for raw, reads in zip(raws, (
            read_path, lambda raw: read_trajectory(raw, PANDA, PANDA_READY))):
        # Serialised messages may have some bytes more at their end.
        for length in range(len(raw) - 24):
            with pytest.raises(StateError):
                reads(raw[:length])
        for at in range(0, len(raw) - 3, 4):
            for count in (2**31, 2**32 - 1, MOST_POINTS):
                read_both(raw[:at] + count.to_bytes(4, 'little') + raw[at + 4:])
    assert time.process_time() - begin < 5.0


@given(st.binary(max_size=300))
def test_any_bytes_are_refused_or_read(raw):
    for reads in (read_path, lambda raw: read_trajectory(raw, PANDA, PANDA_READY)):
        try:
            found = reads(b'\0\1\0\0' + raw)
        except StateError:
            continue
        assert len(found.times) == len(found.points)
