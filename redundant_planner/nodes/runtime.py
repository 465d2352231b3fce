"""The process around a node: it starts, runs and ends one, and prepares middleware and system."""

from __future__ import annotations

import atexit
from collections.abc import Callable
import contextlib
import gc
import os
from pathlib import Path
import signal
import sys
import traceback
from types import FrameType

import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from redundant_planner.core.errors import PlannerError
from redundant_planner.io.resources import share_directory
from redundant_planner.nodes.endable_node import EndableNode
from redundant_planner.nodes.rclpy_internals import START_ERRORS

BAD_INPUT = 2
# The highest ROS domain whose ports there are.
_LAST_DOMAIN = 232

# With these a user chooses Fast DDS's transports; each release reads one of the two names.
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_DEFAULT_PROFILE = Path('DEFAULT_FASTRTPS_PROFILES.xml')
_TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'


def run(make_node: Callable[[], EndableNode], name: str, args: list[str] | None = None) -> int:
    """Run one node until it is done or interrupted; return the process's exit status.

    Bad input at the start ends the process with one readable line. The node finishes before the
    process ends, for whichever reason.

    Args:
        make_node: constructs the node.
        name: of the executable, for messages.
        args: command line, `sys.argv` if None.
    """
    interrupted = False
    node: EndableNode | None = None

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        if interrupted:  # a handler within a handler would wait for its own lock
            return
        interrupted = True
        if node is not None:
            node.end()

    # rclpy's own handlers close the context before a node can publish its last stop.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
        # Ctrl-C under `ros2 launch` comes twice, from the terminal and from launch. Python drops
        # its handlers as it ends; the second signal would then kill a process that ends in order.
        atexit.register(signal.signal, number, signal.SIG_IGN)
    keep_off_shared_memory()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
        executor = best_executor(rclpy.get_default_context())
        executor.add_node(node)
        # All objects so far live as long as the process: the collector need not look at them.
        gc.collect()
        gc.freeze()
        if not interrupted:
            node.spin_until_the_end(executor)
    except (PlannerError, ParameterException, *START_ERRORS) as error:
        print(f'{name}: {error}', file=sys.stderr)
        return BAD_INPUT
    finally:
        for step in ((node.finish, node.destroy_node) if node is not None else ()):
            try:
                step()
            except Exception:
                traceback.print_exc()
        rclpy.try_shutdown()
    return node.status


def keep_off_shared_memory() -> None:
    """Have Fast DDS talk over UDP, unless the user has chosen otherwise.

    Its shared-memory transport checks a new node's port in the publishing thread, and sleeps for
    333 ms if that node is slow to answer. A control loop would miss eighty ticks whenever a node
    starts. Call it before `rclpy.init`.

    If discovery is limited to LOCALHOST, rmw_fastrtps adds shared memory to any choice. There a
    profile of this package limits discovery instead, and rmw_fastrtps is told to add nothing.
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

    All threads get it, as each tick waits for the middleware's threads, which bring its inputs
    and take its output.

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


def ros_domain() -> int:
    """Return the user's ROS domain.

    Raises:
        PlannerError: ROS_DOMAIN_ID is none.
    """
    given = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not given.isdecimal() or int(given) > _LAST_DOMAIN:
        raise PlannerError(f"ROS_DOMAIN_ID is '{given}'; it must be a number from 0 to "
                           f'{_LAST_DOMAIN}')
    return int(given)


def spin_once(executor: Executor, seconds: float) -> None:
    """Run what is due or comes within some seconds [s], where Ctrl-C raises KeyboardInterrupt.

    Raised within a callback it would go through the C++ of rclpy's EventsExecutor, which may make
    another exception of it.

    Raises:
        KeyboardInterrupt: afterwards, if SIGINT or SIGTERM came and has Python's own handler.
    """
    came = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True

    raising = [number for number in (signal.SIGINT, signal.SIGTERM)
               if signal.getsignal(number) is signal.default_int_handler]
    for number in raising:
        signal.signal(number, note)
    try:
        executor.spin_once(timeout_sec=seconds)
    finally:
        for number in raising:
            signal.signal(number, signal.default_int_handler)
    if came:
        raise KeyboardInterrupt


def best_executor(context: Context) -> Executor:
    """Return the executor with the least overhead per callback that this rclpy has."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)
