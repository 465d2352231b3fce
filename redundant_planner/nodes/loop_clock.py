"""The time that the control loop runs by: the system's, or a simulator's."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from redundant_planner.nodes.messages import NANOSECONDS


class LoopClock(NamedTuple):
    """A clock for ages and one for stamps.

    Attributes:
        now: returns the loop's time [s], by which commands and measurements age.
        stamp_ns: returns the time for message stamps [ns].
        ros_time: returns the time that others' stamps are compared with [s].
        timers: for timers of the loop.
        simulated: whether a simulator sets the pace, so that time may stand still or jump.
    """

    now: Callable[[], float]
    stamp_ns: Callable[[], int]
    ros_time: Callable[[], float]
    timers: Clock
    simulated: bool


def loop_clock(node: Node) -> LoopClock:
    """Return the clock for a node, simulated if its `use_sim_time` is set."""
    clock = node.get_clock()

    def ros_time() -> float:
        return float(clock.now().nanoseconds / NANOSECONDS)

    if node.get_parameter('use_sim_time').value:
        return LoopClock(ros_time, lambda: int(clock.now().nanoseconds), ros_time, clock, True)
    # The system's own clocks: reading rclpy's takes a hundred times as long.
    return LoopClock(time.monotonic, time.time_ns, ros_time,
                     Clock(clock_type=ClockType.STEADY_TIME), False)
