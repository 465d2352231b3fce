"""planning_scene_obstacles without moveit_msgs: its messages travel as JSON in std_msgs/String.

moveit_msgs is not on PyPI. The node is the real one, with all that it does; only the classes of
its messages are others. Where moveit_msgs is installed, `Sender` speaks the real ones as well.
"""

from __future__ import annotations

import importlib
import json
import re
from types import SimpleNamespace

from std_msgs.msg import String
from std_srvs.srv import Trigger

from redundant_planner.nodes import runtime
from redundant_planner.nodes.planning_scene_obstacles import MoveitMessages, PlanningSceneObstacles
from redundant_planner.perception.planning_scene import with_scene

TOPICS = {'planning_scene': 'PlanningScene', 'monitored_planning_scene': 'PlanningScene',
          'collision_object': 'CollisionObject',
          'attached_collision_object': 'AttachedCollisionObject'}


class StandIn(PlanningSceneObstacles):
    """The node with other classes of messages."""

    def __init__(self):
        super().__init__(MoveitMessages(String, String, String, Trigger))

    def _take(self, apply, message):
        super()._take(apply, decoded(message.data if isinstance(message, String) else message))

    def _request(self):
        return Trigger.Request()

    def _on_whole(self, future):
        text = future.result().message
        self._asked_at = None
        self._take(with_scene, text)


def encoded(message) -> str:
    """A message as JSON; of bytes, one is a number and others are a list."""
    def plain(part):
        if isinstance(part, bytes):
            return part[0] if len(part) == 1 else list(part)
        return vars(part)

    return json.dumps(message, default=plain)


def decoded(text: str):
    return json.loads(text, object_hook=lambda fields: SimpleNamespace(**fields))


def filled(kind, fields):
    """A ROS message with those of the fields that it has."""
    message = kind()
    for name, of in kind.get_fields_and_field_types().items():
        if not hasattr(fields, name):
            continue
        value = getattr(fields, name)
        inner = re.match(r'(?:sequence<)?(\w+)/(\w+)', of)
        if inner:
            element = getattr(importlib.import_module(f'{inner[1]}.msg'), inner[2])
            value = ([filled(element, one) for one in value] if of.startswith('sequence')
                     else filled(element, value))
        elif of == 'double':
            value = float(value)
        elif 'double' in of:
            value = [float(one) for one in value]
        elif of == 'sequence<int8>':
            value = [(one + 128) % 256 - 128 for one in value]
        setattr(message, name, value)
    return message


class Sender:
    """Publishes messages of `scene_messages`, and answers for the whole scene."""

    def __init__(self, node, moveit: bool):
        self.node, self.moveit = node, moveit
        self._publishers = {}
        self._service = None
        self.asked = 0

    def send(self, topic, message):
        publisher = self.open(topic)
        publisher.publish(filled(publisher.msg_type, message) if self.moveit
                          else String(data=encoded(message)))

    def open(self, topic):
        """The publisher of a topic, with a listener as soon as `heard` says so."""
        if topic not in self._publishers:
            kind = (getattr(importlib.import_module('moveit_msgs.msg'), TOPICS[topic])
                    if self.moveit else String)
            self._publishers[topic] = self.node.create_publisher(kind, topic, 10)
        return self._publishers[topic]

    def heard(self, topic):
        return self.open(topic).get_subscription_count() > 0

    def offer(self, scene):
        """Begin to answer for a whole scene, as a move_group that has just started."""
        self.leave()
        kind = (importlib.import_module('moveit_msgs.srv').GetPlanningScene if self.moveit
                else Trigger)

        def answer(request, response):
            self.asked += 1
            if self.moveit:
                response.scene = filled(type(response.scene), scene)
            else:
                response.message = encoded(scene)
            return response

        self._service = self.node.create_service(kind, 'get_planning_scene', answer)

    def leave(self):
        if self._service is not None:
            self.node.destroy_service(self._service)
            self._service = None


def main(args=None) -> int:
    return runtime.run(StandIn, 'planning_scene_obstacles', args)
