"""A Panda that only sees by a camera: `ros2 launch redundant_planner camera.launch.py`.

Fake hardware, the test camera, cloud_obstacles, the planner, and a scenario whose obstacles only
the camera sees.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from redundant_planner.io.scenario import load_scenario


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the nodes follow from the scenario that is named."""
    config = Path(get_package_share_directory('redundant_planner')) / 'config'
    return LaunchDescription([
        DeclareLaunchArgument(
            'scenario', default_value=str(config / 'scenarios' / 'panda_camera.yaml'),
            description='scenario file: robot, start posture, twist, obstacles'),
        DeclareLaunchArgument(
            'camera', default_value=str(config / 'perception' / 'panda.yaml'),
            description='parameter file for depth_camera and cloud_obstacles'),
        DeclareLaunchArgument('params', default_value=str(config / 'planner' / 'default.yaml'),
                              description='parameter file for the planner'),
        OpaqueFunction(function=_nodes),
    ])


def _nodes(context) -> list[Node]:
    """Make the nodes once the arguments are known."""
    scenario_file = LaunchConfiguration('scenario').perform(context)
    scenario = load_scenario(Path(scenario_file))
    robot, camera = str(scenario.robot_file), LaunchConfiguration('camera')
    start = {'initial_joints': list(scenario.start),
             'initial_positions': list(scenario.start.values())}
    parameters = {
        'fake_hardware_node': [robot, start], 'depth_camera': [robot, camera],
        'cloud_obstacles': [robot, camera],
        'planner_node': [robot, LaunchConfiguration('params')],
        'scenario_player': [{'scenario': scenario_file}]}
    return [
        Node(package='redundant_planner', executable=name, parameters=given, output='screen',
             remappings=[('obstacles', 'camera_obstacles')] if name == 'scenario_player' else [])
        for name, given in parameters.items()]
