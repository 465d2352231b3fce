"""What the planner waits for, and robot_description: late, unexpanded, again, and changed."""

from __future__ import annotations

from bench import ARM_VALUES, FILE
from conftest import ROBOTS
from live_helpers import LIVE, station
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

pytestmark = LIVE

TEXT = (ROBOTS / 'paper_2p5r.urdf').read_text()
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WAITING = {'tip_frame': 'tool_tip', 'link_shapes': 'straight', 'axes': ['vx', 'vy', 'vz']}
FORWARD = np.array([0.0, -0.1, 0.0, 0.0, 0.0, 0.0])


def listen(ros):
    """Return what the planner says, and the topic."""
    said = []
    ros.node.create_subscription(
        Log, '/rosout', lambda m: said.append(m.msg) if m.name == 'planner_node' else None,
        QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    return said, ros.node.create_publisher(String, 'robot_description', LATCHED)


def says(said, *words):
    return lambda: any(all(word in line for word in words) for line in said)


@pytest.mark.long
def test_a_late_description_is_waited_for_and_an_unexpanded_one_is_refused_by_joint():
    with station() as (ros, processes):
        said, description = listen(ros)
        ros.node.destroy_publisher(description)
        processes.start('planner_node', values=WAITING)
        ros.wait_for(says(said, 'waiting for a URDF on the topic /robot_description for 10 s: '
                                'nobody publishes there'), 'a reminder')
        description = ros.node.create_publisher(String, 'robot_description', LATCHED)
        description.publish(String(data=TEXT.replace('upper="0.4"', 'upper="${stroke}"', 1)))
        ros.wait_for(says(said, "/robot_description: the limit of joint 'd1' of the URDF has "
                                "upper='${stroke}'; it takes a number"), 'the refusal')
        ros.wait_for(says(said, 'for 20 s: what came cannot be used'), 'another reminder')
        description.publish(String(data=TEXT))
        ros.wait_for(says(said, 'planning for'), 'the start')
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        ros.drive_until(FORWARD, ros.moves, 'motion')
        reminders = sum('waiting for a URDF' in line for line in said)
        ros.drive(FORWARD, 6.0)
        assert sum('waiting for a URDF' in line for line in said) == reminders


def test_the_same_again_is_nothing_and_a_changed_one_is_said_while_the_arm_moves_on():
    with station() as (ros, processes):
        said, description = listen(ros)
        description.publish(String(data=TEXT))
        processes.start('planner_node', values=WAITING)
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        ros.drive_until(FORWARD, ros.moves, 'motion')
        description.publish(String(data=TEXT))
        ros.drive(FORWARD, 0.5)
        changed = '/robot_description has changed, and planner_node goes on with the URDF that ' \
                  'it began with: restart it to take the new one'
        assert not says(said, changed)()
        ros.commands.clear()
        for text in (TEXT.replace('upper="0.4"', 'upper="0.3"', 1), '<robot'):
            before = said.count(changed)
            description.publish(String(data=text))
            ros.drive_until(FORWARD / 4.0, lambda before=before: said.count(changed) > before,
                            'the word')
        # Each is said once, and the arm did not stop for it.
        description.publish(String(data=TEXT))
        ros.drive(FORWARD / 4.0, 0.5)
        assert said.count(changed) == 2
        assert all(np.any(message.velocity) for message in ros.commands)


def test_an_arm_that_does_not_say_where_it_is_is_waited_for_in_words():
    with station() as (ros, processes):
        said, description = listen(ros)
        ros.node.destroy_publisher(ros.joint_states)
        description.publish(String(data=TEXT))
        processes.start('planner_node', values=WAITING)
        ros.wait_for(says(said, "waiting for joint_states: nobody publishes on '/joint_states'"),
                     'word of nobody')
        ros.node.create_publisher(JointState, 'joint_states', 1)
        ros.wait_for(says(said, "'/station' publishes on '/joint_states', and nothing has come"),
                     'word of the silent one')
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        ros.drive_until(FORWARD, ros.moves, 'motion')
        assert sum('waiting for joint_states' in line for line in said) == 2
