"""Hands on a gamepad, on a keyboard and on a puck that drive a live arm.

A hand holds sticks, keys or the puck; the messages come at the device's rate. docs/devices.md
promises the directions, the speeds and the times to rest.
"""

from __future__ import annotations

from contextlib import contextmanager
from importlib import import_module
import time

from bench import CREEPING
from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from device_nodes import AXES, BUTTONS, GameController, JoyTeleop, KeyTeleop, Spacenav, TwistJoy
from live_helpers import station
import numpy as np

from redundant_planner.io.devices import device_file, device_settings
from redundant_planner.nodes.messages import seconds_of, twist_to_message

ROBOT = make_panda()
NAMES = list(ROBOT.joint_names)
# A stick at its end stop, as SDL counts it.
FULL = 32767
FORWARD, LEFT, UP, ROLL, PITCH, TURN = np.eye(6)


class Hand:
    """A hand on a device: what it holds is sent at the device's rate, as long as we wait.

    Attributes:
        robot: the arm.
        plugged: whether the device is there.
        let_go_at: when it was let go or unplugged, of `time.time()` [s].
    """

    robot = ROBOT

    def __init__(self, ros):
        self.ros, self.plugged, self.let_go_at, self.answers = ros, True, np.inf, []
        self._clients, self._last = {}, time.monotonic()

    def send(self, twist):
        if twist is not None:
            self.ros.twist.publish(twist_to_message(twist))

    def call(self, commands):
        """Call services as joy_teleop does: not at all if they are not there."""
        for command in commands:
            request = kind_of(command).Request()
            for key, value in command.items():
                if key.startswith('service_request.'):
                    setattr(request, key.partition('.')[2], value)
            client = self.client(command)
            if client.service_is_ready():
                client.call_async(request).add_done_callback(
                    lambda done: self.answers.append(done.result().message))

    def client(self, command):
        name = command['service_name']
        if name not in self._clients:
            self._clients[name] = self.ros.node.create_client(kind_of(command), name)
        return self._clients[name]

    def find_services(self, settings):
        """Wait until the services that a file names are there."""
        for command in JoyTeleop(settings).commands.values():
            self.ros.wait_for(self.client(command).service_is_ready, command['service_name'])

    def answered(self, text):
        """Go on until the planner has answered a call, and forget the answer."""
        self.until(lambda: any(text in answer for answer in self.answers), text)
        self.answers.clear()

    def is_due(self, period):
        """Return whether so much time has passed since it was last due."""
        if time.monotonic() < self._last + period:
            return False
        # What the machine slept through is not made up for, as in a node's own timer.
        self._last = max(self._last + period, time.monotonic() - period)
        return True

    def until(self, condition, what):
        self.ros.wait_for(condition, what, meanwhile=self.work)

    def still_for(self, count):
        """Go on for so many commands of the arm, and return whether none of them moves it."""
        self.until(self.ros.at_rest, 'rest')
        self.ros.commands.clear()
        self.until(lambda: len(self.ros.commands) >= count, 'commands')
        return all(np.abs(m.velocity).max() < CREEPING for m in self.ros.commands)

    def moves_with(self, twist):
        """Go on until the arm moves the tip as it should, to a twentieth of the speed."""
        def does():
            return self.ros.commands and np.linalg.norm(
                self.tip_twist() - twist) < 0.05 * np.linalg.norm(twist)
        self.until(does, f'a motion of the tip with {twist}')

    def tip_twist(self):
        """What the latest command moves the tip with."""
        command = self.ros.commands[-1]
        return self.robot.kinematics(np.array(command.position)).jacobian @ command.velocity

    def rests_within(self, seconds):
        """Wait for rest, and hold it to what is promised."""
        commands = self.ros.commands
        self.until(lambda: any(seconds_of(m.header.stamp) > self.let_go_at for m in commands)
                   and self.ros.stops(), 'a stop')
        late = [m for m in commands if seconds_of(m.header.stamp) > self.let_go_at]
        rest = next(seconds_of(m.header.stamp) for m in late
                    if np.abs(m.velocity).max() < CREEPING)
        print(f'\nat rest after {rest - self.let_go_at:.2f} s, promised are {seconds} s')
        assert rest - self.let_go_at <= seconds

    def unplug(self):
        self.plugged, self.let_go_at = False, time.time()

    def plug_in(self):
        self.plugged = True

    def goes_silent(self):
        """Go on until no command has come for a while."""
        self.ros.commands.clear()
        begin = time.monotonic()

        def is_silent():
            nonlocal begin
            if self.ros.commands:
                self.ros.commands.clear()
                begin = time.monotonic()
            return time.monotonic() > begin + 0.3

        self.until(is_silent, 'silence')


class OnGamepad(Hand):
    """Sticks and buttons by their names."""

    def __init__(self, ros):
        super().__init__(ros)
        settings = device_settings('gamepad')
        self.pad = GameController(settings['game_controller_node'])
        self._twist_joy = TwistJoy(settings['teleop_twist_joy_node'])
        self._joy_teleop = JoyTeleop(settings['joy_teleop'])
        self.find_services(settings['joy_teleop'])

    def hold(self, *buttons, **sticks):
        """Hold these buttons and sticks, and nothing else; sticks as SDL counts, ±FULL."""
        was = set(self.pad.down)
        self.let_go_at = time.time()
        self.pad.down = {BUTTONS[name.replace('_', ' ')] for name in buttons}
        self.pad.raw = np.zeros(6)
        for name, raw in sticks.items():
            self.pad.raw[AXES[name.replace('_', ' ')]] = raw
        # A button is said at once, in a message of its own.
        if was != self.pad.down and self.plugged:
            self._say()

    def work(self):
        if self.plugged and self.is_due(self.pad.period):
            self._say()

    def _say(self):
        axes, buttons = self.pad.joy()
        self.send(self._twist_joy.twist(axes, buttons))
        self.call(self._joy_teleop.calls(buttons))


class OnKeyboard(Hand):
    """One key at a time, repeated as a desktop does: after half a second, at 30 Hz."""

    DELAY, PERIOD = 0.5, 1.0 / 30.0

    def __init__(self, ros):
        super().__init__(ros)
        self._keys = KeyTeleop(device_settings('keyboard')['teleop_twist_keyboard'])
        self._key, self._next = '', np.inf

    def hold(self, key):
        self._key, self._next = key, time.monotonic() + self.DELAY
        self.send(self._keys.twist(key))

    def press(self, key):
        self.let_go()
        self.send(self._keys.twist(key))

    def let_go(self):
        self._key, self.let_go_at = '', time.time()

    def work(self):
        if self.plugged and self._key and time.monotonic() >= self._next:
            self._next = time.monotonic() + self.PERIOD
            self.send(self._keys.twist(self._key))


class OnPuck(Hand):
    """The puck, off its middle by counts; a hand trembles, so it speaks 60 times a second."""

    EVENTS = 1.0 / 60.0

    def __init__(self, ros):
        super().__init__(ros)
        settings = device_settings('spacemouse')
        self._puck = Spacenav(settings['spacenav'])
        self._joy_teleop = JoyTeleop(settings['joy_teleop'])
        self.find_services(settings['joy_teleop'])
        self.counts, self._event, self._spoke, self._tremble = np.zeros(6), None, 0.0, 1
        self._buttons, self.is_steady = [0, 0], False

    def hold(self, *counts, buttons=(0, 0)):
        self.counts, self._buttons = np.array(counts, dtype=float), list(buttons)
        self._event = self.counts
        self.let_go_at = time.time()

    def plug_in(self):
        super().plug_in()
        self.is_steady = False

    def let_go(self):
        """It springs back, and the last that is heard of it is its middle."""
        self.hold(*np.zeros(6))

    def work(self):
        # Polls that the machine slept through are made up for: no more than a few are late.
        while self.is_due(Spacenav.PERIOD):
            event, self._event = self._event, None
            now = time.monotonic()
            if (event is None and self.counts.any() and not self.is_steady
                    and now > self._spoke + self.EVENTS):
                self._tremble = -self._tremble
                event = self.counts + self._tremble * np.sign(self.counts)
            if event is not None and self.plugged:
                self._spoke = now
            else:
                event = None
            self.send(self._puck.poll(event))
            self.call(self._joy_teleop.calls(self._buttons))


def kind_of(command):
    """The type of the service that a command of joy_teleop calls."""
    package, _, name = command['interface_type'].split('/')
    return getattr(import_module(f'{package}.srv'), name)


@contextmanager
def panda_with(device, kind):
    """A hand on a device, and a Panda with the files that the launch file gives it."""
    with station() as (ros, processes):
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], {
            'urdf': PANDA_URDF, 'initial_joints': NAMES,
            'initial_positions': PANDA_READY.tolist()})
        processes.start('planner_node', [ROBOTS / 'panda.yaml', device_file(device)],
                        {'urdf': PANDA_URDF})
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
        ros.wait_for(ros.at_rest, 'rest')
        yield kind(ros)
