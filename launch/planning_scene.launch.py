"""A Panda among the objects of MoveIt's planning scene.

`ros2 launch redundant_planner planning_scene.launch.py` starts fake hardware, the planner and
planning_scene_obstacles. With `arm:=false` it starts the last one alone, for an arm and a planner
that run already.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

START = {'initial_joints': [f'panda_joint{i}' for i in range(1, 8)],
         'initial_positions': [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]}


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes."""
    config = Path(get_package_share_directory('redundant_planner')) / 'config'
    robot = LaunchConfiguration('robot')
    arm = IfCondition(LaunchConfiguration('arm'))
    return LaunchDescription([
        DeclareLaunchArgument('robot', default_value=str(config / 'robots' / 'panda.yaml'),
                              description='parameter file of the arm'),
        DeclareLaunchArgument('params', default_value=str(config / 'planner' / 'default.yaml'),
                              description='parameter file for the planner'),
        DeclareLaunchArgument('arm', default_value='true',
                              description='whether to start fake hardware and the planner, too'),
        Node(package='redundant_planner', executable='fake_hardware_node', output='screen',
             parameters=[robot, START], condition=arm),
        Node(package='redundant_planner', executable='planner_node', output='screen',
             parameters=[robot, LaunchConfiguration('params')], condition=arm),
        Node(package='redundant_planner', executable='planning_scene_obstacles', output='screen',
             parameters=[robot]),
    ])
