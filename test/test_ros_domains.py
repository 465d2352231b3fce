"""Tests stay away from ROS domains in which somebody is."""

from __future__ import annotations

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
import ros_domains
from ros_domains import next_domain


@pytest.fixture
def somebody():
    """A domain with a participant."""
    context, domain = Context(), next_domain()
    rclpy.init(context=context, domain_id=domain)
    node = Node('somebody', context=context)
    try:
        yield domain
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_domain_with_somebody_in_it_is_left_out(somebody, monkeypatch):
    others = {next_domain() for _ in range(50)}
    assert somebody not in others and len(others) > 5
    assert all(101 < domain < 233 for domain in others)
    monkeypatch.setattr(ros_domains, '_DOMAINS', range(somebody, somebody + 1))
    with pytest.raises(RuntimeError, match=f'from {somebody} to {somebody}'):
        next_domain()
