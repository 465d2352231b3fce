"""Without rclpy's private parts the nodes do the same, with more work."""

from __future__ import annotations

from contextlib import contextmanager
import time
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from ros_domains import next_domain
from std_msgs.msg import String

from redundant_planner.core.errors import ParameterError
from redundant_planner.nodes import rclpy_internals
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.ros_parameters import refuse_unknown_parameters


@contextmanager
def lone_node(*arguments):
    context = Context()
    rclpy.init(context=context, domain_id=next_domain())
    node = Node('lone', context=context, cli_args=['--ros-args', *arguments],
                start_parameter_services=False, enable_rosout=False)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize('hidden', [True, False])
def test_messages_wait_until_they_are_fetched(monkeypatch, hidden):
    if not hidden:
        monkeypatch.setattr(rclpy_internals, 'hide_from_executors', lambda *_: False)
    with lone_node() as node:
        inbox = PolledSubscription(node, String, 'words', QoSProfile(depth=3))
        publisher = node.create_publisher(String, 'words', 10)
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        assert inbox.fetch() == []
        deadline = time.monotonic() + 60.0
        while not publisher.get_subscription_count():
            assert time.monotonic() < deadline
            executor.spin_once(timeout_sec=0.01)
        begin = time.time_ns()
        for i in range(5):
            publisher.publish(String(data=f'word {i}'))
        heard = []
        while len(heard) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.1)
            for _ in range(10):
                executor.spin_once(timeout_sec=0.0)
            heard += inbox.fetch_stamped()
        assert all(b'word' in raw for raw, _ in heard)
        assert b'word 4' in heard[-1][0]
        assert all(begin <= stamp <= time.time_ns() for _, stamp in heard)
        assert inbox.fetch() == []


def test_a_subscription_that_is_listed_elsewhere_stays_where_it_is():
    class Stranger:
        handle = object()

    assert not rclpy_internals.hide_from_executors(Stranger(), Stranger())


def test_an_rclpy_that_does_not_tell_which_parameters_were_given_is_mentioned():
    with lone_node('-p', 'typo:=1') as node:
        with pytest.raises(ParameterError, match="'typo' is not known"):
            refuse_unknown_parameters(node)
        del node._parameter_overrides
        warned = []
        node.get_logger = lambda: SimpleNamespace(warning=warned.append)
        refuse_unknown_parameters(node)
        assert len(warned) == 1 and 'unnoticed' in warned[0]
