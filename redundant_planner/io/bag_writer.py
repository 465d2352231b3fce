"""Writes bags."""

from __future__ import annotations

from collections.abc import Sequence
import contextlib
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.serde import SerdeError
from rosbags.typesys import get_typestore, Stores

from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.rosbags_internals import write_pending_chunk

Array = npt.NDArray[np.float64]

TYPES = get_typestore(Stores.ROS2_JAZZY)

JOINT_STATE = 'sensor_msgs/msg/JointState'
# After a JointState without positions, velocities and efforts.
_LONGEST_PADDING = 8


class BagWriter:
    """Writes serialised messages to an MCAP bag, as `ros2 bag record` would."""

    def __init__(self, path: Path) -> None:
        """Prepare a bag in the new folder `path`.

        Raises:
            RecordingError: there is something of that name.
        """
        if path.exists():
            raise RecordingError(f"'{path}' exists already; name a new folder")
        path.parent.mkdir(parents=True, exist_ok=True)
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
            topic, message_type, typestore=TYPES)

    def write(self, topic: str, time_ns: int, message: bytes) -> None:
        """Append a CDR-serialised message received at `time_ns`."""
        connection = self._connections[topic]
        self._writer.write(connection, time_ns, _without_padding(message, connection.msgtype))

    def flush(self) -> None:
        """Hand all messages to the system, so that they survive the process's sudden end.

        Otherwise they wait until a chunk is full, which at a low rate takes minutes.
        """
        write_pending_chunk(self._writer)

    def write_joints(
        self, topic: str, time_ns: int, names: Sequence[str], positions: Array,
        velocities: Array,
    ) -> None:
        """Append a JointState stamped with `time_ns`."""
        kinds = TYPES.types
        stamp = kinds['builtin_interfaces/msg/Time'](time_ns // 10**9, time_ns % 10**9)
        message = kinds[JOINT_STATE](
            kinds['std_msgs/msg/Header'](stamp, ''), list(names), positions, velocities,
            np.empty(0))
        self.write(topic, time_ns, bytes(TYPES.serialize_cdr(message, JOINT_STATE)))

    def write_twist(self, topic: str, time_ns: int, twist: Array) -> None:
        """Append a geometry_msgs/Twist of six numbers."""
        kinds = TYPES.types
        vector = kinds['geometry_msgs/msg/Vector3']
        message = kinds['geometry_msgs/msg/Twist'](vector(*twist[:3]), vector(*twist[3:]))
        self.write(topic, time_ns, bytes(TYPES.serialize_cdr(message, 'geometry_msgs/msg/Twist')))

    def write_text(self, topic: str, time_ns: int, text: str) -> None:
        """Append a std_msgs/String."""
        message = TYPES.types['std_msgs/msg/String'](text)
        self.write(topic, time_ns, bytes(TYPES.serialize_cdr(message, 'std_msgs/msg/String')))


def _without_padding(message: bytes, message_type: str) -> bytes:
    """Return a JointState without the bytes that rclpy leaves after trailing empty lists.

    They may be anything; rosbags takes such a message for a broken one.
    """
    if message_type != JOINT_STATE:
        return message
    for end in range(len(message), len(message) - _LONGEST_PADDING - 1, -4):
        with contextlib.suppress(SerdeError):
            TYPES.deserialize_cdr(message[:end], message_type)
            return message[:end]
    return message


def message_type_known(message_type: str) -> bool:
    """Return whether a type, as 'sensor_msgs/msg/JointState', can be written to a bag."""
    return message_type in TYPES.types
