"""What each device sends with its file, from raw input, moves a live arm as it is meant to.

A hand holds sticks, keys or the puck; the messages come at the device's rate. docs/devices.md
promises the directions, the speeds and the times to rest.
"""

from __future__ import annotations

from importlib import import_module
import time

from bench import ARM, ARM_VALUES, CREEPING, FILE
from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from device_nodes import AXES, BUTTONS, GameController, JoyTeleop, KeyTeleop, Spacenav, TwistJoy
from live_helpers import LIVE, station
import numpy as np
import pytest

from redundant_planner.io.devices import device_file, device_settings
from redundant_planner.io.resources import share_directory
from redundant_planner.nodes.messages import seconds_of, twist_to_message

pytestmark = LIVE

ROBOT = make_panda()
NAMES = list(ROBOT.joint_names)
# A stick at its end stop, as SDL counts it.
FULL = 32767
# docs/devices.md: at rest so long after letting go, and after the device's last word [s].
LET_GO = {'gamepad': 0.3, 'keyboard': 0.9, 'spacemouse': 0.3}
GONE = {'gamepad': 0.4, 'keyboard': 0.9, 'spacemouse': 0.4}
STOP_KEY = 0.3
FORWARD, LEFT, UP, TURN = np.eye(6)[[0, 1, 2, 5]]


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


def on(device, kind):
    """A fixture: a hand on a device, and an arm with the files that the launch file gives it."""
    @pytest.fixture(scope='module')
    def hand():
        with station() as (ros, processes):
            processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], {
                'urdf': PANDA_URDF, 'initial_joints': NAMES,
                'initial_positions': PANDA_READY.tolist()})
            processes.start('planner_node', [ROBOTS / 'panda.yaml', device_file(device)],
                            {'urdf': PANDA_URDF})
            ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
            ros.wait_for(ros.at_rest, 'rest')
            yield kind(ros)
    return hand


gamepad = on('gamepad', OnGamepad)
keyboard = on('keyboard', OnKeyboard)
puck = on('spacemouse', OnPuck)


@pytest.fixture(autouse=True)
def _device_is_there(request):
    """A test that is tried again starts as at first, wherever it failed."""
    for name in {'gamepad', 'keyboard', 'puck'} & set(request.fixturenames):
        request.getfixturevalue(name).plug_in()


def test_the_docs_promise_these_times():
    page = (share_directory() / 'docs' / 'devices.md').read_text()
    rows = [[cell.strip() for cell in line.strip('|').split('|')] for line in page.splitlines()
            if (line.startswith('|') and 'zero twist' in line) or '| nothing |' in line]
    promised = {row[0] if 'press' not in row[1] else 'k': (row[3], row[4]) for row in rows}
    assert promised == {'k': (f'{STOP_KEY} s', ''), **{
        device: (f'{LET_GO[device]} s', f'{GONE[device]} s') for device in LET_GO}}


@pytest.mark.parametrize(('sticks', 'twist'), [
    ({'left_y': -FULL}, 0.1 * FORWARD), ({'left_y': FULL}, -0.1 * FORWARD),
    ({'left_x': -FULL}, 0.1 * LEFT), ({'left_x': FULL}, -0.1 * LEFT),
    ({'right_y': -FULL}, 0.1 * UP), ({'right_y': FULL}, -0.1 * UP),
    ({'right_x': -FULL}, 0.4 * TURN), ({'right_x': FULL}, -0.4 * TURN),
    ({'left_y': -FULL, 'right_y': FULL}, 0.1 * (FORWARD - UP))])
def test_the_sticks_move_the_tip_only_with_the_button(gamepad, sticks, twist):
    """SDL counts up and left as negative: pushing a stick forward is -FULL."""
    gamepad.hold(**sticks)
    assert gamepad.still_for(60)
    gamepad.hold('left_shoulder', **sticks)
    gamepad.moves_with(twist)
    gamepad.hold(**sticks)
    gamepad.rests_within(LET_GO['gamepad'])


def test_a_stick_halfway_is_half_as_fast_and_a_little_is_nothing(gamepad):
    dead = 0.1
    gamepad.hold('left_shoulder', left_y=-0.9 * dead * FULL)
    assert gamepad.still_for(60)
    gamepad.hold('left_shoulder', left_y=-(dead + 0.5 * (1.0 - dead)) * FULL)
    gamepad.moves_with(0.05 * FORWARD)
    gamepad.hold('left_shoulder', left_y=(dead + 0.5 * (1.0 - dead)) * FULL)
    gamepad.moves_with(-0.05 * FORWARD)
    gamepad.hold()
    gamepad.rests_within(LET_GO['gamepad'])


def test_the_right_shoulder_is_fast_and_back_to_slow_without_a_stop(gamepad):
    gamepad.hold('right_shoulder', left_x=-FULL)
    gamepad.moves_with(0.25 * LEFT)
    gamepad.hold('right_shoulder', left_x=FULL)
    gamepad.moves_with(-0.25 * LEFT)
    gamepad.ros.commands.clear()
    gamepad.hold('left_shoulder', left_x=FULL)
    gamepad.moves_with(-0.1 * LEFT)
    assert all(np.any(m.velocity) for m in gamepad.ros.commands)
    gamepad.hold('right_shoulder', right_x=-FULL)
    gamepad.moves_with(1.0 * TURN)
    gamepad.hold()
    gamepad.rests_within(LET_GO['gamepad'])


def test_the_arm_of_the_launch_file_stops_as_fast():
    """The paper's arm brakes at 2 m/s² only, and is started without a word about the arm."""
    with station() as (ros, processes):
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        processes.start('planner_node', [*FILE, device_file('gamepad')])
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
        hand = OnGamepad(ros)
        hand.robot = ARM
        hand.hold('right_shoulder', left_x=FULL)
        hand.moves_with(-0.25 * LEFT[:3])
        hand.hold(left_x=FULL)
        hand.rests_within(LET_GO['gamepad'])
        hand.hold('right_shoulder', left_x=-FULL)
        hand.moves_with(0.25 * LEFT[:3])
        hand.unplug()
        hand.rests_within(GONE['gamepad'])


def test_a_gamepad_that_is_gone_stops_the_arm(gamepad):
    gamepad.hold('left_shoulder', left_y=FULL)
    gamepad.moves_with(-0.1 * FORWARD)
    gamepad.unplug()
    gamepad.rests_within(GONE['gamepad'])
    gamepad.plug_in()
    gamepad.hold()


def silent(hand):
    """Go on until no command has come for a while."""
    hand.ros.commands.clear()
    begin = time.monotonic()

    def is_silent():
        nonlocal begin
        if hand.ros.commands:
            hand.ros.commands.clear()
            begin = time.monotonic()
        return time.monotonic() > begin + 0.3

    hand.until(is_silent, 'silence')


def test_buttons_of_the_gamepad_pause_go_on_and_reset(gamepad):
    stick = {'left_y': -FULL}
    gamepad.hold('left_shoulder', **stick)
    gamepad.moves_with(0.1 * FORWARD)
    gamepad.hold('left_shoulder', 'back', **stick)
    gamepad.answered('paused')
    silent(gamepad)
    gamepad.hold('left_shoulder', 'start', left_y=FULL)
    gamepad.answered('resumed')
    gamepad.moves_with(-0.1 * FORWARD)
    gamepad.ros.commands.clear()
    gamepad.hold('left_shoulder', 'y', left_y=FULL)
    gamepad.answered('reset')
    gamepad.until(lambda: any(not np.any(m.velocity) for m in gamepad.ros.commands),
                  'rest after the reset')
    gamepad.moves_with(-0.1 * FORWARD)
    assert not gamepad.answers, 'a button that stays down calls once'
    gamepad.hold()
    gamepad.rests_within(LET_GO['gamepad'])


@pytest.mark.parametrize(('key', 'twist'), [
    ('i', 0.1 * FORWARD), (',', -0.1 * FORWARD), ('J', 0.1 * LEFT), ('L', -0.1 * LEFT),
    ('t', 0.1 * UP), ('b', -0.1 * UP), ('j', 0.4 * TURN), ('l', -0.4 * TURN)])
def test_a_key_moves_the_tip_and_k_stops_it_at_once(keyboard, key, twist):
    keyboard.hold(key)
    keyboard.moves_with(twist)
    keyboard.press('k')
    keyboard.rests_within(STOP_KEY)


def test_a_held_key_moves_without_a_stop_until_it_is_let_go(keyboard):
    """The keyboard's own pause before it repeats a key is bridged."""
    keyboard.hold('i')
    keyboard.moves_with(0.1 * FORWARD)
    keyboard.ros.commands.clear()
    keyboard.until(lambda: len(keyboard.ros.commands) > 200, 'commands')
    assert all(np.any(m.velocity) for m in keyboard.ros.commands)
    keyboard.let_go()
    keyboard.rests_within(LET_GO['keyboard'])
    keyboard.hold(',')
    keyboard.moves_with(-0.1 * FORWARD)
    keyboard.unplug()
    keyboard.rests_within(GONE['keyboard'])
    keyboard.plug_in()
    keyboard.let_go()


def test_q_is_faster_and_any_other_key_stops(keyboard):
    for _ in range(5):
        keyboard.press('q')
    keyboard.hold(',')
    keyboard.moves_with(-0.1 * 1.1 ** 5 * FORWARD)
    keyboard.press(' ')
    keyboard.rests_within(STOP_KEY)
    for _ in range(5):
        keyboard.press('z')


# The puck's counts: right, up, forward, and about these axes.
@pytest.mark.parametrize(('counts', 'twist'), [
    ((0, 0, 350, 0, 0, 0), 0.15 * FORWARD), ((0, 0, -350, 0, 0, 0), -0.15 * FORWARD),
    ((-350, 0, 0, 0, 0, 0), 0.15 * LEFT), ((350, 0, 0, 0, 0, 0), -0.15 * LEFT),
    ((0, 350, 0, 0, 0, 0), 0.15 * UP), ((0, -350, 0, 0, 0, 0), -0.15 * UP),
    ((0, 0, 0, 0, 350, 0), 0.6 * TURN), ((0, 0, 0, 0, -350, 0), -0.6 * TURN),
    ((0, 0, 0, 0, 0, 350), 0.6 * np.eye(6)[3]), ((0, 0, 0, -350, 0, 0), 0.6 * np.eye(6)[4]),
    ((0, 0, 0, 0, 0, -350), -0.6 * np.eye(6)[3]), ((0, 0, 0, 350, 0, 0), -0.6 * np.eye(6)[4]),
    ((0, 0, 175, 0, 0, 0), 0.075 * FORWARD)])
def test_the_puck_moves_the_tip_and_springs_back(puck, counts, twist):
    puck.hold(*counts)
    puck.moves_with(twist)
    puck.let_go()
    puck.rests_within(LET_GO['spacemouse'])


@pytest.mark.parametrize('way', ['held still', 'unplugged'])
def test_a_puck_that_falls_silent_stops_the_arm(puck, way):
    """Its node says the last twist again and again, unless it is told to say zero."""
    puck.hold(0, 0, -350 if way == 'held still' else 350, 0, 0, 0)
    puck.moves_with(np.sign(puck.counts[2]) * 0.15 * FORWARD)
    if way == 'unplugged':
        puck.unplug()
    else:
        puck.is_steady, puck.let_go_at = True, time.time()
    puck.rests_within(GONE['spacemouse'])
    assert puck.still_for(60)
    puck.plug_in()
    puck.let_go()


def test_buttons_of_the_puck_pause_and_go_on_afresh(puck):
    forward = (0, 0, 175, 0, 0, 0)
    puck.hold(*forward)
    puck.moves_with(0.075 * FORWARD)
    puck.hold(*forward, buttons=(1, 0))
    puck.answered('paused')
    silent(puck)
    puck.hold(0, 0, -175, 0, 0, 0, buttons=(0, 1))
    puck.until(lambda: len(puck.answers) == 2, 'two answers')
    assert sorted(answer.split()[0] for answer in puck.answers) == ['reset:', 'resumed']
    puck.moves_with(-0.075 * FORWARD)
    puck.let_go()
    puck.rests_within(LET_GO['spacemouse'])
