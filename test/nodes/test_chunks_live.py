"""Chunks on real topics: a policy's, a planned trajectory, what is refused, and exact replay."""

from __future__ import annotations

import time

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
from live_helpers import LIVE, station
from nav_msgs.msg import Path
import numpy as np
import pinocchio as pin
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from topic_recorder import TopicRecorder
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.tools.replay_bag import main as replay_bag
from redundant_planner.tools.replayed_ticks import again, differences

pytestmark = LIVE

ROBOT = make_panda()
NAMES = list(ROBOT.joint_names)
ARM = {'urdf': PANDA_URDF, 'initial_joints': NAMES, 'initial_positions': PANDA_READY.tolist()}
TOPICS = {
    'joint_states': JointState, 'joint_command': JointState, 'cmd_vel': Twist,
    'target_path': Path, 'target_trajectory': JointTrajectory,
    'planner_node/configuration': String, 'planner_node/ticks': Float64MultiArray}
END = np.array([0.3, 0.1, -0.2, 0.2, 0.1, -0.1, 0.3])


@pytest.fixture
def ros():
    with station() as (ros, processes):
        ros.path = ros.node.create_publisher(Path, 'target_path', 10)
        ros.trajectory = ros.node.create_publisher(JointTrajectory, 'target_trajectory', 10)
        ros.progress, ros.said = [], []
        ros.node.create_subscription(
            DiagnosticArray, 'planner_node/target', lambda m: ros.progress.extend(m.status),
            QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        ros.node.create_subscription(Log, '/rosout', lambda m: ros.said.append(m.msg), 100)
        ros.recorder = TopicRecorder(ros, TOPICS)
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], ARM)
        processes.start('planner_node', [ROBOTS / 'panda.yaml'],
                        {'urdf': PANDA_URDF, 'publish_ticks': True})
        ros.wait_for(lambda: ros.commands and ros.path.get_subscription_count()
                     and ros.trajectory.get_subscription_count()
                     and ros.twist.get_subscription_count(), 'start')
        yield ros


def now(ros):
    return ros.node.get_clock().now().nanoseconds / 1e9


def stamp(seconds):
    return Time(nanoseconds=round(seconds * 1e9)).to_msg()


def trajectory(times, points, begin=None):
    """A trajectory of all joints; without a stamp it begins as it arrives."""
    message = JointTrajectory(joint_names=NAMES)
    if begin is not None:
        message.header.stamp = stamp(begin)
    for due, q in zip(times, points):
        point = JointTrajectoryPoint(positions=q.tolist())
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(
            round(due * 1e9), 10**9)
        message.points.append(point)
    return message


def path(dues, positions, rotation):
    """A path of poses with one orientation, due by the clock."""
    message = Path()
    message.header.frame_id, message.header.stamp = ROBOT.base_frame, stamp(dues[0])
    for due, position in zip(dues, positions):
        pose = PoseStamped()
        pose.header.stamp = stamp(due)
        p, o = pose.pose.position, pose.pose.orientation
        p.x, p.y, p.z = position.tolist()
        o.x, o.y, o.z, o.w = pin.Quaternion(rotation).coeffs().tolist()
        message.poses.append(pose)
    return message


def state(ros):
    return ros.progress[-1].message if ros.progress else ''


def value(ros, key):
    return float({v.key: v.value for v in ros.progress[-1].values}[key])


def smooth(x):
    x = np.clip(x, 0.0, 1.0)
    return (x**3 * (10.0 - 15.0 * x + 6.0 * x**2))[:, None]


def replays(ros, folder):
    """Write the bag, compute it again, and return its inputs."""
    ros.recorder.write(folder / 'bag')
    with open_bag(folder / 'bag') as opened:
        inputs = read_inputs(opened, None, '', '')
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 300 and found.max() < 1e-9
    assert replay_bag([str(folder / 'bag'), '--out', str(folder / 'other'),
                       '--method', 'variational']) == 0
    return inputs


@pytest.mark.long
def test_a_policy_of_joints_and_a_trajectory_and_their_bag_replays(ros, tmp_path):
    # A chunk of 0.8 s every 0.4 s, on one motion of 3 s, each some milliradians beside it.
    random, begin, sent = np.random.default_rng(1), now(ros) + 0.2, 0

    def policy():
        nonlocal sent
        if now(ros) > begin + 0.4 * sent - 0.05:
            t = 0.4 * sent + np.arange(17) / 20.0
            points = PANDA_READY + smooth(t / 3.0) * END + random.normal(0.0, 3e-3, 7)
            ros.trajectory.publish(trajectory(t - t[0], points, begin + t[0]))
            sent += 1

    ros.wait_for(lambda: now(ros) > begin + 3.4, 'the end', meanwhile=policy)
    ros.wait_for(lambda: state(ros) == 'reached', 'reached')
    np.testing.assert_allclose(ros.state(NAMES), PANDA_READY + END, atol=0.015)
    velocities = np.array([command.velocity for command in ros.commands])
    assert np.abs(velocities).max() > 0.1
    # Back along a planned trajectory that begins as it arrives.
    t = np.linspace(0.0, 2.0, 21)
    here = ros.state(NAMES)
    ros.trajectory.publish(trajectory(t, here + smooth(t / 2.0) * (PANDA_READY - here)))
    ros.wait_for(lambda: state(ros) == 'moving', 'motion')  # what was said before is of the policy
    ros.wait_for(lambda: state(ros) == 'reached', 'reached')
    np.testing.assert_allclose(ros.state(NAMES), PANDA_READY, atol=1e-3)
    assert value(ros, 'behind [s]') < 0.5 and value(ros, 'beside the chunk [m, rad]') < 1e-3
    # What it cannot do it refuses by name.
    for message, reason in (
            (JointTrajectory(joint_names=['elbow']),
             "target_trajectory ignored: it names 'elbow'"),
            (trajectory([1.0], [PANDA_READY + 3.0]),
             f"target_trajectory ignored: the chunk takes joint '{NAMES[0]}'"),
            (trajectory(t, [PANDA_READY] * 21, now(ros) - 100.0),
             'target_trajectory ignored: by its stamps its last point was due'),
            (trajectory(t, [PANDA_READY] * 21, now(ros) + 100.0),
             'target_trajectory ignored: by its stamps it begins')):
        ros.wait_for(lambda reason=reason: any(reason in line for line in ros.said), reason,
                     meanwhile=lambda message=message: (
                         ros.trajectory.publish(message), ros.spin(0.2)))
    ros.wait_for(ros.at_rest, 'rest')
    inputs = replays(ros, tmp_path)
    assert sum(isinstance(tick.target, Chunk) for _, tick in inputs.ticks) >= sent
    assert sum(tick.goes_on for _, tick in inputs.ticks) > 500


@pytest.mark.long
def test_a_path_of_the_tip_and_a_twist_that_ends_it(ros, tmp_path):
    begin = ROBOT.kinematics(ros.state(NAMES))
    first = now(ros) + 0.1
    t = np.linspace(0.0, 3.0, 31)
    way = begin.tip_position + smooth(t / 3.0) * np.array([0.1, 0.2, -0.05])
    ros.path.publish(path(first + t, way, begin.tip_rotation))
    ros.wait_for(lambda: now(ros) > first + 1.5, 'the middle')
    tip = ROBOT.kinematics(ros.state(NAMES)).tip_position
    off = np.abs(tip - (begin.tip_position + smooth(
        np.linspace(0.4, 0.7, 400)) * np.array([0.1, 0.2, -0.05]))).max(axis=1).min()
    assert off < 3e-3
    ros.wait_for(lambda: state(ros) == 'reached', 'reached')
    there = ROBOT.kinematics(ros.state(NAMES))
    np.testing.assert_allclose(there.tip_position, way[-1], atol=1e-3)
    # A twist takes over within a chunk; nothing of that is left.
    first = now(ros)
    ros.path.publish(path(first + t, way[::-1], begin.tip_rotation))
    ros.wait_for(lambda: now(ros) > first + 1.0, 'motion')
    ros.drive_until(np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]),
                    lambda: state(ros) == 'no target', 'no target')
    ros.wait_for(ros.at_rest, 'rest')
    still = ros.state(NAMES)
    time.sleep(0.5)
    ros.spin(0.1)
    np.testing.assert_allclose(ros.state(NAMES), still, atol=1e-3)
    message = path([0.0, 0.0], way[:2], begin.tip_rotation)
    ros.wait_for(lambda: any('target_path ignored: its poses have no stamps' in line
                             for line in ros.said), 'a word', meanwhile=lambda: (
                                 ros.path.publish(message), ros.spin(0.2)))
    replays(ros, tmp_path)
