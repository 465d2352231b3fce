"""Drive an arm by hand: `ros2 launch redundant_planner teleop.launch.py device:=gamepad`.

Starts a planner, a simulated arm and the nodes of the device. `arm:=false` leaves the planner and
the arm out, for those who run theirs already. docs/devices.md has the devices.
"""

import os
from pathlib import Path
import shutil

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from redundant_planner.io.devices import device_file, DEVICES, installed_drivers, run_line
from redundant_planner.io.scenario import load_scenario


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments; the nodes follow from the device."""
    config = Path(get_package_share_directory('redundant_planner')) / 'config'
    return LaunchDescription([
        DeclareLaunchArgument('device', description=f'one of {", ".join(DEVICES)}'),
        DeclareLaunchArgument('arm', default_value='true',
                              description='whether to start a planner and a simulated arm too'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='of all nodes: that of the arm that is driven'),
        DeclareLaunchArgument('scenario', default_value=str(config / 'scenarios' / 'paper.yaml'),
                              description='scenario file: the robot and its start posture'),
        DeclareLaunchArgument('params', default_value=str(config / 'planner' / 'default.yaml'),
                              description='parameter file for the planner'),
        DeclareLaunchArgument('rviz', default_value='false',
                              description='whether to show it all in RViz'),
        OpaqueFunction(function=_drivers),
        OpaqueFunction(function=_arm, condition=IfCondition(LaunchConfiguration('arm'))),
        Node(package='rviz2', executable='rviz2', output='screen',
             arguments=['-d', str(config / 'rviz' / 'planner.rviz')],
             condition=IfCondition(LaunchConfiguration('rviz'))),
    ])


def _drivers(context) -> list[Node | LogInfo]:
    """Make the device's nodes. A device without its packages ends the launch with one line."""
    device = LaunchConfiguration('device').perform(context)
    file, namespace = device_file(device), LaunchConfiguration('namespace').perform(context)
    actions = []
    for driver in installed_drivers(device):
        # launch's own terminal is not read by the nodes it starts: they take a window.
        window = shutil.which('xterm') if os.environ.get('DISPLAY') else None
        if driver.reads_keys and not window:
            actions.append(LogInfo(msg='keys are read in a terminal; type there: '
                                       + run_line(driver, file, namespace)))
            continue
        actions.append(Node(
            package=driver.package, executable=driver.executable, name=driver.name,
            namespace=LaunchConfiguration('namespace'),
            parameters=[str(file)], remappings=list(driver.remap), output='screen',
            prefix='xterm -e' if driver.reads_keys else None))
    return actions


def _arm(context) -> list[Node]:
    """Make the planner, with what it needs to know of the device, and the simulated arm."""
    scenario = load_scenario(Path(LaunchConfiguration('scenario').perform(context)))
    robot = str(scenario.robot_file)
    start = {'initial_joints': list(scenario.start),
             'initial_positions': list(scenario.start.values())}
    device = str(device_file(LaunchConfiguration('device').perform(context)))
    return [
        Node(package='redundant_planner', executable='fake_hardware_node',
             namespace=LaunchConfiguration('namespace'),
             parameters=[robot, start], output='screen'),
        Node(package='redundant_planner', executable='planner_node',
             namespace=LaunchConfiguration('namespace'),
             parameters=[robot, LaunchConfiguration('params'), device], output='screen'),
    ]
