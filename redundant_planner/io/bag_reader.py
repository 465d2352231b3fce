"""A bag that is open for reading: its topics, and what was recorded on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import contextlib
from pathlib import Path
import tempfile
from typing import Any, NamedTuple

import numpy as np
from rosbags.serde import SerdeError

from redundant_planner.core.errors import known
from redundant_planner.io.bag_files import bag_files
from redundant_planner.io.bag_storage import BagFile, RecordingError
from redundant_planner.io.bag_writer import JOINT_STATE, TYPES
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.io.joint_chunks import JointBatch
from redundant_planner.io.left_out import LeftOut
from redundant_planner.io.unpacking import unpacked_message

_STRING = 'std_msgs/msg/String'
# What the topics that are read must hold.
_EXPECTED = {
    'joint_states': (JOINT_STATE,), 'joint_command': (JOINT_STATE,),
    'cmd_vel': ('geometry_msgs/msg/Twist', 'geometry_msgs/msg/TwistStamped'),
    'cmd_vel_preview': ('trajectory_msgs/msg/MultiDOFJointTrajectory',),
    'obstacles': ('visualization_msgs/msg/MarkerArray',),
    'attached': ('visualization_msgs/msg/MarkerArray',), 'robot_description': (_STRING,),
    'configuration': (_STRING,), 'ticks': ('std_msgs/msg/Float64MultiArray',),
    'target_pose': ('geometry_msgs/msg/PoseStamped',), 'target_joints': (JOINT_STATE,),
    'target_path': ('nav_msgs/msg/Path',),
    'target_trajectory': ('trajectory_msgs/msg/JointTrajectory',),
    'target': ('diagnostic_msgs/msg/DiagnosticArray',),
    'diagnostics': ('diagnostic_msgs/msg/DiagnosticArray',)}
# Topics whose messages come in chunks.
_STREAMS = ('joint_states', 'joint_command')
# Topics whose messages are read as they stand: another package's decoder refuses the bytes that
# rclpy leaves after empty lists.
_AS_BYTES = ('target_path', 'target_trajectory')
# What `--end` is at most, without an end [s].
_FOREVER = 5e9


class Event(NamedTuple):
    """A message of another topic.

    Attributes:
        topic: without its namespace.
        arrival: when it was recorded [s].
        message: decoded; None where `raw` is read by this package itself.
        raw: as it stands in the bag.
    """

    topic: str
    arrival: float
    message: Any
    raw: bytes


class Topic(NamedTuple):
    """A topic of a bag: its name, and the type of its messages."""

    name: str
    kind: str


class Bag:
    """A bag that is open for reading, its times counted from its first message."""

    def __init__(
        self, files: list[BagFile], path: Path, topics: dict[str, Topic], prefix: str,
    ) -> None:
        """Use `open_bag`."""
        self._files, self._topics, self.path, self._prefix = files, topics, path, prefix
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

    def call(self, names: Sequence[str]) -> list[str]:
        """Return by which names several topics with obstacles are read from now on.

        Args:
            names: theirs, without a slash before them, or the ends of them.
        """
        short = ['obstacles', *(f'obstacles of topic {i}' for i in range(1, len(names)))]
        recorded = {Topic(*topic) for file in self._files for topic in file.topics.values()}
        for one, name in zip(short, names):
            found = [topic for topic in recorded if topic.kind in _EXPECTED['obstacles']
                     and topic.name.endswith(f'/{name}')]
            self._topics.pop(one, None)
            if found:
                self._topics[one] = min(found, key=lambda topic: (
                    not topic.name.startswith(self._prefix), topic.name.count('/')))
        return short

    def of_tips(self, tips: Sequence[str], names: Sequence[str]) -> list[str]:
        """Return by which names topics of several tips are read from now on: TIP/NAME.

        By NAME alone none of them is any more.
        """
        recorded = {Topic(*topic) for file in self._files for topic in file.topics.values()}
        short = []
        for name in names:
            own = [topic for topic in recorded if topic.kind in _EXPECTED[name]
                   and topic.name.startswith(self._prefix)]
            self._topics.pop(name, None)
            for tip in tips:
                ends = f'/{tip}/{name}'
                found = [topic for topic in own if topic.name.endswith(ends)]
                if found:
                    short.append(f'{tip}/{name}')
                    self._topics[short[-1]] = min(
                        found, key=lambda topic: (topic.name.count('/'), topic.name))
        return short

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
        batches: dict[str, JointBatch] = {}
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
                if name in _STREAMS:
                    batch = batches.setdefault(name, JointBatch(name, self.left_out))
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
                    message = None if name.rsplit('/', 1)[-1] in _AS_BYTES else _decoded(raw, kind)
                except Exception as error:  # another package's decoder, on bytes from anywhere
                    self.left_out.add(name, f'they cannot be decoded ({error})')
                    continue
                yield Event(name, arrival, message, raw)
        for batch in batches.values():
            yield from batch.chunk(self.origin_ns)


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
        bag = Bag([file for file in files if file.counts], path, topics, _prefix(namespace))
        bag.remarks += remarks
        yield bag


def _prefix(namespace: str) -> str:
    """Return what the names of a namespace's topics begin with."""
    return f'/{namespace.strip("/")}/' if namespace.strip('/') else '/'


def _channels(file: BagFile, topic: Topic) -> list[int]:
    return [channel for channel, found in file.topics.items() if found == tuple(topic)]


def _chosen_topics(
    path: Path, files: list[BagFile], namespace: str,
) -> tuple[dict[str, Topic], list[str]]:
    """Return the topics by the last part of their names, of one namespace.

    Also a sentence about each that holds something else than its name says.
    """
    topics: dict[str, Topic] = {}
    problems = []
    prefix = _prefix(namespace)
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


def _decoded(raw: bytes, kind: str) -> Any:
    """Decode a message; rclpy's serialize_message pads a trailing empty list by four bytes."""
    try:
        return TYPES.deserialize_cdr(raw, kind)
    except SerdeError:
        return TYPES.deserialize_cdr(raw[:-4], kind)
