"""What launch/ros2_control.launch.py starts, and its files: launch itself tests do not have."""

from __future__ import annotations

import runpy
import sys
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

from conftest import make_panda, PANDA_READY, PANDA_URDF
import numpy as np
import pytest
import yaml

from redundant_planner.io.node_parameters import OUTPUTS, PlannerNodeParameters
from redundant_planner.io.resources import share_directory

CONFIG = share_directory() / 'config' / 'ros2_control'


class Noted(SimpleNamespace):
    """Keeps the arguments that it is made with."""

    def __init__(self, *args, **kwargs):
        super().__init__(args=args, **kwargs)

    def perform(self, context):
        """Return the value of a launch argument."""
        return context[self.args[0]]


@pytest.fixture
def file(monkeypatch):
    """The launch file's names, with stand-ins for what it imports."""
    kinds = {'launch': ['LaunchDescription'],
             'launch.actions': ['DeclareLaunchArgument', 'OpaqueFunction'],
             'launch.substitutions': ['LaunchConfiguration'],
             'launch_ros': [], 'launch_ros.actions': ['Node']}
    for module, names in kinds.items():
        made = ModuleType(module)
        for name in names:
            setattr(made, name, type(name, (Noted,), {}))
        monkeypatch.setitem(sys.modules, module, made)
    packages = ModuleType('ament_index_python.packages')
    packages.get_package_share_directory = lambda name: str(share_directory())
    monkeypatch.setitem(sys.modules, 'ament_index_python', ModuleType('ament_index_python'))
    monkeypatch.setitem(sys.modules, 'ament_index_python.packages', packages)
    return runpy.run_path(str(share_directory() / 'launch' / 'ros2_control.launch.py'))


@pytest.mark.parametrize('output', OUTPUTS)
def test_arm_controllers_and_planner_start_for_each_output(file, output):
    arguments, nodes = file['generate_launch_description']().args[0][:-1], []
    assert {a.args[0] for a in arguments} == {'output', 'urdf'}
    nodes = file['_nodes']({'output': output, 'urdf': str(PANDA_URDF)})
    publisher, manager, spawner, planner = nodes
    tree = ElementTree.fromstring(publisher.parameters[0]['robot_description'])
    assert len(tree.findall('ros2_control')) == 1 and len(tree.findall('link')) > 7
    controller = spawner.arguments[1]
    assert manager.parameters == [str(CONFIG / 'panda_controllers.yaml')]
    assert planner.parameters[1]['outputs'] == [output]
    assert planner.remappings == [(output, f'/{controller}/' + (
        'joint_trajectory' if output == 'joint_trajectory' else 'commands'))]


def test_controllers_take_the_planners_joints_in_its_order_at_its_rate():
    text = (CONFIG / 'panda_controllers.yaml').read_text()
    assert '*' not in text and '&' not in text  # ROS reads no aliases
    content = yaml.safe_load(text)
    manager = content.pop('controller_manager')['ros__parameters']
    assert manager.pop('update_rate') == PlannerNodeParameters().rate
    assert set(manager) - {'joint_state_broadcaster'} == set(content)
    for name, values in content.items():
        assert tuple(values['ros__parameters']['joints']) == make_panda().joint_names, name


def test_the_hardware_has_every_joint_and_starts_inside_the_limits():
    hardware = ElementTree.fromstring((CONFIG / 'panda_ros2_control.xml').read_text())
    joints = hardware.findall('joint')
    assert tuple(joint.get('name') for joint in joints) == make_panda().joint_names
    starts = [float(joint.find('state_interface/param').text) for joint in joints]
    np.testing.assert_allclose(starts, PANDA_READY)
    for joint in joints:
        assert {c.get('name') for c in joint.findall('command_interface')} == {
            'position', 'velocity'}
