"""Keeps another node's parameter `allowed_contacts` as the planning scene has it."""

from __future__ import annotations

from collections.abc import Callable
import math
import time

from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.parameter import Parameter
from rclpy.task import Future

from redundant_planner.core.errors import known
from redundant_planner.nodes.endable_node import EndableNode

_NAME = 'allowed_contacts'
# After how long a request without an answer is made again [s].
_PATIENCE = 3.0
# After how long it is asked again what the planner has: one that starts anew as another one ends
# is always there, and one that was killed seems to be there for a while [s].
_TRUST = 5.0


class AllowedContactsSetter:
    """Compares what the planner has with what it is to have, and sets it.

    The planner may start later, and anew: `update` is called again and again.
    """

    def __init__(self, node: EndableNode, planner: str, warn: Callable[[str], None]) -> None:
        """Begin without knowing what the planner has.

        Args:
            node: to make clients on.
            planner: name of the planner's node.
            warn: takes a sentence.
        """
        self._guard, self._warn, self._planner = node.guard, warn, planner
        self._get = node.create_client(GetParameters, f'{planner}/get_parameters')
        self._set = node.create_client(SetParameters, f'{planner}/set_parameters')
        # What the planner has, as far as is known; None for not at all.
        self._there: frozenset[str] | None = None
        self._known_at = -math.inf  # since when [s]
        self._mine: frozenset[str] = frozenset()
        self._refused: tuple[str, ...] | None = None
        self._asked_at: float | None = None

    def update(self, wanted: tuple[str, ...]) -> None:
        """Ask the planner for what it has, or set what it is to have, if there is a need."""
        now = time.monotonic()
        if not (self._get.service_is_ready() and self._set.service_is_ready()):
            self._there = self._refused = self._asked_at = None
            return
        if self._asked_at is not None and now - self._asked_at < _PATIENCE:
            return
        if self._there is None or now - self._known_at > _TRUST:
            self._call(self._get, GetParameters.Request(names=[_NAME]), self._on_values, now)
        elif self._there != frozenset(wanted) and wanted != self._refused:
            lost = sorted(self._there - self._mine - frozenset(wanted))
            if lost:
                self._warn(f"allowed_contacts of '{self._planner}' had entries that are neither "
                           'of the scene nor among the parameter allowed_contacts of this node: '
                           f'{known(lost)} no longer count')
            value = Parameter(_NAME, Parameter.Type.STRING_ARRAY, list(wanted))
            self._call(
                self._set, SetParameters.Request(parameters=[value.to_parameter_msg()]),
                lambda response: self._on_answer(response, wanted), now)

    def _call(
        self, client: Client, request: object, take: Callable[..., None], now: float,
    ) -> None:
        def answer(future: Future) -> None:
            self._asked_at = None
            response = future.result()
            if response is not None:
                take(response)

        self._asked_at = now
        client.call_async(request).add_done_callback(
            lambda future: self._guard.call(f"an answer of '{self._planner}'", answer, future))

    def _on_values(self, response: GetParameters.Response) -> None:
        for value in response.values[:1]:
            there = frozenset(value.string_array_value)
            if there != self._there:
                self._refused = None
            self._there, self._known_at = there, time.monotonic()

    def _on_answer(self, response: SetParameters.Response, wanted: tuple[str, ...]) -> None:
        for result in response.results[:1]:
            if result.successful:
                self._there = self._mine = frozenset(wanted)
            else:
                self._refused = wanted
                self._warn(f"allowed_contacts of '{self._planner}' stay as they were: "
                           f'{result.reason}')
