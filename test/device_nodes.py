"""What the nodes of the devices send, computed from raw input and the device's file.

Each class does what a node of ROS 2 Jazzy does, as its source says; its docstring names the node
and the version. None of them is installed for the tests.
"""

from __future__ import annotations

import numpy as np

# Node → the parameters that it declares, with their types. A value of another type ends the node.
# joy 3.3.0, joy/src/game_controller.cpp
_GAME_CONTROLLER = {
    'device_id': int, 'device_name': str, 'deadzone': float, 'autorepeat_rate': float,
    'sticky_buttons': bool, 'coalesce_interval_ms': int}
# teleop_twist_joy 2.6.5, src/teleop_twist_joy.cpp
_TWIST_JOY = {
    'publish_stamped_twist': bool, 'frame': str, 'require_enable_button': bool,
    'enable_button': int, 'enable_turbo_button': int, 'inverted_reverse': bool,
    **{f'axis_linear.{axis}': int for axis in 'xyz'},
    **{f'axis_angular.{axis}': int for axis in ('yaw', 'pitch', 'roll')},
    **{f'scale_linear{level}.{axis}': float for level in ('', '_turbo') for axis in 'xyz'},
    **{f'scale_angular{level}.{axis}': float for level in ('', '_turbo')
       for axis in ('yaw', 'pitch', 'roll')}}
# teleop_twist_keyboard 2.4.1, README.md
_KEYBOARD = {'stamped': bool, 'frame_id': str, 'speed': float, 'turn': float}
# spacenav 3.3.0, spacenav/src/spacenav.cpp
_SPACENAV = {
    'full_scale': float, 'static_count_threshold': int, 'zero_when_static': bool,
    'static_trans_deadband': float, 'static_rot_deadband': float, 'use_twist_stamped': bool,
    **{f'{part}_scale/{axis}': float for part in ('linear', 'angular') for axis in 'xyz'}}
DECLARED = {'game_controller_node': _GAME_CONTROLLER, 'teleop_twist_joy_node': _TWIST_JOY,
            'teleop_twist_keyboard': _KEYBOARD, 'spacenav': _SPACENAV}
# joy_teleop 2.0.0, joy_teleop/joy_teleop.py: what it reads of a command that calls a service.
SERVICE_KEYS = {'type', 'interface_type', 'service_name', 'service_request', 'buttons', 'axes'}

# teleop_twist_keyboard: key → x, y, z and turn, and key → factors of speed and turn.
_MOVES = {'i': (1, 0, 0, 0), ',': (-1, 0, 0, 0), 'j': (0, 0, 0, 1), 'l': (0, 0, 0, -1),
          'J': (0, 1, 0, 0), 'L': (0, -1, 0, 0), 't': (0, 0, 1, 0), 'b': (0, 0, -1, 0)}
_SPEEDS = {'q': (1.1, 1.1), 'z': (0.9, 0.9), 'w': (1.1, 1.0), 'x': (0.9, 1.0),
           'e': (1.0, 1.1), 'c': (1.0, 0.9)}
# How SDL counts a gamepad's buttons and axes, which game_controller_node keeps: joy/README.md
BUTTONS = {'y': 3, 'back': 4, 'start': 6, 'left shoulder': 9, 'right shoulder': 10}
AXES = {'left x': 0, 'left y': 1, 'right x': 2, 'right y': 3}
# docs/devices.md: at rest so long after letting go, and after the device's last word [s].
LET_GO = {'gamepad': 0.3, 'keyboard': 0.9, 'spacemouse': 0.3}
GONE = {'gamepad': 0.4, 'keyboard': 0.9, 'spacemouse': 0.4}
STOP_KEY = 0.3


class GameController:
    """joy 3.3.0's game_controller_node: axes and buttons, sent again while nothing changes."""

    def __init__(self, settings):
        """Begin with all sticks in the middle and no button down."""
        self._deadzone = settings['deadzone']
        self.period = 1.0 / settings['autorepeat_rate']
        self.raw, self.down = np.zeros(6), set()

    def joy(self):
        """Return (axes, buttons): forward and left are positive, as in ROS; SDL's are negative."""
        free = np.maximum(np.abs(self.raw) / 32767.0 - self._deadzone, 0.0)
        axes = -np.sign(self.raw) * free / (1.0 - self._deadzone)
        return axes.tolist(), [int(button in self.down) for button in range(21)]


class TwistJoy:
    """teleop_twist_joy 2.6.5: a twist per Joy while a dead-man button is down, then one zero."""

    def __init__(self, settings):
        """Begin as the node does: its first Joy without a button sends a zero."""
        self._settings, self._sent_zero = settings, False

    def twist(self, axes, buttons):
        """Return the twist (6,) that a Joy sends; None if it sends nothing."""
        held = {key: self._settings[key] >= 0 and bool(buttons[self._settings[key]])
                for key in ('enable_button', 'enable_turbo_button')}
        if held['enable_turbo_button']:
            return self._scaled(axes, '_turbo')
        if held['enable_button'] or not self._settings['require_enable_button']:
            return self._scaled(axes, '')
        silent, self._sent_zero = self._sent_zero, True
        return None if silent else np.zeros(6)

    def _scaled(self, axes, level):
        self._sent_zero = False
        twist = []
        for part, names in (('linear', 'xyz'), ('angular', ('roll', 'pitch', 'yaw'))):
            for name in names:
                axis = self._settings[f'axis_{part}.{name}']
                scale = self._settings[f'scale_{part}{level}.{name}']
                twist.append(0.0 if axis == -1 else axes[axis] * scale)
        if self._settings['inverted_reverse'] and twist[0] < 0.0:
            twist[5] = -twist[5]
        return np.array(twist)


class JoyTeleop:
    """joy_teleop 2.0.0: calls a service once when all buttons of a command go down."""

    def __init__(self, settings):
        """Take the commands in the order of their names, as the node does."""
        self.commands = {}
        for key, value in sorted(settings.items()):
            name, _, rest = key.partition('.')
            self.commands.setdefault(name, {})[rest] = value
        self._active = dict.fromkeys(self.commands, False)

    def calls(self, buttons):
        """Return the commands that a Joy sets off, each a dictionary of its settings."""
        due = []
        for name, command in self.commands.items():
            active = all(buttons[button] == 1 for button in command['buttons'])
            if active and not self._active[name]:
                due.append(command)
            self._active[name] = active
        return due


class KeyTeleop:
    """teleop_twist_keyboard 2.4.1: a twist per key, and nothing between the keys."""

    def __init__(self, settings):
        """Begin at rest, with the speeds of the file."""
        self._speed, self._turn, self._move = settings['speed'], settings['turn'], (0, 0, 0, 0)

    def twist(self, key):
        """Return the twist (6,) that a key sends. Keys that are neither moves nor speeds stop."""
        if key in _SPEEDS:
            faster, turn_faster = _SPEEDS[key]
            self._speed, self._turn = self._speed * faster, self._turn * turn_faster
        else:
            self._move = _MOVES.get(key, (0, 0, 0, 0))
        x, y, z, turn = self._move
        return np.array([x * self._speed, y * self._speed, z * self._speed, 0, 0,
                         turn * self._turn])


class Spacenav:
    """spacenav 3.3.0: asks spacenavd every millisecond; what it hears becomes a twist at once."""

    PERIOD = 0.001

    def __init__(self, settings):
        """Begin with the puck in the middle."""
        self._settings, self._silent, self._normed = settings, 0, np.zeros(6)

    def poll(self, event=None):
        """Return the twist (6,) that one poll sends; None if it sends nothing.

        Args:
            event: of spacenavd, (x, y, z, rx, ry, rz) counts: right, up, forward; None for none.
        """
        if event is None:
            self._silent += 1
            if self._silent <= self._settings['static_count_threshold']:
                return None
            for part, band in ((slice(0, 3), 'trans'), (slice(3, 6), 'rot')):
                if self._settings['zero_when_static'] or np.all(
                        np.abs(self._normed[part]) < self._settings[f'static_{band}_deadband']):
                    self._normed[part] = 0.0
        else:
            x, y, z, rx, ry, rz = event
            self._normed = np.array([z, -x, y, rz, -rx, ry]) / self._settings['full_scale']
        self._silent = 0
        return self._normed * [self._settings[f'{part}_scale/{axis}']
                               for part in ('linear', 'angular') for axis in 'xyz']
