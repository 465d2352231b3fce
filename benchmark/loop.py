"""The live loop: period, latency and load of planner_node as a user runs it.

    python -m benchmark.loop --rate 1000 --obstacles 10

Planner and fake hardware run as processes of their own; this process plays the operator and the
camera. The period is that of joint_command's stamps, the latency the time from publishing a
cmd_vel, after standstill, to the stamp of the first joint_command that moves. With --targets the
operator sends poses to go to by a free way, whether or not the arm stands: the latency says
little then.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from pathlib import Path
import struct
import subprocess
import sys
import time

from geometry_msgs.msg import PoseStamped, Twist
import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rich.console import Console
from rich.progress import track
from rich.table import Table
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from benchmark.voxels import voxel_messages
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.resources import panda_urdf, share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.nodes.child_processes import cpu_seconds, Processes
from redundant_planner.nodes.messages import markers_of, twist_to_message
from redundant_planner.nodes.pose_messages import pose_to_message
from redundant_planner.nodes.runtime import best_executor, keep_off_shared_memory

Array = npt.NDArray[np.float64]

_CAMERA_RATE = 30.0
_OPERATOR_RATE = 50.0
# The operator moves and rests in turn, for as long each, and sends a target as often [s].
_TURN, _TARGET_PERIOD = 0.4, 3.0
# Targets lie so far to either side of the start posture: its first joint [rad].
_ASIDE = 1.0
_FRAMES = 60
_runs = itertools.count(os.getpid())
_STARTS = {
    'panda': np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]),
    'paper_2p5r': np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])}


def obstacle_messages(robot: Robot, start: Array, count: int, seed: int = 0) -> list[bytes]:
    """Return a second or two of serialised MarkerArrays: balls that sway around the arm.

    They keep off its start posture by 5 cm and sway by 3 cm, at up to 0.1 m/s.
    """
    random = np.random.default_rng(seed)
    arm = robot.kinematics(start)
    radii = [capsule.radius + 0.08 for capsule in robot.capsules]
    centers: list[Array] = []
    while len(centers) < count:
        ball = Obstacle('o', random.uniform((-1.2, -1.2, -0.3), (1.2, 1.2, 1.4)),
                        random.uniform(0.02, 0.05, 3))
        pairs = link_clearance(
            inflated_obstacles(Scene.of([ball]), radii), arm.segment_start, arm.segment_end)
        if pairs.normalized_distance.min() > 0.0:
            centers.append(ball.center)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    messages = []
    for i in range(_FRAMES):
        sway = 0.03 * np.sin(2.0 * np.pi * i / _FRAMES) * directions
        balls = [Obstacle('ball', c + s, np.full(3, 0.03)) for c, s in zip(centers, sway)]
        messages.append(bytes(serialize_message(markers_of(balls, robot.base_frame))))
    return messages


class Operator:
    """Sends twists and obstacles by the clock, and notes what comes back and when."""

    def __init__(
        self, context: Context, frames: list[bytes], twist: Array, targets: list[PoseStamped],
    ) -> None:
        """Prepare to send obstacle frames, and targets, or a twist (6,) to and fro without any."""
        self.node = Node('operator', context=context, enable_rosout=False)
        self.executor = best_executor(context)
        self.executor.add_node(self.node)
        self.stamps: list[float] = []
        self.latencies: list[float] = []
        self._frames = frames
        self._go = twist_to_message(twist), twist_to_message(-twist)
        self._rest = Twist()
        self._asked: float | None = None
        self._targets = itertools.cycle(targets) if targets else None
        self._target = self.node.create_publisher(PoseStamped, 'target_pose', 10)
        self._twist = self.node.create_publisher(Twist, 'cmd_vel', 10)
        self._obstacles = self.node.create_publisher(MarkerArray, 'obstacles', 10)
        self.node.create_subscription(
            JointState, 'joint_command', self._on_command, QoSProfile(depth=1000), raw=True)

    def _on_command(self, raw: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from('<iI', raw, 4)
        stamp = seconds + 1e-9 * nanoseconds
        self.stamps.append(stamp)
        if self._asked is not None and stamp > self._asked and np.any(
                deserialize_message(raw, JointState).velocity):
            self.latencies.append(stamp - self._asked)
            self._asked = None

    def wait(self, patience: float = 30.0) -> None:
        """Wait for the planner's first command."""
        deadline = time.monotonic() + patience
        while not self.stamps:
            if time.monotonic() > deadline:
                raise RuntimeError('the planner does not speak')
            self.executor.spin_once(timeout_sec=0.05)

    def drive(self, seconds: float) -> None:
        """Send for a while."""
        begin = time.monotonic()
        twists = frames = targets = 0
        moving = False
        while (elapsed := time.monotonic() - begin) < seconds:
            if self._targets is not None and elapsed >= targets * _TARGET_PERIOD:
                self._asked = time.time()
                self._target.publish(next(self._targets))
                targets += 1
            if self._targets is None and elapsed >= twists / _OPERATOR_RATE:
                turn = int(elapsed / _TURN)
                go = turn % 2 == 1
                if go and not moving:
                    self._asked = time.time()
                moving = go
                self._twist.publish(self._go[turn // 2 % 2] if go else self._rest)
                twists += 1
            if self._frames and elapsed >= frames / _CAMERA_RATE:
                self._obstacles.publish(self._frames[frames % len(self._frames)])
                frames += 1
            due = min(twists / _OPERATOR_RATE if self._targets is None else
                      targets * _TARGET_PERIOD,
                      frames / _CAMERA_RATE if self._frames else np.inf)
            self.executor.spin_once(timeout_sec=max(begin + due - time.monotonic(), 0.0))


def measure(
    *, robot: str, urdf: str, rate: int, obstacles: int, seconds: float, method: str, busy: bool,
    voxels: bool = False, targets: bool = False,
) -> dict[str, float]:
    """Run the loop once, the obstacles balls or voxels; keys as in the JSON."""
    file, start = share_directory() / 'config' / 'robots' / f'{robot}.yaml', _STARTS[robot]
    changes = {'urdf': urdf} if urdf else {}
    arm = load_robot(file, **changes)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    keep_off_shared_memory()
    # Another domain for every run: nodes of the last one may still be known on its own.
    context, domain = Context(), 60 + next(_runs) % 40
    rclpy.init(context=context, domain_id=domain)
    bare = bare_period_p99(rate)
    camera = voxel_messages if voxels else obstacle_messages
    frames = camera(arm, start, obstacles) if obstacles else []
    goals = [arm.kinematics(start + side * _ASIDE * np.eye(arm.n)[0]).tips.first
             for side in (1.0, -1.0)] if targets else []
    operator = Operator(
        context, frames, np.array([0.0, 0.05, 0.03, 0.0, 0.0, 0.0]),
        [pose_to_message(goal, arm.base_frame) for goal in goals])
    neighbour = subprocess.Popen([sys.executable, '-c', 'while True: pass']) if busy else None
    try:
        with Processes(domain) as processes:
            hardware = processes.start('fake_hardware_node', [file], {
                **changes, 'initial_joints': list(arm.joint_names),
                'initial_positions': start.tolist(), 'rate': rate})
            planner = processes.start('planner_node', [file], {
                **changes, 'rate': rate, 'method': method,
                'estimate_obstacle_velocity': not voxels})
            operator.wait()
            operator.drive(3.0)
            operator.stamps.clear()
            operator.latencies.clear()
            children = {'planner': planner, 'fake hardware': hardware}
            before = {name: cpu_seconds(child.pid) for name, child in children.items()}
            at_first = resident_kib(planner.pid)
            begin = time.monotonic()
            operator.drive(seconds)
            elapsed = time.monotonic() - begin
            load = {f'{name} cpu percent': 100.0 * (cpu_seconds(child.pid) - before[name])
                    / elapsed for name, child in children.items()}
            memory = resident_kib(planner.pid)
    finally:
        if neighbour is not None:
            neighbour.kill()
        operator.node.destroy_node()
        rclpy.shutdown(context=context)
    periods = np.diff(operator.stamps)
    latencies = np.array(operator.latencies)
    return {
        'rate': rate, 'obstacles': obstacles, 'busy': float(busy),
        'period median ms': 1e3 * float(np.median(periods)),
        'period p99 ms': 1e3 * float(np.percentile(periods, 99)),
        'period max ms': 1e3 * float(periods.max()), 'bare period p99 ms': bare,
        'latency median ms': 1e3 * float(np.median(latencies)),
        'latency p99 ms': 1e3 * float(np.percentile(latencies, 99)),
        **load, 'planner memory MiB': memory / 1024.0,
        'its growth MiB': (memory - at_first) / 1024.0}


def bare_period_p99(rate: int) -> float:
    """Return the 99th percentile of the periods of a process that only waits [ms]."""
    return float(subprocess.run(
        [sys.executable, '-m', 'benchmark.bare_loop', str(rate)], check=True,
        stdout=subprocess.PIPE, text=True).stdout)


def resident_kib(pid: int) -> float:
    """Return the resident memory of a process [KiB]."""
    for line in Path(f'/proc/{pid}/status').read_text().splitlines():
        if line.startswith('VmRSS:'):
            return float(line.split()[1])
    raise RuntimeError(f'process {pid} has no VmRSS')


def main(args: list[str] | None = None) -> int:
    """Run the benchmark; return the process's exit status."""
    parser = argparse.ArgumentParser(prog='benchmark.loop', description=__doc__)
    parser.add_argument('--robot', default='panda', choices=tuple(_STARTS))
    parser.add_argument('--urdf', default='',
                        help="URDF instead of the robot file's, or of the Panda found here")
    parser.add_argument('--rate', type=int, nargs='+', default=[250, 500, 1000], metavar='HZ')
    parser.add_argument('--obstacles', type=int, nargs='+', default=[10], metavar='COUNT')
    parser.add_argument('--voxels', action='store_true',
                        help='the obstacles are voxels at rest, in one CUBE_LIST')
    parser.add_argument('--targets', action='store_true',
                        help='the operator sends target_pose, not cmd_vel')
    parser.add_argument('--method', default='dynamic_factor')
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--busy', action='store_true',
                        help='also with a process that keeps one core busy')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args(args)
    urdf = options.urdf
    if options.robot == 'panda' and not urdf:
        urdf = str(panda_urdf() or '')
    runs = [(rate, count, busy) for rate in options.rate for count in options.obstacles
            for busy in ((False, True) if options.busy else (False,))]
    rows = [measure(robot=options.robot, urdf=urdf, rate=rate, obstacles=count,
                    seconds=options.seconds, method=options.method, busy=busy,
                    voxels=options.voxels, targets=options.targets)
            for rate, count, busy in track(runs, description='loops')]
    table = Table(title=f'{options.robot}, {options.method}, {options.seconds:g} s each')
    for name in rows[0]:
        table.add_column(name)
    for row in rows:
        table.add_row(*(f'{value:.4g}' for value in row.values()))
    Console(width=180).print(table)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
