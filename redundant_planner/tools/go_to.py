"""go_to: sends the arm of a running planner to a pose of its tip, or to joint positions."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
import signal
import sys
import time
from typing import Any

import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Column

from redundant_planner.core.errors import PlannerError, StateError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.goal import Goal
from redundant_planner.core.target.progress import TargetState
from redundant_planner.io.printable import printable
from redundant_planner.io.tip_topics import OBJECT
from redundant_planner.nodes.runtime import keep_off_shared_memory
from redundant_planner.nodes.state_report import DOES_NOT_FOLLOW
from redundant_planner.nodes.target_client import TargetClient
from redundant_planner.tools.asked_goal import joint_target_of, target_of
from redundant_planner.tools.target_advice import explained

Array = npt.NDArray[np.float64]

# How long an arm that cannot get to its target may stay so before this gives up [s]: what is in
# the way may leave it, but no place gets into reach. And how long before this says so [s].
_PATIENT = {TargetState.BLOCKED.value: 5.0, TargetState.OUT_OF_REACH.value: 1.0}
_STEADY = 0.3
# How long the planner may be silent, which speaks of its target 20 times a second [s].
_SILENCE = 5.0
# What the planner says is left of a way.
_LEFT = ('distance [m]', 'angle [rad]', 'farthest joint [rad, m]')


class _Patience:
    """Counts for how long an arm cannot get to its target."""

    def __init__(self) -> None:
        self._stuck_since: float | None = None
        self._is_said = False

    def is_over(self, state: str, now: float) -> bool:
        """Take the arm's state [s]; return whether to give up."""
        if state not in _PATIENT:
            self._stuck_since = None
        elif self._stuck_since is None:
            self._stuck_since, self._is_said = now, False
        return self._stuck_since is not None and now > self._stuck_since + _PATIENT[state]

    def is_news(self, now: float) -> bool:
        """Return once whether the arm has been stuck for long enough to say so [s]."""
        if self._stuck_since is None or self._is_said or now <= self._stuck_since + _STEADY:
            return False
        self._is_said = True
        return True


def follow(client: TargetClient, target: Goal, console: Console) -> str:
    """Show how far the arm has come until it is there or stays blocked; return the last state.

    Raises:
        StateError: the planner says nothing of the target, or nothing more.
    """
    word, patience = client.wait_for_word(), _Patience()
    first = _left(word.values)
    wide = Column(no_wrap=True, min_width=12)
    with Progress(TextColumn('{task.description}', table_column=wide), BarColumn(),
                  TextColumn('{task.fields[what]}'), console=console) as bar:
        task = bar.add_task('moving', total=1.0, what='')
        while True:
            assert client.word is not None, 'there is always a last word'
            word = client.word
            if not word.is_of_sent:
                return 'somebody else commands the arm now'
            if word.state == DOES_NOT_FOLLOW:
                return word.state
            reached, limit = word.state == TargetState.REACHED.value, word.values['limited by']
            share = 1.0 if reached else 1.0 - min(_left(word.values) / max(first, 1e-9), 1.0)
            bar.update(task, completed=share, description=word.state,
                       what=f'{_shown(word.values, target)} {"" if reached else printable(limit)}')
            now = time.monotonic()
            if reached or patience.is_over(word.state, now):
                return word.state
            if patience.is_news(now):
                console.print(f'{word.state}: {explained(limit)}; '
                              f'waiting {_PATIENT[word.state]:g} s for a way')
            if now > word.heard + _SILENCE:
                raise StateError(f'no word of the target for {_SILENCE:g} s')
            client.spin()


def _left(values: Mapping[str, str]) -> float:
    """Return what is left of a way, metres and radians alike."""
    return sum(float(values.get(key, 0.0)) for key in _LEFT)


def _shown(values: Mapping[str, str], target: Goal) -> str:
    """Return what is left of a way for a person."""
    distance, angle, joint = (float(values[key]) for key in _LEFT)
    way = (f'{1e3 * distance:.1f} mm, {np.degrees(angle):.1f}°' if isinstance(target, Pose) else
           f'farthest joint {joint:.3f} rad or m')
    return f'{way}, another {float(values["expected time [s]"]):.1f} s'


def _target_of(
    options: argparse.Namespace, robot: Robot, q: Array, held: Pose | None,
) -> Goal:
    """Return where to go from a posture (n,), and from where what the tips hold is."""
    if options.joints is not None:
        return joint_target_of(robot, q, options.joints, options.relative)
    tip = held
    if options.tip != OBJECT or tip is None:
        tip = dict(zip(robot.tips, robot.kinematics(q).tips.each))[options.tip or robot.tip_frame]
    return target_of(tip, options.position, options.rpy, options.relative)


def _have_interrupted(client: TargetClient) -> None:
    """Have Ctrl-C end the client's waiting between two callbacks, however often it comes."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: client.interrupt())


def _stopped(client: TargetClient) -> bool:
    """Bring the arm to rest; return whether that worked, and if not, say so."""
    # Another Ctrl-C would leave the arm moving, or the planner paused.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    problem = client.stop()
    if problem:
        print(f'go_to: the arm may still move: {problem}', file=sys.stderr)
    return not problem


def _status_after(client: TargetClient, state: str) -> int:
    """Say how the arm's last state is, unless it is there; return the process's exit status."""
    if state == TargetState.REACHED.value:
        return 0
    reason = client.word.values.get('limited by', '') if client.word is not None else ''
    if state not in _PATIENT:
        print(f'go_to: {state}{": " if reason else ""}{printable(reason)}', file=sys.stderr)
        return 1
    print(f'go_to: {state}: {explained(reason)}; go_to gives up', file=sys.stderr)
    return 1 if _stopped(client) else 2


def _options(given: list[str]) -> argparse.Namespace:
    """Return what a command line without ROS arguments asks for."""
    parser = argparse.ArgumentParser(
        prog='go_to', description=__doc__,
        epilog='ROS arguments (--ros-args -r __ns:=/left …) may follow.')
    numbers: dict[str, Any] = {'type': float, 'nargs': 3}
    parser.add_argument('--position', metavar=('X', 'Y', 'Z'), **numbers,
                        help='of the tip in the base frame [m]; left out: where it is')
    parser.add_argument('--rpy', metavar=('ROLL', 'PITCH', 'YAW'), **numbers,
                        help='its orientation [rad]; left out: as it is')
    parser.add_argument('--joints', metavar='JOINT=POSITION', nargs='+',
                        help='joint positions instead [rad, m]; left out: as they are')
    parser.add_argument('--relative', action='store_true',
                        help='all are given from where the arm is; of the tip, in its own axes')
    parser.add_argument('--tip', default='', metavar='NAME',
                        help=f"which of several tips, or '{OBJECT}' for what they hold together")
    parser.add_argument('--object', action='store_const', dest='tip', const=OBJECT,
                        help=f'the same as --tip {OBJECT}')
    parser.add_argument('--wait', action='store_true',
                        help='show a progress bar until the arm is there; Ctrl-C stops the arm')
    parser.add_argument('--planner', default='planner_node', help="name of the planner's node")
    options = parser.parse_args(given)
    options.of_tip = options.position is not None or options.rpy is not None
    if options.of_tip == (options.joints is not None):
        parser.error('give --position, --rpy or both, or else --joints')
    if options.tip and not options.of_tip:
        parser.error('--joints are of the whole body: leave --tip away')
    return options


def main(args: list[str] | None = None) -> int:
    """Run go_to; return the process's exit status: 0 if the arm is there or on its way."""
    given = sys.argv[1:] if args is None else args
    ros = given.index('--ros-args') if '--ros-args' in given else len(given)
    options = _options(given[:ros])
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    console = Console(markup=False, emoji=False, highlight=False)
    client = None
    try:
        keep_off_shared_memory()
        rclpy.init(args=['go_to', *given[ros:]], signal_handler_options=SignalHandlerOptions.NO)
        client = TargetClient(options.planner, options.tip)
        _have_interrupted(client)
        robot, q = client.arm(joints=not options.of_tip)
        target = _target_of(options, robot, q, client.held)
        client.send(target)
        if not options.wait:
            client.wait_for_word()
            return 0
        return _status_after(client, follow(client, target, console))
    except (PlannerError, OSError) as error:
        print(f'go_to: {printable(str(error))}', file=sys.stderr)
        if client is not None:
            _stopped(client)
        return 2
    except KeyboardInterrupt:
        if client is not None and not _stopped(client):
            return 2
        print('go_to: stopped', file=sys.stderr)
        return 130
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    raise SystemExit(main())
