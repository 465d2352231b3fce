"""Bags: the only file that knows their format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from redundant_planner.core.errors import ObstacleError, PlannerError
from redundant_planner.core.obstacles import Obstacle

Array = npt.NDArray[np.float64]

_TYPES = get_typestore(Stores.ROS2_JAZZY)
_SPHERE, _ADD = 2, 0


class RecordingError(PlannerError):
    """A bag cannot be read, or lacks what was asked of it."""


class BagWriter:
    """Writes serialised messages to an MCAP bag, as `ros2 bag record` would."""

    def __init__(self, path: Path) -> None:
        """Prepare a bag in the new folder `path`."""
        self._writer = Writer(path, version=9,  # Jazzy's
                              storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> BagWriter:
        """Open the bag."""
        self._writer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag; it is complete and readable from then on."""
        self._writer.close()

    def add_topic(self, topic: str, message_type: str) -> None:
        """Announce a topic, its type written as 'sensor_msgs/msg/JointState'."""
        self._connections[topic] = self._writer.add_connection(
            topic, message_type, typestore=_TYPES)

    def write(self, topic: str, time_ns: int, message: bytes) -> None:
        """Append a CDR-serialised message received at `time_ns`."""
        self._writer.write(self._connections[topic], time_ns, message)


@dataclass(frozen=True)
class JointLog:
    """A series of JointState messages.

    Attributes:
        names: joint names, the order of the columns.
        times: (k,) header stamps [s], from the recording's start.
        positions: (k, n) [rad, m].
        velocities: (k, n) [rad/s, m/s].
    """

    names: tuple[str, ...]
    times: Array
    positions: Array
    velocities: Array

    def select(self, names: tuple[str, ...]) -> JointLog:
        """Return the log with the columns of `names`, in that order.

        Raises:
            RecordingError: a joint was not recorded.
        """
        missing = [name for name in names if name not in self.names]
        if missing:
            raise RecordingError(f'joints {missing} were not recorded; the bag has '
                                 f'{list(self.names)}')
        columns = [self.names.index(name) for name in names]
        return JointLog(names, self.times, self.positions[:, columns],
                        self.velocities[:, columns])

    def between(self, begin: float, end: float) -> JointLog:
        """Return the part with begin ≤ time ≤ end [s]."""
        inside = (self.times >= begin) & (self.times <= end)
        return JointLog(self.names, self.times[inside], self.positions[inside],
                        self.velocities[inside])


@dataclass(frozen=True)
class Recording:
    """What a bag holds of one motion; times in seconds from the first message.

    Attributes:
        states: joint_states.
        commands: joint_command.
        twist_times: (k,) when each cmd_vel arrived.
        twists: (k, 6) [m/s, rad/s].
        obstacles: the obstacles as last published.
        robot_description: URDF text, empty if none was recorded.
    """

    states: JointLog
    commands: JointLog
    twist_times: Array
    twists: Array
    obstacles: tuple[Obstacle, ...]
    robot_description: str


def read_recording(path: Path) -> Recording:
    """Read a bag of the planner's topics.

    Raises:
        RecordingError: it is no bag, is damaged, or has no joint states or commands.
    """
    joints: dict[str, list[tuple[float, tuple[str, ...], Array, Array]]] = {
        'joint_states': [], 'joint_command': []}
    twist_times: list[float] = []
    twists: list[list[float]] = []
    obstacles: dict[tuple[str, int], Obstacle] = {}
    description = ''
    try:
        with AnyReader([path], default_typestore=_TYPES) as reader:
            origin = reader.start_time * 1e-9
            for connection, time_ns, raw in reader.messages():
                topic = connection.topic.rsplit('/', 1)[-1]
                if topic not in ('joint_states', 'joint_command', 'cmd_vel', 'obstacles',
                                 'robot_description'):
                    continue
                message = _decoded(reader, raw, connection.msgtype)
                if topic in joints:
                    stamp = message.header.stamp
                    joints[topic].append((
                        stamp.sec - origin + stamp.nanosec * 1e-9, tuple(message.name),
                        np.array(message.position), np.array(message.velocity)))
                elif topic == 'cmd_vel':
                    linear, angular = message.linear, message.angular
                    twist_times.append(time_ns * 1e-9 - origin)
                    twists.append([linear.x, linear.y, linear.z,
                                   angular.x, angular.y, angular.z])
                elif topic == 'obstacles':
                    _apply_markers(message, obstacles)
                else:
                    description = message.data
    except (AnyReaderError, OSError) as error:
        raise RecordingError(f"'{path}' is not a readable bag: {error}") from None
    logs = {topic: _joint_log(path, topic, rows) for topic, rows in joints.items()}
    return Recording(logs['joint_states'], logs['joint_command'], np.array(twist_times),
                     np.array(twists).reshape(-1, 6), tuple(obstacles.values()), description)


def _decoded(reader: AnyReader, raw: bytes, message_type: str) -> Any:
    """Decode a message; rclpy's serialize_message pads a trailing empty list by four bytes."""
    try:
        return reader.deserialize(raw, message_type)
    except AnyReaderError:
        return reader.deserialize(raw[:-4], message_type)


def _joint_log(
    path: Path, topic: str, rows: list[tuple[float, tuple[str, ...], Array, Array]],
) -> JointLog:
    if not rows:
        raise RecordingError(f"'{path}' holds no messages on {topic}")
    names = rows[0][1]
    rows = [row for row in rows if row[1] == names]
    return JointLog(names, np.array([row[0] for row in rows]),
                    np.array([row[2] for row in rows]), np.array([row[3] for row in rows]))


def _apply_markers(message: Any, obstacles: dict[tuple[str, int], Obstacle]) -> None:
    for marker in message.markers:
        key = (marker.ns, marker.id)
        if marker.action == _ADD and marker.type == _SPHERE:
            pose = marker.pose
            p, o, s = pose.position, pose.orientation, marker.scale
            try:
                obstacles[key] = Obstacle(
                    marker.ns or str(marker.id), np.array([p.x, p.y, p.z]),
                    0.5 * np.array([s.x, s.y, s.z]), np.array([o.x, o.y, o.z, o.w]))
            except ObstacleError:
                continue  # the planner refused it as well
        elif marker.action != _ADD:
            obstacles.pop(key, None)
