"""Two arms that keep clear of each other: `ros2 launch redundant_planner two_arms.launch.py`.

Each has a planner and fake hardware in its namespace, /left or /right. `go_to` moves one of them:
`ros2 run redundant_planner go_to --relative --position 0 0 0.1 --ros-args -r __ns:=/left`.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

START = {'initial_joints': [f'panda_joint{i}' for i in range(1, 8)],
         'initial_positions': [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]}


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes of both arms."""
    config = Path(get_package_share_directory('redundant_planner')) / 'config'
    files = [LaunchConfiguration('robot'), LaunchConfiguration('arms')]
    return LaunchDescription([
        DeclareLaunchArgument('robot', default_value=str(config / 'robots' / 'panda.yaml'),
                              description='parameter file of the arms, which are alike'),
        DeclareLaunchArgument('arms', default_value=str(config / 'planner' / 'two_arms.yaml'),
                              description='parameter file with what differs: /left/** and '
                                          '/right/**'),
        *(Node(package='redundant_planner', executable=node, namespace=side, output='screen',
               parameters=[*files, *more])
          for side in ('left', 'right')
          for node, more in (('fake_hardware_node', [START]), ('planner_node', [])))])
