"""What launch/ros2_control.launch.py starts, and that its files agree with the planner's."""

from __future__ import annotations

from xml.etree import ElementTree

from conftest import PANDA_READY, PANDA_URDF, ROBOTS
from launch_stand_ins import launch_file
import pytest
import yaml

from redundant_planner.core.errors import PlannerError
from redundant_planner.io.node_parameters import OUTPUTS, PlannerNodeParameters
from redundant_planner.io.parameter_files import read_parameter_file
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import load_robot

CONFIG = share_directory() / 'config'
CONTROLLERS = yaml.safe_load((CONFIG / 'ros2_control' / 'panda_controllers.yaml').read_text())
MANAGER = CONTROLLERS['controller_manager']['ros__parameters']
BLOCK = ElementTree.parse(CONFIG / 'ros2_control' / 'panda_ros2_control.xml').getroot()
PACKAGES = ('controller_manager', 'forward_command_controller', 'joint_state_broadcaster',
            'joint_trajectory_controller', 'robot_state_publisher')
# The last part of the topic on which a controller of a type takes commands.
TOPICS = {'forward_command_controller/ForwardCommandController': 'commands',
          'joint_trajectory_controller/JointTrajectoryController': 'joint_trajectory'}


@pytest.fixture
def robot_file(tmp_path):
    """The Panda's file with a URDF that this machine has."""
    file = tmp_path / 'panda.yaml'
    text = (ROBOTS / 'panda.yaml').read_text()
    file.write_text(text.replace(
        'package://moveit_resources_panda_description/urdf/panda.urdf', str(PANDA_URDF)))
    return str(file)


@pytest.fixture
def launch(monkeypatch, tmp_path):
    return launch_file(monkeypatch, tmp_path, 'ros2_control', PACKAGES)


@pytest.mark.parametrize('output', OUTPUTS)
def test_the_planner_commands_the_controller_that_is_active(launch, robot_file, output):
    state, manager, active, inactive, planner = launch(robot=robot_file, output=output)
    assert [node.executable for node in (state, manager, active, inactive, planner)] == [
        'robot_state_publisher', 'ros2_control_node', 'spawner', 'spawner', 'planner_node']
    (file,) = manager.parameters
    assert active.arguments[-2:] == inactive.arguments[-2:] == ['--param-file', file]
    broadcaster, controller = active.arguments[:-2]
    assert broadcaster == 'joint_state_broadcaster'
    *others, flag = inactive.arguments[:-2]
    assert flag == '--inactive'
    # Every controller is started once, under a name that the manager knows.
    assert sorted([broadcaster, controller, *others]) == sorted(set(MANAGER) - {'update_rate'})
    assert planner.parameters[-1] == {'outputs': [output]}
    assert planner.remappings == [(output, f'/{controller}/{TOPICS[MANAGER[controller]["type"]]}')]
    wanted = CONTROLLERS[controller]['ros__parameters']
    interfaces = wanted.get('command_interfaces') or [wanted['interface_name']]
    assert interfaces == ['velocity' if output == 'velocity_commands' else 'position']


def test_the_manager_gets_the_arms_urdf_with_the_block(launch, robot_file):
    (description,) = launch(robot=robot_file)[0].parameters
    text = description['robot_description']
    assert text.value_type is str
    robot = ElementTree.fromstring(text.args[0])
    assert len(robot.findall('joint')) == len(ElementTree.parse(PANDA_URDF).findall('joint'))
    assert robot.find('ros2_control').get('name') == BLOCK.get('name')


def test_the_files_agree_with_each_other_and_with_the_planner():
    arm = load_robot(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF))
    rate = read_parameter_file(CONFIG / 'planner' / 'default.yaml')['rate']
    assert MANAGER['update_rate'] == rate == PlannerNodeParameters().rate
    has = {joint.get('name'): {kind: {e.get('name') for e in joint.findall(f'{kind}_interface')}
                               for kind in ('command', 'state')} for joint in BLOCK.iter('joint')}
    assert tuple(has) == arm.joint_names
    for name in set(MANAGER) - {'update_rate', 'joint_state_broadcaster'}:
        wanted = CONTROLLERS[name]['ros__parameters']
        assert tuple(wanted['joints']) == arm.joint_names
        commands = wanted.get('command_interfaces') or [wanted['interface_name']]
        for joint in wanted['joints']:
            assert set(commands) <= has[joint]['command']
            assert set(wanted.get('state_interfaces', ())) <= has[joint]['state']
    # What joint_states are to have.
    assert all(joint['state'] == {'position', 'velocity'} for joint in has.values())
    parameters = {e.get('name'): e.text for e in BLOCK.findall('hardware/param')}
    assert parameters == {'calculate_dynamics': 'true'}
    start = [float(e.text) for e in BLOCK.iter('param') if e.get('name') == 'initial_value']
    assert start == list(PANDA_READY)


def test_what_is_missing_ends_the_launch_with_one_line(launch, robot_file, monkeypatch, tmp_path):
    bare = tmp_path / 'bare.yaml'
    bare.write_text('/**: {ros__parameters: {tip_frame: tool0}}')
    with pytest.raises(PlannerError, match="gives no robot: set 'urdf'"):
        launch(robot=str(bare))
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    with pytest.raises(PlannerError, match='sudo apt install ros-jazzy-controller-manager '):
        launch(robot=robot_file)
