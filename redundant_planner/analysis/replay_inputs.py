"""All that a planner was given, read from a bag tick by tick."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.robot_of_bag import robot_of_bag
from redundant_planner.core.errors import StateError
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import checked_target, Target
from redundant_planner.io.bag_reader import Bag, Event
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.chunk_reader import read_path, read_trajectory
from redundant_planner.io.joint_chunk import GAP, JointChunk
from redundant_planner.io.joint_chunks import ChosenJoints
from redundant_planner.io.joint_turns import Seams
from redundant_planner.io.plausible import LARGEST
from redundant_planner.io.preview_reader import read_preview
from redundant_planner.io.printable import printable
from redundant_planner.io.recorded_configuration import COMMAND_TIMEOUT, number_of, obstacle_topics
from redundant_planner.io.recorded_inputs import sound_twist
from redundant_planner.io.recorded_tick import checksum, RecordedTick, TickKind
from redundant_planner.io.target_reader import read_joint_target, read_target

Array = npt.NDArray[np.float64]

# Ticks per second, if the bag does not say, and at most.
_RATE = 250
_FASTEST_RATE = 1000
_TARGETS = ('target_pose', 'target_joints', 'target_path', 'target_trajectory')
# A stamp that is further from the time of its recording is of another clock [s].
_SAME_CLOCK = 60.0


@dataclass
class Inputs:
    """What a planner was given; times in seconds from the bag's first message.

    Attributes:
        robot: the arm.
        values: the parameters it ran with, as far as they were recorded.
        parts: of the joint states, with pauses between them: begin and end [s], and the first
            joint state (n,) [rad, m].
        ticks: every tick's inputs, if they were recorded, and the times of their recording.
        twists: times and cmd_vel.
        obstacles: times and serialised MarkerArrays, of each topic with obstacles.
        topics: names of these, without a slash before them.
        attached: times and serialised MarkerArrays.
        targets: times and what came on the topics of targets, in the base frame or of all joints.
        previews: arrival times, beginnings by their stamps, and what was announced.
        commands: joint_command, stamp [ns] → velocities (n,) [rad/s, m/s].
        raw: times and messages that go into the new bag as they are, by topic.
    """

    robot: Robot
    values: dict[str, Any]
    parts: list[tuple[float, float, Array]] = field(default_factory=list)
    ticks: list[tuple[float, RecordedTick]] = field(default_factory=list)
    twists: list[tuple[float, Array]] = field(default_factory=list)
    obstacles: list[list[tuple[float, bytes]]] = field(default_factory=lambda: [[]])
    topics: list[str] = field(default_factory=lambda: ['obstacles'])
    attached: list[tuple[float, bytes]] = field(default_factory=list)
    targets: list[tuple[float, Target]] = field(default_factory=list)
    previews: list[tuple[float, float, Preview]] = field(default_factory=list)
    commands: dict[int, Array] = field(default_factory=dict)
    raw: list[tuple[str, float, bytes]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def read_inputs(bag: Bag, params: Path | None, urdf: str, tip: str) -> Inputs:
    """Read what a planner was given.

    Raises:
        PlannerError: the bag lacks a robot or joint states.
    """
    notes: list[str] = []
    robot, values, _ = robot_of_bag(bag, params, urdf, tip, notes)
    if robot is None:
        raise RecordingError(f"'{bag.path}': {'; '.join(notes)}")
    inputs = Inputs(robot, values, notes=notes)
    inputs.topics = obstacle_topics(values)
    collector = _Collector(bag, inputs)
    for item in bag.read(('joint_states', 'joint_command', 'ticks', 'cmd_vel', *collector.places,
                          'attached', 'cmd_vel_preview', *_TARGETS, 'robot_description'),
                         order=()):
        if isinstance(item, JointChunk):
            collector.take_joints(item)
            continue
        try:
            collector.take(item)
        except StateError as error:
            bag.left_out.add(item.topic, str(error))
    collector.end()
    if not inputs.parts:
        raise RecordingError('; '.join((
            f"'{bag.path}' holds no messages on joint_states", *bag.problems)))
    if len(inputs.parts) > 1:
        inputs.notes.append(
            f'joint_states pauses {len(inputs.parts) - 1} times for more than {GAP:g} s; nothing '
            'is commanded there')
    inputs.notes += [printable(problem) for problem in bag.problems]
    return inputs


class _Collector:
    """Sorts the messages of a bag into what a planner was given.

    Attributes:
        places: topic with obstacles, as the bag calls it → its place in `Inputs.obstacles`.
    """

    def __init__(self, bag: Bag, inputs: Inputs) -> None:
        """Begin with nothing.

        Args:
            bag: open for reading.
            inputs: takes what is found.
        """
        self.places = {topic: i for i, topic in enumerate(bag.call(inputs.topics))}
        inputs.obstacles = [[] for _ in self.places]
        self._bag, self._inputs, robot = bag, inputs, inputs.robot
        self._joints = {
            topic: ChosenJoints(topic, robot.joint_names, bag.left_out, Seams.of(robot))
            for topic in ('joint_states', 'joint_command')}

    def take_joints(self, item: JointChunk) -> None:
        """Take joint states or commands."""
        inputs, chosen = self._inputs, self._joints[item.topic].of(item)
        if chosen is None:
            return
        if item.topic == 'joint_command':
            stamps = np.round(chosen.stamps * 1e9).astype(np.int64) + self._bag.origin_ns
            inputs.commands.update(zip(stamps.tolist(), chosen.velocities))
        else:
            _extend(inputs.parts, chosen)

    def take(self, item: Event) -> None:
        """Take a message of another topic.

        Raises:
            StateError: it cannot be used.
        """
        inputs, origin_ns = self._inputs, self._bag.origin_ns
        if item.topic == 'ticks':
            inputs.ticks.append((item.arrival, _tick(item, inputs.robot)))
        elif item.topic == 'cmd_vel':
            twist = sound_twist(item, self._bag.left_out)
            if twist is not None:
                inputs.twists.append((item.arrival, twist))
        elif item.topic == 'cmd_vel_preview':
            preview = _preview(item)
            if preview is not None:
                inputs.previews.append((item.arrival, _begin(item, origin_ns), preview))
        elif item.topic in self.places:
            place = self.places[item.topic]
            inputs.obstacles[place].append((item.arrival, item.raw))
            inputs.raw.append((inputs.topics[place], item.arrival, item.raw))
        else:
            inputs.raw.append((item.topic, item.arrival, item.raw))
            if item.topic == 'attached':
                inputs.attached.append((item.arrival, item.raw))
            elif item.topic in _TARGETS:
                inputs.targets.append((item.arrival, _target(item, inputs.robot, origin_ns)))

    def end(self) -> None:
        """Take what waited for more joints.

        Raises:
            JointsMissingError: there are joint states, and none is of this robot.
        """
        states = self._joints['joint_states']
        waiting = states.rest()
        if waiting is not None:
            _extend(self._inputs.parts, waiting)
        if not self._inputs.parts:
            states.check_found()


def _extend(parts: list[tuple[float, float, Array]], chunk: JointChunk) -> None:
    """Add joint states to the last part, or begin another one after a pause."""
    times = chunk.arrivals
    begins = [0, *(np.flatnonzero(np.diff(times) > GAP) + 1).tolist()]
    for begin, after in zip(begins, (*begins[1:], len(times))):
        first, last = float(times[begin]), float(times[after - 1])
        if parts and first - parts[-1][1] <= GAP:
            parts[-1] = (parts[-1][0], max(parts[-1][1], last), parts[-1][2])
        else:
            parts.append((first, last, chunk.positions[begin]))


def _tick(item: Event, robot: Robot) -> RecordedTick:
    """Return a recorded tick.

    Raises:
        StateError: it is none of this robot.
    """
    tick = RecordedTick.of(item.message.data, robot.n, robot.tips)
    if not (np.abs(np.concatenate((tick.q, tick.twist.ravel()))) <= LARGEST).all():
        raise StateError(f'a recorded tick has a posture or twist beyond {LARGEST:g}')
    return tick


def _preview(item: Event) -> Preview | None:
    """Return what was announced; None where the node refused it, and did not count it."""
    try:
        return read_preview(bytes(item.raw))[1]
    except StateError:
        return None


def _target(item: Event, robot: Robot, origin_ns: int) -> Target:
    """Return a target in the base frame, or of all joints.

    Raises:
        StateError: it is none, or given in another frame, whose place is not in the bag, or does
            not name all joints.
    """
    raw = bytes(item.raw)
    if item.topic == 'target_joints':
        return read_joint_target(raw, robot)[1]
    if item.topic == 'target_pose':
        _, frame, pose = read_target(raw)
        _check_frame(frame, robot)
        return pose
    read = read_path(raw) if item.topic == 'target_path' else read_trajectory(
        raw, robot, np.clip(np.zeros(robot.n), robot.position_min, robot.position_max))
    _check_frame(read.frame, robot)
    begin = read.stamp - origin_ns * 1e-9 if read.stamp else item.arrival
    late = item.arrival - begin if abs(item.arrival - begin) < _SAME_CLOCK else 0.0
    return checked_target(Chunk(read.times, read.points, read.velocities, late), robot)


def _check_frame(frame: str, robot: Robot) -> None:
    """Raise StateError for another frame than the base's."""
    if frame not in ('', robot.base_frame):
        raise StateError(f"they are given in frame '{frame}'; without ~/ticks those in "
                         f"'{robot.base_frame}' are replayed")


def _begin(item: Event, origin_ns: int) -> float:
    """Return when a preview begins: at its stamp, or on receipt if that is of another clock."""
    stamp = item.message.header.stamp
    begin = (stamp.sec * 10**9 + stamp.nanosec - origin_ns) * 1e-9
    return float(begin) if abs(begin - item.arrival) < _SAME_CLOCK else item.arrival


def ticks_of_topics(inputs: Inputs) -> list[tuple[float, RecordedTick]]:
    """Make up ticks at the planner's rate from what arrived when."""
    rate = rate_of(inputs.values)
    timeout = number_of(inputs.values, 'incoming_command_timeout', COMMAND_TIMEOUT, 10.0)
    ticks: list[tuple[float, RecordedTick]] = []
    for begin, end, start in inputs.parts:
        times = begin + np.arange(round((end - begin) * rate)) / rate
        ticks += _ticks_at(inputs, times, start, timeout)
    return ticks


def rate_of(values: dict[str, Any]) -> int:
    """Return the ticks per second of a planner with these parameters."""
    return max(int(number_of(values, 'rate', _RATE, _FASTEST_RATE)), 1)


def _ticks_at(
    inputs: Inputs, times: Array, start: Array, timeout: float,
) -> list[tuple[float, RecordedTick]]:
    """Make up the ticks of a part, whose first joint state is `start`."""
    arrivals = [np.array([entry[0] for entry in listed]) for listed in (
        inputs.twists, inputs.obstacles[0], inputs.previews, inputs.attached, inputs.targets)]
    latest, known, announced, attached, aimed = (
        np.searchsorted(a, times, side='right') for a in arrivals)
    more = [[(count, checksum_at(listed, count)) for count in np.searchsorted(
        [at for at, _ in listed], times, side='right').tolist()]
        for listed in inputs.obstacles]
    ticks = []
    kind, still = TickKind.STARTING, np.zeros(6)
    for i, (time, twist, scene, preview, held, aim) in enumerate(zip(
            times, latest, known, announced, attached, aimed)):
        fresh = twist > 0 and time - inputs.twists[twist - 1][0] <= timeout
        # Whichever came last commands.
        target = inputs.targets[aim - 1][1] if aim and not (
            twist and inputs.twists[twist - 1][0] > inputs.targets[aim - 1][0]) else None
        elapsed = time - inputs.previews[preview - 1][1] if preview and fresh else np.nan
        ticks.append((float(time), RecordedTick(
            0, float(time), kind, int(scene), int(preview), float(elapsed), int(held),
            inputs.twists[twist - 1][1] if fresh else still, start, target,
            tuple(topic[i] for topic in more))))
        kind = TickKind.GOING_ON
    return ticks


def checksum_at(messages: list[tuple[float, bytes]], count: int) -> int:
    """Return that of the latest of so many messages, 0 for none."""
    return checksum(messages[count - 1][1]) if count else 0
