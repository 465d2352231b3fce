"""A recorded motion, read from a bag into memory as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.io.joint_chunks import ChosenJoints, columns_of
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.io.recorded_inputs import as_it_is, sound_twist

Array = npt.NDArray[np.float64]


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
        for topic, chosen in joints.items():
            found = chosen.rest()
            chunks[topic] += [found] if found is not None else []
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
