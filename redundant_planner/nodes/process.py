"""What every node of this package does around its own work: start, spin, end, and say why."""

from __future__ import annotations

import atexit
from collections.abc import Callable
import contextlib
import gc
import os
from pathlib import Path
import signal
import sys
from types import FrameType

import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from redundant_planner.core.errors import PlannerError
from redundant_planner.resources import share_directory

BAD_INPUT = 2

# What a user chooses Fast DDS's transports with; each release reads one of the two names.
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_DEFAULT_PROFILE = Path('DEFAULT_FASTRTPS_PROFILES.xml')
_TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'

# How long a signal to a node in which nothing happens may wait for the executor to look up [s].
_PATIENCE = 0.5


class EndableNode(Node):
    """A node that can end itself, and has a last word.

    Attributes:
        done: whether it has come to its end.
    """

    done = False
    _spin: Future | None = None

    def end(self) -> None:
        """End the process, after this callback."""
        self.done = True
        if self._spin is not None:
            self._spin.set_result(None)

    def spin_until_the_end(self, executor: Executor) -> None:
        """Run callbacks until `end` is called."""
        while not self.done:
            # Not spin(): rclpy 7.1's EventsExecutor turns in circles there without a timeout; nor
            # spin_once(), which costs 20 us for every callback. Not often either: each of these
            # calls leaks 32 bytes. A new future each time, as one would collect their callbacks.
            self._spin = Future()
            executor.spin_until_future_complete(self._spin, timeout_sec=_PATIENCE)

    def finish(self) -> None:
        """Do what must be done while publishing is still possible."""


def run(make_node: Callable[[], EndableNode], name: str, args: list[str] | None = None) -> int:
    """Run one node until it is done or interrupted; return the process's exit status.

    Bad input at the start ends the process with one readable line.

    Args:
        make_node: constructs the node.
        name: of the executable, for messages.
        args: command line, `sys.argv` if None.
    """
    interrupted = False
    node: EndableNode | None = None

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        if node is not None:
            node.end()

    # Ours rather than rclpy's handlers, which close the context before a node can say goodbye.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
        # Ctrl-C under `ros2 launch` comes twice, from the terminal and from launch. Python gives
        # handlers up as it ends, and the second would then make an orderly end look like a death.
        atexit.register(signal.signal, number, signal.SIG_IGN)
    keep_off_shared_memory()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
        executor = best_executor(rclpy.get_default_context())
        executor.add_node(node)
        # What exists by now lives as long as the process: keep the collector off it.
        gc.collect()
        gc.freeze()
        if not interrupted:
            node.spin_until_the_end(executor)
        node.finish()
    except (PlannerError, ParameterException, rclpy_implementation.RCLError,
            rclpy_implementation.UnknownROSArgsError) as error:
        print(f'{name}: {error}', file=sys.stderr)
        return BAD_INPUT
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def keep_off_shared_memory() -> None:
    """Have Fast DDS talk over UDP, unless the user has chosen otherwise.

    Its shared-memory transport checks a newcomer's port in the publishing thread and sleeps
    for 333 ms where that node is slow to answer: whenever some node starts, a control loop may
    miss eighty ticks. Call it before `rclpy.init`.

    Where discovery is limited to LOCALHOST, rmw_fastrtps adds shared memory to whatever was
    chosen. There a profile of ours limits it instead, and rmw_fastrtps is told to add nothing.
    Peers (ROS_STATIC_PEERS) have no place in that profile: with them shared memory stays.
    """
    profile = str(share_directory() / 'config' / 'middleware' / 'localhost_udp.xml')
    chosen = {os.environ.get(name) for name in _PROFILES} - {None, profile}
    if chosen or os.environ.get(_TRANSPORTS, 'UDPv4') != 'UDPv4' or _DEFAULT_PROFILE.exists():
        return
    os.environ[_TRANSPORTS] = 'UDPv4'
    only_here = os.environ.get('ROS_LOCALHOST_ONLY') == '1'
    if only_here or (os.environ.get(_RANGE) == 'LOCALHOST'
                     and not os.environ.get('ROS_STATIC_PEERS')):
        os.environ.update(dict.fromkeys(_PROFILES, profile))
        os.environ[_RANGE] = 'SYSTEM_DEFAULT'
        if only_here:  # which overrides the range
            os.environ['ROS_LOCALHOST_ONLY'] = '0'


def request_priority(priority: int) -> bool:
    """Give the process's threads a SCHED_FIFO priority; return whether the system granted it.

    All of them: a tick that preempts everybody else's work still waits for the middleware's
    own threads, which bring its inputs and take its output.

    Args:
        priority: 1 to 98; 0 asks for nothing and is always granted.
    """
    if priority == 0:
        return True
    try:
        for thread in os.listdir('/proc/self/task'):
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))
    except (PermissionError, AttributeError, FileNotFoundError):
        return False
    return True


def best_executor(context: Context) -> Executor:
    """Return the executor with the least overhead per callback that this rclpy has."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)
