"""replay_bag: what the planner would have done with other parameters, computed offline."""

from __future__ import annotations

import argparse
from collections import deque
from dataclasses import fields, replace
from pathlib import Path
import sys
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from redundant_planner.analysis.replay_inputs import Inputs, read_inputs
from redundant_planner.core.errors import ParameterError, PlannerError
from redundant_planner.core.parameters import METHODS, PlannerParameters, ros_name
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.bag_writer import BagWriter
from redundant_planner.io.parameter_files import read_parameter_file, settings_of
from redundant_planner.io.printable import printable
from redundant_planner.io.software_version import with_version
from redundant_planner.tools.replayed_ticks import again, differences, otherwise, Replay

Array = npt.NDArray[np.float64]


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


def _difference(inputs: Inputs, replay: Replay) -> str:
    found = differences(inputs, replay)
    if not len(found):
        return 'the bag has none of their commands'
    return (f'{len(found)} of {len(replay.velocities)} ticks have their command in the bag, '
            f'largest difference {found.max():.3g}')


if __name__ == '__main__':
    raise SystemExit(main())
