"""A Panda behind ros2_control: `ros2 launch redundant_planner ros2_control.launch.py`.

A controller manager with mock hardware, its controllers, and the planner. `output:=` chooses what
the planner commands, and with it the controller that is active. docs/ros2_control.md has the rest.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription
from redundant_planner.core.errors import ParameterError
from redundant_planner.io.hardware_block import with_hardware
from redundant_planner.io.parameter_files import read_robot_parameters, urdf_text
from redundant_planner.io.resources import read_text
from redundant_planner.io.ros_packages import check_installed

PACKAGES = ('controller_manager', 'forward_command_controller', 'joint_state_broadcaster',
            'joint_trajectory_controller', 'robot_state_publisher')
# Output of the planner → controller, and its topic.
CONTROLLERS = {
    'velocity_commands': ('arm_velocity', 'commands'),
    'position_commands': ('arm_position', 'commands'),
    'joint_trajectory': ('arm_trajectory', 'joint_trajectory'),
}


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the nodes follow from the robot's file and the output."""
    config = Path(get_package_share_directory('redundant_planner')) / 'config'
    return LaunchDescription([
        DeclareLaunchArgument('output', default_value='velocity_commands',
                              choices=list(CONTROLLERS),
                              description='what the planner commands; its controller is active'),
        DeclareLaunchArgument('robot', default_value=str(config / 'robots' / 'panda.yaml'),
                              description='parameter file of the arm'),
        DeclareLaunchArgument(
            'hardware', default_value=str(config / 'ros2_control' / 'panda_ros2_control.xml'),
            description='file with the <ros2_control> block that the URDF gets'),
        DeclareLaunchArgument(
            'controllers', default_value=str(config / 'ros2_control' / 'panda_controllers.yaml'),
            description='parameter file of the controller manager and its controllers'),
        DeclareLaunchArgument('params', default_value=str(config / 'planner' / 'default.yaml'),
                              description='parameter file for the planner'),
        OpaqueFunction(function=_nodes),
    ])


def _nodes(context) -> list[Node]:
    """Make the nodes once the arguments are known."""
    check_installed('ros2_control', PACKAGES)
    given = {name: LaunchConfiguration(name).perform(context)
             for name in ('output', 'robot', 'hardware', 'controllers', 'params')}
    robot = Path(given['robot'])
    parameters, _ = read_robot_parameters(robot)
    urdf = urdf_text(parameters, robot.parent)
    if not urdf:
        raise ParameterError(f"'{robot}' gives no robot: set 'urdf'")
    description = with_hardware(urdf, read_text(Path(given['hardware'])))
    active, topic = CONTROLLERS[given['output']]
    inactive = [name for name, _ in CONTROLLERS.values() if name != active]
    return [
        # The manager takes the URDF from the topic.
        Node(package='robot_state_publisher', executable='robot_state_publisher', output='screen',
             parameters=[{'robot_description': ParameterValue(description, value_type=str)}]),
        Node(package='controller_manager', executable='ros2_control_node', output='screen',
             parameters=[given['controllers']]),
        *(Node(package='controller_manager', executable='spawner', output='screen',
               arguments=[*names, '--param-file', given['controllers']])
          for names in (('joint_state_broadcaster', active), (*inactive, '--inactive'))),
        Node(package='redundant_planner', executable='planner_node', output='screen',
             parameters=[given['robot'], given['params'], {'outputs': [given['output']]}],
             remappings=[(given['output'], f'/{active}/{topic}')]),
    ]
