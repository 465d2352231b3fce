"""quick_start: from a URDF to a simulated arm that moves, in one command.

Fits capsules, proposes a start, writes a parameter file and a picture, starts fake_hardware_node
and planner_node with the file, and says what to type next. Ctrl-C ends both nodes.
"""

from __future__ import annotations

import argparse
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
import os
from pathlib import Path
import shlex
import shutil
import signal
import sys
import time

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from redundant_planner.core.errors import known, PlannerError
from redundant_planner.io.xacro_files import expanded
from redundant_planner.nodes.child_processes import LiveError, Processes
from redundant_planner.nodes.fake_hardware_node import HEARS_COMMANDS
from redundant_planner.nodes.runtime import (
    best_executor,
    keep_off_shared_memory,
    ros_domain,
    spin_once,
)
from redundant_planner.tools.show_robot import (
    add_arm_options,
    Arm,
    arm_of,
    described_by_file,
    described_by_urdf,
    draw,
    parameter_file,
    said_of_limits,
    said_of_tip,
    several_tips,
)

ARM, _PLANNER = 'fake_hardware_node', 'planner_node'
# How long both nodes get to start, compilation included, and the planner to stop the arm [s].
_START_PATIENCE, _STOP_PATIENCE = 300.0, 3.0
# Other nodes announce themselves every 3 s, and are found within this [s].
_DISCOVERY = 3.5
# What rclpy calls a node that it has half found.
_UNNAMED = '_NODE_NAME_UNKNOWN_'
# How often it is looked whether a node has ended [s].
_LOOK = 0.1
# Of what a node said last, how much is repeated when it has ended.
_LAST_LINES = 5


class _Station:
    """A node that sees whether other arms are there, and whether the planner is ready."""

    def __init__(self, context: Context) -> None:
        """Listen from now on."""
        self._node = Node('quick_start', context=context, enable_rosout=False,
                          start_parameter_services=False)
        self._configured, self._commands = False, False
        self._since = time.monotonic()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._node.create_subscription(
            String, f'{_PLANNER}/configuration', self._on_configuration, latched)
        self._node.create_subscription(
            JointState, 'joint_command', self._on_command, qos_profile_sensor_data)
        self._executor = best_executor(context)
        self._executor.add_node(self._node)

    def _on_configuration(self, message: String) -> None:
        self._configured = True

    def _on_command(self, message: JointState) -> None:
        self._commands = True

    @property
    def ready(self) -> bool:
        """Whether the planner has built its robot and commands the arm."""
        return self._configured and self._commands

    def listen(self, seconds: float) -> None:
        """Take in what comes [s]."""
        spin_once(self._executor, seconds)

    def is_alone(self, domain: int) -> bool:
        """Return whether there surely is no arm, and no planner but ours; False: not sure yet.

        Raises:
            LiveError: there is one.
        """
        if time.monotonic() < self._since + _DISCOVERY:
            return False
        found = Counter(
            info.node_name for topic in ('joint_states', 'joint_command')
            for info in self._node.get_publishers_info_by_topic(topic))
        others = found - Counter((_PLANNER, f'{_PLANNER}_last_word'))
        if _UNNAMED in others:  # which may be ours
            return False
        if others:
            raise LiveError(
                f'an arm or a planner runs already in ROS domain {domain}: '
                f'{known(sorted(others))}; end it, or set ROS_DOMAIN_ID to another number in '
                'every terminal')
        return True

    def close(self) -> None:
        """Leave the network."""
        self._node.destroy_node()


def prepared(
    options: argparse.Namespace, say: Callable[[str], object], warn: Callable[[str], object],
) -> tuple[Arm, Path, bool]:
    """Write the parameter file and the picture of an arm, unless they are there.

    Args:
        options: of the command line.
        say, warn: take sentences.

    Returns:
        The arm, its parameter file, and whether the file says where the arm starts.

    Raises:
        PlannerError, OSError: with what is wrong.
    """
    options.out.mkdir(parents=True, exist_ok=True)
    urdf = expanded(options.urdf, options.xacro_args, options.out)
    stem = Path(urdf).stem
    file, picture = (options.out / f'{stem}.{kind}' for kind in ('yaml', 'png'))
    if options.tip and options.tips:
        raise PlannerError('give --tip or --tips, not both')
    described = described_by_urdf(
        urdf, options.tip, options.base, lambda _: None, options.tips)
    is_kept = file.exists() and not options.overwrite
    if is_kept:
        wanted, described = described.parameters, described_by_file(file)
        found = described.parameters
        tips = ' '.join(found.tips) or found.tip_frame
        for what, asked, there in (
                ('URDF', wanted.urdf, found.urdf),
                ('tip', options.tip or ' '.join(options.tips) or tips, tips),
                ('base', options.base or found.base_frame, found.base_frame)):
            if asked != there:
                raise PlannerError(
                    f"'{file}' is there already, with the {what} '{there}' and not '{asked}'; "
                    'give another folder with --out, or --overwrite it')
        say(f'{file} is there already and used as it is (--overwrite makes it anew)')
        if found.urdf and Path(found.urdf).is_file() and (
                Path(found.urdf).stat().st_mtime > file.stat().st_mtime):
            warn(f'{found.urdf} is newer than {file}')
    else:
        if not (options.tip or options.tips) and (sentence := several_tips(urdf)):
            warn(sentence)
        described = described_by_urdf(urdf, options.tip, options.base, warn, options.tips)
        say('fitting capsules to the collision geometry')
    arm = arm_of(described, warn)
    if not is_kept:
        file.write_text(parameter_file(arm.parameters, arm.robot, arm.start, arm.sources))
        say(f'parameter file: {file}')
    say(said_of_limits(arm))
    if not is_kept and not arm.parameters.tips and not options.tip:
        say(said_of_tip(arm.robot))
    if picture.exists() and not options.overwrite:
        say(f'{picture} is there already and stays as it is')
    else:
        draw(picture, arm, warn)
        say(f'picture:        {picture}')
    return arm, file, bool(described.start) or not is_kept


def next_steps(
    domain: int, drive: Sequence[str], go_to: Sequence[str], tips: Sequence[str] = (),
) -> str:
    """Return what to type in another terminal.

    Args:
        domain: the ROS domain.
        drive, go_to: how the commands are called here.
        tips: of a body with several.
    """
    if tips:
        drive, go_to = ([*command, '--tip', tips[0]] for command in (drive, go_to))
    there = f'ROS_DOMAIN_ID={domain} ' if domain else ''
    return '\n'.join((
        'In another terminal, move the tip by keys:', '',
        f'    {there}{shlex.join(drive)}', '',
        'Or send it 5 cm along its own x axis:', '',
        f'    {there}{shlex.join(go_to)} --relative --position 0.05 0 0 --wait', '',
        'Ctrl-C here ends the planner and the simulated arm.'))


def _called_here(command: str) -> list[str]:
    """Return how a command of this package is called on this machine."""
    if shutil.which(command):
        return [command]
    if shutil.which('ros2'):
        return ['ros2', 'run', 'redundant_planner', command]
    return [sys.executable, '-m', f'redundant_planner.tools.{command}']


class Nodes(Processes):
    """The arm and the planner as processes, whose lines go to the terminal.

    Attributes:
        arm_hears: whether the arm has said that it hears the planner: the planner may find it
            some seconds before.
    """

    def __init__(self, domain: int) -> None:
        """Prepare for processes on a ROS domain."""
        super().__init__(domain, self._pass_on)
        self._said: dict[str, deque[str]] = {}
        self.arm_hears = False
        if sys.stderr.isatty():
            self.environment['RCUTILS_COLORIZED_OUTPUT'] = '1'

    def _pass_on(self, name: str, line: str) -> None:
        self._said.setdefault(name, deque(maxlen=_LAST_LINES)).append(line)
        self.arm_hears = self.arm_hears or (name == ARM and HEARS_COMMANDS in line)
        print(line, file=sys.stderr, flush=True)

    def check(self) -> None:
        """Make sure that all run.

        Raises:
            LiveError: one has ended, whatever its exit status, with what it said last.
        """
        for name, child in self._children.items():
            if child.poll() is not None:
                time.sleep(_LOOK)  # its last lines are on their way
                last = '\n  '.join(self._said.get(name, ()))
                raise LiveError(f'{name} ended with exit status {child.returncode}' + (
                    f'; it said last:\n  {last}' if last else ''))


def _run(
    file: Path, values: Mapping[str, object], station: _Station, domain: int,
    say: Callable[[str], object], tips: Sequence[str], kind: Callable[[int], Nodes],
) -> None:
    """Run arm and planner until Ctrl-C.

    Args:
        file: their parameters.
        values: the arm's besides.
        station: that is about to close.
        domain: the ROS domain.
        say: takes what the user is to read.
        tips: of a body with several.
        kind: of processes, on a ROS domain.

    Raises:
        LiveError: one of them ended, or the planner is not ready in time.
        KeyboardInterrupt: as soon as the planner has stopped the arm.
    """
    nodes = kind(domain)
    with nodes:
        # It loads for some seconds, and commands nothing before there is an arm.
        planner = nodes.start(_PLANNER, [file], name=_PLANNER)
        try:
            deadline, is_started = time.monotonic() + _START_PATIENCE, False
            while not (is_started and station.ready and nodes.arm_hears):
                nodes.check()
                if time.monotonic() > deadline:
                    raise LiveError(f'{_PLANNER} did not get ready within {_START_PATIENCE:g} s')
                station.listen(_LOOK)
                if not is_started and station.is_alone(domain):
                    nodes.start(ARM, [file], values, name=ARM)
                    is_started = True
            station.close()
            say(next_steps(domain, _called_here('drive'), _called_here('go_to'), tips))
            while True:
                nodes.check()
                time.sleep(_LOOK)
        except KeyboardInterrupt:
            # Another Ctrl-C would leave the arm without the planner's last word.
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_IGN)
            nodes.end(planner, _STOP_PATIENCE)
            raise


def main(args: list[str] | None = None, kind: Callable[[int], Nodes] = Nodes) -> int:
    """Run quick_start.

    Args:
        args: command line.
        kind: of processes that arm and planner are, on a ROS domain.

    Returns:
        The process's exit status: 0 if Ctrl-C ended a running arm.
    """
    parser = argparse.ArgumentParser(prog='quick_start', description=__doc__)
    parser.add_argument('urdf', help='path, file:// or package:// location of the URDF')
    add_arm_options(parser, 'parameter file')
    parser.add_argument('--out', type=Path, default=Path(),
                        help='folder for the parameter file and the picture, which have the '
                             "URDF's name (default: the current one)")
    parser.add_argument('--overwrite', action='store_true',
                        help='make both files anew; without it those that are there are used')
    options = parser.parse_args(args)
    console = Console(stderr=True, markup=False, emoji=False, highlight=False, soft_wrap=True)

    def say(sentence: str, style: str = '') -> None:
        console.print(sentence, style=style)

    def warn(sentence: str) -> None:
        console.print(f'careful: {sentence}', style='yellow')

    running = False

    def say_next(text: str) -> None:
        nonlocal running
        running = True
        say(f'\nReady after {time.monotonic() - began:.0f} s.\n{text}\n', 'bold')

    # Ended politely, it cleans up as it does after Ctrl-C, also where a shell has it ignore that.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    began, context = time.monotonic(), Context()
    try:
        domain = ros_domain()
        # A simulated arm is nobody else's business on the network.
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        keep_off_shared_memory()
        rclpy.init(context=context, domain_id=domain,
                   signal_handler_options=SignalHandlerOptions.NO)
        station = _Station(context)
        arm, file, has_start = prepared(options, say, warn)
        say(f'starting {_PLANNER} and {ARM}')
        _run(file, {} if has_start else {
            'initial_joints': list(arm.start), 'initial_positions': list(arm.start.values())},
            station, domain, say_next, arm.parameters.tips, kind)
    except LiveError as error:
        print(f'quick_start: {error}', file=sys.stderr)
        return 1
    except (PlannerError, OSError) as error:
        print(f'quick_start: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('quick_start: ended', file=sys.stderr)
        return 0 if running else 130
    finally:
        rclpy.try_shutdown(context=context)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
