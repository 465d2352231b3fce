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
import traceback
from types import FrameType
from typing import Any

from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC
from rclpy.timer import Timer

from redundant_planner.core.errors import PlannerError
from redundant_planner.io.resources import share_directory
from redundant_planner.nodes.guard import Guard, line_of

BAD_INPUT = 2

# What a user chooses Fast DDS's transports with; each release reads one of the two names.
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_DEFAULT_PROFILE = Path('DEFAULT_FASTRTPS_PROFILES.xml')
_TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
_RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'

# How long a signal to a node in which nothing happens may wait for the executor to look up [s].
_PATIENCE = 0.5


class EndableNode(Node):
    """A node that can end itself, has a last word, and survives what nobody foresaw.

    Each callback runs behind a guard, rclpy's own for parameters and clocks included: an exception
    costs the message that led to it.

    Attributes:
        done: whether it has come to its end.
        status: of the process that it is run in, once it has ended.
        guard: counts exceptions.
    """

    done = False
    status = 0
    _spin: Future | None = None

    def __init__(self, name: str) -> None:
        """Make a node of this name."""
        # First, as rclpy's constructor already creates guarded services.
        self.guard = Guard(lambda text: self.get_logger().error(text))
        super().__init__(name)

    def end(self) -> None:
        """End the process, after this callback."""
        self.done = True
        if self._spin is not None:
            self._spin.set_result(None)

    def spin_until_the_end(self, executor: Executor) -> None:
        """Run callbacks until `end` is called, whatever they raise."""
        while not self.done and self.context.ok():
            # Not spin(): rclpy 7.1's EventsExecutor turns in circles there without a timeout; nor
            # spin_once(), which costs 20 us for every callback. Not often either: each of these
            # calls leaks 32 bytes. A new future each time, as one would collect their callbacks.
            self._spin = Future()
            try:
                executor.spin_until_future_complete(self._spin, timeout_sec=_PATIENCE)
            except Exception as error:
                # What rclpy does around callbacks fails too: a request of bytes that are no text.
                self.guard.caught("rclpy's executor", error)
                self.go_first()

    def go_first(self) -> None:
        """Do what may not wait; called ahead of each callback that is about to run."""

    def refuse_time(self, reason: str) -> None:
        """Deal with a message on /clock that gives no time."""
        self.get_logger().warning(reason, throttle_duration_sec=1.0)

    def finish(self) -> None:
        """Do what must be done while publishing is still possible, whatever led to the end."""

    def create_subscription(
        self, msg_type: type[Any], topic: str, callback: Callable[[Any], object],
        *arguments: Any, raw: bool = False, **options: Any,
    ) -> Subscription:
        """Subscribe as rclpy does; reading the message's bytes is behind the guard, too."""
        if topic == CLOCK_TOPIC:
            callback = self._without_negative_time(callback)

        def take(message: bytes) -> None:
            self.go_first()
            try:
                callback(message if raw else deserialize_message(message, msg_type))
            except Exception as error:
                self.guard.caught(f"a message on '{topic}'", error)

        return super().create_subscription(msg_type, topic, take, *arguments, raw=True, **options)

    def create_service(
        self, srv_type: type[Any], srv_name: str, callback: Callable[[Any, Any], Any],
        *arguments: Any, **options: Any,
    ) -> Service:
        """Offer a service as rclpy does; a request that fails is answered with the reason."""

        def serve(request: Any, response: Any) -> Any:
            self.go_first()
            try:
                return callback(request, response)
            except Exception as error:
                self.guard.caught(f"a request to '{srv_name}'", error)
                return _refused(request, response, line_of(error))

        return super().create_service(srv_type, srv_name, serve, *arguments, **options)

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], object], *arguments: Any,
        **options: Any,
    ) -> Timer:
        """Create a timer as rclpy does."""

        def run() -> None:
            self.guard.call('a timer', callback)

        return super().create_timer(timer_period_sec, run, *arguments, **options)

    def add_on_set_parameters_callback(
        self, callback: Callable[[list[Parameter]], SetParametersResult],
    ) -> None:
        """Have a callback judge changes of parameters; where it fails they are refused."""

        def judge(parameters: list[Parameter]) -> SetParametersResult:
            self.go_first()
            try:
                return callback(parameters)
            except Exception as error:
                names = ', '.join(parameter.name for parameter in parameters)
                self.guard.caught(f'a change of {names}', error)
                return SetParametersResult(successful=False, reason=line_of(error))

        super().add_on_set_parameters_callback(judge)

    def _without_negative_time(self, callback: Callable[[Any], object]) -> Callable[[Any], None]:
        """Keep times before zero from rclpy's clocks, whose timers would fail for ever."""

        def take(message: Any) -> None:
            if message.clock.sec < 0:
                self.refuse_time(f'/clock says {message.clock.sec} s; time must not be negative')
            else:
                callback(message)

        return take


def _refused(request: Any, response: Any, reason: str) -> Any:
    """Return a service's response that says why it failed, where it has a place for that."""
    if hasattr(response, 'success'):
        response.success, response.message = False, reason
    elif hasattr(response, 'results'):  # of set_parameters, one each; some may have been set
        left = len(request.parameters) - len(response.results)
        response.results += [SetParametersResult(successful=False, reason=reason)] * left
    elif isinstance(getattr(response, 'result', None), SetParametersResult):
        response.result = SetParametersResult(successful=False, reason=reason)
    return response


def run(make_node: Callable[[], EndableNode], name: str, args: list[str] | None = None) -> int:
    """Run one node until it is done or interrupted; return the process's exit status.

    Bad input at the start ends the process with one readable line. Whatever ends it, the node
    finishes first.

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
    except (PlannerError, ParameterException, rclpy_implementation.RCLError,
            rclpy_implementation.UnknownROSArgsError) as error:
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
