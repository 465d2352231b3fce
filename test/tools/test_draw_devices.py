"""The pictures of the devices say what their files say."""

from __future__ import annotations

from pathlib import Path
import re
import sys

import pytest

from redundant_planner.io.devices import device_settings, DEVICES
from redundant_planner.tools import draw_devices

FIGURES = Path(__file__).resolve().parent.parent.parent / 'docs' / 'figures'


def words(path):
    """All that a picture says, in its order: Matplotlib writes it beside the letters' outlines."""
    return re.findall('<!-- (.*?) -->', path.read_text())


def test_the_command_writes_the_pictures_that_the_docs_show(tmp_path, monkeypatch):
    (tmp_path / 'figures').mkdir()
    monkeypatch.setattr(sys, 'argv', ['draw_devices', '--docs', str(tmp_path)])
    draw_devices.main()
    for device in DEVICES:
        name = f'device_{device}.svg'
        assert len(words(FIGURES / name)) > 8
        assert words(tmp_path / 'figures' / name) == words(FIGURES / name), (
            'run `python -m redundant_planner.tools.draw_devices`')
        assert f'figures/{name}' in (FIGURES.parent / 'devices.md').read_text()


def test_another_mapping_is_another_picture(tmp_path):
    settings = device_settings('gamepad')
    sticks = settings['teleop_twist_joy_node']
    assert draw_devices.stick_ways(settings)['left stick', 'up'] == 'forward'
    assert draw_devices.levels(settings)['right shoulder'] == '0.25 m/s, 1.0 rad/s'
    draw_devices.draw('gamepad', settings, tmp_path / 'before.svg')
    sticks.update({'scale_linear.x': -0.1, 'axis_angular.yaw': -1, 'enable_turbo_button': -1})
    settings['joy_teleop']['reset.buttons'] = [0]
    ways = draw_devices.stick_ways(settings)
    assert ways['left stick', 'up'] == 'back' and ways['left stick', 'down'] == 'forward'
    assert ('right stick', 'left') not in ways
    assert set(draw_devices.levels(settings)) == {'left shoulder'}
    assert draw_devices.calls(settings) == {4: 'pause', 6: 'go on', 0: 'reset'}
    draw_devices.draw('gamepad', settings, tmp_path / 'after.svg')
    assert words(tmp_path / 'after.svg') != words(tmp_path / 'before.svg')


@pytest.mark.parametrize(('device', 'node', 'name', 'value'), [
    ('keyboard', 'teleop_twist_keyboard', 'speed', 0.2),
    ('spacemouse', 'spacenav', 'linear_scale/z', -0.3),
    ('spacemouse', 'spacenav', 'full_scale', 500.0),
    ('spacemouse', 'joy_teleop', 'reset.buttons', [0])])
def test_what_the_picture_says_follows_the_file(tmp_path, device, node, name, value):
    settings = device_settings(device)
    settings[node][name] = value
    draw_devices.draw(device, settings, tmp_path / 'other.svg')
    assert words(tmp_path / 'other.svg') != words(FIGURES / f'device_{device}.svg')
