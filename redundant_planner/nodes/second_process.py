"""The process that stops the arm in the planner's place; see `last_word`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
from dataclasses import dataclass
import gc
import json
import mmap
import os
import select
import signal
import time
from typing import NoReturn

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from redundant_planner.core.safety.jerk import SmoothStop
from redundant_planner.core.safety.position_command import integrated
from redundant_planner.nodes import runtime
from redundant_planner.nodes.command_memory import (
    CommandMemory,
    HAS_FAILED,
    HAS_STARTED,
    NotedCommand,
    NUMBER,
    OWN_LISTENERS,
    PLANNERS_LISTENERS,
    STATE,
)
from redundant_planner.nodes.command_output import CommandOutput

# The end of the second node's name.
SUFFIX = '_last_word'
# What the planner writes to the pipe before it ends with the arm at rest.
END = b'end\n'
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


@dataclass(frozen=True)
class Brief:
    """All that the second process needs to stop the arm in the planner's place.

    Attributes:
        node, namespace: the planner's.
        topics: name of an output → the topic that it is published on.
        outputs: besides joint_command, those that owe a stop (`NEVER_ENDING`).
        joint_names: n of them.
        position_min, position_max, acceleration_max, jerk_max: n each [rad, m; per s²; per s³].
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
    jerk_max: Sequence[float]
    period: float
    priority: int


def live_as_second(pipe: int, memory: mmap.mmap, args: list[str] | None) -> NoReturn:
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
        memory[STATE] = HAS_FAILED
    finally:
        os._exit(0)


def _wait_and_speak(pipe: int, memory: mmap.mmap, args: list[str] | None) -> None:
    with os.fdopen(pipe, 'rb') as lines:
        line = lines.readline()
        if not line.endswith(b'\n') or line == END:
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
        output = CommandOutput(
            node, brief.joint_names, brief.outputs, brief.period, np.array(brief.position_min),
            np.array(brief.position_max))
        runtime.request_priority(brief.priority)
        memory[STATE] = HAS_STARTED
        while not select.select([lines], [], [], _LOOK)[0]:
            NUMBER.pack_into(memory, OWN_LISTENERS, sum(output.listeners().values()))
        if lines.readline() != END:
            commands = CommandMemory(memory)
            commands.prepare(len(brief.joint_names))
            last = commands.latest()
            if last is not None and last.velocities.any():
                speak(brief, last, output, NUMBER.unpack_from(memory, PLANNERS_LISTENERS)[0])
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
        listeners: how many must find the outputs before the stop is published.
        clock, sleep: of the system [s].
    """
    dq, positions = last.velocities, last.positions
    stop = SmoothStop(
        np.array(brief.acceleration_max), np.array(brief.jerk_max), brief.period)
    stop.moving(last.before)
    stop.moving(dq)
    low, high = np.array(brief.position_min), np.array(brief.position_max)
    due = last.time + brief.period
    if clock() - last.time > _STALE:
        dq = np.zeros(len(dq))

    def publish(now: float) -> None:
        output.publish(last.stamp_ns + int(1e9 * (now - last.time)), positions, dq)

    while dq.any():
        sleep(max(due - clock(), 0.0))
        dq = stop.next()
        positions = integrated(positions, dq, brief.period, low, high)
        now = clock()
        due = now + brief.period
        publish(now)
    enough = clock() + _FOUND
    while sum(output.listeners().values()) < listeners and clock() < enough:
        sleep(PAUSE)
    for _ in range(STOPS):
        sleep(PAUSE)
        publish(clock())
    output.wait_until_heard(ACKNOWLEDGED)
