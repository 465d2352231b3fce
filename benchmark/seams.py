"""Joints that turn without end, across the seam of a driver that wraps them, live.

    python -m benchmark.seams --minutes 5

planner_node drives a Kinova of example-robot-data. Its simulated driver says the three joints
without end within (−π, π], with 0.1 mrad of noise, and the arm stands with all three at ±π. It is
commanded by twists, joint targets, streams of poses and of joint positions, and to poses behind
an obstacle, in turn. record_bag records.

The bag has to show no restart, no limit exceeded, no word of an error, and the recorded commands
once more where its ticks are computed again (as replay_bag does). A crossing counts once a joint
is beyond the noise on the other side.
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
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.context import Context
from rich.console import Console
from rich.table import Table

from benchmark.example_arms import ROBOTS
from benchmark.seam_operator import HOME, Operator
from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.turns import TURN
from redundant_planner.io.bag_reader import Bag, Event, open_bag
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.io.recorded_tick import TickKind
from redundant_planner.nodes.child_processes import LiveError, Processes
from redundant_planner.nodes.runtime import keep_off_shared_memory
from redundant_planner.tools.replayed_ticks import again, differences
from redundant_planner.tools.show_robot import Arm, arm_of, described_by_urdf, parameter_file

Array = npt.NDArray[np.float64]

_URDF = ROBOTS / 'kinova_description' / 'robots' / 'kinova.urdf'
_TIP = 'j2s6s200_end_effector'
# Of the measurements [rad].
_NOISE = 1e-4
# Beyond the seam by as much it is crossed [rad].
_BEYOND = 20.0 * _NOISE
# Round-off in quotients of recorded numbers.
_ROUND_OFF = 1e-6
# How long processes may take to start, and the recorder to close the bag [s].
_START, _END = 300.0, 20.0


class Outcome(NamedTuple):
    """What a run came to.

    Attributes:
        seconds: of commands.
        crossings: of the seam, of each joint without end.
        segments: kind of command → how often.
        missed: kinds of command whose target was not reached in time.
        warnings: sentences in the log or in /diagnostics that are no good.
        restarts: of the planner where the arm moved.
        velocity, acceleration, jerk: largest share of a limit that a command took.
        step: largest change of a commanded position between two commands, as a share of what the
            velocity limit allows.
        beyond: how far a measured joint was beyond its range at most [rad].
        clearance: smallest distance of a link to the obstacle [m].
        ticks: of which the bag has the command.
        difference: of a replayed command from the recorded one at most [rad/s].
    """

    seconds: float
    crossings: dict[str, int]
    segments: dict[str, int]
    missed: list[str]
    warnings: list[str]
    restarts: int
    velocity: float
    acceleration: float
    jerk: float
    step: float
    beyond: float
    clearance: float
    ticks: int
    difference: float

    @property
    def problems(self) -> list[str]:
        """What went wrong, a sentence each."""
        limits = {'velocity': self.velocity, 'acceleration': self.acceleration,
                  'jerk': self.jerk, 'a step of a position': self.step}
        return [
            *(f'not reached in time: {kind}' for kind in self.missed), *self.warnings,
            *([f'{self.restarts} restarts in motion'] if self.restarts else []),
            *(f'{name} {share:.6f} of its limit' for name, share in limits.items()
              if share > 1.0 + _ROUND_OFF),
            *([f'{self.beyond:.4f} rad beyond a range'] if self.beyond > 10.0 * _NOISE else []),
            *([f'{-self.clearance:.4f} m into the obstacle'] if self.clearance < 0.0 else []),
            *([] if self.ticks and self.difference == 0.0 else [
                f'of {self.ticks} replayed ticks one is {self.difference:.3g} rad/s off'])]


def run(
    folder: Path, seconds: float, domain: int, kind: type[Processes] = Processes,
) -> Outcome:
    """Command the arm, record it, and judge the bag.

    Args:
        folder: for the bag and the parameter file.
        seconds: of commands.
        domain: ROS domain.
        kind: of processes that arm and planner are.

    Raises:
        LiveError: a process ended, or did not get ready.
    """
    arm = arm_of(described_by_urdf(str(_URDF), _TIP, '', lambda _: None), lambda _: None,
                 HOME.tolist())
    file, bag = folder / 'kinova.yaml', folder / 'bag'
    file.write_text(parameter_file(arm.parameters, arm.robot, arm.start, arm.sources))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    keep_off_shared_memory()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        with kind(domain) as processes:
            operator = Operator(context, arm.robot)
            recorder = subprocess.Popen(
                [sys.executable, '-m', 'redundant_planner.tools.record_bag', str(bag)],
                env=processes.environment, stdout=subprocess.DEVNULL)
            try:
                # It hears the planner's first tick.
                _wait(lambda: _hears(bag), processes, operator, 'record_bag')
                processes.start('planner_node', [file], {'publish_ticks': True})
                processes.start('fake_hardware_node', [file], {
                    'wrap_continuous': True, 'noise': _NOISE})
                _wait(lambda: operator.is_ready, processes, operator, 'the planner')
                began = time.monotonic()
                operator.command(began + seconds)
                lasted = time.monotonic() - began
                operator.spin(0.5)
                processes.check()
            finally:
                recorder.send_signal(signal.SIGINT)
                recorder.wait(_END)
            operator.close()
    finally:
        rclpy.try_shutdown(context=context)
    return judged(bag, arm, operator, lasted)


def _hears(bag: Path) -> bool:
    return bag.is_dir() and any(bag.iterdir())


def _wait(
    done: Callable[[], bool], processes: Processes, operator: Operator, what: str,
) -> None:
    deadline = time.monotonic() + _START
    while not done():
        processes.check()
        if time.monotonic() > deadline:
            raise LiveError(f'{what} did not get ready within {_START:g} s')
        operator.spin(0.1)


def judged(bag: Path, arm: Arm, operator: Operator, seconds: float) -> Outcome:
    """Return what a bag shows, and what its operator has heard.

    Args:
        bag: its folder.
        arm: that was driven.
        operator: who drove it.
        seconds: how long.
    """
    robot, analysis = arm.robot, analyse(bag)
    with open_bag(bag) as reader:
        inputs = read_inputs(reader, None, '', '')
        states = _rows(reader, 'joint_states', robot)[1]
        stamps, commanded = _rows(reader, 'joint_command', robot)
        errors = {status.message for event in reader.read(('diagnostics',))
                  if isinstance(event, Event) for status in event.message.status
                  if status.level and status.name.endswith(': planner')}
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    endless = np.isinf(robot.position_max)
    period = 1.0 / float(inputs.values['rate'])
    steps = np.abs(np.diff(np.where(endless, np.unwrap(commanded, axis=0), commanded), axis=0))
    # A busy machine sends a command late, and the next one in time.
    allowed = robot.velocity_max * (np.diff(stamps)[:, None] + period)
    peaks = analysis.commanded
    assert peaks is not None, 'the planner commanded'
    bad = [said for said in (*operator.said, *sorted(errors)) if any(word in said for word in (
        'jumped', 'does not follow', 'no usable', 'starts again', 'failed', 'forgotten'))]
    kinds = np.array([tick.kind for _, tick in inputs.ticks])
    moving = np.array([bool(np.any(inputs.commands.get(tick.stamp_ns, np.zeros(robot.n))))
                       for _, tick in inputs.ticks])
    return Outcome(
        seconds=seconds, segments=operator.segments, missed=operator.missed,
        crossings={robot.joint_names[j]: crossings(states[:, j])
                   for j in np.flatnonzero(endless)},
        warnings=list(dict.fromkeys(bad)),
        restarts=int((moving[:-1] & (kinds[1:] == TickKind.STARTING)).sum()),
        velocity=float((peaks.velocity / robot.velocity_max).max()),
        acceleration=float((peaks.acceleration / robot.acceleration_max).max()),
        jerk=float((peaks.jerk / robot.jerk_max).max()),
        step=float((steps / allowed).max()),
        beyond=float(np.maximum(robot.position_min - states, states - robot.position_max).max()),
        clearance=analysis.distance,
        ticks=len(found), difference=float(found.max(initial=0.0)))


def _rows(reader: Bag, topic: str, robot: Robot) -> tuple[Array, Array]:
    """Return stamps (k,) [s] and positions (k, n) [rad] of a topic, as they were sent."""
    chunks = [chunk for chunk in reader.read((topic,)) if isinstance(chunk, JointChunk)]
    return (np.concatenate([chunk.stamps for chunk in chunks]), np.vstack([
        chunk.positions[:, [chunk.names.index(name) for name in robot.joint_names]]
        for chunk in chunks]))


def crossings(q: Array) -> int:
    """Return how often wrapped positions (k,) cross ±π, noise left out [rad]."""
    off = np.unwrap(q) - np.pi  # from the seam, and every turn from it
    turn = np.floor(off / TURN)
    clear = np.abs(off - TURN * np.rint(off / TURN)) > _BEYOND
    return int(np.abs(np.diff(turn[clear])).sum())


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return 1 if something went wrong."""
    parser = argparse.ArgumentParser(prog='benchmark.seams', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--minutes', type=float, default=5.0)
    parser.add_argument('--out', type=Path, help='folder to keep the bag in')
    parser.add_argument('--json', type=Path, metavar='FILE')
    options = parser.parse_args(args)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        outcome = run(folder, 60.0 * options.minutes, 1 + os.getpid() % 100)
    table = Table('what', 'value', title='Kinova, wrapped', show_header=False)
    for name, value in outcome._asdict().items():
        table.add_row(name, ', '.join(f'{key}: {count}' for key, count in value.items())
                      if isinstance(value, dict) else f'{value:.6g}'
                      if isinstance(value, float) else str(value))
    console = Console()
    console.print(table)
    for problem in outcome.problems:
        console.print(problem, markup=False)
    if options.json is not None:
        options.json.write_text(json.dumps(outcome._asdict(), indent=1) + '\n')
    return 1 if outcome.problems else 0


if __name__ == '__main__':
    raise SystemExit(main())
