"""~/posture with real processes: what it sets, what it refuses, and an elbow that follows."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from live_helpers import LIVE, station
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState

pytestmark = LIVE

NAMES = list(make_panda().joint_names)


@pytest.fixture
def ros():
    with station() as (ros, processes):
        ros.posture = ros.node.create_publisher(JointState, 'planner_node/posture', 10)
        ros.said = []
        ros.node.create_subscription(Log, '/rosout', lambda m: ros.said.append(m.msg), 100)
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], {
            'urdf': PANDA_URDF, 'initial_joints': NAMES,
            'initial_positions': PANDA_READY.tolist()})
        processes.start('planner_node', [ROBOTS / 'panda.yaml'],
                        {'urdf': PANDA_URDF, 'posture.weight': 20.0})
        ros.wait_for(lambda: ros.commands and ros.posture.get_subscription_count()
                     and ros.twist.get_subscription_count(), 'start')
        yield ros


def preferred(ros):
    answer = ros.call(GetParameters, 'get_parameters',
                      GetParameters.Request(names=['posture.preferred']))
    return list(answer.values[0].string_array_value)


@pytest.mark.long
def test_a_posture_is_set_live_and_the_elbow_goes_there(ros):
    ros.posture.publish(JointState(name=['panda_joint3'], position=[0.4]))
    ros.wait_for(lambda: preferred(ros) == ['panda_joint3=0.4'], 'the posture')
    # To and fro: what remains of it is the null space's.
    for speed in (0.08, -0.08):
        for axis in range(2):
            twist = np.zeros(6)
            twist[axis] = speed
            count = len(ros.commands)
            ros.drive_until(twist, lambda count=count: len(ros.commands) > count + 300, 'motion')
    ros.wait_for(ros.at_rest, 'rest')
    assert ros.state(NAMES)[2] > 0.2

    for message, reason in (
            (JointState(name=['elbow'], position=[0.0]), "names joint 'elbow'"),
            (JointState(name=['panda_joint4'], position=[1.0]), "joint 'panda_joint4' goes from"),
            (JointState(name=['panda_joint4'], position=[np.nan]), 'joint=position'),
            (JointState(name=['panda_joint4']), '1 names and 0 positions')):
        ros.wait_for(lambda reason=reason: any(
            'posture ignored' in line and reason in line for line in ros.said), reason,
            meanwhile=lambda message=message: (ros.posture.publish(message), ros.spin(0.2)))
    assert preferred(ros) == ['panda_joint3=0.4']
    ros.posture.publish(JointState())
    ros.wait_for(lambda: preferred(ros) == [], 'no posture')
