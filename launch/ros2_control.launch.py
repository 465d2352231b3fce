"""A Panda on ros2_control's mock hardware: `ros2 launch redundant_planner ros2_control.launch.py`.

With `output:=joint_trajectory` or `output:=position_commands` the planner commands another
controller. docs/ros2_control.md has what each is good for.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from redundant_planner.io.resources import resolve

# The controller of each output, and the topic that it listens to.
CONTROLLERS = {
    'velocity_commands': ('arm_velocity', 'commands'),
    'position_commands': ('arm_position', 'commands'),
    'joint_trajectory': ('arm_trajectory', 'joint_trajectory')}
URDF = 'package://moveit_resources_panda_description/urdf/panda.urdf'


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the nodes follow from the output."""
    return LaunchDescription([
        DeclareLaunchArgument('output', default_value='velocity_commands',
                              description=f'one of {", ".join(CONTROLLERS)}'),
        DeclareLaunchArgument('urdf', default_value=URDF, description='of a Panda'),
        OpaqueFunction(function=_nodes),
    ])


def with_hardware(urdf: str, hardware: str) -> str:
    """Return a URDF's text with what ros2_control needs to know of the arm in it."""
    body, end, rest = urdf.rpartition('</robot>')
    return f'{body}{hardware}{end}{rest}'


def _nodes(context) -> list[Node]:
    """Make the arm's nodes, the spawner of its controllers, and the planner."""
    config = Path(get_package_share_directory('redundant_planner')) / 'config'
    output = LaunchConfiguration('output').perform(context)
    controller, topic = CONTROLLERS[output]
    urdf = LaunchConfiguration('urdf').perform(context)
    controllers = str(config / 'ros2_control' / 'panda_controllers.yaml')
    description = {'robot_description': with_hardware(
        resolve(urdf).read_text(),
        (config / 'ros2_control' / 'panda_ros2_control.xml').read_text())}
    return [
        Node(package='robot_state_publisher', executable='robot_state_publisher',
             parameters=[description], output='screen'),
        Node(package='controller_manager', executable='ros2_control_node',
             parameters=[controllers], output='screen'),
        Node(package='controller_manager', executable='spawner',
             arguments=['joint_state_broadcaster', controller, '--param-file', controllers],
             output='screen'),
        Node(package='redundant_planner', executable='planner_node',
             parameters=[str(config / 'robots' / 'panda.yaml'),
                         {'urdf': urdf, 'outputs': [output], 'rate': 250}],
             remappings=[(output, f'/{controller}/{topic}')], output='screen'),
    ]
