"""identify_delay: how late an arm follows its commands, from a bag or from a small motion."""

from __future__ import annotations

import argparse
from dataclasses import asdict
import json
from pathlib import Path
import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from redundant_planner.analysis.drive_fit import drive_fit, DriveFit, Motion
from redundant_planner.core.errors import PlannerError, StateError
from redundant_planner.core.parameters import AXES
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.io.joint_chunks import ChosenJoints
from redundant_planner.io.printable import printable


def motion_of_bag(path: Path, namespace: str) -> tuple[Motion, tuple[str, ...]]:
    """Return the commands and joint states of a bag by their stamps, and the joints' names.

    Raises:
        PlannerError: it is no bag, or lacks one of the two.
    """
    with open_bag(path, namespace) as bag:
        for topic in ('joint_command', 'joint_states'):
            if not bag.topics.get(topic):
                raise StateError(f"'{path}' has no {topic}; it takes both joint_command and "
                                 'joint_states')
        chunks = [chunk for chunk in bag.read(('joint_states', 'joint_command'), order=())
                  if isinstance(chunk, JointChunk)]
        names = next((c.names for c in chunks if c.topic == 'joint_command'), ())
        rows = {}
        for topic in ('joint_command', 'joint_states'):
            joints = ChosenJoints(topic, names, bag.left_out)
            found = [chosen for chunk in chunks if chunk.topic == topic
                     and (chosen := joints.of(chunk)) is not None]
            waiting = joints.rest()
            found += [waiting] if waiting is not None else []
            if not found:
                joints.check_found()
                raise StateError(f"'{path}' has no {topic} that can be used")
            rows[topic] = (np.concatenate([c.stamps for c in found]),
                           np.concatenate([c.positions for c in found]),
                           np.concatenate([c.velocities for c in found]))
    times, _, commands = rows['joint_command']
    order = np.argsort(times, kind='stable')
    order = order[np.isfinite(commands[order]).all(axis=1)]
    return Motion(times[order], commands[order], *rows['joint_states'][:2]), names


def _late(time: float, error: float | None) -> str:
    """Return a time with its error [s] in ms; without an error it cannot be told from none."""
    return 'none' if error is None else f'{1e3 * time:.1f} ± {1e3 * error:.1f}'


def print_fit(console: Console, whole: DriveFit, joints: dict[str, DriveFit]) -> None:
    """Print a table, and what belongs into the planner's parameter file."""
    table = Table(title='How late the drives are')
    for heading in ('joint', 'lag [ms]', 'dead time [ms]', 'together [ms]', 'noise [mrad, mm]'):
        table.add_column(heading, justify='left' if heading == 'joint' else 'right')
    for name, fit in {**joints, 'all': whole}.items():
        table.add_row(
            printable(name), _late(fit.lag, fit.lag_error),
            _late(fit.dead_time, fit.dead_time_error),
            f'{1e3 * (fit.lag + fit.dead_time):.1f}', f'{1e3 * fit.noise:.3f}')
    console.print(table)
    if whole.lag_error is None and whole.dead_time_error is None:
        console.print('The motion shows no lag that can be told from none.\n')
    console.print('For the parameter file of planner_node:\n')
    console.print(f'    drive.lag: {whole.lag:.3f}\n    drive.dead_time: {whole.dead_time:.3f}')


def main(args: list[str] | None = None) -> int:
    """Run identify_delay; return the process's exit status."""
    parser = argparse.ArgumentParser(
        prog='identify_delay', description=__doc__,
        epilog='With --live ROS arguments (--ros-args -r __ns:=/left …) may follow.')
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument('bag', nargs='?', type=Path,
                        help='with joint_command and joint_states, their stamps of one clock')
    source.add_argument('--live', action='store_true',
                        help='move the tip of a running planner a little, to and fro')
    parser.add_argument('--namespace', default='', help='of the topics in the bag')
    parser.add_argument('--axis', choices=AXES, default='vz', help='of the motion')
    parser.add_argument('--distance', type=float, default=0.03, metavar='METRES',
                        help='how far, or rad about an axis (default: %(default)s)')
    parser.add_argument('--duration', type=float, default=4.0, metavar='SECONDS')
    parser.add_argument('--yes', action='store_true', help='move without asking first')
    parser.add_argument('--json', type=Path, metavar='FILE')
    given = sys.argv[1:] if args is None else args
    ros = given.index('--ros-args') if '--ros-args' in given else len(given)
    options = parser.parse_args(given[:ros])
    console = Console(markup=False, emoji=False)
    try:
        if options.live:
            from redundant_planner.tools.to_and_fro import ask_and_move
            motion, names = ask_and_move(
                options.axis, options.distance, options.duration, options.yes, given[ros:])
        else:
            motion, names = motion_of_bag(options.bag, options.namespace)
        whole, joints = drive_fit(motion, names)
        print_fit(console, whole, joints)
        if options.json is not None:
            options.json.write_text(json.dumps({
                'all': asdict(whole), 'joints': {n: asdict(f) for n, f in joints.items()}},
                indent=1) + '\n', encoding='utf-8')
    except (PlannerError, OSError) as error:
        print(f'identify_delay: {printable(str(error))}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('identify_delay: interrupted', file=sys.stderr)
        return 130
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
