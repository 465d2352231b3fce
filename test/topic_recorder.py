"""Keeps what comes on topics while a live test runs, and writes a bag of it."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, QoSProfile

from redundant_planner.io.bag_writer import BagWriter


class TopicRecorder:
    """Subscribes on a station's node; topics that the planner latches are latched."""

    def __init__(self, ros, topics):
        """Keep the messages of topics, name → class."""
        self.messages, self._topics = [], topics
        latched = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, kind in topics.items():
            ros.node.create_subscription(
                kind, topic, lambda raw, topic=topic: self.messages.append(
                    (topic, ros.node.get_clock().now().nanoseconds, raw)),
                latched if topic.endswith(('ticks', 'configuration')) else 1000, raw=True)

    def write(self, path):
        with BagWriter(path) as bag:
            for topic, kind in self._topics.items():
                package = kind.__module__.split('.')[0]
                bag.add_topic(f'/{topic}', f'{package}/msg/{kind.__name__}')
            for topic, at, raw in self.messages:
                bag.write(f'/{topic}', at, raw)
