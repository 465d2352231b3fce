"""Markers on a topic that are published again and again, and deleted when they are gone."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
import numpy as np
import numpy.typing as npt
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.robot.quaternions import quaternion_of
from redundant_planner.perception.scene_markers import SceneMarker

Array = npt.NDArray[np.float64]

_COLOR = ColorRGBA(r=0.45, g=0.6, b=0.4, a=0.8)

# A marker's namespace and id.
Key = tuple[str, int]


class MarkerTopic:
    """The markers on a topic: those that are no longer there are deleted."""

    def __init__(self, publisher: Publisher) -> None:
        """Begin without any."""
        self._publisher = publisher
        # What is said again and again, and which markers that are.
        self._messages: list[bytes] = []
        self._shown: set[Key] = set()
        self._gone: set[Key] = set()

    def add(self, solids: dict[str, list[SceneMarker]], lists: dict[Key, bytes]) -> None:
        """Publish markers unless they are the same; `remove` deletes those that are not there.

        Args:
            solids: frame → single markers.
            lists: namespace and id → message with that marker.
        """
        array = MarkerArray(markers=[
            marker_message(frame, marker) for frame, them in solids.items() for marker in them])
        shown = {*((marker.ns, marker.id) for marker in array.markers), *lists}
        self._gone |= self._shown - shown
        self._gone -= shown
        self._shown = shown
        messages = [*([bytes(serialize_message(array))] if array.markers else []),
                    *lists.values()]
        if messages != self._messages:
            self._messages = messages
            self.repeat()

    def remove(self) -> None:
        """Delete the markers that were shown before the latest ones and are not among them."""
        if self._gone:
            self._publisher.publish(MarkerArray(markers=[
                Marker(ns=name, id=number, action=Marker.DELETE)
                for name, number in sorted(self._gone)]))
            self._gone.clear()

    def clear(self) -> None:
        """Delete all markers of the topic, and publish ours again."""
        self._publisher.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
        self.repeat()

    def repeat(self) -> None:
        """Publish the same again."""
        for message in self._messages:
            self._publisher.publish(message)


def pose_numbers(pose: Array) -> tuple[float, ...]:
    """Return a pose (4, 4) as x y z and a quaternion x y z w."""
    return (*pose[:3, 3].tolist(), *quaternion_of(pose[:3, :3]).tolist())


def marker_message(frame: str, marker: SceneMarker) -> Marker:
    """Return a shape as a message, given in a frame."""
    numbers = pose_numbers(marker.pose)
    return Marker(
        # Without a stamp, which would grow old: the same bytes are published again.
        header=Header(frame_id=frame, stamp=Time()), ns=marker.namespace, id=marker.number,
        type=marker.kind, action=Marker.ADD, color=_COLOR,
        pose=Pose(position=Point(x=numbers[0], y=numbers[1], z=numbers[2]),
                  orientation=Quaternion(
                      x=numbers[3], y=numbers[4], z=numbers[5], w=numbers[6])),
        scale=Vector3(**dict(zip('xyz', marker.size.tolist()))))
