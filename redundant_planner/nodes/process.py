"""What every node of this package does around its own work: start, spin, end, and say why."""

from __future__ import annotations

from collections.abc import Callable
import gc
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

from redundant_planner.core.errors import PlannerError

BAD_INPUT = 2

# How long a signal may wait for the executor to look up [s].
_PATIENCE = 0.1


class EndableNode(Node):
    """A node with a last word.

    Attributes:
        done: set it and the process ends after the callback that is running.
    """

    done = False

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

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True

    # Ours rather than rclpy's handlers, which close the context before a node can say goodbye.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    node = None
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
        executor = best_executor(rclpy.get_default_context())
        executor.add_node(node)
        # What exists by now lives as long as the process: keep the collector off it.
        gc.collect()
        gc.freeze()
        while not (interrupted or node.done):
            # Not spin(): rclpy 7.1's EventsExecutor turns in circles there without a timeout.
            executor.spin_once(timeout_sec=_PATIENCE)
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


def best_executor(context: Context) -> Executor:
    """Return the executor with the least overhead per callback that this rclpy has."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)
