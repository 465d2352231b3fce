"""Draws what each part of a device does, from its file: docs/figures/device_….svg.

Run `python -m redundant_planner.tools.draw_devices` after a change in config/devices.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, FancyArrowPatch, FancyBboxPatch

from redundant_planner.analysis.style import AMBER_FILL, BLUE_FILL, GREY_FILL, INK, MUTED, styled
from redundant_planner.io.devices import device_settings, DEVICES

_DOCS = Path(__file__).resolve().parent.parent.parent / 'docs'
Settings = Mapping[str, Mapping[str, Any]]

# What a positive and a negative twist of the tip look like, in the axes of the base.
_WAYS = {'x': ('forward', 'back'), 'y': ('left', 'right'), 'z': ('up', 'down'),
         'yaw': ('turn left', 'turn right'), 'pitch': ('nod down', 'nod up'),
         'roll': ('lean right', 'lean left')}
# How game_controller_node counts; a stick's positive ways are up and left.
_STICKS = {0: ('left stick', 'left', 'right'), 1: ('left stick', 'up', 'down'),
           2: ('right stick', 'left', 'right'), 3: ('right stick', 'up', 'down')}
_BUTTONS = {0: 'A', 1: 'B', 2: 'X', 3: 'Y', 4: 'back', 5: 'guide', 6: 'start',
            9: 'left shoulder', 10: 'right shoulder'}
_SAYS = {'pause': 'pause', 'go_on': 'go on', 'reset': 'reset'}
# teleop_twist_keyboard's keys; the row a key is in, and where.
_KEYS = {'u': (0, 0, 'forward,\nturn left'), 'i': (0, 1, 'forward'),
         'o': (0, 2, 'forward,\nturn right'),
         'j': (1, 0, 'turn left'), 'k': (1, 1, 'stop'), 'l': (1, 2, 'turn right'),
         'm': (2, 0, 'back,\nturn right'), ',': (2, 1, 'back'), '.': (2, 2, 'back,\nturn left'),
         'U': (0, 4, 'forward\nand left'), 'I': (0, 5, 'forward'),
         'O': (0, 6, 'forward\nand right'),
         'J': (1, 4, 'left'), 'K': (1, 5, 'stop'), 'L': (1, 6, 'right'),
         'M': (2, 4, 'back\nand left'), '<': (2, 5, 'back'), '>': (2, 6, 'back\nand right'),
         't': (0, 8, 'up'), 'b': (2, 8, 'down')}


def stick_ways(settings: Settings) -> dict[tuple[str, str], str]:
    """Return (stick, way it is pushed) → what the tip does, of the gamepad's file."""
    values = settings['teleop_twist_joy_node']
    ways = {}
    for kind, names in (('linear', 'xyz'), ('angular', ('yaw', 'pitch', 'roll'))):
        for name in names:
            axis, scale = values[f'axis_{kind}.{name}'], values[f'scale_{kind}.{name}']
            if axis in _STICKS and scale:
                stick, *pushed = _STICKS[axis]
                does = _WAYS[name] if scale > 0.0 else _WAYS[name][::-1]
                ways.update({(stick, way): what for way, what in zip(pushed, does)})
    return ways


def levels(settings: Settings) -> dict[str, str]:
    """Return dead-man button → its speeds, of the gamepad's file."""
    values = settings['teleop_twist_joy_node']
    return {_BUTTONS[values[button]]: _speeds(
        max(abs(values[f'scale_linear{level}.{a}']) for a in 'xyz'),
        max(abs(values[f'scale_angular{level}.{a}']) for a in ('yaw', 'pitch', 'roll')))
        for button, level in (('enable_button', ''), ('enable_turbo_button', '_turbo'))
        if values[button] >= 0}


def calls(settings: Settings) -> dict[int, str]:
    """Return button → what joy_teleop asks the planner for, of a device's file."""
    found: dict[int, list[str]] = {}
    for key, value in settings['joy_teleop'].items():
        name, _, rest = key.partition('.')
        if rest == 'buttons':
            found.setdefault(value[0], []).append(_SAYS.get(name, name))
    return {button: ' and '.join(said) for button, said in found.items()}


@styled
def draw(device: str, settings: Settings, path: Path) -> None:
    """Write a device's picture.

    Args:
        device: its name.
        settings: from `device_settings`.
        path: SVG or PNG file.
    """
    matplotlib.rcParams['svg.hashsalt'] = device  # the same file every time
    figure = Figure(figsize=(8.6, 4.3))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, 8.6), ylim=(0.0, 4.3))
    axes.set_axis_off()
    {'gamepad': _gamepad, 'keyboard': _keyboard, 'spacemouse': _puck}[device](axes, settings)
    figure.savefig(path, metadata={'Date': None} if path.suffix == '.svg' else None)


def _gamepad(axes: Any, settings: Settings) -> None:
    _title(axes, 'hold a shoulder button and push a stick')
    _box(axes, (0.5, 0.35, 7.6, 2.75), '', GREY_FILL)
    held = levels(settings)
    for left, name in ((0.7, 'left shoulder'), (5.5, 'right shoulder')):
        _box(axes, (left, 3.15, 2.4, 0.5), f'{name}: hold\n{held.get(name, "nothing")}',
             AMBER_FILL if name in held else 'white')
    ways = stick_ways(settings)
    for x, stick in ((1.9, 'left stick'), (5.0, 'right stick')):
        middle = (x, 1.6)
        axes.add_patch(Circle(middle, 0.33, facecolor='white', edgecolor=INK, zorder=2.0))
        for way, (right, up) in {'up': (0, 1), 'down': (0, -1), 'left': (-1, 0),
                                 'right': (1, 0)}.items():
            if (stick, way) in ways:
                _arrow(axes, (x + 0.38 * right, 1.6 + 0.38 * up),
                       (x + 0.72 * right, 1.6 + 0.72 * up))
                _words(axes, x + 0.78 * right, 1.6 + 0.88 * up, ways[stick, way],
                       ha={-1: 'right', 0: 'center', 1: 'left'}[right])
        _words(axes, x, 0.48, stick, color=MUTED)
    asked = calls(settings)
    for x, y, button in ((3.15, 2.72, 4), (3.85, 2.72, 6), (7.3, 2.25, 3), (7.3, 1.35, 0),
                         (7.75, 1.8, 1), (6.85, 1.8, 2)):
        name = _BUTTONS[button]
        axes.add_patch(Ellipse((x, y), 0.55 if y > 2.5 else 0.36, 0.36, zorder=2.0,
                               facecolor=BLUE_FILL if button in asked else 'white', edgecolor=INK))
        _words(axes, x, y, name, size=8.0)
        if button in asked:
            _words(axes, x, y + (-0.3 if y > 2.5 else 0.3), asked[button], weight='bold')


def _keyboard(axes: Any, settings: Settings) -> None:
    values = settings['teleop_twist_keyboard']
    _title(axes, f'hold a key: {_speeds(values["speed"], values["turn"])} to begin with')
    for key, (row, column, does) in _KEYS.items():
        left, low = 0.35 + 0.88 * column, 2.55 - 0.82 * row
        _box(axes, (left, low, 0.82, 0.76), '', AMBER_FILL if does == 'stop' else GREY_FILL)
        _words(axes, left + 0.12, low + 0.6, key, weight='bold')
        _words(axes, left + 0.43, low + 0.27, does, size=7.2)
    _words(axes, 0.35, 3.5, 'as they are', color=MUTED, ha='left')
    _words(axes, 3.87, 3.5, 'with shift', color=MUTED, ha='left')
    for i, (keys, what) in enumerate((('q  z', 'both speeds'), ('w  x', 'speed'),
                                      ('e  c', 'turning speed'))):
        _box(axes, (0.35 + 2.6 * i, 0.25, 0.6, 0.4), keys, BLUE_FILL)
        _words(axes, 1.02 + 2.6 * i, 0.45, f'{what}\n± a tenth', ha='left', size=7.6)
    _words(axes, 8.1, 0.45, 'other keys: stop', ha='right', size=7.6)


def _puck(axes: Any, settings: Settings) -> None:
    values = settings['spacenav']
    _title(axes, 'push or turn the puck, and the other way likewise; it springs back')
    axes.add_patch(Ellipse((4.3, 1.35), 3.4, 1.5, facecolor=GREY_FILL, edgecolor=INK, zorder=1.0))
    axes.add_patch(Ellipse((4.3, 1.6), 1.9, 0.85, facecolor='white', edgecolor=INK, zorder=2.0))
    ends = {'x': ((4.75, 2.0), (5.35, 2.65)), 'y': ((3.3, 1.6), (2.35, 1.6)),
            'z': ((4.3, 2.05), (4.3, 3.05))}
    places = {'x': (5.45, 2.72, 'left', 'push forward'), 'y': (2.25, 1.6, 'right', 'push left'),
              'z': (4.3, 3.2, 'center', 'pull up')}
    turns = {'x': (5.45, 2.36, 'left', 'tilt right'), 'y': (2.25, 1.1, 'right', 'tilt forward'),
             'z': (6.25, 1.35, 'left', 'twist left')}
    names = {'x': 'roll', 'y': 'pitch', 'z': 'yaw'}
    for axis in 'xyz':
        speed, turn = values[f'linear_scale/{axis}'], values[f'angular_scale/{axis}']
        _arrow(axes, *ends[axis])
        x, y, side, hand = places[axis]
        _words(axes, x, y, f'{hand}: {_WAYS[axis][speed < 0.0]}, {abs(speed):.2f} m/s', ha=side)
        x, y, side, hand = turns[axis]
        _words(axes, x, y, f'{hand}: {_WAYS[names[axis]][turn < 0.0]}, {abs(turn):.1f} rad/s',
               ha=side)
    axes.add_patch(FancyArrowPatch((4.95, 1.45), (3.65, 1.45), color=MUTED, linewidth=1.4,
                                   arrowstyle='<|-', mutation_scale=12, zorder=3.0,
                                   connectionstyle='arc3,rad=-0.45'))
    for button, (left, name) in enumerate(((0.45, 'left button'), (6.2, 'right button'))):
        said = calls(settings).get(button, 'nothing')
        _box(axes, (left, 0.25, 1.95, 0.5), f'{name}: {said}',
             BLUE_FILL if button in calls(settings) else 'white')
    _words(axes, 4.3, 0.3, f'speeds at {values["full_scale"]:g} counts of deflection',
           color=MUTED)


def _speeds(linear: float, angular: float) -> str:
    return f'{linear:.2f} m/s, {angular:.1f} rad/s'


def _title(axes: Any, text: str) -> None:
    _words(axes, 4.3, 4.0, text, size=11.0, weight='bold')


def _words(axes: Any, x: float, y: float, text: str, *, ha: str = 'center', size: float = 9.0,
           color: str = INK, weight: str = 'normal') -> None:
    axes.text(x, y, text, ha=ha, va='center', fontsize=size, color=color, fontweight=weight,
              zorder=4.0)


def _box(axes: Any, place: tuple[float, float, float, float], text: str, color: str) -> None:
    left, low, width, height = place
    axes.add_patch(FancyBboxPatch((left, low), width, height, facecolor=color, edgecolor=INK,
                                  boxstyle='round,pad=0,rounding_size=0.1', zorder=1.0))
    _words(axes, left + 0.5 * width, low + 0.5 * height, text)


def _arrow(axes: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.add_patch(FancyArrowPatch(start, end, arrowstyle='-|>', mutation_scale=14, color=INK,
                                   linewidth=1.6, shrinkA=0.0, shrinkB=0.0, zorder=3.0))


def main() -> None:
    """Write the pictures of all devices."""
    parser = argparse.ArgumentParser(description='Draws docs/figures/device_*.svg.')
    parser.add_argument('--docs', type=Path, default=_DOCS, help='folder that has figures/')
    folder = parser.parse_args().docs / 'figures'
    for device in DEVICES:
        draw(device, device_settings(device), folder / f'device_{device}.svg')


if __name__ == '__main__':
    main()
