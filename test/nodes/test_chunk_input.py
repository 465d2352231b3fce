"""Chunks as they come: when they begin, in which frame, and what is refused."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rclpy.time import Time
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from redundant_planner.core.robot.se3 import Pose, Poses
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.nodes.command_input import CommandInput

PANDA = make_panda()
TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TIP = Pose(np.array([1.0, 2.0, 3.0]), TURNED)


@pytest.fixture
def said():
    return []


@pytest.fixture
def command(said):
    return CommandInput(
        {'base_link': 'base', 'tool0': 'tool'}, 'base', lambda: 100.0, lambda: 5000.0,
        said.append, lambda frame: (np.array([0.0, 0.0, 1.0]), TURNED))


def stamp(seconds):
    return Time(nanoseconds=round(seconds * 1e9)).to_msg()


def path(dues, frame='', stamped=True):
    """Poses along x, due at times [s], as bytes."""
    message = Path()
    message.header.frame_id = frame
    if stamped:
        message.header.stamp = stamp(dues[0])
    for i, due in enumerate(dues):
        pose = PoseStamped()
        pose.header.stamp = stamp(due)
        pose.pose.position.x = 0.1 * i
        message.poses.append(pose)
    return bytes(serialize_message(message))


def trajectory(begin, positions=PANDA_READY, names=None):
    message = JointTrajectory(joint_names=list(names or PANDA.joint_names))
    if begin is not None:
        message.header.stamp = stamp(begin)
    for due in (0, 2):
        point = JointTrajectoryPoint(positions=list(map(float, positions)))
        point.time_from_start.sec = due
        message.points.append(point)
    return bytes(serialize_message(message))


@pytest.mark.parametrize(('begin', 'late'), [
    (4999.5, 0.5), (5000.0, 0.0), (5001.0, -1.0), (None, 0.0)])
def test_a_chunk_begins_at_its_stamp_or_as_it_arrives(command, said, begin, late):
    command.on_trajectory(trajectory(begin), PANDA, PANDA_READY)
    found = command.target(Poses.of(TIP))
    assert isinstance(found, Chunk) and found.late == pytest.approx(late) and not said
    begin = 4990.0 if begin is None else begin
    command.on_path(path([begin, begin + 2.0], stamped=begin != 4990.0))
    assert command.target(Poses.of(TIP)).late == pytest.approx(late) and not said
    # The same object for as long as it holds.
    assert command.target(Poses.of(TIP)) is command.target(Poses.of(TIP)) is command.known_target


@pytest.mark.parametrize(('begin', 'reason'), [
    (4990.0, 'its last point was due 8.000 s ago'), (5061.0, 'it begins 61.000 s from now')])
def test_a_chunk_of_another_time_is_refused(command, said, begin, reason):
    command.on_trajectory(trajectory(begin), PANDA, PANDA_READY)
    command.on_path(path([begin, begin + 2.0]))
    assert not command.has_target
    assert [line.partition(' ')[0] for line in said] == ['target_trajectory', 'target_path']
    assert all(reason in line and 'use_sim_time' in line for line in said)


@pytest.mark.parametrize(('frame', 'second'), [
    ('', [0.1, 0.0, 0.0]), ('base_link', [0.1, 0.0, 0.0]), ('tool0', [1.0, 2.1, 3.0]),
    ('elsewhere', [0.0, 0.1, 1.0])])
def test_poses_may_be_given_in_any_frame(command, said, frame, second):
    command.on_path(path([5000.0, 5001.0], frame))
    found = command.target(Poses.of(TIP))
    np.testing.assert_allclose(found.points[1].position, second, atol=1e-12)
    assert not said
    # Meant from where the tip was at first.
    assert command.target(Poses.of(Pose(np.zeros(3), np.eye(3)))) is found


def test_what_cannot_be_followed_is_refused_and_changes_nothing(command, said):
    command.on_path(path([5000.0, 5001.0]))
    before = command.target(Poses.of(TIP))
    command.on_trajectory(trajectory(None), PANDA, None)
    command.on_trajectory(trajectory(None, PANDA_READY + 3.0), PANDA, PANDA_READY)
    command.on_trajectory(trajectory(None, [0.0], ['elbow']), PANDA, PANDA_READY)
    command.on_path(path([5001.0, 5000.5]))
    command.on_path(b'')
    assert command.target(Poses.of(TIP)) is before
    for line, reason in zip(said, ('nothing was heard on joint_states yet',
                                   "takes joint 'panda_joint1'", "names 'elbow'",
                                   'do not ascend', 'it begins with nothing'), strict=True):
        assert reason in line


def test_a_twist_ends_a_chunk(command):
    command.on_trajectory(trajectory(None), PANDA, PANDA_READY)
    assert command.has_target
    command.on_twist(b'\0\1\0\0' + bytes(48))
    assert not command.has_target
