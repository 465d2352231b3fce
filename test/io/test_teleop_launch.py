"""What launch/teleop.launch.py starts: stand-ins for launch, which tests do not have, note it."""

from __future__ import annotations

from launch_stand_ins import launch_file
import pytest

from redundant_planner.core.errors import PlannerError
from redundant_planner.io.devices import device_file, DEVICES, drivers_of


@pytest.fixture
def launch(monkeypatch, tmp_path):
    """What starts the launch file's functions with arguments, and returns the nodes."""
    packages = [driver.package for drivers in DEVICES.values() for driver in drivers]
    monkeypatch.delenv('DISPLAY', raising=False)
    return launch_file(monkeypatch, tmp_path, 'teleop', packages)


@pytest.mark.parametrize('device', ['gamepad', 'spacemouse'])
def test_planner_arm_and_device_start_from_the_device_alone(launch, device):
    nodes = launch(device=device)
    drivers = drivers_of(device)
    assert [node.executable for node in nodes] == [
        *(driver.executable for driver in drivers), 'fake_hardware_node', 'planner_node']
    for node, driver in zip(nodes, drivers):
        assert (node.package, node.name) == (driver.package, driver.name)
        assert node.parameters == [str(device_file(device))]
        assert node.remappings == list(driver.remap)
    assert all(node.namespace.args == ('namespace',) for node in nodes)
    assert nodes[-1].parameters[-1] == str(device_file(device))


def test_those_who_run_their_own_planner_get_the_device_alone(launch):
    assert [node.package for node in launch(device='gamepad', arm='false')] == [
        driver.package for driver in drivers_of('gamepad')]


def test_a_keyboard_gets_a_window_or_says_what_to_type(launch, monkeypatch, tmp_path):
    said, *arm = launch(device='keyboard')
    assert 'ros2 run teleop_twist_keyboard teleop_twist_keyboard --ros-args' in said.msg
    assert [node.executable for node in arm] == ['fake_hardware_node', 'planner_node']
    assert launch(device='keyboard', namespace='left')[0].msg.endswith(' -r __ns:=/left')
    xterm = tmp_path / 'bin' / 'xterm'
    xterm.parent.mkdir()
    xterm.touch(mode=0o755)
    monkeypatch.setenv('PATH', str(xterm.parent))
    monkeypatch.setenv('DISPLAY', ':0')
    assert launch(device='keyboard')[0].prefix == 'xterm -e'


def test_rviz_is_shown_if_asked_for(launch):
    assert launch(device='gamepad', rviz='true')[-1].package == 'rviz2'


def test_an_unknown_device_and_missing_packages_end_the_launch_with_one_line(launch, monkeypatch):
    for arm in ('true', 'false'):
        with pytest.raises(PlannerError, match="device 'wheel' is not known"):
            launch(device='wheel', arm=arm)
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    with pytest.raises(PlannerError, match='sudo apt install ros-jazzy-spacenav') as error:
        launch(device='spacemouse')
    assert '\n' not in str(error.value)
