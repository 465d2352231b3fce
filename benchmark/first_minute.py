"""The first minute: quick_start on every arm of example-robot-data with five to eight joints.

    python -m benchmark.first_minute
    python -m benchmark.first_minute --wrapped --parts

One arm after another, as a new user would: quick_start in an empty folder, no capsules fitted
before, and then a twist along each axis of the base, there and back. An arm moves if its tip
reaches 90 % of the commanded speed each time, and moves for the first time within a minute.
Machine code is kept from earlier starts.

The axes are those of position that quick_start's file commands: a planar arm has two of them. That
they are all that the arm can follow, `core/robot/possible_axes.py` sees to.

With `--wrapped` the arm says joints without end within (−π, π], and only arms with such joints are
tried. With `--parts` its joint states come from two publishers, each with half of the joints.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState

from benchmark.example_arms import arms
from benchmark.joint_states_in_halves import WHOLE
from redundant_planner.core.machine_code_cache import machine_code_folder
from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot import model
from redundant_planner.io.likely_tips import likely_tip
from redundant_planner.io.resources import read_text
from redundant_planner.io.robot_files import load_robot
from redundant_planner.nodes.messages import positions_from_message, twist_to_message
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory

Array = npt.NDArray[np.float64]

# What is commanded [m/s], how often [Hz], for how long, and how long the arm may speed up [s].
_SPEED, _RATE, _SECONDS, _SPEEDING_UP = 0.05, 50.0, 0.5, 0.3
# At least this share of the commanded speed counts as moving.
_SHARE = 0.9
# How long quick_start may take, which gives up after 300 s itself, its nodes to be found after
# that, and its end [s].
_PATIENCE, _FOUND, _END_PATIENCE = 400.0, 20.0, 20.0
# Within this the arm has to move [s].
_MINUTE = 60.0
# How many joints an arm has, and the axes that are tried: up first.
_JOINTS, _TRIED = range(5, 9), ('vz', 'vx', 'vy')
_DOMAIN = 61


class Minute(NamedTuple):
    """What became of one arm.

    Attributes:
        arm: its URDF's name.
        joints: of the chain.
        ready: seconds until quick_start says what to type next.
        moving: seconds until the tip has moved.
        axes: that were commanded.
        shares: of the commanded speed, there and back along each of them.
        ended: seconds from Ctrl-C to the end.
        status: exit status then.
        problem: what quick_start or its nodes said last where the arm does not move.
    """

    arm: str
    joints: int
    ready: float = np.nan
    moving: float = np.nan
    axes: tuple[str, ...] = ()
    shares: tuple[float, ...] = ()
    ended: float = np.nan
    status: int = 0
    problem: str = ''

    @property
    def moves(self) -> bool:
        """Whether the tip follows along each axis, and soon."""
        return bool(self.shares) and min(self.shares) >= _SHARE and self.moving < _MINUTE


class _Operator:
    """Commands twists, and sees where the tip goes."""

    def __init__(self, context: Context, topic: str) -> None:
        """Listen to the arm's own joint states on a topic."""
        self._node = Node('operator', context=context)
        self._executor = best_executor(context)
        self._executor.add_node(self._node)
        self._states: list[tuple[float, JointState]] = []
        self._node.create_subscription(
            JointState, topic,
            lambda message: self._states.append((time.monotonic(), message)), 10)
        self._twist = self._node.create_publisher(
            type(twist_to_message(np.zeros(6))), 'cmd_vel', 10)

    def drive(self, robot: model.Robot, axis: int, speed: float) -> tuple[float, float]:
        """Command a speed along an axis [m/s] for a while.

        Returns:
            When the tip had moved, and its speed after speeding up as a share of the command;
            NaN where arm and planner are not there.
        """
        deadline = time.monotonic() + _FOUND
        while not self._states or not self._twist.get_subscription_count():
            if time.monotonic() > deadline:
                return np.nan, np.nan
            self._executor.spin_once(timeout_sec=0.01)
        twist, until = np.zeros(6), time.monotonic() + _SPEEDING_UP + _SECONDS
        twist[axis] = speed
        self._states.clear()
        while time.monotonic() < until:
            self._twist.publish(twist_to_message(twist))
            due = time.monotonic() + 1.0 / _RATE
            while time.monotonic() < due:
                self._executor.spin_once(timeout_sec=0.002)
        times = np.array([at for at, _ in self._states])
        stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
                           for _, m in self._states])
        places = np.array([robot.kinematics(positions_from_message(
            m, robot.joint_names)).tip_position[axis] for _, m in self._states])
        moved = np.flatnonzero(np.abs(places - places[0]) > 1e-4)
        at = np.flatnonzero(stamps > stamps[0] + _SPEEDING_UP)[0]
        reached = (places[-1] - places[at]) / (stamps[-1] - stamps[at])
        return (float(times[moved[0]]) if len(moved) else np.nan), float(reached / speed)

    def rest(self) -> None:
        """Say nothing until the arm stands."""
        until = time.monotonic() + 0.7
        while time.monotonic() < until:
            self._executor.spin_once(timeout_sec=0.01)

    def close(self) -> None:
        """Leave: an executor that is not shut down keeps its context on the network.

        On the same domain the next planner would hear two senders of twists.
        """
        self._executor.shutdown()
        self._node.destroy_node()


def first_minute(
    urdf: Path, joints: int, domain: int, *, fresh: bool = True, wrapped: bool = False,
    parts: bool = False,
) -> Minute:
    """Run quick_start on an arm and move it.

    Args:
        urdf: the arm.
        joints: how many it has.
        domain: ROS domain.
        fresh: whether capsules are fitted anew.
        wrapped: whether joints without end are said within (−π, π].
        parts: whether joint states come from two publishers.
    """
    with tempfile.TemporaryDirectory() as folder:
        environment = dict(os.environ, ROS_DOMAIN_ID=str(domain))
        if fresh:
            code = machine_code_folder(os.environ.get('NUMBA_CACHE_DIR', ''), '')
            environment |= {'XDG_CACHE_HOME': str(Path(folder) / 'cache')} | (
                {} if code is None else {'NUMBA_CACHE_DIR': str(code.parent)})
        log = Path(folder) / 'log'
        begin = time.monotonic()
        with log.open('w') as output:
            process = subprocess.Popen(
                [sys.executable, '-m', 'benchmark.drivers', *(['--wrapped'] if wrapped else []),
                 *(['--parts'] if parts else []), str(urdf), '--out', folder],
                env=environment, stdout=output, stderr=subprocess.STDOUT)
        result = Minute(urdf.stem, joints)
        try:
            _wait(lambda: process.poll() is not None or 'Ready after' in log.read_text())
            if process.poll() is None:
                result = _moved(result._replace(ready=time.monotonic() - begin),
                                Path(folder) / f'{urdf.stem}.yaml', domain, begin,
                                WHOLE if parts else 'joint_states')
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            ending = time.monotonic()
            try:
                process.wait(_END_PATIENCE)
            finally:
                process.kill()
        return result._replace(
            ended=time.monotonic() - ending, status=process.returncode,
            problem=_said(log) if process.returncode or not result.moves else '')


def _said(log: Path) -> str:
    """Return what was said last in warning, or last of all."""
    lines = log.read_text().splitlines()
    warnings = [line for line in lines if '[WARN]' in line or '[ERROR]' in line]
    return '; '.join(warnings[-3:] or lines[-1:])


def _moved(result: Minute, file: Path, domain: int, begin: float, topic: str) -> Minute:
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        operator, robot, at, shares = _Operator(context, topic), load_robot(file), np.nan, []
        axes = tuple(axis for axis in _TRIED if axis in robot.axes)
        for axis in map(AXES.index, axes):
            # There and back.
            for speed in (_SPEED, -_SPEED):
                moved, share = operator.drive(robot, axis, speed)
                at = float(np.fmin(at, moved - begin))
                shares.append(share)
                operator.rest()
        operator.close()
    finally:
        rclpy.shutdown(context=context)
    return result._replace(moving=at, axes=axes, shares=tuple(shares))


def _turns_without_end(urdf: Path) -> bool:
    """Return whether a joint of an arm's likely chain has no limits."""
    text = read_text(urdf)
    robot = model.Robot(text, likely_tip(text), capsules=[], velocity_max=1.0)
    return bool(np.isinf(robot.position_max).any())


def _wait(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _PATIENCE
    while not done() and time.monotonic() < deadline:
        time.sleep(0.05)


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return 1 if an arm does not move."""
    parser = argparse.ArgumentParser(prog='benchmark.first_minute', description=__doc__)
    parser.add_argument('--arm', nargs='+', default=[], metavar='NAME',
                        help='only these, by the names of their URDFs')
    parser.add_argument('--wrapped', action='store_true',
                        help='arms with joints without end, which say them within (−π, π]')
    parser.add_argument('--parts', action='store_true',
                        help='joint states come from two publishers, half of the joints each')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args(args)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    keep_off_shared_memory()
    table = Table(title='quick_start, in an empty folder')
    for heading in ('arm', 'joints', 'ready [s]', 'moving [s]', 'speed along each axis',
                    'Ctrl-C [s]', 'moves'):
        table.add_column(heading)
    rows: list[dict[str, Any]] = []
    console = Console()
    for i, (urdf, joints) in enumerate(arms(_JOINTS)):
        if ((options.arm and urdf.stem not in options.arm)
                or (options.wrapped and not _turns_without_end(urdf))):
            continue
        found = first_minute(urdf, joints, _DOMAIN + i % 20, wrapped=options.wrapped,
                             parts=options.parts)
        rows.append({**found._asdict(), 'moves': found.moves})
        console.print(f'{found.arm}: {"moves" if found.moves else found.problem or "FAILS"}')
        table.add_row(found.arm, str(joints), f'{found.ready:.1f}', f'{found.moving:.1f}',
                      ', '.join(f'±{axis[1]} {share:.2f} {back:.2f}' for axis, share, back in zip(
                          found.axes, found.shares[::2], found.shares[1::2])),
                      f'{found.ended:.1f}',
                      'yes' if found.moves else found.problem or 'no')
    console.print(table)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1))
    return 0 if rows and all(row['moves'] for row in rows) else 1


if __name__ == '__main__':
    raise SystemExit(main())
