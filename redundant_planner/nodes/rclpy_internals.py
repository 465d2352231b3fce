"""All private parts of rclpy that this package uses, each with what happens without it.

Tested with rclpy 7.1 (ROS 2 Jazzy). Another release may lack any of them; the nodes then run all
the same, at the price that the function's docstring names.
"""

from __future__ import annotations

from collections.abc import Collection
import time
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

try:
    from rclpy.impl.implementation_singleton import rclpy_implementation
    # Bad arguments on the command line. Without these names they end a node with a traceback.
    START_ERRORS: tuple[type[Exception], ...] = (
        rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError)
except (ImportError, AttributeError):
    START_ERRORS = ()


def hide_from_executors(node: Node, subscription: Subscription) -> bool:
    """Have executors leave a subscription's messages where they are, for `take_all`.

    rclpy has no option for that. Executors serve the node's list of subscriptions; one that is not
    in it still exists and receives.

    Returns:
        Whether that worked; otherwise executors call its callback for each message.
    """
    listed = getattr(node, '_subscriptions', None)
    if not isinstance(listed, list) or subscription not in listed or not hasattr(
            getattr(subscription, 'handle', None), 'take_message'):
        return False
    listed.remove(subscription)
    return True


def take_all(subscription: Subscription, message_class: type[Any]) -> list[tuple[bytes, int]]:
    """Return the messages that wait on a hidden subscription, the latest one last.

    Returns:
        Serialised messages, and when they were published by the system's clock [ns].
    """
    messages = []
    handle = subscription.handle
    with handle:
        while (taken := handle.take_message(message_class, True)) is not None:
            raw, about = taken
            messages.append((raw, about.get('source_timestamp') or time.time_ns()))
    return messages


def given_parameters(node: Node) -> Collection[str] | None:
    """Return the names of all parameters given at the start, declared or not.

    Returns:
        The names; None where this rclpy does not tell: misspelt names then stay unnoticed.
    """
    given = getattr(node, '_parameter_overrides', None)
    return None if given is None else tuple(given)
