"""Bags: the only file that knows their format."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
from dataclasses import dataclass, field
from pathlib import Path
import shutil
import struct
import tempfile
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import get_typestore, Stores

from redundant_planner.core.errors import known, PlannerError
from redundant_planner.core.obstacles import Obstacle
from redundant_planner.joint_layout import joint_layout, JointLayout, LayoutError
from redundant_planner.nodes.obstacle_book import ObstacleBook, Transform

Array = npt.NDArray[np.float64]

_TYPES = get_typestore(Stores.ROS2_JAZZY)
_JOINT_STATE = 'sensor_msgs/msg/JointState'
_STRING = 'std_msgs/msg/String'
# What the topics that are read must hold.
_EXPECTED = {
    'joint_states': (_JOINT_STATE,), 'joint_command': (_JOINT_STATE,),
    'cmd_vel': ('geometry_msgs/msg/Twist', 'geometry_msgs/msg/TwistStamped'),
    'cmd_vel_preview': ('trajectory_msgs/msg/MultiDOFJointTrajectory',),
    'obstacles': ('visualization_msgs/msg/MarkerArray',), 'robot_description': (_STRING,),
    'configuration': (_STRING,), 'ticks': ('std_msgs/msg/Float64MultiArray',),
    'diagnostics': ('diagnostic_msgs/msg/DiagnosticArray',)}
# Messages of a joint topic that are taken together.
_CHUNK = 4096
_MAGIC = b'\x89MCAP0\r\n'
# What ends an MCAP file without an index: DataEnd, and a Footer that points nowhere.
_DATA_END = struct.pack('<BQI', 0x0F, 4, 0)
_FOOTER = struct.pack('<BQQQI', 0x02, 20, 0, 0, 0)
# Bags that were not closed are repaired in a copy up to this size [bytes].
_COPIED = 2_000_000_000


class RecordingError(PlannerError):
    """A bag cannot be read, or lacks what was asked of it."""


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
            topic, message_type, typestore=_TYPES)

    def write(self, topic: str, time_ns: int, message: bytes) -> None:
        """Append a CDR-serialised message received at `time_ns`."""
        self._writer.write(self._connections[topic], time_ns, message)

    def flush(self) -> None:
        """Hand what was written to the system: it survives the process's sudden end.

        Otherwise it waits for a chunk to be full, which at a low rate takes minutes.
        """
        storage = self._writer.storage
        if isinstance(storage, McapWriter) and storage.chunk.msgs:
            storage.close_chunk()
            storage.bio.flush()

    def write_joints(
        self, topic: str, time_ns: int, names: Sequence[str], positions: Array,
        velocities: Array,
    ) -> None:
        """Append a JointState stamped with `time_ns`."""
        kinds = _TYPES.types
        stamp = kinds['builtin_interfaces/msg/Time'](time_ns // 10**9, time_ns % 10**9)
        message = kinds[_JOINT_STATE](
            kinds['std_msgs/msg/Header'](stamp, ''), list(names), positions, velocities,
            np.empty(0))
        self.write(topic, time_ns, bytes(_TYPES.serialize_cdr(message, _JOINT_STATE)))

    def write_twist(self, topic: str, time_ns: int, twist: Array) -> None:
        """Append a geometry_msgs/Twist of six numbers."""
        kinds = _TYPES.types
        vector = kinds['geometry_msgs/msg/Vector3']
        message = kinds['geometry_msgs/msg/Twist'](vector(*twist[:3]), vector(*twist[3:]))
        self.write(topic, time_ns, bytes(_TYPES.serialize_cdr(message, 'geometry_msgs/msg/Twist')))

    def write_text(self, topic: str, time_ns: int, text: str) -> None:
        """Append a std_msgs/String."""
        message = _TYPES.types['std_msgs/msg/String'](text)
        self.write(topic, time_ns, bytes(_TYPES.serialize_cdr(message, 'std_msgs/msg/String')))


def message_type_known(message_type: str) -> bool:
    """Return whether a type, as 'sensor_msgs/msg/JointState', can be written to a bag."""
    return message_type in _TYPES.types


class JointChunk(NamedTuple):
    """Successive JointState messages of one topic.

    Attributes:
        topic: without its namespace.
        names: joint names, the order of the columns.
        arrivals: (k,) when they were recorded [s].
        stamps: (k,) of their headers, `arrivals` where there are none [s].
        positions: (k, n) [rad, m].
        velocities: (k, n) [rad/s, m/s], NaN where there are none.
    """

    topic: str
    names: tuple[str, ...]
    arrivals: Array
    stamps: Array
    positions: Array
    velocities: Array


class Event(NamedTuple):
    """A message of another topic.

    Attributes:
        topic: without its namespace.
        arrival: when it was recorded [s].
        message: decoded.
        raw: as it stands in the bag.
    """

    topic: str
    arrival: float
    message: Any
    raw: bytes


class Bag:
    """A bag that is open for reading, its times counted from its first message."""

    def __init__(self, reader: AnyReader, path: Path, topics: dict[str, Connection]) -> None:
        """Use `open_bag`."""
        self._reader, self._topics, self.path = reader, topics, path
        self.origin_ns = reader.start_time
        self.duration = max((reader.end_time - reader.start_time) * 1e-9, 0.0)
        self.problems: list[str] = []

    @property
    def topics(self) -> dict[str, int]:
        """Topic without namespace → number of its messages."""
        return {name: connection.msgcount for name, connection in self._topics.items()}

    def read(
        self, topics: Sequence[str], begin: float = 0.0, end: float = np.inf,
        progress: Callable[[float], None] | None = None, order: Sequence[str] | None = None,
    ) -> Iterator[JointChunk | Event]:
        """Yield what was recorded on some topics without holding it all.

        Joint states come in chunks, which end where a message comes between whose order counts.
        A message that cannot be decoded is left out and mentioned in `problems`.

        Args:
            topics: names without namespace.
            order: those whose place among the joint states counts; all of them if None.
            begin, end: seconds from the first message.
            progress: takes the share that is done, now and then.
        """
        chosen = [self._topics[name] for name in topics if name in self._topics]
        names = {connection.id: name for name, connection in self._topics.items()}
        batches: dict[str, _JointBatch] = {}
        broken: dict[str, int] = {}
        first = self.origin_ns + round(begin * 1e9)
        last = None if np.isinf(end) else self.origin_ns + round(end * 1e9)
        try:
            for connection, time_ns, raw in self._reader.messages(
                    connections=chosen, start=first, stop=last) if chosen else ():
                name, arrival = names[connection.id], (time_ns - self.origin_ns) * 1e-9
                if connection.msgtype == _JOINT_STATE:
                    batch = batches.setdefault(name, _JointBatch(name))
                    if not batch.fits(raw):
                        yield from batch.chunk(self.origin_ns)
                    if batch.add(arrival, raw) == _CHUNK:
                        yield from batch.chunk(self.origin_ns)
                        if progress is not None:
                            progress(min(arrival / max(self.duration, 1e-9), 1.0))
                    continue
                if order is None or name in order:
                    for batch in batches.values():
                        yield from batch.chunk(self.origin_ns)
                try:
                    message = _decoded(self._reader, raw, connection.msgtype)
                except (AnyReaderError, UnicodeDecodeError, ValueError) as error:
                    broken[name] = broken.get(name, 0) + 1
                    if broken[name] == 1:
                        self.problems.append(f'a message on {name} cannot be decoded: {error}')
                    continue
                yield Event(name, arrival, message, bytes(raw))
        except (AnyReaderError, ReaderError, OSError, struct.error) as error:
            self.problems.append(f'the bag is damaged after a while: {error}')
        for batch in batches.values():
            yield from batch.chunk(self.origin_ns)
            self.problems += batch.problems


@contextlib.contextmanager
def open_bag(path: Path, namespace: str = '') -> Iterator[Bag]:
    """Open a bag: MCAP or sqlite3, compressed or not, closed properly or not.

    Args:
        path: its folder, or its file.
        namespace: of the topics, where the bag has several arms.

    Raises:
        RecordingError: it is no bag, is empty, or cannot be read.
    """
    with contextlib.ExitStack() as stack:
        if not path.exists():
            raise RecordingError(f"'{path}' is not a readable bag: there is no such file")
        whole = path
        if _unclosed(path):
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            whole = _repaired_copy(path, folder)
        try:
            reader = stack.enter_context(AnyReader([whole], default_typestore=_TYPES))
        except (AnyReaderError, ReaderError, OSError, ValueError, KeyError, TypeError) as error:
            raise RecordingError(f"'{path}' is not a readable bag: {error}") from None
        if not reader.message_count:
            raise RecordingError(f"'{path}' holds no messages")
        topics, problems = _chosen_topics(path, reader, namespace)
        bag = Bag(reader, path, topics)
        bag.problems += problems
        if whole is not path:
            bag.problems.append('the bag was not closed: what the recorder had written is there')
        yield bag


def _chosen_topics(
    path: Path, reader: AnyReader, namespace: str,
) -> tuple[dict[str, Connection], list[str]]:
    """Return the connections by the last part of their names, of one namespace.

    Also a sentence about each that holds something else than its name says.
    """
    topics: dict[str, Connection] = {}
    problems = []
    prefix = f'/{namespace.strip("/")}/' if namespace.strip('/') else '/'
    for connection in sorted(reader.connections, key=lambda c: c.topic.count('/')):
        short = connection.topic.rsplit('/', 1)[-1]
        if not connection.topic.startswith(prefix) and short != 'diagnostics':
            continue
        expected = _EXPECTED.get(short, (connection.msgtype,))
        if connection.msgtype in expected:
            topics.setdefault(short, connection)
        else:
            problems.append(f"'{connection.topic}' is {connection.msgtype}; it must be "
                            f'{" or ".join(expected)}')
    if namespace and not topics and not problems:
        raise RecordingError(f"'{path}' has no topics in namespace '{namespace}'; it has "
                             f'{known(sorted({c.topic for c in reader.connections}))}')
    return topics, problems


def _mcap_file(path: Path) -> Path | None:
    files = [path] if path.suffix == '.mcap' else sorted(path.glob('*.mcap'))
    return files[0] if len(files) == 1 else None


def _unclosed(path: Path) -> bool:
    """Return whether a bag is an MCAP file without its end: the recorder was killed."""
    file = _mcap_file(path) if path.is_dir() or path.suffix == '.mcap' else None
    if file is None or file.stat().st_size < len(_MAGIC):
        return False
    with file.open('rb') as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            return False
        stream.seek(-len(_MAGIC), 2)
        return stream.read() != _MAGIC


def _repaired_copy(path: Path, folder: Path) -> Path:
    file = _mcap_file(path)
    assert file is not None
    if file.stat().st_size > _COPIED:
        raise RecordingError(f"'{path}' was not closed, and is too long to be repaired in a copy; "
                             f'record_bag --repair {path} repairs it where it is')
    copy = folder / file.name
    shutil.copyfile(file, copy)
    close_mcap(copy)
    return copy


def repair(path: Path) -> bool:
    """Close a bag whose recorder was killed, where it is; return whether that was needed.

    Raises:
        RecordingError: it is no MCAP bag.
    """
    file = _mcap_file(path) if path.exists() else None
    if file is None:
        raise RecordingError(f"'{path}' is not an MCAP bag")
    if not _unclosed(path):
        return False
    close_mcap(file)
    return True


def close_mcap(file: Path) -> None:
    """Cut off an incomplete last record and write the end of the file.

    An MCAP file is a series of records, each with its kind (1 byte) and length (8 bytes).
    """
    size = file.stat().st_size
    with file.open('r+b') as stream:
        end = len(_MAGIC)
        while end + 9 <= size:
            stream.seek(end)
            length = struct.unpack('<xQ', stream.read(9))[0]
            if end + 9 + length > size:
                break
            end += 9 + length
        stream.truncate(end)
        stream.seek(end)
        stream.write(_DATA_END + _FOOTER + _MAGIC)


class _JointBatch:
    """Collects JointState messages of the same joints, and decodes them all at once.

    Decoded one by one, ten minutes at 1 kHz would take as long as they lasted. All messages of a
    publisher differ in stamp and numbers alone, so that one look at the first tells where the
    numbers are.
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._raw: list[bytes] = []
        self._arrivals: list[float] = []
        self._layout: JointLayout | None = None
        self.problems: list[str] = []

    def fits(self, raw: bytes) -> bool:
        """Return whether a message may join the others."""
        return not self._raw or (
            self._layout is not None and self._layout.fits(raw, self._raw[0]))

    def add(self, arrival: float, raw: bytes) -> int:
        """Take in a message; return how many there are."""
        if not self._raw:
            try:
                self._layout = joint_layout(raw)
            except LayoutError as error:
                self._layout, self._problem = None, str(error)
        self._raw.append(bytes(raw))
        self._arrivals.append(arrival)
        return len(self._raw)

    def chunk(self, origin_ns: int) -> Iterator[JointChunk]:
        """Yield what was collected, if anything, and begin anew."""
        if not self._raw:
            return
        raws, arrivals = self._raw, np.array(self._arrivals)
        self._raw, self._arrivals = [], []
        if self._layout is None:
            self.problems.append(
                f'{len(raws)} messages on {self._topic} are left out: {self._problem}')
            return
        names, positions, velocities, order = self._layout[:4]
        block = np.frombuffer(b''.join(raws), np.uint8).reshape(len(raws), -1)

        def numbers(at: int, kind: str, count: int) -> npt.NDArray[Any]:
            size = np.dtype(kind).itemsize * count
            return np.ascontiguousarray(block[:, at:at + size]).view(order + kind)

        seconds = numbers(4, 'i4', 1)[:, 0].astype(np.int64)
        nanoseconds = seconds * 10**9 + numbers(8, 'u4', 1)[:, 0]
        stamps = (nanoseconds - origin_ns) * 1e-9
        stamps = np.where(nanoseconds > 0, stamps, arrivals)
        shape = len(raws), len(names)
        q = numbers(positions, 'f8', len(names)).astype(float)
        dq = (numbers(velocities, 'f8', len(names)).astype(float) if velocities
              else np.full(shape, np.nan))
        yield JointChunk(self._topic, names, arrivals, stamps, q, dq)


def _decoded(reader: AnyReader, raw: bytes, message_type: str) -> Any:
    """Decode a message; rclpy's serialize_message pads a trailing empty list by four bytes."""
    try:
        return reader.deserialize(raw, message_type)
    except AnyReaderError:
        return reader.deserialize(raw[:-4], message_type)


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
        columns = columns_of(self.names, names)
        return JointLog(names, self.times, self.positions[:, columns],
                        self.velocities[:, columns])

    def between(self, begin: float, end: float) -> JointLog:
        """Return the part with begin ≤ time ≤ end [s]."""
        inside = (self.times >= begin) & (self.times <= end)
        return JointLog(self.names, self.times[inside], self.positions[inside],
                        self.velocities[inside])


def columns_of(recorded: Sequence[str], wanted: Sequence[str]) -> list[int]:
    """Return where the wanted joints stand among the recorded ones.

    Raises:
        RecordingError: a joint was not recorded.
    """
    missing = [name for name in wanted if name not in recorded]
    if missing:
        raise RecordingError(f'joints {missing} were not recorded; the bag has {list(recorded)}')
    return [list(recorded).index(name) for name in wanted]


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


@dataclass
class _Rows:
    chunks: list[JointChunk] = field(default_factory=list)

    def log(self, path: Path, topic: str) -> JointLog:
        if not self.chunks:
            raise RecordingError(f"'{path}' holds no messages on {topic}")
        names = self.chunks[0].names
        chunks = [chunk for chunk in self.chunks if chunk.names == names]
        return JointLog(names, np.concatenate([c.stamps for c in chunks]),
                        np.concatenate([c.positions for c in chunks]),
                        np.concatenate([c.velocities for c in chunks]))


def read_recording(path: Path) -> Recording:
    """Read a bag of the planner's topics into memory.

    Raises:
        RecordingError: it is no bag, is damaged, or has no joint states or commands.
    """
    rows = {'joint_states': _Rows(), 'joint_command': _Rows()}
    twist_times: list[float] = []
    twists: list[Array] = []
    book = ObstacleBook((), (), transform=as_it_is)
    description = ''
    with open_bag(path) as bag:
        for item in bag.read([*rows, 'cmd_vel', 'obstacles', 'robot_description']):
            if isinstance(item, JointChunk):
                rows[item.topic].chunks.append(item)
            elif item.topic == 'cmd_vel':
                twist_times.append(item.arrival)
                twists.append(twist_of(item.message))
            elif item.topic == 'obstacles':
                book.update(item.raw, item.arrival)
            else:
                description = item.message.data
    logs = {topic: found.log(path, topic) for topic, found in rows.items()}
    return Recording(logs['joint_states'], logs['joint_command'], np.array(twist_times),
                     np.array(twists).reshape(-1, 6), book.scene.obstacles(),
                     description)


def as_it_is(frame: str) -> Transform:
    """Take every frame for the base's: what a planner refused is not known from a bag."""
    return np.zeros(3), np.eye(3)


def twist_of(message: Any) -> Array:
    """Return the six numbers of a decoded Twist or TwistStamped."""
    twist = getattr(message, 'twist', message)
    linear, angular = twist.linear, twist.angular
    return np.array([linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
