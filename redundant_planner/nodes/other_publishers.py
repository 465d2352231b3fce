"""Which nodes publish on a topic, by name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rclpy.node import Node

from redundant_planner.nodes.second_process import SUFFIX


def publishers_of(node: Node, topic: str) -> list[str]:
    """Return the names of all nodes that publish on a topic, but for planners' last words.

    Args:
        node: to ask the ROS graph through.
        topic: as the node names it, before remapping.
    """
    name = node.resolve_topic_name(topic)
    return node_names(publisher for publisher in node.get_publishers_info_by_topic(name)
                      if not publisher.node_name.endswith(SUFFIX))


def node_names(publishers: Iterable[Any]) -> list[str]:
    """Return the full node names of publishers as the ROS graph knows them, sorted."""
    return sorted('a node whose name is not known yet' if 'UNKNOWN' in p.node_name
                  else f'{p.node_namespace.rstrip("/")}/{p.node_name}' for p in publishers)
