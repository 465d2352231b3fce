"""A subscription whose messages are fetched when they are wanted."""

from __future__ import annotations

from collections import deque
import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile

from redundant_planner.nodes import rclpy_internals


class PolledSubscription:
    """Holds a topic's last messages, serialised, until `fetch`.

    A callback per message costs rclpy's executor as much time as a whole tick, and delays the
    tick that falls due meanwhile. Where an rclpy does not let the executor leave a subscription
    alone, a callback keeps the messages: slower, but the same.

    Attributes:
        topic: its name.
    """

    def __init__(
        self, node: Node, message_class: type[Any], topic: str,
        qos: QoSProfile = qos_profile_sensor_data,
    ) -> None:
        """Subscribe.

        Args:
            node: to subscribe on.
            message_class: of the messages.
            topic: its name.
            qos: its depth is the number of messages that are held.
        """
        self.topic = topic
        self._message_class = message_class
        self._kept: deque[tuple[bytes, int]] = deque(maxlen=qos.depth)
        self._subscription = node.create_subscription(
            message_class, topic, lambda raw: self._kept.append((raw, time.time_ns())), qos,
            raw=True)
        self._hidden = rclpy_internals.hide_from_executors(node, self._subscription)

    def fetch(self) -> list[bytes]:
        """Return the messages since the last fetch, the latest one last."""
        return [message for message, _ in self.fetch_stamped()]

    def fetch_stamped(self) -> list[tuple[bytes, int]]:
        """Return them with the times they were published at, by the system's clock [ns].

        From a callback, the times are those of arrival.
        """
        if self._hidden:
            return rclpy_internals.take_all(self._subscription, self._message_class)
        messages = list(self._kept)
        self._kept.clear()
        return messages
