"""Two hands on one body, with real processes: twists, targets, one object, and exact replays."""

from __future__ import annotations

import time

from conftest import HANDS, make_two_handed, two_handed_urdf
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
from live_helpers import LIVE, station
from nav_msgs.msg import Path
import numpy as np
import pinocchio as pin
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool
from topic_recorder import TopicRecorder

from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.tools.replayed_ticks import again, differences

pytestmark = LIVE

BODY = make_two_handed()
NAMES = list(BODY.joint_names)
START = [0.2, 0.0, 0.4, 0.3, 0.2, 0.9, 0.1, 0.4, 0.4, -0.3, -0.2, 0.9, -0.1, 0.4]
VALUES = {'robot_description': two_handed_urdf(), 'tips': list(HANDS), 'link_shapes': 'straight',
          'link_radius': 0.03}
TOPICS = {
    'joint_states': JointState, 'joint_command': JointState,
    'planner_node/configuration': String, 'planner_node/ticks': Float64MultiArray}
LEFT, RIGHT = HANDS


@pytest.fixture
def ros():
    with station() as (ros, processes):
        node = ros.node
        ros.twists = {tip: node.create_publisher(Twist, f'{tip}/cmd_vel', 1)
                      for tip in (*HANDS, 'object')}
        ros.targets = {tip: node.create_publisher(PoseStamped, f'{tip}/target_pose', 10)
                       for tip in (*HANDS, 'object')}
        ros.paths = {tip: node.create_publisher(Path, f'{tip}/target_path', 10)
                     for tip in (*HANDS, 'object')}
        ros.progress, ros.said = [], []
        node.create_subscription(
            DiagnosticArray, 'planner_node/target', lambda m: ros.progress.extend(m.status),
            QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        node.create_subscription(Log, '/rosout', lambda m: ros.said.append(m.msg), 100)
        ros.recorder = TopicRecorder(ros, TOPICS)
        processes.start('fake_hardware_node', [], {
            'robot_description': VALUES['robot_description'], 'initial_joints': NAMES,
            'initial_positions': START})
        # What is known of the lateness of measurements counts twice for two hands.
        processes.start('planner_node', [], {
            **VALUES, 'publish_ticks': True, 'drive.dead_time': 0.006})
        ros.wait_for(lambda: ros.commands and all(
            p.get_subscription_count() for p in
                (*ros.twists.values(), *ros.targets.values(), *ros.paths.values())),
            'start')
        yield ros


def publisher(ros, **twists):
    """Return what sends twists (6,) on topics of tips."""
    def publish():
        for tip, twist in twists.items():
            message = Twist()
            (message.linear.x, message.linear.y, message.linear.z, message.angular.x,
             message.angular.y, message.angular.z) = map(float, twist)
            ros.twists[tip].publish(message)

    return publish


def drive(ros, seconds, *, moves=True, **twists):
    """Send twists (6,) on topics of tips for some time, once they move the arm."""
    publish = publisher(ros, **twists)
    if moves:
        ros.wait_for(ros.moves, 'motion', meanwhile=publish)
    end = time.monotonic() + seconds
    ros.wait_for(lambda: time.monotonic() > end, 'the end of a drive', meanwhile=publish)
    ros.wait_for(ros.at_rest if moves else ros.stops, 'rest')


def hands(ros):
    return BODY.kinematics(ros.state(NAMES)).tips.each


def stamped(position, rotation, seconds=0.0):
    message = PoseStamped()
    p, o = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = np.asarray(position, dtype=float).tolist()
    o.x, o.y, o.z, o.w = pin.Quaternion(np.asarray(rotation)).coeffs().tolist()
    message.header.stamp.sec = int(seconds)
    message.header.stamp.nanosec = round(1e9 * (seconds % 1.0))
    return message


def send(ros, tip, position, rotation):
    ros.progress.clear()
    ros.targets[tip].publish(stamped(position, rotation))


def send_path(ros, tip, position, rotation, end, seconds=1.5):
    """Send a chunk of poses from one place to another."""
    ros.progress.clear()
    shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 16))
    ros.paths[tip].publish(Path(poses=[
        stamped(position + share * (np.asarray(end) - position), rotation, 0.1 + seconds * i / 15)
        for i, share in enumerate(shares)]))


def reached(ros):
    return bool(ros.progress) and ros.progress[-1].message == 'reached'


def relative(poses):
    left, right = poses
    return np.concatenate((left.rotation.T @ (right.position - left.position),
                           (left.rotation.T @ right.rotation).ravel()))


# How much of the hands' relative pose may be lost [m, 1]. In even ticks it is 2e-4 at most
# (test_several_tips.py); where the machine does other work a late tick costs more.
LOST = 2e-3


def test_two_hands_by_topics_and_again_from_the_bag(ros, tmp_path):
    before = hands(ros)
    drive(ros, 1.0, left_hand=(0.0, 0.0, 0.05, 0, 0, 0), right_hand=(0.0, 0.04, 0.0, 0, 0, 0))
    after = hands(ros)
    left, right = (b.position - a.position for a, b in zip(before, after))
    assert left[2] > 0.03 and np.abs(left[:2]).max() < 1e-3
    assert right[1] > 0.02 and np.abs(right[[0, 2]]).max() < 1e-3

    # A target for each hand: both arrive.
    goals = {LEFT: before[0].position + (0.03, 0.05, 0.0), RIGHT: before[1].position}
    for pose, (tip, position) in zip(before, goals.items()):
        send(ros, tip, position, pose.rotation)
    ros.wait_for(lambda: reached(ros), 'both hands at their targets')
    for pose, position in zip(hands(ros), goals.values()):
        assert np.linalg.norm(pose.position - position) < 2e-3

    # A chunk for each hand, and back.
    for ends in ([at + (0.0, 0.0, 0.04) for at in goals.values()], list(goals.values())):
        for (tip, pose), end in zip(zip(HANDS, hands(ros)), ends):
            send_path(ros, tip, pose.position, pose.rotation, end)
        ros.wait_for(lambda: reached(ros), 'both hands at the ends of their chunks')
        for pose, end in zip(hands(ros), ends):
            assert np.linalg.norm(pose.position - end) < 2e-3

    # Coupled: their relative pose stays, and each alone is not obeyed.
    ros.wait_for(ros.at_rest, 'rest')
    answer = ros.call(SetBool, 'couple', SetBool.Request(data=True))
    assert answer.success and 'object/cmd_vel' in answer.message
    held = relative(hands(ros))
    drive(ros, 1.0, object=(0.02, 0.0, 0.04, 0.1, 0.0, 0.0))
    assert np.abs(relative(hands(ros)) - held).max() < LOST
    assert hands(ros)[0].position[2] - goals[LEFT][2] > 0.02
    # A pause brings it to rest as a whole.
    keep_on = publisher(ros, object=(0.0, 0.0, -0.05, 0.0, 0.1, 0.0))
    ros.wait_for(lambda: np.abs(ros.commands[-1].velocity).max() > 0.05, 'motion',
                 meanwhile=keep_on)
    assert ros.call(SetBool, 'pause', SetBool.Request(data=True), meanwhile=keep_on).success
    ros.wait_for(ros.stops, 'a stop')
    late = time.monotonic() + 0.3
    ros.wait_for(lambda: time.monotonic() > late, 'the end of twists on their way')
    assert np.abs(relative(hands(ros)) - held).max() < LOST
    assert ros.call(SetBool, 'pause', SetBool.Request(data=False)).success
    there = hands(ros)
    drive(ros, 0.3, moves=False, left_hand=(0.0, 0.0, 0.1, 0, 0, 0))
    assert np.abs(hands(ros)[0].position - there[0].position).max() < 1e-4
    ros.wait_for(lambda: any('cmd_vel ignored: the tips are coupled' in said
                             for said in ros.said), 'a word about that')
    middle = np.mean([pose.position for pose in hands(ros)], axis=0)
    send(ros, 'object', middle + (0.0, 0.0, -0.03), np.eye(3))
    ros.wait_for(lambda: reached(ros), 'the object at its target')
    assert np.abs(relative(hands(ros)) - held).max() < LOST
    send_path(ros, 'object', middle + (0.0, 0.0, -0.03), np.eye(3), middle)
    ros.wait_for(lambda: reached(ros), 'the object at the end of its chunk')
    assert np.abs(relative(hands(ros)) - held).max() < LOST
    ros.wait_for(ros.at_rest, 'rest')
    assert ros.call(SetBool, 'couple', SetBool.Request(data=False)).success
    drive(ros, 0.5, right_hand=(0.0, 0.0, 0.05, 0, 0, 0))
    assert np.abs(relative(hands(ros)) - held).max() > 5e-3

    ros.recorder.write(tmp_path / 'bag')
    with open_bag(tmp_path / 'bag', '') as opened:
        inputs = read_inputs(opened, None, '', '')
    assert inputs.robot.tips == HANDS and len(inputs.ticks) > 500
    apart = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(apart) > 500 and apart.max() == 0.0
