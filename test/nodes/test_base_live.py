"""A Panda on a base, with real processes: out of reach, there, and at rest."""

from __future__ import annotations

from conftest import PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Twist
from live_helpers import LIVE, station
from nav_msgs.msg import Odometry
import numpy as np
import pinocchio as pin
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile

from redundant_planner.io.robot_files import load_robot

pytestmark = LIVE

FILE = [ROBOTS / 'panda.yaml']
ARM = {'urdf': PANDA_URDF, 'base': 'holonomic'}
ROBOT = load_robot(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF), base='holonomic')
NAMES = list(ROBOT.joint_names)


@pytest.fixture
def ros():
    with station() as (ros, processes):
        node = ros.node
        ros.target = node.create_publisher(PoseStamped, 'target_pose', 10)
        ros.progress, ros.odometry, ros.driven = [], [], []
        node.create_subscription(
            DiagnosticArray, 'planner_node/target', lambda m: ros.progress.extend(m.status),
            QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        node.create_subscription(Odometry, 'odom', ros.odometry.append, 100)
        node.create_subscription(Twist, 'base_cmd_vel', ros.driven.append, 100)
        processes.start('fake_hardware_node', FILE, {
            **ARM, 'initial_joints': NAMES[3:], 'initial_positions': PANDA_READY.tolist()})
        processes.start('planner_node', FILE, ARM)
        ros.wait_for(lambda: ros.commands and ros.odometry
                     and ros.target.get_subscription_count(), 'start')
        yield ros


def place(ros):
    pose = ros.odometry[-1].pose.pose
    return np.array((pose.position.x, pose.position.y,
                     2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)))


def test_a_target_out_of_the_arms_reach_is_reached(ros):
    start = ROBOT.kinematics(np.concatenate((np.zeros(3), PANDA_READY)))
    message = PoseStamped()
    p, o = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = (start.tip_position + (0.5, 1.0, 0.1)).tolist()
    o.x, o.y, o.z, o.w = pin.Quaternion(start.tip_rotation).coeffs().tolist()
    ros.target.publish(message)
    ros.wait_for(lambda: ros.progress and ros.progress[-1].message == 'reached', 'the target')
    arm = ros.state(NAMES[3:])
    tip = ROBOT.kinematics(np.concatenate((place(ros), arm))).tip_position
    assert np.linalg.norm(tip - (p.x, p.y, p.z)) < 3e-3
    way = np.linalg.norm(place(ros)[:2])
    assert 0.3 < way < 1.3  # the arm does its part
    speeds = np.array([np.hypot(m.linear.x, m.linear.y) for m in ros.driven])
    assert 0.1 < speeds.max() <= 0.5 * np.sqrt(2.0) + 1e-6
    # Where its odometry says that it moves is where it was told to.
    twists = [np.array((m.twist.twist.linear.x, m.twist.twist.linear.y)) for m in ros.odometry]
    assert max(map(np.linalg.norm, twists)) > 0.1
    ros.wait_for(lambda: np.hypot(ros.driven[-1].linear.x, ros.driven[-1].linear.y) < 1e-3,
                 'rest')
