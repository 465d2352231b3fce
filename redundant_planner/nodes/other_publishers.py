"""Which nodes publish on a topic, by name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rclpy.node import Node

from redundant_planner.core.errors import known
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


def why_nothing_comes(node: Node, topic: str, kind: str) -> str:
    """Return what may keep messages of a kind, 'package/msg/Name', on a topic from a node."""
    name = node.resolve_topic_name(topic)
    publishers = node.get_publishers_info_by_topic(name)
    others = [publisher for publisher in publishers if publisher.topic_type != kind]
    if not publishers:
        return (f"nobody publishes on '{name}'; does the arm's driver run, in this ROS domain and "
                'namespace?')
    if others:
        return (f"{known(node_names(others))} publishes '{others[0].topic_type}' on '{name}'; it "
                f"must be '{kind}'")
    return f"{known(node_names(publishers))} publishes on '{name}', and nothing has come yet"


def node_names(publishers: Iterable[Any]) -> list[str]:
    """Return the full node names of publishers as the ROS graph knows them, sorted."""
    return sorted('a node whose name is not known yet' if 'UNKNOWN' in p.node_name
                  else f'{p.node_namespace.rstrip("/")}/{p.node_name}' for p in publishers)
