"""Planner, fake hardware and a scenario's player: `ros2 launch redundant_planner demo.launch.py`.

With `play:=false` nothing is played and the arm waits for cmd_vel. With
`hardware:=mujoco_hardware_node` the arm has mass, drives and contacts.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from redundant_planner.io.scenario import load_scenario


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the nodes follow from the scenario that is named."""
    config = Path(get_package_share_directory('redundant_planner')) / 'config'
    return LaunchDescription([
        DeclareLaunchArgument('scenario', default_value=str(config / 'scenarios' / 'paper.yaml'),
                              description='scenario file: robot, start posture, twist, obstacles'),
        DeclareLaunchArgument('params', default_value=str(config / 'planner' / 'default.yaml'),
                              description='parameter file for the planner'),
        DeclareLaunchArgument('hardware', default_value='fake_hardware_node',
                              description='the simulated arm: fake_hardware_node, or '
                                          'mujoco_hardware_node, which has mass'),
        DeclareLaunchArgument('play', default_value='true',
                              description='whether to play the twist of the scenario'),
        DeclareLaunchArgument('rviz', default_value='false',
                              description='whether to show it all in RViz'),
        OpaqueFunction(function=_nodes),
    ])


def _nodes(context) -> list[Node]:
    """Make the nodes once the arguments are known."""
    scenario_file = LaunchConfiguration('scenario').perform(context)
    scenario = load_scenario(Path(scenario_file))
    robot = str(scenario.robot_file)
    start = {'initial_joints': list(scenario.start),
             'initial_positions': list(scenario.start.values())}
    return [
        Node(package='redundant_planner', executable=LaunchConfiguration('hardware'),
             parameters=[robot, start], output='screen'),
        Node(package='redundant_planner', executable='planner_node',
             parameters=[robot, LaunchConfiguration('params')], output='screen'),
        Node(package='redundant_planner', executable='scenario_player',
             parameters=[{'scenario': scenario_file}], output='screen',
             condition=IfCondition(LaunchConfiguration('play'))),
        Node(package='rviz2', executable='rviz2', output='screen',
             arguments=['-d', str(Path(get_package_share_directory('redundant_planner'))
                                  / 'config' / 'rviz' / 'planner.rviz')],
             condition=IfCondition(LaunchConfiguration('rviz'))),
    ]
