"""demo: one scenario over live topics, then a table in the terminal, a picture and a bag."""

from __future__ import annotations

import argparse
from pathlib import Path
import shutil
import signal
import sys
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from redundant_planner.analysis import metrics
from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.figures import motion_picture
from redundant_planner.analysis.report import write_report
from redundant_planner.analysis.smallest_clearance import SmallestClearance
from redundant_planner.core.errors import PlannerError, RobotError
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.bag_storage import RecordingError
from redundant_planner.io.recording import JointLog, read_recording, Recording
from redundant_planner.io.resources import panda_urdf, resolve
from redundant_planner.io.scenario import load_scenario, Scenario
from redundant_planner.nodes.physics_report import CONTACTS, TORQUE_JOINT, TORQUE_SHARE
from redundant_planner.physics import require_mujoco
from redundant_planner.tools.live_run import LiveRun, play

Array = npt.NDArray[np.float64]

DEFAULT_SCENARIO = 'package://redundant_planner/config/scenarios/paper.yaml'
# With --physics, and the robot file whose URDF may lie elsewhere.
PHYSICS_SCENARIO = 'package://redundant_planner/config/scenarios/panda_obstacles.yaml'
_PANDA = 'panda.yaml'
# How long before and after the commanded motion the arm is looked at [s].
_MARGIN = 0.2


class Summary(NamedTuple):
    """What a live run is judged by.

    Attributes:
        states: the measured motion.
        displacement: (n,) |end − start| of every joint [rad, m].
        path: (n,) Σ|Δq| of every joint, Eq. 10 [rad, m].
        clearance: where a link was nearest to an obstacle; None without any.
        distance: how near [m].
        path_error: largest distance of the tip from the commanded path [m].
        periods: of joint_command [s].
    """

    states: JointLog
    displacement: Array
    path: Array
    clearance: metrics.Clearance | None
    distance: float
    path_error: float
    periods: metrics.Periods


def summarise(robot: Robot, recording: Recording) -> Summary:
    """Measure the recorded motion.

    Raises:
        RecordingError: there is none.
    """
    moving = recording.twist_times[(recording.twists != 0.0).any(axis=1)]
    if not len(moving):
        raise RecordingError('nothing was commanded')
    begin, end = moving[0] - _MARGIN, moving[-1] + _MARGIN
    states = recording.states.select(robot.joint_names).between(begin, end)
    inside = (recording.twist_times >= moving[0]) & (recording.twist_times <= end)
    path = metrics.commanded_path(
        robot, states.positions[0], recording.twist_times[inside], recording.twists[inside])
    # The line goes on straight where the message clock and the planner's differ by a tick.
    overrun = path[-1] + (path[-1] - path[-2]) if len(path) > 1 else path[-1]
    tips = metrics.tip_positions(robot, states.positions)
    clearance = SmallestClearance(robot)
    clearance.of(states.positions, Scene.of(recording.obstacles), 0)
    return Summary(
        states=states,
        displacement=metrics.displacement(states.positions),
        path=metrics.joint_path(states.positions),
        clearance=clearance.smallest,
        distance=clearance.distance,
        path_error=float(metrics.distance_to_path(tips, np.vstack((path, overrun))).max()),
        periods=metrics.periods(recording.commands.between(begin, end).times))


def print_summary(
    console: Console, scenario: Scenario, robot: Robot, summary: Summary, run: LiveRun,
) -> None:
    """Print the tables of a run."""
    joints = Table(title=f"Scenario '{scenario.name}' on '{robot.name}', live")
    for heading in ('joint (rad, m)', 'start', 'end', 'displacement', 'path Σ|Δq|'):
        joints.add_column(heading, justify='left' if 'joint' in heading else 'right')
    for i, name in enumerate(robot.joint_names):
        joints.add_row(name, *(f'{value:.4f}' for value in (
            summary.states.positions[0, i], summary.states.positions[-1, i],
            summary.displacement[i], summary.path[i])))
    console.print(joints)

    motion = Table(show_header=False)
    clearance, periods = summary.clearance, summary.periods
    rows = {
        'smallest distance of a link to an obstacle': (
            f'{1e3 * summary.distance:.1f} mm ({clearance.link} to {clearance.obstacle})'
            if clearance else 'no obstacle'),
        'largest distance from the commanded path': f'{1e3 * summary.path_error:.3f} mm',
        'joint path, all joints': f'{summary.path.sum():.4f} rad + m',
        '∫ q̇ᵀq̇ dt': f'{metrics.effort(summary.states.velocities, summary.states.times):.5f}',
        'joint_command period': (
            f'median {1e3 * periods.median:.3f} ms, p99 {1e3 * periods.p99:.3f} ms, '
            f'longest {1e3 * periods.longest:.3f} ms'),
        'planner process': f'{100 * run.planner_cpu:.0f} % of one core',
    }
    if run.physics:
        rows['contacts'] = run.physics[CONTACTS]
        rows['largest torque asked for'] = (
            f'{float(run.physics[TORQUE_SHARE]):.0%} of its limit ({run.physics[TORQUE_JOINT]})')
    for name, value in rows.items():
        motion.add_row(name, value)
    console.print(motion)


def _panda_urdf(scenario: Scenario) -> str:
    """Return where a Panda's URDF is; empty for a scenario of another robot.

    Raises:
        RobotError: this machine has none.
    """
    if scenario.robot_file.name != _PANDA:
        return ''
    found = panda_urdf()
    if found is None:
        raise RobotError('no URDF of a Panda on this machine: pip install example-robot-data, or '
                         'give --urdf')
    return str(found)


def _physics_options(options: argparse.Namespace) -> list[str]:
    """Return the options that are passed on to mujoco_hardware_node."""
    viewer = ['--viewer'] if options.viewer else []
    return viewer + (['--record', str(options.record.resolve())] if options.record else [])


def main(args: list[str] | None = None) -> int:
    """Run the demo; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='demo', description=__doc__)
    parser.add_argument('--scenario', help=f'scenario file to play (default: {DEFAULT_SCENARIO}; '
                        f'with --physics {PHYSICS_SCENARIO})')
    parser.add_argument('--physics', action='store_true',
                        help='play it on an arm with mass, drives and contacts (MuJoCo)')
    parser.add_argument('--viewer', action='store_true',
                        help="with --physics: open MuJoCo's viewer")
    parser.add_argument('--record', type=Path, metavar='FILE',
                        help='with --physics: write a film, .gif or .mp4')
    parser.add_argument('--params', action='append', default=[], type=Path, metavar='FILE',
                        help='parameter file for the planner; may be given more than once')
    parser.add_argument('--urdf', help="URDF to use instead of the robot file's")
    parser.add_argument('--out', type=Path, default=Path('demo_output'),
                        help='folder for the bag and the picture (default: %(default)s)')
    options = parser.parse_args(args)
    if (options.viewer or options.record) and not options.physics:
        parser.error('--viewer and --record show the physics: give --physics as well')
    console = Console()
    # Ended politely, it cleans up as it does after Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        if options.physics:
            require_mujoco()
        path = resolve(options.scenario or (
            PHYSICS_SCENARIO if options.physics else DEFAULT_SCENARIO))
        scenario = load_scenario(path)
        urdf = options.urdf or (_panda_urdf(scenario) if options.physics else '')
        changes = {'urdf': urdf} if urdf else {}
        robot = scenario.load_robot(**changes)
        options.out.mkdir(parents=True, exist_ok=True)
        bag = options.out / scenario.name
        shutil.rmtree(bag, ignore_errors=True)
        console.print(f"playing '{scenario.name}' for {scenario.duration:g} s …")
        run = play(scenario, path, bag, planner_files=[p.resolve() for p in options.params],
                   planner_values=changes,
                   physics=_physics_options(options) if options.physics else None)
        recording = read_recording(bag)
        summary = summarise(robot, recording)
        print_summary(console, scenario, robot, summary, run)
        picture = options.out / f'{scenario.name}.png'
        states = summary.states
        motion_picture(picture, robot, states.times - states.times[0], states.positions,
                       states.velocities, recording.obstacles, f"'{scenario.name}', live")
        report = write_report(options.out / 'report', [analyse(bag)])
        console.print(f'picture: {picture}\nbag:     {bag}\nreport:  {report}')
    except (PlannerError, OSError) as error:
        print(f'demo: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('demo: interrupted', file=sys.stderr)
        return 130
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
