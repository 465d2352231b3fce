"""Targets, with real processes: there, away, around a wall, and bags that replay it."""

from __future__ import annotations

import time

from bench import CREEPING
from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
from live_helpers import LIVE, station
import numpy as np
import pinocchio as pin
import pytest
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from topic_recorder import TopicRecorder
from visualization_msgs.msg import MarkerArray

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.nodes.messages import markers_of
from redundant_planner.tools.replay_bag import main as replay_bag
from redundant_planner.tools.replayed_ticks import again, differences

pytestmark = LIVE

ROBOT = make_panda()
NAMES = list(ROBOT.joint_names)
ARM = {'urdf': PANDA_URDF, 'initial_joints': NAMES, 'initial_positions': PANDA_READY.tolist()}
TOPICS = {
    'joint_states': JointState, 'joint_command': JointState, 'cmd_vel': Twist,
    'target_pose': PoseStamped, 'target_joints': JointState, 'planner_node/configuration': String,
    'planner_node/ticks': Float64MultiArray, 'obstacles': MarkerArray}


def pose(position, rotation, frame=''):
    """A PoseStamped without a stamp."""
    message = PoseStamped()
    message.header.frame_id = frame
    p, o = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = np.asarray(position, dtype=float).tolist()
    o.x, o.y, o.z, o.w = pin.Quaternion(np.asarray(rotation)).coeffs().tolist()
    return message


@pytest.fixture
def ros():
    with station() as (ros, processes):
        ros.target = ros.node.create_publisher(PoseStamped, 'target_pose', 50)
        ros.progress, ros.said = [], []
        ros.node.create_subscription(
            DiagnosticArray, 'planner_node/target', lambda m: ros.progress.extend(m.status),
            QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        ros.node.create_subscription(Log, '/rosout', lambda m: ros.said.append(m.msg), 100)
        ros.recorder = TopicRecorder(ros, TOPICS)
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], ARM)
        processes.start('planner_node', [ROBOTS / 'panda.yaml'],
                        {'urdf': PANDA_URDF, 'publish_ticks': True, 'limits.linear_speed': 0.2})
        ros.wait_for(lambda: ros.commands and ros.target.get_subscription_count()
                     and ros.twist.get_subscription_count(), 'start')
        yield ros


def tip(ros):
    return ROBOT.kinematics(ros.state(NAMES))


def state(ros):
    return ros.progress[-1].message if ros.progress else ''


def target(ros):
    """The target that the planner last spoke of, as text."""
    return {v.key: v.value for s in ros.progress[-1:] for v in s.values}.get('target')


def go(ros, message, until):
    """Publish a target once, and wait for a state that is of this one."""
    before = target(ros)
    ros.target.publish(message)
    ros.wait_for(lambda: state(ros) == until and target(ros) != before, until)


def test_to_a_pose_and_on_from_there_and_its_bag_replays(ros, tmp_path):
    begin = tip(ros)
    goal = begin.tip_position + (0.1, 0.15, 0.05)
    turned = pin.exp3(np.array([0.0, 0.0, 0.3])) @ begin.tip_rotation
    go(ros, pose(goal, turned, 'panda_link0'), 'reached')
    ros.wait_for(ros.at_rest, 'rest')
    there = tip(ros)
    np.testing.assert_allclose(there.tip_position, goal, atol=1e-3)
    assert np.linalg.norm(pin.log3(there.tip_rotation.T @ turned)) < np.radians(0.2)
    values = {v.key: v.value for v in ros.progress[-1].values}
    assert float(values['distance [m]']) < 1e-3 and float(values['expected time [s]']) < 0.01
    np.testing.assert_allclose(
        np.array(values['target'].split(), dtype=float)[:3], goal, atol=1e-6)

    # From there 5 cm along the hand's own z: what the tip's frame means.
    go(ros, pose((0.0, 0.0, 0.05), np.eye(3), 'panda_hand'), 'reached')
    ros.wait_for(ros.at_rest, 'rest')
    np.testing.assert_allclose(
        tip(ros).tip_position, goal + 0.05 * turned[:, 2], atol=1e-3)

    # A twist takes over at once; afterwards nothing is left of the target.
    ros.drive_until(np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]),
                    lambda: state(ros) == 'no target', 'no target')
    ros.wait_for(ros.at_rest, 'rest')
    ros.recorder.write(tmp_path / 'bag')
    with open_bag(tmp_path / 'bag') as opened:
        inputs = read_inputs(opened, None, '', '')
    assert sum(tick.target is not None for _, tick in inputs.ticks) > 200
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 500 and found.max() < 1e-9
    assert replay_bag([str(tmp_path / 'bag'), '--out', str(tmp_path / 'again')]) == 0
    assert replay_bag([str(tmp_path / 'bag'), '--out', str(tmp_path / 'other'),
                       '--method', 'variational']) == 0


@pytest.mark.long
def test_around_a_wall_and_its_bag_replays(ros, tmp_path):
    """The line to the target leads through the wall; the planner finds a way around it."""
    goal = PANDA_READY + np.array([1.5, 0.3, 0.0, -0.2, 0.0, 0.0, 0.0])
    wall = Obstacle.box('wall', (0.3, 0.3, 0.35), (0.3, 0.04, 0.5))
    ros.obstacles.publish(markers_of([wall], ROBOT.base_frame))
    ros.wait_for(lambda: any(v.value == '1' for s in ros.statuses[-1:] for v in s.values
                             if v.key == 'obstacles'), 'the wall')
    there = ROBOT.kinematics(goal)
    ros.target.publish(pose(there.tip_position, there.tip_rotation))
    ros.wait_for(lambda: state(ros) == 'reached', 'reached')
    assert {'thinking', 'moving'} <= {status.message for status in ros.progress}
    # A state from before may come after this word, and the last millimetre takes a moment.
    ros.wait_for(ros.at_rest, 'rest')
    np.testing.assert_allclose(tip(ros).tip_position, there.tip_position, atol=1e-3)
    ros.recorder.write(tmp_path / 'bag')
    with open_bag(tmp_path / 'bag') as opened:
        inputs = read_inputs(opened, None, '', '')
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 500 and found.max() < 1e-9
    postures = np.array([tick.q for _, tick in inputs.ticks])
    motion = Motion.through(capsules_of(ROBOT), postures)
    assert motion.to_obstacles((wall,), 0.004).distance > 0.005


@pytest.mark.long
def test_to_joint_positions_and_its_bag_replays(ros, tmp_path):
    joints = ros.node.create_publisher(JointState, 'target_joints', 10)
    ros.wait_for(joints.get_subscription_count, 'listener')
    begin = ros.state(NAMES)
    joints.publish(JointState(name=[NAMES[3], NAMES[0]], position=[begin[3] + 0.3, 0.5]))
    ros.wait_for(lambda: state(ros) == 'reached', 'reached')
    ros.wait_for(ros.at_rest, 'rest')
    expected = begin.copy()
    expected[[3, 0]] = begin[3] + 0.3, 0.5
    np.testing.assert_allclose(ros.state(NAMES), expected, atol=1e-3)
    assert target(ros).split()[0] == f'{NAMES[0]}=0.500000'
    # From there to a pose, and what it cannot do it refuses by name.
    goal = tip(ros).tip_position + (0.0, -0.1, 0.05)
    go(ros, pose(goal, tip(ros).tip_rotation), 'reached')
    np.testing.assert_allclose(tip(ros).tip_position, goal, atol=1e-3)
    for message, reason in (
            (JointState(name=['elbow'], position=[0.1]),
             "target_joints ignored: it names 'elbow'"),
            (JointState(name=[NAMES[3]], position=[0.5]),
             f"target_joints ignored: the target of joint '{NAMES[3]}' is 0.5; it must be")):
        ros.wait_for(lambda reason=reason: any(reason in line for line in ros.said), reason,
                     meanwhile=lambda message=message: (
                         joints.publish(message), ros.spin(0.2)))
    ros.wait_for(ros.at_rest, 'rest')
    ros.recorder.write(tmp_path / 'bag')
    with open_bag(tmp_path / 'bag') as opened:
        inputs = read_inputs(opened, None, '', '')
    assert sum(isinstance(tick.target, np.ndarray) for _, tick in inputs.ticks) > 100
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 300 and found.max() < 1e-9
    assert replay_bag([str(tmp_path / 'bag'), '--out', str(tmp_path / 'other'),
                       '--method', 'variational']) == 0


@pytest.mark.long
def test_a_stream_in_bursts_is_followed_without_a_thought_and_its_bag_replays(ros, tmp_path):
    """A circle at 72 Hz that comes once in 0.1 s, by stamps of a clock of its own."""
    begin, there = time.monotonic(), tip(ros)
    sent: list[float] = []

    def place(t):
        return there.tip_position + 0.05 * np.array((0.0, np.sin(2.0 * t), 1.0 - np.cos(2.0 * t)))

    def burst():
        now = time.monotonic() - begin
        if now < (sent[-1] if sent else 0.0) + 0.1:
            return
        for stamp in np.arange(len(sent), int(72.0 * now) + 1) / 72.0:
            message = pose(place(stamp), there.tip_rotation)
            message.header.stamp = Time(seconds=100.0 + stamp).to_msg()
            ros.target.publish(message)
            sent.append(stamp)

    ros.wait_for(lambda: len(sent) > 400, 'the stream', meanwhile=burst)
    ros.wait_for(lambda: np.linalg.norm(tip(ros).tip_position - place(sent[-1])) < 1e-3, 'its end')
    ros.wait_for(ros.at_rest, 'rest')
    assert {'moving'} <= {status.message for status in ros.progress} <= {'moving', 'reached'}
    ros.recorder.write(tmp_path / 'bag')
    with open_bag(tmp_path / 'bag') as opened:
        inputs = read_inputs(opened, None, '', '')
    assert sum(len(tick.news) for _, tick in inputs.ticks) == len(sent)
    assert max(len(tick.news) for _, tick in inputs.ticks) > 4
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 1000 and found.max() < 1e-9
    # On its circle, wherever along it.
    tips = np.array([ROBOT.kinematics(tick.q).tip_position for _, tick in inputs.ticks[250:-500]])
    radii = np.linalg.norm(tips - there.tip_position - (0.0, 0.0, 0.05), axis=1)
    assert np.abs(np.median(radii) - 0.05) < 1e-3


def test_a_zero_cmd_vel_lets_go_and_bad_targets_are_refused(ros):
    begin = tip(ros).tip_position
    far = pose(begin + (0.15, 0.25, 0.0), tip(ros).tip_rotation)
    ros.target.publish(far)
    ros.wait_for(lambda: state(ros) == 'moving', 'motion')
    ros.twist.publish(Twist())
    ros.wait_for(ros.at_rest, 'rest')
    ros.wait_for(lambda: state(ros) == 'no target', 'no target')
    assert np.linalg.norm(tip(ros).tip_position - (begin + (0.15, 0.25, 0.0))) > 0.05
    bad = pose(begin, np.eye(3))
    bad.pose.orientation.w = 3.0
    for message, reason in (
            (pose(begin, np.eye(3), 'elsewhere'), "target_pose ignored: it is given in frame "
                                                  "'elsewhere'; without tf2_ros it must be in"),
            (bad, 'target_pose ignored: its orientation is the quaternion'),
            (pose((np.nan, 0.0, 0.0), np.eye(3)), 'target_pose ignored: its position is')):
        ros.wait_for(lambda reason=reason: any(reason in line for line in ros.said), reason,
                     meanwhile=lambda message=message: (
                         ros.target.publish(message), ros.spin(0.2)))
    # What an arm that is measured late corrects is no motion.
    assert np.abs(ros.commands[-1].velocity).max() < CREEPING
    out = pose(begin + (1.5, 0.0, 0.0), np.eye(3))
    go(ros, out, 'out of reach')
    values = {v.key: v.value for v in ros.progress[-1].values}
    assert float(values['ends off by [m, rad]']) > 0.3


def after(ros, count=100):
    """The joints after so many more states."""
    ros.states.clear()
    ros.wait_for(lambda: len(ros.states) >= count, 'states')
    return ros.state(NAMES)


def test_a_zero_twist_right_after_a_target_lets_go_of_it(ros):
    """Whichever spoke last commands, also where a tick hears both."""
    joints = ros.node.create_publisher(JointState, 'target_joints', 10)
    ros.wait_for(joints.get_subscription_count, 'the planner')
    begin = ros.state(NAMES)
    for turn in (0.3, -0.3, 0.3):
        joints.publish(JointState(name=NAMES[-1:], position=[begin[-1] + turn]))
        ros.twist.publish(Twist())
        np.testing.assert_allclose(after(ros), begin, atol=1e-4)


def test_a_target_is_forgotten_while_two_send_twists(ros):
    second = Node('second', context=ros.node.context)
    second.create_publisher(Twist, 'cmd_vel', 10)
    begin = tip(ros)
    ros.wait_for(lambda: any('cmd_vel has 2 publishers' in text for text in ros.said), 'a word')
    ros.target.publish(pose(begin.tip_position + (0.0, 0.1, 0.0), begin.tip_rotation))
    ros.wait_for(lambda: any('target forgotten: cmd_vel has 2' in t for t in ros.said), 'another')
    second.destroy_node()
    ros.wait_for(lambda: ros.node.count_publishers('cmd_vel') == 1, 'only one')
    for _ in range(5):
        after(ros)
    np.testing.assert_allclose(tip(ros).tip_position, begin.tip_position, atol=1e-4)
