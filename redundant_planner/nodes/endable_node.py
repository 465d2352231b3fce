"""A node that can end itself, and whose callbacks may fail without harm to the others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC
from rclpy.timer import Timer

from redundant_planner.nodes.guard import Guard, line_of

# How often the executor looks whether a signal has come to a node in which nothing happens [s].
_LOOK_UP = 0.5


class EndableNode(Node):
    """A node that can end itself, has a last word, and survives unforeseen exceptions.

    Each callback runs behind a guard, rclpy's own for parameters and clocks included: an exception
    costs the message that led to it.

    Attributes:
        done: whether the node has come to its end.
        status: the exit status of its process, once it has ended.
        guard: counts exceptions.
    """

    def __init__(self, name: str) -> None:
        """Make a node of this name."""
        # First, as rclpy's constructor already creates guarded services.
        self.guard = Guard(lambda text: self.get_logger().error(text))
        self.done = False
        self.status = 0
        self._spin: Future | None = None
        super().__init__(name)

    def end(self) -> None:
        """End the process, after this callback."""
        self.done = True
        if self._spin is not None:
            self._spin.set_result(None)

    def spin_until_the_end(self, executor: Executor) -> None:
        """Run callbacks until `end` is called; their exceptions do not end it."""
        while not self.done and self.context.ok():
            # spin() of rclpy 7.1's EventsExecutor polls without a pause, and spin_once() costs 20
            # us per callback. Each call here leaks 32 bytes, so it lasts long. The future is a new
            # one each time, as a single one would collect the callbacks of all calls.
            self._spin = Future()
            try:
                executor.spin_until_future_complete(self._spin, timeout_sec=_LOOK_UP)
            except Exception as error:
                # rclpy itself may fail around a callback: a request may hold bytes that are no
                # text.
                self.guard.caught("rclpy's executor", error)
                self.go_first()

    def go_first(self) -> None:
        """Do urgent work; called ahead of each callback."""

    def refuse_time(self, reason: str) -> None:
        """Deal with a message on /clock that gives no time."""
        self.get_logger().warning(reason, throttle_duration_sec=1.0)

    def finish(self) -> None:
        """Say a last word while publishing is still possible; called for every kind of end."""

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
        """Have a callback judge changes of parameters; if it fails, they are refused."""

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
        """Keep times before zero from rclpy's clocks; their timers would fail for ever."""

        def take(message: Any) -> None:
            if message.clock.sec < 0:
                self.refuse_time(f'/clock says {message.clock.sec} s; time must not be negative')
            else:
                callback(message)

        return take


def _refused(request: Any, response: Any, reason: str) -> Any:
    """Return a service's response that says why it failed, if it has a field for that."""
    if hasattr(response, 'success'):
        response.success, response.message = False, reason
    elif hasattr(response, 'results'):  # of set_parameters, one each; some may have been set
        left = len(request.parameters) - len(response.results)
        response.results += [SetParametersResult(successful=False, reason=reason)] * left
    elif isinstance(getattr(response, 'result', None), SetParametersResult):
        response.result = SetParametersResult(successful=False, reason=reason)
    return response
