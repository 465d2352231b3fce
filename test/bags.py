"""Bags that the tests make: a simulated motion, recorded as if it had been live."""

from __future__ import annotations

from conftest import make_paper_arm
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, String

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.parameter_files import read_robot_parameters
from redundant_planner.io.parameter_writer import parameter_file_text
from redundant_planner.io.resources import share_directory
from redundant_planner.io.scenario import load_scenario
from redundant_planner.nodes.messages import markers_of
from redundant_planner.simulation import simulate

DT = 0.004
ORIGIN = 1_700_000_000 * 10**9
SCENARIO = load_scenario(share_directory() / 'config' / 'scenarios' / 'paper.yaml')
KINDS = {
    'joint_states': 'sensor_msgs/msg/JointState', 'joint_command': 'sensor_msgs/msg/JointState',
    'cmd_vel': 'geometry_msgs/msg/Twist', 'obstacles': 'visualization_msgs/msg/MarkerArray',
    'robot_description': 'std_msgs/msg/String',
    'planner_node/configuration': 'std_msgs/msg/String'}


def paper_motion(seconds=1.0, method='dynamic_factor'):
    """Simulate the paper's scenario for a while; return robot, parameters and motion."""
    robot, parameters = make_paper_arm(), PlannerParameters(method=method)
    motion = simulate(Planner(robot, parameters), SCENARIO.start_posture(robot),
                      SCENARIO.twist_at, Scene.of(SCENARIO.obstacles), seconds, DT)
    return robot, parameters, motion


def ns(time):
    return ORIGIN + round(time * 1e9)


def write(path, robot, parameters, motion, topics=tuple(KINDS), more=(), ticks=(),
          twist_at=SCENARIO.twist_at):
    """Record motions: states and commands every tick, the twist as often, obstacles once."""
    file = share_directory() / 'config' / 'robots' / 'paper_2p5r.yaml'
    robot_parameters, _ = read_robot_parameters(file)
    with BagWriter(path) as bag:
        for topic in topics:
            bag.add_topic(f'/{topic}', KINDS[topic])
        if 'robot_description' in topics:
            bag.write('/robot_description', ORIGIN, serialize_message(String(data=robot.urdf)))
        if 'planner_node/configuration' in topics:
            bag.write_text('/planner_node/configuration', ORIGIN, parameter_file_text(
                robot_parameters, robot, {}, parameters, PlannerNodeParameters()))
        if 'obstacles' in topics:
            bag.write('/obstacles', ORIGIN, serialize_message(
                markers_of(SCENARIO.obstacles, robot.base_frame)))
        if ticks:
            bag.add_topic('/planner_node/ticks', 'std_msgs/msg/Float64MultiArray')
        for i, numbers in enumerate(ticks):
            bag.write('/planner_node/ticks', ns(DT * i),
                      serialize_message(Float64MultiArray(data=numbers)))
        for part in (motion, *more):
            for i, dq in enumerate(part.velocities):
                at = ns(part.times[i])
                if 'cmd_vel' in topics:
                    bag.write_twist('/cmd_vel', at, twist_at(motion.times[i]))
                for topic in ('joint_states', 'joint_command'):
                    if topic in topics:
                        bag.write_joints(
                            f'/{topic}', at, robot.joint_names, part.positions[i], dq)
    return path
