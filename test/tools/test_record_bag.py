"""record_bag as a process of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

from geometry_msgs.msg import PoseStamped
from live_helpers import LIVE, PATIENCE, station
import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.tools.record_bag import main as record_bag

pytestmark = LIVE
COUNT = 2000


def listens(ros, name, topic='joint_command'):
    """Whether a node of this name has a subscription: others on this machine may have one."""
    return any(found.node_name == name
               for found in ros.node.get_subscriptions_info_by_topic(topic))


@pytest.mark.first_alone
@pytest.mark.parametrize('end', [signal.SIGKILL, signal.SIGINT])
def test_nothing_is_lost_at_a_thousand_hertz_and_a_kill_leaves_it_readable(tmp_path, end):
    """Numbered messages: all of them are there, or after a kill the first ones."""
    folder = tmp_path / 'bag'
    with station() as (ros, processes):
        numbered = ros.node.create_publisher(JointState, 'joint_command', QoSProfile(depth=1000))
        ros.wait_for(lambda: numbered.get_subscription_count(), 'the station itself')
        recorder = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.record_bag', str(folder)],
            env=processes.environment, stdout=subprocess.PIPE, text=True)
        try:
            ros.wait_for(lambda: listens(ros, 'record_bag'), 'recorder')
            # Both sides have to know of each other: what it has acknowledged, the recorder has.
            numbered.publish(JointState(name=['count'], position=[-1.0]))
            ros.wait_for(lambda: numbered.wait_for_all_acked(Duration(seconds=0.01)), 'a receipt')
            begin = time.monotonic()
            for i in range(COUNT):
                while time.monotonic() < begin + 0.001 * i:
                    ros.spin(0.0)
                numbered.publish(JointState(name=['count'], position=[float(i)]))
            time.sleep(0.5)
            recorder.send_signal(end)
            out, _ = recorder.communicate(timeout=PATIENCE)
        finally:
            recorder.kill()
    with open_bag(folder) as bag:
        counted = np.concatenate([item.positions[:, 0] for item in bag.read(['joint_command'])
                                  if isinstance(item, JointChunk)])
        assert any('was not closed' in p for p in bag.problems) == (end == signal.SIGKILL)
    everything, counted = len(counted), counted[counted >= 0.0]
    np.testing.assert_array_equal(counted, np.arange(len(counted)))
    if end == signal.SIGINT:
        assert len(counted) == COUNT and recorder.returncode == 0
        assert f'{everything:8d}  /joint_command' in out
    else:
        assert len(counted) > COUNT / 4


def test_once_it_says_that_it_records_it_hears_who_sends_one_target_and_is_gone(tmp_path):
    with station() as (ros, processes):
        heard, said = [], tmp_path / 'said'
        qos = QoSProfile(depth=1)  # as the planner's
        ros.node.create_subscription(PoseStamped, 'target_pose', heard.append, qos)
        with said.open('w') as out:
            recorder = subprocess.Popen(
                [sys.executable, '-m', 'redundant_planner.tools.record_bag',
                 str(tmp_path / 'bag')], env=processes.environment, stdout=out)
        try:
            ros.wait_for(lambda: 'recording to' in said.read_text(), 'the line')
            assert listens(ros, 'record_bag', 'target_pose')
            sender = ros.node.create_publisher(PoseStamped, 'target_pose', qos)
            ros.wait_for(lambda: sender.get_subscription_count() == 2, 'both that hear it')
            sender.publish(PoseStamped())
            # Who goes before that takes along what is still on its way.
            ros.wait_for(lambda: sender.wait_for_all_acked(Duration(seconds=0.01)), 'receipts')
            ros.wait_for(lambda: heard, 'the target')
            ros.node.destroy_publisher(sender)
            recorder.send_signal(signal.SIGINT)
            assert recorder.wait(PATIENCE) == 0
        finally:
            recorder.kill()
    assert '1  /target_pose' in said.read_text()
    with open_bag(tmp_path / 'bag') as bag:
        # What somebody hears but nobody sends is no topic of the bag.
        assert bag.topics == {'target_pose': 1}


def test_a_short_recording_begins_once_it_is_ready(tmp_path):
    with station() as (_, processes):
        recorder = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.record_bag', str(tmp_path / 'bag'),
             '--duration', '0.3', '--ros-args', '-r', '__ns:=/nobody'],
            env=processes.environment, stdout=subprocess.PIPE, text=True)
        out, _ = recorder.communicate(timeout=PATIENCE)
    assert recorder.returncode == 0
    # Of the station's topics /diagnostics alone is in no namespace.
    assert ': 1 topic is there yet' in out, out


def test_what_is_there_is_not_overwritten(tmp_path, capfd):
    assert record_bag([str(tmp_path)]) == 2
    assert 'exists already' in capfd.readouterr().err
    assert record_bag(['--repair', str(tmp_path)]) == 2
    assert 'is not an MCAP bag' in capfd.readouterr().err
