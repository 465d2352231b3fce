"""replay_bag: what the planner would have done with other parameters, computed offline."""

from __future__ import annotations

import argparse
from collections import deque
from dataclasses import dataclass, fields, replace
from pathlib import Path
import sys
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
import yaml

from redundant_planner.analysis.replay_inputs import (
    checksum_at,
    Inputs,
    rate_of,
    read_inputs,
    ticks_of_topics,
)
from redundant_planner.core.errors import ObstacleError, ParameterError, PlannerError
from redundant_planner.core.horizon.preview import TwistAhead
from redundant_planner.core.parameters import METHODS, PlannerParameters, ros_name
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.jerk import SmoothStop
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.io.parameter_files import read_parameter_file, settings_of
from redundant_planner.io.payload import Payload
from redundant_planner.io.printable import printable
from redundant_planner.io.recorded_configuration import recorded_obstacles, recorded_walls
from redundant_planner.io.recorded_inputs import as_it_is
from redundant_planner.io.recorded_tick import RecordedTick, TickKind
from redundant_planner.io.software_version import with_version
from redundant_planner.paper.method import PaperPlanner, planner_of

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Replay:
    """The commands of a replay.

    Attributes:
        times: (k,) from the bag's first message [s].
        positions, velocities: (k, n).
        twists: (k, 6) commanded, in the command frame.
    """

    times: Array
    positions: Array
    velocities: Array
    twists: Array


def again(inputs: Inputs, parameters: PlannerParameters) -> Replay:
    """Compute the recorded ticks again from their own inputs, measurements included.

    With the recorded parameters this gives the recorded commands back.

    Raises:
        RecordingError: the ticks were not recorded from their beginning.
    """
    return _rows(inputs, parameters, inputs.ticks[_first_start(inputs):], measured=True)


def _first_start(inputs: Inputs) -> int:
    """Return the first tick whose past does not matter."""
    for i, (_, tick) in enumerate(inputs.ticks):
        if tick.kind == TickKind.STARTING:
            return i
    raise RecordingError('the bag has no start of a motion on ticks; record from before the '
                         'planner starts, or after a reset')


def otherwise(inputs: Inputs, parameters: PlannerParameters) -> Replay:
    """Run the planner and an ideal arm from the first joint state on, on the recorded commands."""
    ticks = inputs.ticks
    if not ticks:
        ticks = ticks_of_topics(inputs)
    return _rows(inputs, parameters, ticks, measured=False)


def _rows(
    inputs: Inputs, parameters: PlannerParameters, ticks: list[tuple[float, RecordedTick]], *,
    measured: bool,
) -> Replay:
    """Step through ticks, at measured postures or at those of an ideal arm.

    Raises:
        RecordingError: there are none.
    """
    robot = inputs.robot
    if not ticks:
        raise RecordingError('the bag is too short: no tick lies between its first joint state '
                             'and its last')
    planner = planner_of(robot, parameters)
    values = inputs.values
    book = ObstacleSources.of(
        len(inputs.obstacles),
        [*recorded_obstacles(values, inputs.notes), *recorded_walls(values, inputs.notes)], (),
        transform=as_it_is,
        estimate_velocity=values.get('estimate_obstacle_velocity') is True)
    payload = Payload(robot)
    dt = 1.0 / rate_of(values)
    q: Array = ticks[0][1].q
    dq: Array = np.zeros(robot.n)
    stop = SmoothStop(robot.acceleration_max, robot.jerk_max, dt)
    # Ticks that are made up start again after every pause, where the arm was then.
    made_up = not inputs.ticks
    held, applied = 0, [0] * len(inputs.obstacles)
    counts: list[int] = []
    count = len(ticks)
    positions, velocities = np.empty((count, robot.n)), np.empty((count, robot.n))
    previous = ticks[0][1].time
    chunk: Chunk | None = None  # the latest one
    for i, (_, tick) in enumerate(track(
            ticks, description='replaying', console=Console(stderr=True), transient=True,
            disable=not sys.stderr.isatty())):
        if measured:
            q = tick.q
        # What was taken in after the tick before, with that tick's time.
        for topic, (first, end) in enumerate(_read(inputs, counts, applied, tick)):
            for _, raw in inputs.obstacles[topic][first:end]:
                book.update(raw, previous, topic)
            applied[topic] = end
        counts = [number for number, _ in tick.checked_messages]
        for _, raw in inputs.attached[held:tick.attached_messages]:
            payload.tracker.update(raw, previous)
        held = max(held, tick.attached_messages)
        payload.tracker.expire(previous)
        _hold(payload, planner, book)
        if tick.kind == TickKind.BRAKING and measured:
            dq = stop.next()
            planner.braked(dq, dt)
        else:
            if tick.kind == TickKind.STARTING and (measured or made_up or i == 0):
                planner.reset()
                q = tick.q
            book.expire(tick.time)
            _couple(planner, tick)
            target = chunk if tick.goes_on else tick.target
            chunk = target if isinstance(target, Chunk) else chunk
            dq = planner.step(
                q, tick.twist, book.scene, dt, _ahead(inputs, tick), target,
                news=tick.news, gently=tick.kind == TickKind.TRYING).dq
            stop.moving(dq)
        positions[i], velocities[i] = q, dq
        q, previous = q + dt * dq, tick.time
    return Replay(np.array([time for time, _ in ticks]), positions, velocities,
                  np.array([tick.twist.ravel()[:6] for _, tick in ticks]).reshape(-1, 6))


def _couple(planner: Planner | PaperPlanner, tick: RecordedTick) -> None:
    """Do what the control loop does where several tips begin to hold something, or let go."""
    coupled = len(planner.robot.tips) > 1 and tick.twist.ndim == 1
    if not isinstance(planner, Planner) or coupled == (planner.coupling is not None):
        return
    if coupled:
        planner.couple(q=tick.q)
    else:
        planner.uncouple()


def _read(
    inputs: Inputs, counts: list[int], applied: list[int], tick: RecordedTick,
) -> list[tuple[int, int]]:
    """Return which of the recorded messages with obstacles a tick has heard since the one before.

    The latest one is known by its checksum, and how many there were by their counts: the planner
    may have missed some, and the recorder others.

    Args:
        inputs: of the bag.
        counts: of the tick before; none before the first.
        applied: up to which message of each topic the tick before had heard.
        tick: which.

    Returns:
        First message and the end, of each topic.
    """
    checked = tick.checked_messages[:len(applied)]
    unchecked = len(applied) - len(checked)  # the first topic, in earlier bags
    read = [(place, max(place, tick.obstacle_messages)) for place in applied[:unchecked]]
    for i, (count, check) in enumerate(checked):
        place, listed = applied[unchecked + i], inputs.obstacles[unchecked + i]
        before = counts[i] if i < len(counts) else 0
        heard = count - before if count >= before else count  # fewer: another planner began
        # A message that was not recorded changes nothing.
        end = next((end for end in range(place + 1, len(listed) + 1)
                    if checksum_at(listed, end) == check), place) if heard else place
        read.append((max(place, end - heard), end))
    return read


def _hold(payload: Payload, planner: Planner | PaperPlanner, book: ObstacleSources) -> None:
    """Do what the control loop does with what is attached."""
    things = payload.changed()
    if things is None:
        return
    try:
        planner.hold(things)
    except ObstacleError:
        return
    book.hidden = payload.names


def _ahead(inputs: Inputs, tick: RecordedTick) -> TwistAhead | None:
    if np.isnan(tick.preview_elapsed) or not 0 < tick.preview_messages <= len(inputs.previews):
        return None
    preview, elapsed = inputs.previews[tick.preview_messages - 1][2], tick.preview_elapsed
    if elapsed > preview.times[-1]:
        return None
    return preview.ahead(elapsed)


def write_replay(path: Path, inputs: Inputs, replay: Replay, origin_ns: int, text: str) -> None:
    """Write a bag of a replay: its joint states and commands, and the recorded inputs.

    Raises:
        RecordingError: there is something of that name.
    """
    robot = inputs.robot

    def ns(time: float) -> int:
        return origin_ns + round(time * 1e9)

    kinds = {'joint_states': 'sensor_msgs/msg/JointState',
             'joint_command': 'sensor_msgs/msg/JointState',
             'cmd_vel': 'geometry_msgs/msg/Twist',
             'configuration': 'std_msgs/msg/String',
             'robot_description': 'std_msgs/msg/String',
             'attached': 'visualization_msgs/msg/MarkerArray',
             'target_pose': 'geometry_msgs/msg/PoseStamped',
             'target_joints': 'sensor_msgs/msg/JointState',
             'target_path': 'nav_msgs/msg/Path',
             'target_trajectory': 'trajectory_msgs/msg/JointTrajectory',
             **dict.fromkeys(inputs.topics, 'visualization_msgs/msg/MarkerArray')}
    with BagWriter(path) as bag:
        for topic, kind in kinds.items():
            bag.add_topic(f'/{topic}', kind)
        bag.write_text('/configuration', ns(replay.times[0]), text)
        events = deque(sorted(
            ((time, topic, raw) for topic, time, raw in inputs.raw), key=lambda event: event[0]))
        for i, time in enumerate(replay.times):
            while events and events[0][0] <= time:
                at, topic, raw = events.popleft()
                bag.write(f'/{topic}', ns(at), raw)
            if i == 0 or not np.array_equal(replay.twists[i], replay.twists[i - 1]) or i % 10 == 0:
                bag.write_twist('/cmd_vel', ns(time), replay.twists[i])
            bag.write_joints('/joint_states', ns(time), robot.joint_names, replay.positions[i],
                             replay.velocities[i])
            bag.write_joints('/joint_command', ns(time), robot.joint_names,
                             replay.positions[i], replay.velocities[i])


def main(args: list[str] | None = None) -> int:
    """Run replay_bag; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='replay_bag', description=__doc__)
    parser.add_argument('bag', type=Path)
    parser.add_argument('--out', type=Path, help='folder of the new bag (default: BAG_replay)')
    parser.add_argument('--params', type=Path, help='parameter file that changes some')
    parser.add_argument('--method', choices=METHODS)
    parser.add_argument('--robot', type=Path, help='parameter file of the arm, if not recorded')
    parser.add_argument('--urdf', default='')
    parser.add_argument('--tip', default='')
    parser.add_argument('--namespace', default='')
    options = parser.parse_args(args)
    out = options.out or options.bag.parent / f'{options.bag.stem}_replay'
    try:
        if out.exists():
            raise PlannerError(f"'{out}' exists already; name a new folder with --out")
        with open_bag(options.bag, options.namespace) as bag:
            inputs = read_inputs(bag, options.robot, options.urdf, options.tip)
            origin_ns = bag.origin_ns
        recorded = settings_of(PlannerParameters, inputs.values)
        changed = recorded
        if options.params is not None:
            if not options.params.is_file():
                raise ParameterError(f"'{options.params}' is not a file")
            changed = settings_of(PlannerParameters, {
                **_as_in_files(recorded), **read_parameter_file(options.params)})
        if options.method:
            changed = replace(changed, method=options.method)
        exact = changed == recorded and bool(inputs.ticks)
        replay = again(inputs, changed) if exact else otherwise(inputs, changed)
        values = {**inputs.values, **_as_in_files(changed)}
        write_replay(out, inputs, replay, origin_ns,
                     with_version(
                         yaml.safe_dump({'/**': {'ros__parameters': values}}, sort_keys=False)))
        if exact:
            print(f'every tick again with the recorded parameters: {_difference(inputs, replay)}')
        else:
            print(f"'{changed.method}' from the first joint state on, with an ideal arm")
        for note in inputs.notes:
            print(f'note: {printable(note)}')
        print(f'bag: {out}')
    except (PlannerError, OSError) as error:
        print(f'replay_bag: {printable(str(error))}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('replay_bag: interrupted', file=sys.stderr)
        return 130
    return 0


def _as_in_files(parameters: PlannerParameters) -> dict[str, Any]:
    """Return parameters under the names that files give them, without tuples, as YAML likes it."""
    values = {ros_name(entry): getattr(parameters, entry.name) for entry in fields(parameters)}
    return {name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()}


def differences(inputs: Inputs, replay: Replay) -> Array:
    """Return how far each replayed command is from the recorded one, (k,); lost ones are left out.

    Where simulated time stood still, ticks have the same stamp; the last one's command counts.

    Args:
        inputs: of the bag.
        replay: from `again`.
    """
    ticks = inputs.ticks[_first_start(inputs):]
    replayed = {tick.stamp_ns: dq for (_, tick), dq in zip(ticks, replay.velocities)}
    apart = np.array([np.abs(inputs.commands[stamp] - dq).max()
                      for stamp, dq in replayed.items() if stamp in inputs.commands])
    return apart[np.isfinite(apart)]  # a command without velocities tells nothing


def _difference(inputs: Inputs, replay: Replay) -> str:
    found = differences(inputs, replay)
    if not len(found):
        return 'the bag has none of their commands'
    return (f'{len(found)} of {len(replay.velocities)} ticks have their command in the bag, '
            f'largest difference {found.max():.3g}')


if __name__ == '__main__':
    raise SystemExit(main())
