"""go_to: sends the arm of a running planner to a pose of its tip, or to joint positions."""

from __future__ import annotations

import argparse
from collections.abc import Callable
import contextlib
import signal
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
import numpy as np
import numpy.typing as npt
import pinocchio as pin
import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Column
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool

from redundant_planner.core.errors import known, PlannerError, StateError
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.goal import checked_goal, Goal
from redundant_planner.core.target.progress import TargetState
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.printable import printable
from redundant_planner.io.recorded_configuration import configuration_of
from redundant_planner.io.robot_files import robot_of_values
from redundant_planner.nodes.joint_messages import JointReader
from redundant_planner.nodes.pose_messages import pose_of_message, pose_to_message
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory, spin_once
from redundant_planner.nodes.state_report import DOES_NOT_FOLLOW, TARGET
from redundant_planner.nodes.supervisor import PAUSED_ALREADY
from redundant_planner.nodes.tip_topics import OBJECT, OBJECT_POSE, text_of_tip, topic_of

Array = npt.NDArray[np.float64]

# How long planner and arm are waited for [s], and the arm for coming to rest.
_PATIENCE, _STOPPING = 10.0, 3.0
# Slower than this is at rest, see docs/interface.md [rad/s, m/s].
_AT_REST = 2e-3
# How long an arm that cannot get to its target may stay so before this gives up [s]: what is in
# the way may leave it, but no place gets into reach. And how long before this says so [s].
_PATIENT = {TargetState.BLOCKED.value: 5.0, TargetState.OUT_OF_REACH.value: 1.0}
_STEADY = 0.3
# How long the planner may be silent, which speaks of its target 20 times a second [s].
_SILENCE = 5.0
# What a planner's reason has in it → what may help. The first one that is found counts.
_ADVICE = {
    'no posture has the tip': 'a nearer place, or another orientation (--rpy)',
    'out of its cone': 'a tip that leans less (--rpy), or a wider cone.angle',
    'too near to an obstacle': 'a place further from it, another orientation (--rpy) or a '
                               'smaller clearance.margin, or take it away',
    'too near to': 'another place or orientation (--rpy); look at the capsules with show_robot if '
                   'these links have more room in reality',
    'no way to the target': 'a place in between first, or take away what is in the way',
    'near obstacle': 'target.path: free, which goes around, or take it away',
    'at its limit': 'target.path: free, or another orientation (--rpy)'}
# Those who remap the planner's topics have to tell this too.
_REMAPPED = 'if the planner has it remapped, repeat that here: --ros-args -r'
# Targets that differ by less are one, as their numbers are rounded [m, rad].
_SAME = 1e-5
# What the planner says is left of a way.
_LEFT = ('distance [m]', 'angle [rad]', 'farthest joint [rad, m]')


class _Client:
    """A node that sends targets to a planner, and hears what becomes of them."""

    def __init__(self, planner: str, tip: str = '') -> None:
        """Look for a planner's topics.

        Args:
            planner: name of its node.
            tip: that targets are for, or `OBJECT`; empty for the only one.
        """
        self.node = Node('go_to', enable_rosout=False, start_parameter_services=False)
        self.configuration = ''
        self._reader: JointReader | None = None
        self._speeds = np.zeros(0)  # of each joint, NaN where it was not heard since [rad/s, m/s]
        self.status: DiagnosticStatus | None = None
        self.heard = -np.inf  # when the status came [s]
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.joint_target = self.node.create_publisher(JointState, 'target_joints', 1)
        self.pause = self.node.create_client(SetBool, f'{planner}/pause')
        self.node.create_subscription(
            String, f'{planner}/configuration', self._on_configuration, latched)
        self.node.create_subscription(
            DiagnosticArray, f'{planner}/target', self._on_status, latched)
        self.node.create_subscription(
            JointState, 'joint_states', self._on_state, qos_profile_sensor_data, raw=True)
        self._executor = best_executor(self.node.context)
        self._executor.add_node(self.node)
        self._planner = planner
        self._sent: Goal | None = None
        self._names: tuple[str, ...] = ()
        self._tip, self._tips = tip, 0
        self._target: Publisher | None = None
        self.held: Pose | None = None  # where the object is, once it was heard

    def _on_configuration(self, message: String) -> None:
        self.configuration = message.data

    def _on_state(self, raw: bytes) -> None:
        if self._reader is None:
            return
        with contextlib.suppress(StateError):
            which = self._reader.read(raw)
            dq = self._reader.velocities(raw)
            self._speeds[which] = 0.0 if dq is None else np.abs(dq)

    def _on_status(self, message: DiagnosticArray) -> None:
        """Keep what is said of the target that was sent, and of nothing earlier."""
        status = message.status[0] if message.status else None
        if self._sent is None or status is None:
            return
        if self.status is not None or self.is_of(status, self._sent):
            self.status, self.heard = status, time.monotonic()

    def spin(self, seconds: float = 0.02) -> None:
        """Listen for a while [s]."""
        spin_once(self._executor, seconds)

    def wait_for(
        self, condition: Callable[[], object], what: str | Callable[[], str], topic: str = '',
    ) -> None:
        """Listen until something holds.

        Args:
            condition: that it waits for.
            what: it is.
            topic: that it comes on, if that may have another name for the planner.

        Raises:
            StateError: it takes too long.
        """
        until = time.monotonic() + _PATIENCE
        while not condition():
            if time.monotonic() > until:
                lacking = what if isinstance(what, str) else what()
                raise StateError(
                    f'no {lacking} within {_PATIENCE:g} s; is {self._planner} running, in the '
                    'same ROS domain and namespace? --planner names another' if not topic else
                    f'no {lacking} on {self.node.resolve_topic_name(topic)} within '
                    f'{_PATIENCE:g} s; {_REMAPPED} {topic}:=…')
            self.spin()

    def arm(self, *, joints: bool) -> tuple[Robot, Array]:
        """Return the planner's robot, and its posture (n,) now.

        Args:
            joints: whether targets will be of the joints, and not of a tip.

        Raises:
            PlannerError: the planner, its tip or the arm is not there.
        """
        self.wait_for(lambda: self.configuration, 'configuration of a planner')
        notes: list[str] = []
        values = configuration_of(self.configuration, notes)
        if not values:
            raise StateError(f"the planner's configuration is unusable: {'; '.join(notes)}")
        robot = robot_of_values(values)
        self._listen_for(robot, joints=joints)
        reader = self._reader = JointReader(robot.joint_names, Seams.of(robot))
        self._speeds = np.zeros(robot.n)
        self.wait_for(lambda: not reader.missing,
                      lambda: f'joint_states of {known(reader.missing)}', 'joint_states')
        if self._tip == OBJECT and not joints:
            self.wait_for(lambda: self.held is not None,
                          'pose of what the tips hold, which takes ~/couple,', OBJECT_POSE)
        return robot, reader.posture

    def _listen_for(self, robot: Robot, *, joints: bool) -> None:
        """Make sure that the planner hears targets.

        Raises:
            StateError: it does not, or has no such tip.
        """
        self._tips, topic = len(robot.tips), 'target_joints'
        publisher = self.joint_target
        if self._tips > 1:
            self.node.create_subscription(PoseStamped, OBJECT_POSE, self._on_object, 1)
        if not joints:
            topic = topic_of(self._tip, 'target_pose', robot.tips)
            publisher = self._target = self.node.create_publisher(PoseStamped, topic, 1)
        self.wait_for(publisher.get_subscription_count, 'listener', topic)

    def _on_object(self, message: PoseStamped) -> None:
        self.held = pose_of_message(message)

    def has_word(self) -> bool:
        """Return whether the planner has spoken of the target.

        Raises:
            StateError: it never will: what the tips hold does not let them move.
        """
        if self.held is not None and self._tip != OBJECT:
            raise StateError(f'the tips hold one object together: move it with --tip {OBJECT}, '
                             'or let go (~/couple with false)')
        return self.status is not None

    def send(self, target: Goal, robot: Robot) -> None:
        """Publish a target."""
        self._sent, self._names = target, robot.joint_names
        if isinstance(target, Pose):
            assert self._target is not None, 'a planner that was asked for a tip has it'
            self._target.publish(pose_to_message(target, robot.base_frame))
        else:
            self.joint_target.publish(
                JointState(name=list(robot.joint_names), position=target.tolist()))

    def is_of(self, status: DiagnosticStatus, target: Goal) -> bool:
        """Return whether a status is of a target."""
        text = _values(status).get(TARGET, '')
        if self._tips > 1 and isinstance(target, Pose) and self._tip != OBJECT:
            text = text_of_tip(text, self._tip)
        words = text.split()
        if not isinstance(target, Pose):
            named = [word.rpartition('=') for word in words]
            return tuple(name for name, _, _ in named) == self._names and bool(
                np.abs(np.array([value for _, _, value in named], float) - target).max() < _SAME)
        if len(words) != 7 or '=' in words[0]:
            return False
        numbers = np.array(words, dtype=float)
        turn = np.asarray(pin.Quaternion(numbers[3:]).toRotationMatrix())
        return bool(np.abs(numbers[:3] - target.position).max() < _SAME
                    and np.abs(turn - target.rotation).max() < _SAME)

    def stop(self) -> str:
        """Bring the arm to rest, unless no target was sent; return what keeps it from that.

        A pause lets go of the target. One that somebody else began goes on.
        """
        if self._sent is None:
            return ''
        # Another Ctrl-C would leave the arm moving, or the planner paused.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        until = time.monotonic() + _STOPPING
        answer = self._ask_for_pause(True, until) if self.pause.wait_for_service(1.0) else None
        if answer is None:
            return f'{self._planner} does not answer'
        rests = False
        self._speeds[:] = np.nan
        while not rests and time.monotonic() < until:
            self.spin(0.1)
            rests = bool((self._speeds < _AT_REST).all())
        if answer != PAUSED_ALREADY and self._ask_for_pause(False, until + 1.0) is None:
            return f'{self._planner} stays paused: it does not answer any more'
        return '' if rests else f'it does not come to rest within {_STOPPING:g} s'

    def _ask_for_pause(self, paused: bool, until: float) -> str | None:
        """Have the planner pause or go on; return its answer, None if none comes in time [s]."""
        answer = self.pause.call_async(SetBool.Request(data=paused))
        while not answer.done() and time.monotonic() < until:
            self.spin()
        return str(answer.result().message) if answer.done() else None


def target_of(
    tip: Pose, position: list[float] | None, rpy: list[float] | None, relative: bool,
) -> Pose:
    """Return the pose to go to, in the base frame.

    Args:
        tip: where it is now.
        position: x, y, z [m]; None to stay there.
        rpy: roll, pitch, yaw [rad]; None to keep the orientation.
        relative: whether both are given from where the tip is, in its axes.

    Raises:
        StateError: a number is not finite.
    """
    for name, values in (('--position', position), ('--rpy', rpy)):
        if not np.isfinite(values or 0.0).all():
            raise StateError(f'{name} is {values}; it takes three finite numbers')
    turn = None if rpy is None else np.asarray(pin.rpy.rpyToMatrix(*rpy))
    if relative:
        return se3.composed(tip, Pose(
            np.array(position or np.zeros(3), dtype=float), np.eye(3) if turn is None else turn))
    return Pose(tip.position if position is None else np.array(position, dtype=float),
                tip.rotation if turn is None else turn)


def joint_target_of(robot: Robot, q: Array, entries: list[str], relative: bool) -> Array:
    """Return the joint positions (n,) to go to.

    Args:
        robot: the arm.
        q: (n,) where it is now; joints that are not named stay there.
        entries: of the command line, 'joint=position' [rad, m].
        relative: whether the positions count from `q`.

    Raises:
        StateError: an entry is none, names no joint of the arm or one twice, or asks for more than
            its limits allow.
    """
    target = np.clip(q, robot.position_min, robot.position_max)
    named: set[str] = set()
    for entry in entries:
        name, _, text = entry.partition('=')
        try:
            value = float(text)
        except ValueError:
            raise StateError(f"--joints has '{entry}'; it takes joint=position, "
                             f"as '{robot.joint_names[0]}=0.5'") from None
        if name not in robot.joint_names:
            raise StateError(f"--joints has '{entry}'; the joints are {known(robot.joint_names)}")
        if name in named:
            raise StateError(f"--joints names '{name}' twice")
        named.add(name)
        j = robot.joint_names.index(name)
        target[j] = value + (q[j] if relative else 0.0)
    return np.asarray(checked_goal(target, robot))


def follow(client: _Client, target: Goal, console: Console) -> str:
    """Show how far the arm has come until it is there or stays blocked; return the last state.

    Raises:
        StateError: the planner says nothing of the target, or nothing more.
    """
    client.wait_for(lambda: client.has_word() and client.status and client.status.values,
                    'word of the target on ~/target')
    first = _left(client.status)
    stuck_since, is_said = None, False
    wide = Column(no_wrap=True, min_width=12)
    with Progress(TextColumn('{task.description}', table_column=wide), BarColumn(),
                  TextColumn('{task.fields[what]}'), console=console) as bar:
        task = bar.add_task('moving', total=1.0, what='')
        while True:
            status = client.status
            assert status is not None
            state, values = status.message, _values(status)
            if not client.is_of(status, target):
                return 'somebody else commands the arm now'
            if state == DOES_NOT_FOLLOW:
                return str(state)
            share = 1.0 - min(_left(status) / max(first, 1e-9), 1.0)
            bar.update(task, completed=share, description=state, what=(
                f'{_shown(values, target)}, another {float(values["expected time [s]"]):.1f} s '
                f'{printable(values["limited by"])}'))
            if state == TargetState.REACHED.value:
                bar.update(task, completed=1.0)
                return str(state)
            now = time.monotonic()
            if state not in _PATIENT:
                stuck_since = None
            elif stuck_since is None:
                stuck_since, is_said = now, False
            elif now > stuck_since + _PATIENT[state]:
                return str(state)
            elif not is_said and now > stuck_since + _STEADY:
                is_said = True
                console.print(f'{state}: {explained(values["limited by"])}; '
                              f'waiting {_PATIENT[state]:g} s for a way')
            if time.monotonic() > client.heard + _SILENCE:
                raise StateError(f'no word of the target for {_SILENCE:g} s')
            client.spin()


def explained(reason: str) -> str:
    """Return the planner's reason, and what may help."""
    advice = next((words for part, words in _ADVICE.items() if part in reason), '')
    return printable(reason or 'the planner does not say why') + (
        f'; try {advice}' if advice else '')


def _values(status: DiagnosticStatus | None) -> dict[str, str]:
    return {} if status is None else {value.key: value.value for value in status.values}


def _left(status: DiagnosticStatus | None) -> float:
    """Return what is left of a way, metres and radians alike."""
    values = _values(status)
    return sum(float(values.get(key, 0.0)) for key in _LEFT)


def _shown(values: dict[str, str], target: Goal) -> str:
    """Return what is left of a way for a person."""
    distance, angle, joint = (float(values[key]) for key in _LEFT)
    if isinstance(target, Pose):
        return f'{1e3 * distance:.1f} mm, {np.degrees(angle):.1f}°'
    return f'farthest joint {joint:.3f} rad or m'


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


def _stopped(client: _Client) -> bool:
    """Bring the arm to rest; return whether that worked, and if not, say so."""
    problem = client.stop()
    if problem:
        print(f'go_to: the arm may still move: {problem}', file=sys.stderr)
    return not problem


def main(args: list[str] | None = None) -> int:
    """Run go_to; return the process's exit status: 0 if the arm is there or on its way."""
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
    given = sys.argv[1:] if args is None else args
    ros = given.index('--ros-args') if '--ros-args' in given else len(given)
    options = parser.parse_args(given[:ros])
    of_tip = options.position is not None or options.rpy is not None
    if of_tip == (options.joints is not None):
        parser.error('give --position, --rpy or both, or else --joints')
    if options.tip and not of_tip:
        parser.error('--joints are of the whole body: leave --tip away')
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    console = Console(markup=False, emoji=False, highlight=False)
    client = None
    try:
        keep_off_shared_memory()
        rclpy.init(args=['go_to', *given[ros:]], signal_handler_options=SignalHandlerOptions.NO)
        client = _Client(options.planner, options.tip)
        robot, q = client.arm(joints=not of_tip)
        target = _target_of(options, robot, q, client.held)
        client.send(target, robot)
        if not options.wait:
            # Until it is heard: a publisher that is gone takes its message along.
            client.wait_for(client.has_word, 'word of the target on ~/target')
            return 0
        state = follow(client, target, console)
        if state == TargetState.REACHED.value:
            return 0
        reason = _values(client.status).get('limited by', '')
        said = f'{state}{": " if reason else ""}{printable(reason)}'
        if state in _PATIENT:
            said = f'{state}: {explained(reason)}; go_to gives up'
        print(f'go_to: {said}', file=sys.stderr)
        return 1 if state not in _PATIENT or _stopped(client) else 2
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
