"""Devices to drive the arm by hand: the nodes they take, from which packages, with which file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any

from redundant_planner.core.errors import known, ParameterError, shown
from redundant_planner.io.resources import read_text, share_directory, yaml_content
from redundant_planner.io.ros_packages import check_installed


@dataclass(frozen=True)
class DriverNode:
    """One node of a package that apt installs.

    Attributes:
        package, executable: as `ros2 run` takes them.
        name: of the node, as in the device's file.
        remap: (from, to) topics.
        reads_keys: whether it reads a terminal of its own.
    """

    package: str
    executable: str
    name: str
    remap: tuple[tuple[str, str], ...] = ()
    reads_keys: bool = False


# Device → its nodes. Each has a file in config/devices.
DEVICES: Mapping[str, tuple[DriverNode, ...]] = {
    'keyboard': (
        DriverNode('teleop_twist_keyboard', 'teleop_twist_keyboard', 'teleop_twist_keyboard',
                   reads_keys=True),),
    'gamepad': (
        DriverNode('joy', 'game_controller_node', 'game_controller_node'),
        DriverNode('teleop_twist_joy', 'teleop_node', 'teleop_twist_joy_node'),
        DriverNode('joy_teleop', 'joy_teleop', 'joy_teleop')),
    'spacemouse': (
        DriverNode('spacenav', 'spacenav_node', 'spacenav', (('spacenav/twist', 'cmd_vel'),)),
        DriverNode('joy_teleop', 'joy_teleop', 'joy_teleop', (('joy', 'spacenav/joy'),))),
}


def drivers_of(device: str) -> tuple[DriverNode, ...]:
    """Return the nodes that a device takes.

    Raises:
        ParameterError: there is no such device.
    """
    if device not in DEVICES:
        raise ParameterError(f'device {shown(device)} is not known; it must be one of '
                             f'{known(DEVICES)}')
    return DEVICES[device]


def installed_drivers(
    device: str, environment: Mapping[str, str] = os.environ,
) -> tuple[DriverNode, ...]:
    """Return the nodes that a device takes, all of which can be started.

    Args:
        device: its name.
        environment: with AMENT_PREFIX_PATH, where packages are looked for.

    Raises:
        ParameterError: there is no such device.
        PlannerError: packages are missing; the message has the line that installs them.
    """
    drivers = drivers_of(device)
    check_installed(f"device '{device}'", [driver.package for driver in drivers], environment)
    return drivers


def device_file(device: str) -> Path:
    """Return a device's parameter file.

    Raises:
        ParameterError: there is no such device.
    """
    drivers_of(device)
    return share_directory() / 'config' / 'devices' / f'{device}.yaml'


def run_line(driver: DriverNode, file: Path, namespace: str = '') -> str:
    """Return what to type in a terminal to run one of the nodes by itself."""
    names = [*driver.remap, *([('__ns', f"/{namespace.strip('/')}")] if namespace else [])]
    remap = ''.join(f' -r {old}:={new}' for old, new in names)
    return f'ros2 run {driver.package} {driver.executable} --ros-args --params-file {file}{remap}'


def device_settings(device: str) -> dict[str, dict[str, Any]]:
    """Return what a device's file sets: node → parameter, with dots → value.

    Raises:
        ParameterError: there is no such device.
        PlannerError: its file cannot be read.
    """
    path = device_file(device)
    content = yaml_content(read_text(path), f"'{path}'")
    return {section.rpartition('/')[2]: dict(_flat(values['ros__parameters']))
            for section, values in content.items()}


def _flat(values: Mapping[str, Any], prefix: str = '') -> Iterable[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', value
