"""Tells planners of the obstacles on the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.publisher import Publisher
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.nodes.messages import marker_of
from redundant_planner.playground.world import Item

_COLOR = (0.85, 0.35, 0.2, 0.8)
# All of them are sent again this often: for planners that come late [s].
_AGAIN = 1.0


class ObstacleSender:
    """Publishes what has changed of some items, and all of them now and then."""

    def __init__(self, executor: Executor) -> None:
        """Prepare, in the context of an executor."""
        self._node = Node('playground_obstacles', context=executor.context, enable_rosout=False,
                          start_parameter_services=False)
        self._publishers: dict[str, Publisher] = {}
        self._sent: Mapping[str, Item] = {}
        self._sent_at = -_AGAIN

    def send(
        self, items: Mapping[str, Item], topics: Iterable[str], frame: str, now: float,
    ) -> None:
        """Publish what is new since the last call.

        Args:
            items: all there are.
            topics: of the planners.
            frame: in which they are given.
            now: time by which they move [s].
        """
        for topic in topics:
            if topic not in self._publishers:
                self._publishers[topic] = self._node.create_publisher(MarkerArray, topic, 10)
        again = now - self._sent_at >= _AGAIN
        markers = [Marker(ns=name, action=Marker.DELETE) for name in self._sent
                   if name not in items]
        markers += [_marker(item, frame, now) for name, item in items.items()
                    if again or item.moves or self._sent.get(name) is not item]
        if markers:
            message = MarkerArray(markers=markers)
            for publisher in self._publishers.values():
                publisher.publish(message)
        if again:
            self._sent_at = now
        self._sent = items

    def forget(self) -> None:
        """Send all anew, to planners that have just begun."""
        self._sent_at = -_AGAIN


def _marker(item: Item, frame: str, now: float) -> Marker:
    obstacle = item.obstacle(now)
    marker = marker_of(obstacle, _COLOR)
    marker.ns, marker.header.frame_id = item.name, frame
    if item.moves:
        velocity = ' '.join(f'{v:.5f}' for v in obstacle.velocity.tolist())
        marker.text = f'twist {velocity} 0 0 0'
    return marker
