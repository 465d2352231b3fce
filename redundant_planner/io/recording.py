"""Bags: what is written to them, and what is read from their files (`bag_files`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
import contextlib
from dataclasses import dataclass
from pathlib import Path
import tempfile
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from rosbags.serde import SerdeError

from redundant_planner.core.errors import known
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.io.bag_files import bag_files, BagFile, RecordingError, unpacked_message
from redundant_planner.io.bag_writer import JOINT_STATE, TYPES
from redundant_planner.io.joint_layout import joint_layout, JointLayout, LayoutError
from redundant_planner.io.obstacle_tracker import ObstacleTracker, Transform

Array = npt.NDArray[np.float64]

_STRING = 'std_msgs/msg/String'
# What the topics that are read must hold.
_EXPECTED = {
    'joint_states': (JOINT_STATE,), 'joint_command': (JOINT_STATE,),
    'cmd_vel': ('geometry_msgs/msg/Twist', 'geometry_msgs/msg/TwistStamped'),
    'cmd_vel_preview': ('trajectory_msgs/msg/MultiDOFJointTrajectory',),
    'obstacles': ('visualization_msgs/msg/MarkerArray',), 'robot_description': (_STRING,),
    'configuration': (_STRING,), 'ticks': ('std_msgs/msg/Float64MultiArray',),
    'diagnostics': ('diagnostic_msgs/msg/DiagnosticArray',)}
# What `--end` is at most, without an end [s].
_FOREVER = 5e9
# Messages of a joint topic that are taken together.
_CHUNK = 4096
# And that many bytes of them.
_CHUNK_BYTES = 32_000_000
# More joints than any machine has: such a message is damaged.
_JOINTS = 256
# A position, velocity or twist beyond this is none [rad, m; per s]: it would only overflow.
LARGEST = 1e6
# Joint states further apart belong to two motions: nothing was commanded between them [s].
GAP = 1.0
# Reasons for leaving messages of a topic out that are spelt out.
_REASONS = 3


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


class JointsMissingError(RecordingError):
    """The joints asked for were not recorded."""


class LeftOut:
    """Messages that could not be used: how many on which topic, and why."""

    def __init__(self) -> None:
        """Begin without any."""
        self._counts: dict[str, Counter[str]] = {}

    def add(self, topic: str, reason: str, count: int = 1) -> None:
        """Count messages; the first few reasons of a topic are kept."""
        reasons = self._counts.setdefault(topic, Counter())
        known_one = reason in reasons or len(reasons) < _REASONS
        reasons[reason if known_one else 'other reasons'] += count

    def sentences(self) -> list[str]:
        """Return a sentence per topic and reason."""
        return [f'{count} messages on {topic} are left out: {reason}'
                for topic, reasons in self._counts.items()
                for reason, count in reasons.items() if count]


class Topic(NamedTuple):
    """A topic of a bag: its name, and the type of its messages."""

    name: str
    kind: str


class Bag:
    """A bag that is open for reading, its times counted from its first message."""

    def __init__(self, files: list[BagFile], path: Path, topics: dict[str, Topic]) -> None:
        """Use `open_bag`."""
        self._files, self._topics, self.path = files, topics, path
        self.origin_ns = min(file.begin_ns for file in files)
        self.duration = max((max(file.end_ns for file in files) - self.origin_ns) * 1e-9, 0.0)
        self.left_out = LeftOut()
        self.remarks: list[str] = []

    @property
    def topics(self) -> dict[str, int]:
        """Topic without namespace → number of its messages."""
        return {short: sum(file.counts[channel] for file in self._files
                           for channel in _channels(file, topic))
                for short, topic in self._topics.items()}

    @property
    def problems(self) -> list[str]:
        """What was wrong with it as far as it was read, a sentence each."""
        return [*self.remarks, *(problem for file in self._files for problem in file.problems),
                *self.left_out.sentences()]

    def read(
        self, topics: Sequence[str], begin: float = 0.0, end: float = np.inf,
        progress: Callable[[float], None] | None = None, order: Sequence[str] | None = None,
    ) -> Iterator[JointChunk | Event]:
        """Yield what was recorded on some topics without holding it all.

        Joint states come in chunks, which end where a message comes between whose order counts.
        A message that cannot be decoded is left out and counted in `left_out`.

        Args:
            topics: names without namespace.
            order: those whose place among the joint states counts; all of them if None.
            begin, end: seconds from the first message.
            progress: takes the share that is done, now and then.
        """
        batches: dict[str, _JointBatch] = {}
        first, last = (self.origin_ns + round(float(np.clip(time, -_FOREVER, _FOREVER)) * 1e9)
                       for time in (begin, end))
        for file in self._files:
            names = {channel: short for short in topics if short in self._topics
                     for channel in _channels(file, self._topics[short])}
            for channel, time_ns, packed in file.messages(names, first, last) if names else ():
                name, arrival = names[channel], (time_ns - self.origin_ns) * 1e-9
                kind = self._topics[name].kind
                try:
                    raw = unpacked_message(packed)
                except RecordingError as error:
                    self.left_out.add(name, str(error))
                    continue
                if kind == JOINT_STATE:
                    batch = batches.setdefault(name, _JointBatch(name, self.left_out))
                    if not batch.fits(raw):
                        yield from batch.chunk(self.origin_ns)
                    batch.add(arrival, raw)
                    if batch.full:
                        yield from batch.chunk(self.origin_ns)
                        if progress is not None:
                            progress(min(arrival / max(self.duration, 1e-9), 1.0))
                    continue
                if order is None or name in order:
                    for batch in batches.values():
                        yield from batch.chunk(self.origin_ns)
                try:
                    message = _decoded(raw, kind)
                except Exception as error:  # another package's decoder, on bytes from anywhere
                    self.left_out.add(name, f'they cannot be decoded ({error})')
                    continue
                yield Event(name, arrival, message, raw)
        for batch in batches.values():
            yield from batch.chunk(self.origin_ns)


def _channels(file: BagFile, topic: Topic) -> list[int]:
    return [channel for channel, found in file.topics.items() if found == tuple(topic)]


@contextlib.contextmanager
def open_bag(path: Path, namespace: str = '') -> Iterator[Bag]:
    """Open a bag: MCAP or sqlite3, compressed or not, closed properly or not.

    Args:
        path: its folder, or its file.
        namespace: of the topics, where the bag has several arms.

    Raises:
        RecordingError: it is no bag, is empty, or cannot be read.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = bag_files(path, Path(folder))
        if not any(file.counts for file in files):
            raise RecordingError('; '.join((f"'{path}' holds no messages", *(
                problem for file in files for problem in file.problems))))
        topics, remarks = _chosen_topics(path, files, namespace)
        bag = Bag([file for file in files if file.counts], path, topics)
        bag.remarks += remarks
        yield bag


def _chosen_topics(
    path: Path, files: list[BagFile], namespace: str,
) -> tuple[dict[str, Topic], list[str]]:
    """Return the topics by the last part of their names, of one namespace.

    Also a sentence about each that holds something else than its name says.
    """
    topics: dict[str, Topic] = {}
    problems = []
    prefix = f'/{namespace.strip("/")}/' if namespace.strip('/') else '/'
    recorded = list(dict.fromkeys(Topic(*topic) for file in files
                                  for topic in file.topics.values()))
    for topic in sorted(recorded, key=lambda topic: topic.name.count('/')):
        short = topic.name.rsplit('/', 1)[-1]
        if not topic.name.startswith(prefix) and short != 'diagnostics':
            continue
        expected = _EXPECTED.get(short, (topic.kind,))
        if topic.kind in expected:
            topics.setdefault(short, topic)
        else:
            problems.append(f"'{topic.name}' is {topic.kind or 'of a type that is not told'}; it "
                            f'must be {" or ".join(expected)}')
    if namespace and not topics and not problems:
        raise RecordingError(f"'{path}' has no topics in namespace '{namespace}'; it has "
                             f'{known(sorted({topic.name for topic in recorded}))}')
    return topics, problems


class _JointBatch:
    """Collects JointState messages of the same joints, and decodes them all at once.

    Decoded one by one, ten minutes at 1 kHz would take as long as they lasted. All messages of a
    publisher differ in stamp and numbers alone, so that one look at the first tells where the
    numbers are.
    """

    def __init__(self, topic: str, left_out: LeftOut) -> None:
        self._topic, self._left_out = topic, left_out
        self._raw: list[bytes] = []
        self._arrivals: list[float] = []
        self._layout: JointLayout | None = None

    def fits(self, raw: bytes) -> bool:
        """Return whether a message may join the others."""
        return not self._raw or (
            self._layout is not None and self._layout.fits(raw, self._raw[0]))

    @property
    def full(self) -> bool:
        """Whether it is time for a chunk."""
        return len(self._raw) >= _CHUNK or len(self._raw) * len(self._raw[0]) >= _CHUNK_BYTES

    def add(self, arrival: float, raw: bytes) -> None:
        """Take in a message."""
        if not self._raw:
            try:
                self._layout = joint_layout(raw)
                self._problem = _problem_of(self._layout.names)
            except LayoutError as error:
                self._layout, self._problem = None, str(error)
        self._raw.append(raw)
        self._arrivals.append(arrival)

    def chunk(self, origin_ns: int) -> Iterator[JointChunk]:
        """Yield what was collected, if anything, and begin anew."""
        if not self._raw:
            return
        raws, arrivals = self._raw, np.array(self._arrivals)
        self._raw, self._arrivals = [], []
        if self._layout is None or self._problem:
            self._left_out.add(self._topic, self._problem, len(raws))
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


def _problem_of(names: Sequence[str]) -> str:
    """Return what is wrong with joint names, if anything."""
    if not names:
        return 'they name no joint'
    if len(names) > _JOINTS:
        return f'they name {len(names)} joints; {_JOINTS} at most are taken'
    if not all(name.isprintable() and len(name) <= _JOINTS for name in names):
        return 'their joint names are no text'
    return ''


def _decoded(raw: bytes, kind: str) -> Any:
    """Decode a message; rclpy's serialize_message pads a trailing empty list by four bytes."""
    try:
        return TYPES.deserialize_cdr(raw, kind)
    except SerdeError:
        return TYPES.deserialize_cdr(raw[:-4], kind)


class ChosenJoints:
    """Picks certain joints out of a topic's chunks, and leaves out what cannot be used."""

    def __init__(self, topic: str, names: Sequence[str], left_out: LeftOut) -> None:
        """Pick the joints of these names; without names those of the first chunk."""
        self.names = tuple(names)
        self._topic, self._left_out = topic, left_out
        self._seen: tuple[str, ...] = ()

    def of(self, chunk: JointChunk) -> JointChunk | None:
        """Return a chunk's joints and messages that can be used, None if there are none."""
        self.names = self.names or chunk.names
        self._seen = self._seen or chunk.names
        try:
            columns = columns_of(chunk.names, self.names)
        except JointsMissingError:
            self._left_out.add(self._topic, 'they are of other joints', len(chunk.stamps))
            return None
        q, dq = chunk.positions[:, columns], chunk.velocities[:, columns]
        # As in the node, which skips such a message; a comparison with NaN is false.
        fine = np.asarray((np.abs(q) <= LARGEST).all(axis=1))
        if not fine.all():
            self._left_out.add(self._topic, 'they have positions that are not finite, or beyond '
                               f'{LARGEST:g}', int((~fine).sum()))
        if not fine.any():
            return None
        dq = np.where(np.abs(dq) <= LARGEST, dq, np.nan)
        return JointChunk(chunk.topic, self.names, chunk.arrivals[fine], chunk.stamps[fine],
                          q[fine], dq[fine])

    def check_found(self) -> None:
        """Raise an error if the joints were never all there.

        Raises:
            JointsMissingError: naming those that were not recorded.
        """
        if self._seen:
            columns_of(self._seen, self.names)


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
        JointsMissingError: a joint was not recorded.
    """
    missing = [name for name in wanted if name not in recorded]
    if missing:
        raise JointsMissingError(
            f'joints {missing} were not recorded; the bag has {list(recorded)}')
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


def read_recording(path: Path) -> Recording:
    """Read a bag of the planner's topics into memory.

    Raises:
        RecordingError: it is no bag, or has no joint states or commands.
    """
    chunks: dict[str, list[JointChunk]] = {'joint_states': [], 'joint_command': []}
    twist_times: list[float] = []
    twists: list[Array] = []
    book = ObstacleTracker((), (), transform=as_it_is)
    description = ''
    with open_bag(path) as bag:
        joints = {topic: ChosenJoints(topic, (), bag.left_out) for topic in chunks}
        for item in bag.read([*chunks, 'cmd_vel', 'obstacles', 'robot_description']):
            if isinstance(item, JointChunk):
                found = joints[item.topic].of(item)
                chunks[item.topic] += [found] if found is not None else []
            elif item.topic == 'cmd_vel':
                twist = sound_twist(item, bag.left_out)
                if twist is not None:
                    twist_times.append(item.arrival)
                    twists.append(twist)
            elif item.topic == 'obstacles':
                book.update(item.raw, item.arrival)
            else:
                description = item.message.data
    for topic, listed in chunks.items():
        if not listed:
            raise RecordingError(f"'{path}' holds no messages on {topic}")
    logs = {topic: JointLog(
        listed[0].names, *(np.concatenate([getattr(chunk, part) for chunk in listed])
                           for part in ('stamps', 'positions', 'velocities')))
            for topic, listed in chunks.items()}
    return Recording(logs['joint_states'], logs['joint_command'], np.array(twist_times),
                     np.array(twists).reshape(-1, 6), book.scene.obstacles(),
                     description)


def as_it_is(frame: str) -> Transform:
    """Take every frame for the base's: what a planner refused is not known from a bag."""
    return np.zeros(3), np.eye(3)


def sound_twist(item: Event, left_out: LeftOut) -> Array | None:
    """Return the six numbers of a cmd_vel, None where the node does not take them either."""
    twist = twist_of(item.message)
    if (np.abs(twist) <= LARGEST).all():
        return twist
    left_out.add(item.topic, f'they have numbers that are not finite, or beyond {LARGEST:g}')
    return None


def twist_of(message: Any) -> Array:
    """Return the six numbers of a decoded Twist or TwistStamped."""
    twist = getattr(message, 'twist', message)
    linear, angular = twist.linear, twist.angular
    return np.array([linear.x, linear.y, linear.z, angular.x, angular.y, angular.z])
