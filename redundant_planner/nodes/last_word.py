"""A second process that brings the arm to rest if planner_node's own dies in motion.

Python cannot handle SIGKILL or a segmentation fault, and a velocity command holds until the next
one. So planner_node forks before it starts, and notes every command in memory that both processes
share. The fork waits at a pipe whose other end only the planner holds. The system closes that end
when the planner dies, for any reason.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from dataclasses import asdict, dataclass
import gc
import json
import mmap
import os
import select
import signal
import struct
import time
from typing import NamedTuple, NoReturn
import warnings

import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from redundant_planner.core.safety.limits import braked
from redundant_planner.core.safety.stopping import PositionCommand
from redundant_planner.nodes import runtime
from redundant_planner.nodes.command_output import CommandOutput

Array = npt.NDArray[np.float64]

# The end of the second node's name, and its states while nothing is wrong.
SUFFIX = '_last_word'
STARTING, READY = 'starting', 'ready'
# The stop at the end: how often it is published, the pause between two [s], and how long to wait
# for an acknowledgement [s].
STOPS = 3
PAUSE = 0.01
ACKNOWLEDGED = 0.3

# A drive without a command for this long has stopped by itself. It must not move again, so the
# second process publishes the stop alone [s].
_STALE = 0.25
# A listener that has not found the second node yet would miss the stop. The second node waits
# until as many listen to it as listened to the planner, but not longer than this [s].
_FOUND = 10.0
# How often it counts its listeners [s].
_LOOK = 0.5
# How long the planner waits at its own end for the other process to leave [s].
_LEAVING = 1.0

# Shared memory: the number of commands so far, the state of the second process, the listeners of
# the planner and of the second process, and two places for commands. The planner writes them in
# turns: if it dies while writing one, the other is whole.
_SIZE = 1 << 16
_COUNT = struct.Struct('@Q')  # native, as it is then written at once
_STATE = _COUNT.size
_NUMBER = struct.Struct('@I')
_PLANNERS_LISTENERS, _OWN_LISTENERS = 16, 20
_COMMANDS = 64
_HAS_STARTED, _HAS_FAILED = 1, 2
_END = b'end\n'


@dataclass(frozen=True)
class Brief:
    """All that the second process needs to stop the arm in the planner's place.

    Attributes:
        node, namespace: the planner's.
        topics: name of an output → the topic that it is published on.
        outputs: besides joint_command, as `CommandOutput` takes them.
        joint_names: n of them.
        position_min, position_max, acceleration_max: n each [rad, m; per s²].
        period: between commands [s].
        priority: real-time priority of its threads, 0 for none.
    """

    node: str
    namespace: str
    topics: dict[str, str]
    outputs: Sequence[str]
    joint_names: Sequence[str]
    position_min: Sequence[float]
    position_max: Sequence[float]
    acceleration_max: Sequence[float]
    period: float
    priority: int


class NotedCommand(NamedTuple):
    """A command as the planner noted it.

    Attributes:
        time: when, by the system's monotonic clock [s].
        stamp_ns: of its message [ns].
        positions, velocities: (n,) [rad, m; per s].
    """

    time: float
    stamp_ns: int
    positions: Array
    velocities: Array


class CommandMemory:
    """The latest command, in memory that two processes share."""

    def __init__(self, memory: mmap.mmap) -> None:
        """Use `_SIZE` bytes of zeros."""
        self._memory = memory
        self._command = struct.Struct('@dq')
        self._n = self._count = 0

    def prepare(self, n: int) -> bool:
        """Make places for commands of n joints; return whether there is room for them."""
        self._n, self._command = n, struct.Struct(f'@dq{2 * n}d')
        return _COMMANDS + 2 * self._command.size <= _SIZE

    def note(self, stamp_ns: int, positions: Array, velocities: Array) -> None:
        """Write the latest command; 2 µs."""
        self._count += 1
        self._command.pack_into(
            self._memory, self._place(self._count), time.monotonic(), stamp_ns,
            *positions.tolist(), *velocities.tolist())
        _COUNT.pack_into(self._memory, 0, self._count)

    def latest(self) -> NotedCommand | None:
        """Return the latest command; None without one."""
        count, = _COUNT.unpack_from(self._memory, 0)
        if not count:
            return None
        when, stamp_ns, *numbers = self._command.unpack_from(self._memory, self._place(count))
        return NotedCommand(when, stamp_ns, np.array(numbers[:self._n]),
                            np.array(numbers[self._n:]))

    def _place(self, count: int) -> int:
        return _COMMANDS + count % 2 * self._command.size


class LastWord:
    """The planner's side: it briefs the other process, and tells it when to leave."""

    def __init__(self, pid: int, pipe: int, memory: mmap.mmap | None, trouble: str = '') -> None:
        """Use `stand_by` or `absent` instead."""
        self._pid, self._pipe, self._memory = pid, pipe, memory
        self._commands = CommandMemory(memory) if memory is not None else None
        self._trouble = trouble
        self._briefed = False

    @classmethod
    def absent(cls, why: str) -> LastWord:
        """Return one without a second process."""
        return cls(0, -1, None, why)

    @classmethod
    def stand_by(cls, args: list[str] | None) -> LastWord:
        """Start the other process; call it before `rclpy.init`, it then calls that itself.

        Args:
            args: command line for `rclpy.init`.
        """
        runtime.keep_off_shared_memory()
        try:
            memory = mmap.mmap(-1, _SIZE)
            read_end, write_end = os.pipe()
        except OSError as error:
            return cls.absent(f'no pipe or no memory to share: {error}')
        # Objects that the collector has seen stay shared between the two processes.
        gc.collect()
        gc.freeze()
        try:
            with warnings.catch_warnings():
                # Python warns of other threads: OpenBLAS's stop for a fork, LTTng's do no harm.
                warnings.simplefilter('ignore', DeprecationWarning)
                pid = os.fork()
        except OSError as error:
            os.close(read_end)
            os.close(write_end)
            return cls.absent(f'no second process: {error}')
        if pid == 0:
            _second_process(read_end, memory, args)
        os.close(read_end)
        return cls(pid, write_end, memory)

    def brief(self, brief: Brief) -> None:
        """Tell the second process about the robot, before the first command."""
        if self._commands is None:
            return
        if not self._commands.prepare(len(brief.joint_names)):
            self._trouble = f'{len(brief.joint_names)} joints are too many for it'
            return
        self._briefed = self._tell(json.dumps(asdict(brief)).encode() + b'\n')

    def note(self, stamp_ns: int, positions: Array, velocities: Array) -> None:
        """Note a command that is about to be published, (n,) each [rad, m; per s]."""
        if self._briefed and self._commands is not None:
            self._commands.note(stamp_ns, positions, velocities)

    def state(self, listeners: int) -> str:
        """Return `STARTING`, `READY`, or why no process would stop the arm.

        Args:
            listeners: how many subscribe to the planner's joint_command; the other process is
                ready when as many have found it.
        """
        if not self._trouble and self._memory is not None:
            _NUMBER.pack_into(self._memory, _PLANNERS_LISTENERS, listeners)
            if self._has_left():
                self._trouble = 'its process has ended'
            elif self._memory[_STATE] == _HAS_FAILED:
                self._trouble = 'its process could not start its node'
            else:
                found, = _NUMBER.unpack_from(self._memory, _OWN_LISTENERS)
                started = self._memory[_STATE] == _HAS_STARTED
                return READY if started and found >= listeners else STARTING
        return self._trouble

    def end(self) -> None:
        """End the other process without a stop, as the arm rests."""
        if self._pipe >= 0:
            self._tell(_END)
            self._leave()

    def hand_over(self) -> None:
        """Have the other process stop the arm, as this one cannot; publish nothing afterwards."""
        if self._pipe >= 0:
            self._leave()

    def _leave(self) -> None:
        os.close(self._pipe)
        self._pipe = -1
        deadline = time.monotonic() + _LEAVING
        while not self._has_left() and time.monotonic() < deadline:
            time.sleep(PAUSE)

    def _tell(self, line: bytes) -> bool:
        try:
            return os.write(self._pipe, line) == len(line)
        except OSError as error:
            self._trouble = f'its process does not listen: {error}'
            return False

    def _has_left(self) -> bool:
        if self._pid:
            try:
                if os.waitpid(self._pid, os.WNOHANG)[0]:
                    self._pid = 0
            except ChildProcessError:
                self._pid = 0
        return self._pid == 0


def _second_process(pipe: int, memory: mmap.mmap, args: list[str] | None) -> NoReturn:
    """Live as the other process, and end it."""
    try:
        gc.disable()  # the collector would copy each object that it looks at
        os.setsid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        # A process that reads the planner's output waits until all copies of it are closed.
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(nothing, stream)
        for name in os.listdir('/proc/self/fd'):
            if int(name) > 2 and int(name) != pipe:
                with contextlib.suppress(OSError):
                    os.close(int(name))
        _wait_and_speak(pipe, memory, args)
    except BaseException:
        memory[_STATE] = _HAS_FAILED
    finally:
        os._exit(0)


def _wait_and_speak(pipe: int, memory: mmap.mmap, args: list[str] | None) -> None:
    with os.fdopen(pipe, 'rb') as lines:
        line = lines.readline()
        if not line.endswith(b'\n') or line == _END:
            return
        brief = Brief(**json.loads(line))
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        # The global arguments would rename this node as well.
        remap = [word for name, topic in brief.topics.items()
                 for word in ('-r', f'{name}:={topic}')]
        node = Node(
            brief.node + SUFFIX, namespace=brief.namespace, use_global_arguments=False,
            cli_args=['--ros-args', *remap], start_parameter_services=False,
            parameter_overrides=[Parameter('start_type_description_service', value=False)])
        output = CommandOutput(node, brief.joint_names, brief.outputs, brief.period)
        runtime.request_priority(brief.priority)
        memory[_STATE] = _HAS_STARTED
        while not select.select([lines], [], [], _LOOK)[0]:
            _NUMBER.pack_into(memory, _OWN_LISTENERS, output.listeners())
        if lines.readline() != _END:
            commands = CommandMemory(memory)
            commands.prepare(len(brief.joint_names))
            last = commands.latest()
            if last is not None and last.velocities.any():
                speak(brief, last, output, _NUMBER.unpack_from(memory, _PLANNERS_LISTENERS)[0])
                node.get_logger().error(
                    f'{brief.node} died while the arm moved; it was told to stop')
        node.destroy_node()
        rclpy.shutdown()


def speak(
    brief: Brief, last: NotedCommand, output: CommandOutput, listeners: int,
    clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Bring an arm to rest whose last command was a motion.

    Args:
        brief: about the planner and its robot.
        last: command that was noted.
        output: takes the commands.
        listeners: how many must find the output before the stop is published.
        clock, sleep: of the system [s].
    """
    dq, positions = last.velocities, last.positions
    acceleration_max = np.array(brief.acceleration_max)
    command = PositionCommand(np.array(brief.position_min), np.array(brief.position_max), np.inf)
    due = last.time + brief.period
    if clock() - last.time > _STALE:
        dq = np.zeros(len(dq))

    def publish(now: float) -> None:
        output.publish(last.stamp_ns + int(1e9 * (now - last.time)), positions, dq)

    while dq.any():
        sleep(max(due - clock(), 0.0))
        dq = braked(dq, acceleration_max, brief.period)
        positions = command.advance(last.positions, dq, brief.period, known=False)
        now = clock()
        due = now + brief.period
        publish(now)
    enough = clock() + _FOUND
    while output.listeners() < listeners and clock() < enough:
        sleep(PAUSE)
    for _ in range(STOPS):
        sleep(PAUSE)
        publish(clock())
    output.wait_until_heard(ACKNOWLEDGED)
