"""What is written to a bag is what is read from it."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, Vector3
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.io.recording import read_recording
from redundant_planner.nodes.messages import markers_of

START = 1_700_000_000 * 10**9


def write_bag(path, commands=True):
    balls = [Obstacle('ball', np.array([1.0, 2, 3]), np.array([0.1, 0.2, 0.3]))]
    with BagWriter(path) as bag:
        for topic, kind in (('joint_states', 'sensor_msgs/msg/JointState'),
                            ('joint_command', 'sensor_msgs/msg/JointState'),
                            ('cmd_vel', 'geometry_msgs/msg/Twist'),
                            ('obstacles', 'visualization_msgs/msg/MarkerArray'),
                            ('robot_description', 'std_msgs/msg/String')):
            bag.add_topic(f'/{topic}', kind)
        bag.write('/robot_description', START, serialize_message(String(data='<robot/>')))
        bag.write('/obstacles', START, serialize_message(markers_of(balls, 'base')))
        for i in range(5):
            stamp = Time(sec=1_700_000_000, nanosec=i * 4_000_000)
            state = JointState(name=['a', 'b'], position=[0.1 * i, 0.2 * i], velocity=[1.0, 2.0])
            state.header.stamp = stamp
            now = START + i * 4_000_000
            bag.write('/joint_states', now, serialize_message(state))
            if commands:
                bag.write('/joint_command', now, serialize_message(state))
            bag.write('/cmd_vel', now, serialize_message(
                Twist(linear=Vector3(x=0.1 * i), angular=Vector3(z=0.2))))


def test_a_bag_gives_back_what_was_recorded(tmp_path):
    write_bag(tmp_path / 'bag')
    recording = read_recording(tmp_path / 'bag')
    assert recording.states.names == ('a', 'b')
    np.testing.assert_allclose(recording.states.times, 0.004 * np.arange(5), atol=1e-6)
    np.testing.assert_allclose(recording.states.select(('b',)).positions[:, 0],
                               0.2 * np.arange(5))
    np.testing.assert_allclose(recording.twists[:, 0], 0.1 * np.arange(5))
    np.testing.assert_allclose(recording.obstacles[0].half_extents, [0.1, 0.2, 0.3])
    assert recording.robot_description == '<robot/>'
    assert len(recording.commands.between(0.003, 0.013).times) == 3
    assert list((tmp_path / 'bag').glob('*.mcap'))


@pytest.mark.parametrize('message', [
    JointState(name=['a', 'b'], position=[0.5, 0.0], velocity=[0.0, 0.0]),
    JointState(name=['a'], position=[0.5], velocity=[0.1], effort=[0.0]),
    JointState(), Twist(), String(data='four zeros: \0\0\0\0\0\0\0\0')], ids=str)
def test_what_rclpy_wrote_is_read_by_rosbags_itself(tmp_path, message):
    """It pads a trailing empty list, and others take that for a broken message."""
    kind = f'{type(message).__module__.split(".")[0]}/msg/{type(message).__name__}'
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/a', kind)
        writer.write('/a', 5, serialize_message(message))
    with AnyReader([tmp_path / 'bag']) as reader:
        (connection, _, raw), = reader.messages()
        read = reader.deserialize(raw, connection.msgtype)
    if isinstance(message, JointState):
        assert read.name == message.name
        for field in ('position', 'velocity', 'effort'):
            np.testing.assert_array_equal(getattr(read, field), getattr(message, field))


def test_bad_bags_are_refused_with_what_is_missing(tmp_path):
    write_bag(tmp_path / 'bag', commands=False)
    with pytest.raises(RecordingError, match='no messages on joint_command'):
        read_recording(tmp_path / 'bag')
    with pytest.raises(RecordingError, match='is not a readable bag'):
        read_recording(tmp_path / 'nothing')
    write_bag(tmp_path / 'good')
    with pytest.raises(RecordingError, match=r"joints \['elbow'\] were not recorded"):
        read_recording(tmp_path / 'good').states.select(('elbow',))
