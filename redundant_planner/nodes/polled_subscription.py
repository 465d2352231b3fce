"""A subscription whose messages are fetched when they are wanted."""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile


class PolledSubscription:
    """Holds a topic's last messages, serialised, until somebody asks for them.

    A callback per message costs rclpy's executor as much as a whole tick does, and delays the
    tick that falls due meanwhile.

    Attributes:
        topic: its name.
    """

    def __init__(
        self, node: Node, kind: type[Any], topic: str,
        qos: QoSProfile = qos_profile_sensor_data,
    ) -> None:
        """Subscribe.

        Args:
            node: to subscribe on.
            kind: the messages' class.
            topic: its name.
            qos: its depth is what the inbox holds.
        """
        self._kind, self.topic = kind, topic
        self._subscription = node.create_subscription(
            kind, topic, lambda message: None, qos, raw=True)
        # Executors serve whatever is in this list; rclpy has no option to leave something out.
        node._subscriptions.remove(self._subscription)

    def fetch(self) -> list[bytes]:
        """Return the messages that have not been fetched yet, the latest one last."""
        return [message for message, _ in self.fetch_stamped()]

    def fetch_stamped(self) -> list[tuple[bytes, int]]:
        """Return them with the times they were published at, by the system's clock [ns]."""
        messages = []
        handle = self._subscription.handle
        with handle:
            while (taken := handle.take_message(self._kind, True)) is not None:
                messages.append((taken[0], taken[1]['source_timestamp'] or time.time_ns()))
        return messages
