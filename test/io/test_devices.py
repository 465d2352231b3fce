"""The devices and their files: what they name exists upstream, and ROS reads it as it is meant."""

from __future__ import annotations

from importlib import import_module

from device_nodes import DECLARED, GONE, LET_GO, SERVICE_KEYS, STOP_KEY
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
import yaml

from redundant_planner.core.errors import ParameterError, PlannerError
from redundant_planner.io.devices import (
    device_file,
    device_settings,
    DEVICES,
    drivers_of,
    installed_drivers,
    run_line,
)
from redundant_planner.io.node_parameters import PlannerNodeParameters
from redundant_planner.io.resources import share_directory
from redundant_planner.io.ros_packages import apt_line
from redundant_planner.nodes.ros_parameters import changed


def commands_of(settings):
    """The commands of joy_teleop: name → key → value."""
    commands = {}
    for key, value in settings.items():
        name, _, rest = key.partition('.')
        commands.setdefault(name, {})[rest] = value
    return commands


@pytest.mark.parametrize('device', DEVICES)
def test_each_file_has_a_section_for_each_node_and_none_besides(device):
    nodes = {driver.name for driver in drivers_of(device)}
    assert nodes <= set(device_settings(device)) <= nodes | {'planner_node'}


@pytest.mark.parametrize('device', DEVICES)
def test_every_parameter_is_one_that_its_node_declares_with_that_type(device):
    settings = device_settings(device)
    changed([PlannerNodeParameters()], settings.pop('planner_node', {}))
    settings.pop('joy_teleop', None)
    for node, values in settings.items():
        for name, value in values.items():
            assert type(value) is DECLARED[node].get(name), f'{node}: {name}'


@pytest.mark.parametrize('device', ['gamepad', 'spacemouse'])
def test_the_services_are_those_of_the_planner_with_their_requests(device):
    commands = commands_of(device_settings(device)['joy_teleop'])
    assert set(commands) == {'pause', 'go_on', 'reset'}
    for command in commands.values():
        assert {key.partition('.')[0] for key in command} <= SERVICE_KEYS
        assert command['type'] == 'service' and len(command['buttons']) == 1
        package, kind, name = command['interface_type'].split('/')
        request = getattr(import_module(f'{package}.{kind}'), name).Request()
        for key, value in command.items():
            if key.startswith('service_request.'):
                assert type(getattr(request, key.partition('.')[2])) is type(value)


def test_no_button_of_the_gamepad_does_two_things():
    settings = device_settings('gamepad')
    sticks = settings['teleop_twist_joy_node']
    commands = commands_of(settings['joy_teleop'])
    buttons = [sticks['enable_button'], sticks['enable_turbo_button'],
               *(command['buttons'][0] for command in commands.values())]
    assert len(set(buttons)) == len(buttons) == 5
    # joy_teleop takes a button that the message lacks for one that is down: SDL's list has 21.
    assert all(0 <= button < 21 for button in buttons)


def test_letting_go_can_stop_the_arm():
    """What each file must say so that the dead-man rule holds."""
    gamepad = device_settings('gamepad')
    assert gamepad['teleop_twist_joy_node']['require_enable_button'] is True
    assert gamepad['game_controller_node']['sticky_buttons'] is False
    # A message may come late by three periods before the arm takes the stick for let go.
    timeout = PlannerNodeParameters().incoming_command_timeout
    assert timeout * gamepad['game_controller_node']['autorepeat_rate'] > 3.0
    assert device_settings('spacemouse')['spacenav']['zero_when_static'] is True


@pytest.mark.parametrize('device', DEVICES)
@pytest.mark.parametrize('namespace', ['', '/left'])
def test_ros_gives_each_node_its_values(device, namespace):
    """The reader of rcl itself, whatever PyYAML makes of the file."""
    context = Context()
    rclpy.init(context=context)
    try:
        for name, values in device_settings(device).items():
            node = Node(name, context=context, namespace=namespace, enable_rosout=False,
                        automatically_declare_parameters_from_overrides=True,
                        cli_args=['--ros-args', '--params-file', str(device_file(device))])
            got = {key: node.get_parameter(key).value for key in values}
            node.destroy_node()
            assert {key: list(value) if isinstance(values[key], list) else value
                    for key, value in got.items()} == values
            assert {key: type(value) for key, value in got.items() if key in DECLARED.get(
                name, {})} == {key: type(value) for key, value in values.items()
                               if key in DECLARED.get(name, {})}
    finally:
        rclpy.shutdown(context=context)


def test_an_unknown_device_is_refused_by_name():
    for name in ('joystick', '', 'Gamepad'):
        with pytest.raises(ParameterError, match=f"device '{name}' is not known; it must be one "
                                                 "of 'keyboard', 'gamepad', 'spacemouse'"):
            device_file(name)


def test_missing_packages_are_named_in_one_line_that_brings_them(tmp_path):
    environment = {'AMENT_PREFIX_PATH': f'/nowhere:{tmp_path}', 'ROS_DISTRO': 'jazzy'}
    (tmp_path / 'share' / 'joy').mkdir(parents=True)
    with pytest.raises(PlannerError) as error:
        installed_drivers('gamepad', environment)
    assert str(error.value) == (
        "device 'gamepad' needs packages that are not installed: "
        'sudo apt install ros-jazzy-teleop-twist-joy ros-jazzy-joy-teleop')
    for package in ('teleop_twist_joy', 'joy_teleop'):
        (tmp_path / 'share' / package).mkdir()
    assert installed_drivers('gamepad', environment) == drivers_of('gamepad')
    assert apt_line(['joy'], {}) == 'sudo apt install ros-jazzy-joy'


def test_the_devices_are_no_dependency_of_the_package():
    manifest = (device_file('gamepad').parents[2] / 'package.xml').read_text()
    for drivers in DEVICES.values():
        assert not any(f'>{driver.package}<' in manifest for driver in drivers)


def test_a_node_can_be_started_by_hand():
    keys, = drivers_of('keyboard')
    assert run_line(keys, device_file('keyboard')) == (
        'ros2 run teleop_twist_keyboard teleop_twist_keyboard --ros-args --params-file '
        f'{device_file("keyboard")}')
    puck, _ = drivers_of('spacemouse')
    assert run_line(puck, device_file('spacemouse')).endswith(' -r spacenav/twist:=cmd_vel')


@pytest.mark.parametrize('device', DEVICES)
def test_each_file_is_yaml_that_names_nodes_of_any_namespace(device):
    content = yaml.safe_load(device_file(device).read_text())
    assert all(section.startswith('/**/') for section in content)


def test_the_docs_promise_these_times_to_rest():
    page = (share_directory() / 'docs' / 'devices.md').read_text()
    rows = [[cell.strip() for cell in line.strip('|').split('|')] for line in page.splitlines()
            if (line.startswith('|') and 'zero twist' in line) or '| nothing |' in line]
    promised = {row[0] if 'press' not in row[1] else 'k': (row[3], row[4]) for row in rows}
    assert promised == {'k': (f'{STOP_KEY} s', ''), **{
        device: (f'{LET_GO[device]} s', f'{GONE[device]} s') for device in LET_GO}}
