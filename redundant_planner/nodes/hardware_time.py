"""The time that a simulated arm lives in: the system's, or one that it gives out on /clock."""

from __future__ import annotations

from collections.abc import Callable
import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage

from redundant_planner.io.node_parameters import ClockParameters
from redundant_planner.nodes.lock_step import LockStep
from redundant_planner.nodes.messages import NANOSECONDS

# How often a node looks whether simulated time goes on without an answer [s].
_LOOK = 1e-3


class HardwareTime:
    """Calls a simulated arm once per period, of real time or of a time of its own.

    Attributes:
        simulated: whether the time is its own, on /clock.
    """

    def __init__(
        self, node: Node, rate: int, parameters: ClockParameters, advance: Callable[[], None],
    ) -> None:
        """Begin with the first period as soon as the node spins.

        Args:
            node: of the arm.
            rate: periods in a second [Hz].
            parameters: of /clock.
            advance: simulates up to `now` and publishes the state.
        """
        self.simulated = parameters.clock
        self._stamps = node.get_clock()
        self._rate, self._advance = rate, advance
        self._ticks = 0
        self._lock_step = LockStep(
            1.0 / rate, parameters.real_time_factor, parameters.answer_timeout)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if not self.simulated:
            node.create_timer(1.0 / rate, advance, clock=steady)
            return
        self._clock = node.create_publisher(ClockMessage, '/clock', 10)
        if parameters.wait_for_cmd_vel:
            node.create_subscription(Twist, 'cmd_vel', self._on_twist, 10, raw=True)
        node.create_timer(_LOOK, self._go_on_if_due, clock=steady)

    def now(self) -> float:
        """Return the time that commands come and states are at [s]."""
        return self._ticks / self._rate if self.simulated else time.monotonic()

    def stamp_ns(self) -> int:
        """Return the time for stamps [ns]."""
        if self.simulated:
            return self._ticks * NANOSECONDS // self._rate
        return int(self._stamps.now().nanoseconds)

    def stamp(self) -> Time:
        """Return the time for stamps, as a message."""
        return Time(**dict(zip(('sec', 'nanosec'), divmod(self.stamp_ns(), NANOSECONDS))))

    @property
    def missed(self) -> int:
        """Periods of simulated time in which an answer was waited for in vain."""
        return self._lock_step.missed

    def commanded(self, stamp: Time) -> None:
        """Note that a joint_command came; simulated time goes on if it was waited for."""
        if self.simulated and stamp.sec * NANOSECONDS + stamp.nanosec >= self.stamp_ns():
            self._lock_step.answer('joint_command')
            self._go_on_if_due()

    def _on_twist(self, raw: bytes) -> None:
        self._lock_step.answer('cmd_vel')
        self._go_on_if_due()

    def _go_on_if_due(self) -> None:
        """Begin the next period once the answers to the last one are here, and say so."""
        now = time.monotonic()
        if not self._lock_step.is_due(now):
            return
        self._lock_step.begin(now)
        self._ticks += 1
        self._advance()
        # After joint_states, so that a tick at this time finds them.
        self._clock.publish(ClockMessage(clock=self.stamp()))
