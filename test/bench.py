"""An arm and its planner on a test bench: real processes, in motion, and how they come to rest."""

from __future__ import annotations

from contextlib import ExitStack
from types import SimpleNamespace

from conftest import make_paper_arm, PASSED, ROBOTS
from live_helpers import station
import numpy as np
import pytest

from redundant_planner.nodes.messages import seconds_of

ARM = make_paper_arm()
START = {'d1': 0.1, 'd2': 0.1, 'theta4': 0.5233, 'theta5': -0.5233, 'theta6': 1.0467}
ARM_VALUES = {'initial_joints': list(START), 'initial_positions': list(START.values())}
FILE = [ROBOTS / 'paper_2p5r.yaml']
RATE = 250.0
# Slower is rest: an arm that was late goes the rest of its way so slowly [rad/s, m/s].
CREEPING = 2e-3
# docs/interface.md promises rest within these times, which are rounded [s].
PROMISED = {'cmd_vel stops': 0.4, 'joint_states stop': 0.15, 'a second cmd_vel': 0.5,
            'a request': 0.03, 'the end of the process': 0.05}


def most_commands(fault):
    """How many commands the arm may take to come to rest after a fault: twice what is promised.

    A busy machine is late in telling the planner, and in stamping what it sends.
    """
    return 2.0 * RATE * PROMISED[fault]


class Bench:
    """A station with an arm and its planner, about to move."""

    def __init__(self, ros, processes, planner='planner_node', values=None):
        self.ros, self.processes = ros, processes
        self.forward = np.array([0.0, -0.1, 0.0, 0.0, 0.0, 0.0])
        self.arm = processes.start('fake_hardware_node', FILE, ARM_VALUES)
        self.planner = processes.start(planner, FILE, values or {})
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')

    def turn_round(self):
        """Come to rest and forget what was said; the next motion goes the other way."""
        self.ros.wait_for(lambda: self.ros.commands, 'commands')
        self.ros.wait_for(self.ros.at_rest, 'rest')
        self.forward = -self.forward
        self.ros.statuses.clear()

    def move(self, count=80):
        """Drive on until the arm has been moving for so many commands; forget the earlier ones."""
        commands = self.ros.commands
        self.ros.drive_until(self.forward, lambda: len(commands) >= count and all(
            np.any(m.velocity) for m in commands[-count:]), 'motion')
        commands.clear()

    def until_rest(self, drive=None):
        """Wait until a command is a stop, driving on or silently."""
        if drive is None:
            self.ros.wait_for(self.ros.stops, 'a stop')
        else:
            self.ros.drive_until(drive, self.ros.stops, 'a stop')

    def commands_until_rest(self, fault):
        """How many commands after a fault at a `time.time()` [s] are no stop yet."""
        after = [m for m in self.ros.commands if seconds_of(m.header.stamp) > fault]
        return next(i for i, m in enumerate(after) if np.abs(m.velocity).max() < CREEPING)

    def braking_commands(self):
        """How many commands before the first stop are each slower than the one before.

        They follow the moment at which the planner knows of a fault, whoever's time it takes to
        tell it.
        """
        speeds = [float(np.linalg.norm(m.velocity)) for m in self.ros.commands]
        rest = next(i for i, speed in enumerate(speeds) if speed == 0.0)
        first = rest
        while first > 0 and speeds[first - 1] > 1.01 * speeds[first]:
            first -= 1
        return rest - first

    def request(self, kind, name, data=None):
        """Call a service of the planner's while the arm is driven on; return the answer."""
        asked = kind.Request() if data is None else kind.Request(data=data)
        return self.ros.call(kind, name, asked, meanwhile=self.ros.driver(self.forward))

    def value(self, key):
        """What the latest diagnostics say of something."""
        return {v.key: v.value for s in self.ros.statuses[-1:] for v in s.values}.get(key)

    def until_motion(self):
        self.ros.drive_until(self.forward, self.ros.moves, 'motion')

    def says(self, text, level=None):
        def said():
            return any(text in s.message and level in (None, s.level)
                       for s in self.ros.statuses)
        self.ros.wait_for(said, f'diagnostics with {text!r}')


def accelerations(commands):
    """The share of each joint's acceleration limit between successive commands.

    A command that got lost on its way here leaves a gap of whole periods.
    """
    velocities = np.array([m.velocity for m in commands])
    stamps = np.array([seconds_of(m.header.stamp) for m in commands])
    ticks = np.maximum(np.round(np.diff(stamps) * RATE), 1.0)
    changes = np.abs(np.diff(velocities, axis=0)) * RATE / ticks[:, None]
    return changes / ARM.acceleration_max


def assert_smooth(commands, fault=''):
    """Hold a stop, or a start, to the acceleration limits; `pytest -s` shows what it took."""
    assert len(commands) > 2
    shares = accelerations(commands)
    worst = int(shares.max(axis=1).argmax())
    stamps = [seconds_of(m.header.stamp) for m in commands]
    around = [(round(t % 1000.0, 4), np.round(m.velocity, 4).tolist())
              for t, m in zip(stamps[max(worst - 2, 0):worst + 4], commands[max(worst - 2, 0):])]
    assert shares.max() <= 1.0 + 1e-6, f'{shares[worst]} of the limits, among {around}'
    if fault:
        rest = next(t for t, m in zip(stamps, commands) if not np.any(m.velocity))
        print(f'\n{fault}: at rest {rest - stamps[0]:.2f} s after it, {shares.max():.2f} of the '
              'acceleration limits')


@pytest.fixture(scope='module')
def make_bench():
    """What makes a bench of a station and processes; a module may put its own in its place."""
    return Bench


@pytest.fixture(scope='module')
def shared_bench():
    """A place for the bench of all tests that leave it alive; a failed test leaves it empty."""
    place = SimpleNamespace(bench=None, resources=ExitStack())
    with place.resources:
        yield place


@pytest.fixture
def bench(shared_bench, make_bench, request):
    """The shared arm and planner, at rest, about to move back."""
    if shared_bench.bench is None:
        shared_bench.bench = make_bench(*shared_bench.resources.enter_context(station()))
    lent, shared_bench.bench = shared_bench.bench, None
    lent.turn_round()
    yield lent
    if request.node.stash.get(PASSED, False):
        shared_bench.bench = lent
    else:
        shared_bench.resources.close()


@pytest.fixture
def own_bench(make_bench):
    """An arm and a planner for a test that ends one of them."""
    with station() as (ros, processes):
        yield make_bench(ros, processes)
