"""A subscription whose messages are fetched when they are wanted."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data


class Inbox:
    """Holds a topic's last messages, serialised, until somebody asks for them.

    A callback per message costs rclpy's executor as much as a whole tick does, and delays the
    tick that falls due meanwhile.
    """

    def __init__(self, node: Node, kind: type[Any], topic: str) -> None:
        """Subscribe.

        Args:
            node: to subscribe on.
            kind: the messages' class.
            topic: its name.
        """
        self._kind = kind
        self._subscription = node.create_subscription(
            kind, topic, lambda message: None, qos_profile_sensor_data, raw=True)
        # Executors serve whatever is in this list; rclpy has no option to leave something out.
        node._subscriptions.remove(self._subscription)

    def fetch(self) -> list[bytes]:
        """Return the messages that have not been fetched yet, the latest one last."""
        messages = []
        handle = self._subscription.handle
        with handle:
            while (taken := handle.take_message(self._kind, True)) is not None:
                messages.append(taken[0])
        return messages
