"""mujoco_hardware_node as a body with two hands, which a planner moves both at once."""

from __future__ import annotations

from conftest import EXAMPLE_ROBOTS, HANDS, make_two_handed, two_handed_urdf
from geometry_msgs.msg import Twist
from live_helpers import LIVE, station
import numpy as np
import pytest

from redundant_planner.core.target.start_posture import start_posture
from redundant_planner.io.robot_files import Robot

pytestmark = LIVE
SPEED = 0.05
# Its joints have a torque that carries it.
TWO_HANDED = {'robot_description': two_handed_urdf().replace('effort="1"', 'effort="300"'),
              'tips': list(HANDS), 'link_shapes': 'straight', 'link_radius': 0.03}
BAXTER = {'urdf': EXAMPLE_ROBOTS / 'baxter_description' / 'urdf' / 'baxter.urdf',
          'tips': ['left_gripper', 'right_gripper'], 'base_frame': 'base'}


def bodies():
    yield pytest.param(TWO_HANDED, make_two_handed, id='two_handed')
    yield pytest.param(BAXTER, lambda: Robot.from_urdf(
        BAXTER['urdf'], tips=BAXTER['tips'], base_frame=BAXTER['base_frame']),
        id='baxter', marks=pytest.mark.long)


@pytest.mark.live
@pytest.mark.parametrize(('values', 'make'), bodies())
def test_both_hands_go_their_ways(values, make):
    robot = make()
    names, start = list(robot.joint_names), start_posture(robot)
    with station() as (ros, processes):
        processes.start('mujoco_hardware_node', [], {
            **values, 'initial_joints': names, 'initial_positions': start.tolist()})
        processes.start('planner_node', [], {**values, 'acceleration_max': [5.0]})
        publishers = [ros.node.create_publisher(Twist, f'{tip}/cmd_vel', 1)
                      for tip in robot.tips]
        ros.wait_for(lambda: ros.commands and all(
            publisher.get_subscription_count() for publisher in publishers), 'start')
        before = robot.kinematics(ros.state(names)).tip_positions

        def publish():
            for publisher, way in zip(publishers, (1.0, -1.0)):
                message = Twist()
                message.linear.z = way * SPEED
                publisher.publish(message)

        def moved():
            return robot.kinematics(ros.state(names)).tip_positions - before

        ros.wait_for(lambda: moved()[0, 2] > 0.05 and moved()[1, 2] < -0.05, 'both hands',
                     meanwhile=publish)
        ros.wait_for(ros.at_rest, 'rest')
        # Each went straight, by about as much, and no torque ran out.
        assert np.abs(moved()[:, :2]).max() < 5e-3
        np.testing.assert_allclose(moved()[0, 2], -moved()[1, 2], atol=0.01)
