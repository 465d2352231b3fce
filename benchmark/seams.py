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

from geometry_msgs.msg import PoseStamped, Twist
import numpy as np
import numpy.typing as npt
from rcl_interfaces.msg import Log
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from benchmark.example_arms import ROBOTS
from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.robot.turns import TURN
from redundant_planner.io.bag_reader import Bag, Event, open_bag
from redundant_planner.io.joint_chunk import JointChunk
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.io.recorded_tick import TickKind
from redundant_planner.nodes.child_processes import LiveError, Processes
from redundant_planner.nodes.messages import markers_of, positions_from_message, twist_to_message
from redundant_planner.nodes.pose_messages import pose_to_message
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory
from redundant_planner.tools.replayed_ticks import again, differences
from redundant_planner.tools.show_robot import Arm, arm_of, described_by_urdf, parameter_file

Array = npt.NDArray[np.float64]

_URDF = ROBOTS / 'kinova_description' / 'robots' / 'kinova.urdf'
_TIP = 'j2s6s200_end_effector'
# Where it stands between motions, far from singularities, and of the first joint how far to the
# sides the poses behind the obstacle are [rad].
_HOME = np.array([np.pi, 2.892, 5.091, np.pi, 1.035, np.pi])
_SIDE = 0.5
# The obstacle's radius [m], half way between those poses.
_BALL = 0.05
# How often commands come [Hz], for how long each [s], and how far to and fro joints go [rad].
_RATE, _LASTS, _SWING = 50.0, 4.2, 0.25
# Of its velocity limit a joint turns with as much by twists; to and fro it turns for so long [s].
_SHARE, _TURNS_FOR = 0.95, 1.0
# Half a period of streams, which the slowest joint can follow [s].
_HALF = 1.4
# A target is reached if no joint, or the tip, is further from it [rad, m], and all are slower
# [rad/s]. It takes no longer than this [s].
_REACHED, _AT_REST, _PATIENCE = 5e-3, 2e-3, 20.0
_NOISE = 1e-4
# Level of a log's warnings.
_WARNING = 30
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


class _Operator:
    """Commands the arm in every way, and waits for what becomes of it."""

    def __init__(self, context: Context, robot: Robot) -> None:
        self.said: list[str] = []
        self.segments: dict[str, int] = {}
        self.missed: list[str] = []
        self._robot = robot
        self._endless = np.flatnonzero(np.isinf(robot.position_max)).tolist()
        self._sign = 1.0  # of the next turn
        self._q, self._dq, self._commands = np.full(robot.n, np.nan), np.zeros(robot.n), 0
        self._node = Node('operator', context=context, enable_rosout=False)
        self._executor = best_executor(context)
        self._executor.add_node(self._node)
        self._twist = self._node.create_publisher(Twist, 'cmd_vel', 10)
        self._joints = self._node.create_publisher(JointState, 'target_joints', 10)
        self._pose = self._node.create_publisher(PoseStamped, 'target_pose', 10)
        self._obstacles = self._node.create_publisher(MarkerArray, 'obstacles', 10)
        self._node.create_subscription(JointState, 'joint_states', self._on_states, 10)
        self._node.create_subscription(JointState, 'joint_command', self._on_command, 10)
        self._node.create_subscription(Log, '/rosout', self._on_log, 100)

    def _on_states(self, message: JointState) -> None:
        self._q = positions_from_message(message, self._robot.joint_names)

    def _on_command(self, message: JointState) -> None:
        self._dq, self._commands = np.array(message.velocity), self._commands + 1

    def _on_log(self, message: Log) -> None:
        if message.level >= _WARNING:
            self.said.append(message.msg)

    def spin(self, seconds: float = 0.01) -> None:
        """Listen for a while [s]."""
        until = time.monotonic() + seconds
        while (rest := until - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=rest)

    @property
    def is_ready(self) -> bool:
        """Whether the planner commands the arm, and hears all commands."""
        return bool(self._commands) and np.isfinite(self._q).all() and all(
            publisher.get_subscription_count() >= 2  # planner and recorder
            for publisher in (self._twist, self._joints, self._pose, self._obstacles))

    def command(self, until: float) -> None:
        """Command the arm in every way, in turn, until a time of the monotonic clock is over [s].

        The last round is finished.
        """
        kinds: dict[str, Callable[[], None]] = {
            'joint targets': self._to_joints, 'twists': self._turn,
            'a stream of poses': lambda: self._stream(self._send_pose),
            'a stream of joint positions': lambda: self._stream(self._send_joints),
            'free ways': self._around}
        self._reach('the first posture', _HOME)
        while time.monotonic() < until:
            for kind, do in kinds.items():
                do()
                self._reach(kind, _HOME)
                self.segments[kind] = self.segments.get(kind, 0) + 1

    def _send_joints(self, q: Array) -> None:
        self._joints.publish(JointState(name=self._robot.joint_names, position=q.tolist()))

    def _send_pose(self, q: Array) -> None:
        """Send the pose of the tip at a posture (n,)."""
        arm = self._robot.kinematics(q)
        self._pose.publish(pose_to_message(
            Pose(arm.tip_position, arm.tip_rotation), self._robot.base_frame))

    def _swung(self, by: float) -> Array:
        """Return the home posture (n,) with all joints without end turned [rad]."""
        q = _HOME.copy()
        q[self._endless] += by
        return q

    def _reach(self, kind: str, q: Array) -> None:
        """Go to joint positions (n,)."""
        self._send_joints(q)
        self._arrive(kind, lambda: float(np.abs(np.where(
            np.isinf(self._robot.position_max), 2.0 * np.sin(0.5 * (self._q - q)),
            self._q - q)).max()))

    def _arrive(self, kind: str, off: Callable[[], float]) -> None:
        """Wait until the arm is at rest where it is told to go, or for too long."""
        deadline = time.monotonic() + _PATIENCE
        while off() > _REACHED or np.abs(self._dq).max() > _AT_REST:
            if time.monotonic() > deadline:
                self.missed.append(kind)
                return
            self.spin()

    def _to_joints(self) -> None:
        for by in (_SWING, -_SWING, _SWING, -_SWING):
            self._reach('joint targets', self._swung(by))

    def _turn(self) -> None:
        """Turn joint by joint by twists: to and fro, the last one all around besides."""
        self._sign = -self._sign
        for joint in self._endless:
            for sign, share in ((1.0, 0.5), (-1.0, 1.0), (1.0, 0.5)):
                self._twist_of(joint, sign, share * _TURNS_FOR)
        last = self._endless[-1]
        self._twist_of(last, self._sign, TURN / (_SHARE * self._robot.velocity_max[last]))
        while np.abs(self._dq).max() > _AT_REST:
            self.spin()

    def _twist_of(self, joint: int, sign: float, seconds: float) -> None:
        """Send the twist that one joint alone makes, for a while [s]."""
        rate = sign * _SHARE * self._robot.velocity_max[joint]
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._twist.publish(twist_to_message(
                rate * self._robot.kinematics(self._q).jacobian[:, joint]))
            self.spin(1.0 / _RATE)

    def _stream(self, send: Callable[[Array], None]) -> None:
        """Send where the tip, or each joint, is along one motion to and fro."""
        begin = time.monotonic()
        while (elapsed := time.monotonic() - begin) < _LASTS:
            send(self._swung(_SWING * np.sin(np.pi * elapsed / _HALF)))
            self.spin(1.0 / _RATE)

    def _around(self) -> None:
        """Go from one side of an obstacle to the other and back."""
        sides = [_HOME + by * np.eye(len(_HOME))[0] for by in (_SIDE, -_SIDE)]
        self._reach('free ways', sides[0])
        ball = markers_of([Obstacle(
            'ball', self._robot.kinematics(_HOME).tip_position, np.full(3, _BALL))],
            self._robot.base_frame)
        self._obstacles.publish(ball)
        self.spin(0.2)
        for q in (sides[1], sides[0]):
            there = self._robot.kinematics(q).tip_position
            self._send_pose(q)
            self._arrive('free ways', lambda there=there: float(np.linalg.norm(
                self._robot.kinematics(self._q).tip_position - there)))
        for marker in ball.markers:
            marker.action = marker.DELETE
        self._obstacles.publish(ball)
        self.spin(0.2)

    def close(self) -> None:
        """Leave."""
        self._executor.shutdown()
        self._node.destroy_node()


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
                 _HOME.tolist())
    file, bag = folder / 'kinova.yaml', folder / 'bag'
    file.write_text(parameter_file(arm.parameters, arm.robot, arm.start, arm.sources))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    keep_off_shared_memory()
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        with kind(domain) as processes:
            operator = _Operator(context, arm.robot)
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
    done: Callable[[], bool], processes: Processes, operator: _Operator, what: str,
) -> None:
    deadline = time.monotonic() + _START
    while not done():
        processes.check()
        if time.monotonic() > deadline:
            raise LiveError(f'{what} did not get ready within {_START:g} s')
        operator.spin(0.1)


def judged(bag: Path, arm: Arm, operator: _Operator, seconds: float) -> Outcome:
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
