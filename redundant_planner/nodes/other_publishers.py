"""Which nodes publish on a topic, by name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rclpy.node import Node

from redundant_planner.core.errors import known
from redundant_planner.nodes.second_process import SUFFIX

# What rclpy has in place of the name of a node of which it has found the publishers only.
_UNNAMED = 'UNKNOWN'


def publishers_of(node: Node, topic: str, *, has_second: bool = False) -> list[str]:
    """Return the names of all nodes that publish on a topic, but for planners' last words.

    Args:
        node: to ask the ROS graph through.
        topic: as the node names it, before remapping.
        has_second: whether a second process of this node's publishes on it, too. The ROS graph
            knows a publisher before it knows whose it is: as long as that process is not found by
            its name, one publisher without a name is taken for it.
    """
    found = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    others = [info for info in found if not info.node_name.endswith(SUFFIX)]
    if has_second and not any(
            (info.node_name, info.node_namespace) == (
                node.get_name() + SUFFIX, node.get_namespace()) for info in found):
        unnamed = next((info for info in others if _UNNAMED in info.node_name), None)
        others = [info for info in others if info is not unnamed]
    return node_names(others)


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
    return sorted('a node whose name is not known yet' if _UNNAMED in p.node_name
                  else f'{p.node_namespace.rstrip("/")}/{p.node_name}' for p in publishers)
