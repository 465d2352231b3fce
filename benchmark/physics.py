"""Hard motions with live nodes on an arm with mass: `python -m benchmark.physics --help`.

Each scenario of `benchmark/generator.py` gets a planner_node and a mujoco_hardware_node, in a ROS
domain of its own, in lock-step by simulated time. Each period waits for its commands, so a busy
machine makes it slower; those that did not come are counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
import json
import os
from pathlib import Path
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from benchmark.generator import DURATION, generate, path_poses, Task
from benchmark.judge import Judge, limit_violation
from redundant_planner.analysis.metrics import distance_to_path
from redundant_planner.core.errors import PlannerError
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.resources import panda_urdf, share_directory
from redundant_planner.nodes import messages, physics_report
from redundant_planner.nodes.child_processes import LiveError, Processes
from redundant_planner.nodes.polled_subscription import PolledSubscription
from redundant_planner.nodes.runtime import keep_off_shared_memory
from redundant_planner.tools.reproduce_paper import find_panda

Array = npt.NDArray[np.float64]

RATE = 250
_ROBOT_FILE = share_directory() / 'config' / 'robots' / 'panda.yaml'
# Simulated time between the announcement and the motion, and after it [s].
_AHEAD, _AFTER = 0.2, 0.3
# The tip may be this far from its path, besides the lag of the drives [m].
TOLERANCE = 2e-3
# How long anything may take in real time [s].
_PATIENCE = 120.0
_PROFILE_STEP = 0.02
# Between two looks at what has come, in real time [s].
_PAUSE = 3e-4


@dataclass(frozen=True)
class Outcome:
    """One scenario.

    Attributes:
        seed: of the scenario.
        contacts: how often the arm began to touch an obstacle or itself.
        min_distance: the smallest distance of a capsule to an obstacle, by the judge [m].
        path_error: the largest distance of the tip from the commanded path [m].
        lag: the largest distance of the tip from where it was commanded to be at that time [m].
        delay: the drives' delay that explains it at the tip's speed, in the median [s].
        torque_share: the most torque that a joint was asked for, as a share of its limit.
        limit_violation: as `benchmark.judge.limit_violation`, of measured postures and commands.
        completed: whether the tip reached the end of the path, to 2 mm.
        missed: periods in which planner or operator did not answer in time.
        seconds: of the motion, in real time [s].
        whole: of the scenario, the start of its processes included, in real time [s].
    """

    seed: int
    contacts: int
    min_distance: float
    path_error: float
    lag: float
    delay: float
    torque_share: float
    limit_violation: float
    completed: bool
    missed: int
    seconds: float
    whole: float

    @property
    def good(self) -> bool:
        """Whether it is as promised, completed or not: no contact, on the path, within limits."""
        return (self.contacts == 0 and self.path_error <= TOLERANCE + self.lag
                and self.torque_share < 1.0 and self.limit_violation == 0.0)


class Operator:
    """Sends a scenario's obstacles and twists, and writes down what the nodes say."""

    def __init__(self, node: Node, robot: Robot, task: Task) -> None:
        """Connect to the nodes of one scenario."""
        self._robot, self._task = robot, task
        self.times: list[float] = []
        self.postures: list[Array] = []
        self.commands: dict[float, tuple[Array, Array]] = {}
        self.physics: dict[str, str] = {}
        self.planner: dict[str, str] = {}
        self.begin = np.inf
        self._twist = node.create_publisher(Twist, 'cmd_vel', 10)
        self._preview = node.create_publisher(MultiDOFJointTrajectory, 'cmd_vel_preview', 1)
        self._obstacles = node.create_publisher(MarkerArray, 'obstacles', 10)
        many = QoSProfile(depth=10_000)
        self._inboxes = [(PolledSubscription(node, kind, topic, many), kind, take)
                         for kind, topic, take in (
            (JointState, 'joint_states', self._on_state),
            (DiagnosticArray, '/diagnostics', self._on_diagnostics),
            (JointState, 'joint_command', self._on_command))]
        self._answered = -np.inf

    def run(self, processes: Processes) -> float:
        """Play the whole scenario; return the real time of its motion [s].

        Raises:
            LiveError: a process failed or something did not happen in time.
        """
        self._wait(lambda: bool(self.commands and self.physics)
                   and self.planner.get('last word') == 'ready', processes, 'joint_command')
        message = messages.markers_of(self._task.obstacles, self._robot.base_frame)
        known = str(len(self._task.obstacles))
        last = -np.inf

        def seen() -> bool:
            nonlocal last
            if time.monotonic() > last + 0.5:
                last = time.monotonic()
                self._obstacles.publish(message)
            return self.physics['obstacles'] == self.planner.get('obstacles') == known

        self._wait(seen, processes, 'obstacles')
        self.begin = self.times[-1] + _AHEAD
        times = np.linspace(0.0, DURATION, round(DURATION / _PROFILE_STEP) + 1)
        preview = messages.preview_to_message(Preview(times, self._task.twist_at(times)))
        preview.header.stamp.sec, preview.header.stamp.nanosec = divmod(
            round(self.begin * messages.NANOSECONDS), messages.NANOSECONDS)
        self._preview.publish(preview)
        began = time.monotonic()
        self._wait(lambda: self.times[-1] > self.begin + DURATION + _AFTER, processes,
                   'the end of the motion')
        seconds = time.monotonic() - began
        steps = int(self.physics['steps'])
        self._wait(lambda: int(self.physics['steps']) > steps + 1000 // 4, processes,
                   'a last report')
        return seconds

    def _wait(self, done: Callable[[], bool], processes: Processes, what: str) -> None:
        deadline = time.monotonic() + _PATIENCE
        while not done():
            self._look()
            processes.check()
            time.sleep(_PAUSE)
            if time.monotonic() > deadline:
                raise LiveError(f'waited {_PATIENCE:g} s in vain for {what}')

    def _look(self) -> None:
        """Take all messages that have come, and send the twist of the next tick."""
        for inbox, kind, take in self._inboxes:
            for raw in inbox.fetch():
                take(deserialize_message(raw, kind))
        if self.commands and (latest := next(reversed(self.commands))) > self._answered:
            # The planner has done this tick: the twist is for its next one.
            self._answered = latest
            elapsed = latest + 1.0 / RATE - self.begin
            self._twist.publish(messages.twist_to_message(
                self._task.twist_at(elapsed) if 0.0 <= elapsed <= DURATION else np.zeros(6)))

    def _on_state(self, message: JointState) -> None:
        now = messages.seconds_of(message.header.stamp)
        self.times.append(now)
        self.postures.append(messages.values_of(
            message.name, message.position, self._robot.joint_names, 'position'))

    def _on_command(self, message: JointState) -> None:
        names = self._robot.joint_names
        self.commands[round(messages.seconds_of(message.header.stamp), 6)] = (
            messages.values_of(message.name, message.position, names, 'position'),
            messages.values_of(message.name, message.velocity, names, 'velocity'))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.physics = physics_report.read_state(message) or self.physics
        for status in message.status:
            if status.name.endswith(': planner'):
                self.planner = {value.key: value.value for value in status.values}


def run(robot: Robot, task: Task, domain_id: int, values: dict[str, object],
        physics: dict[str, object]) -> Outcome:
    """Run one scenario with live nodes.

    Args:
        robot: the arm.
        task: the scenario.
        domain_id: ROS domain of its own.
        values: parameters of planner_node.
        physics: parameters of mujoco_hardware_node.

    Raises:
        LiveError: a process failed, or something did not happen in time.
    """
    began = time.monotonic()
    urdf = {'urdf': panda_urdf()}
    context = Context()
    rclpy.init(context=context, domain_id=domain_id)
    node = Node('operator', context=context, enable_rosout=False)
    try:
        operator = Operator(node, robot, task)
        with Processes(domain_id) as processes:
            processes.start('mujoco_hardware_node', [_ROBOT_FILE], {
                'clock': True, 'wait_for_cmd_vel': True, 'answer_timeout': 10.0,
                'rate': RATE, 'initial_joints': list(robot.joint_names),
                'initial_positions': task.start.tolist(), **urdf, **physics})
            processes.start('planner_node', [_ROBOT_FILE], {
                'use_sim_time': True, 'rate': RATE, **urdf, **values})
            seconds = operator.run(processes)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    return judged(robot, task, operator, seconds, time.monotonic() - began)


def judged(
    robot: Robot, task: Task, operator: Operator, seconds: float, whole: float,
) -> Outcome:
    """Return what a run came to."""
    times = np.round(operator.times, 6)
    inside = (times >= operator.begin - 1e-6) & (times <= operator.begin + DURATION + _AFTER)
    times, postures = times[inside], np.array(operator.postures)[inside]
    dt = 1.0 / RATE
    # A command holds from its stamp on: a period later the arm should be where it leads.
    wanted = [operator.commands.get(round(at - dt, 6)) for at in times]
    tips = np.array([robot.kinematics(q).tip_position for q in postures])
    behind = [float(np.linalg.norm(robot.kinematics(command[0]).tip_position - tip))
              for command, tip in zip(wanted, tips) if command is not None]
    speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / dt
    fast = [lag / speed for lag, speed in zip(behind, speeds) if speed > 0.03]
    velocities = np.array([command[1] for command in wanted[1:] if command is not None])
    followed = replace(task, start=postures[0])
    path = np.array([pose.position for pose in path_poses(robot, followed, dt)])
    errors = distance_to_path(tips, path[::10])
    verdict = Judge(robot).judge(followed, postures, np.diff(postures, axis=0) / dt, dt)
    physics = operator.physics
    return Outcome(
        task.seed, int(physics[physics_report.CONTACTS]), verdict.min_distance,
        float(errors.max()), max(behind), float(np.median(fast)) if fast else 0.0,
        float(physics[physics_report.TORQUE_SHARE]),
        limit_violation(robot, postures, velocities, dt),
        bool(np.linalg.norm(tips[-1] - path[-1]) < TOLERANCE), int(physics['answers missed']),
        seconds, whole)


def print_table(title: str, outcomes: list[Outcome]) -> None:
    """Print what all of them came to."""
    table = Table(title=title, show_header=False)
    steps = DURATION + _AHEAD + _AFTER
    for name, value in {
            'scenarios': f'{len(outcomes)}',
            'contacts': f'{sum(o.contacts for o in outcomes)}',
            'smallest distance to an obstacle':
                f'{1e3 * min(o.min_distance for o in outcomes):.1f} mm',
            'largest distance from the path':
                f'{1e3 * max(o.path_error for o in outcomes):.2f} mm',
            'largest lag': f'{1e3 * max(o.lag for o in outcomes):.2f} mm',
            'further than 2 mm + lag':
                f'{sum(o.path_error > TOLERANCE + o.lag for o in outcomes)}',
            'largest torque asked for':
                f'{max(o.torque_share for o in outcomes):.0%} of its limit',
            'limit violations': f'{sum(o.limit_violation > 0.0 for o in outcomes)}',
            'completed': f'{sum(o.completed for o in outcomes)}',
            'answers missed': f'{sum(o.missed for o in outcomes)}',
            'real-time factor, median': f'{np.median([steps / o.seconds for o in outcomes]):.1f}',
            'real time, all': f'{sum(o.whole for o in outcomes):.0f} s'}.items():
        table.add_row(name, value)
    Console(width=120).print(table)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=20)
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--mass-error', type=float, default=0.0,
                        help='how much heavier the arm is than the URDF says, as a share')
    parser.add_argument('--lag', type=float, default=0.0, help='dead time of the drives [s]')
    parser.add_argument('--method', default='dynamic_factor', help="planner_node's method")
    parser.add_argument('--domain', type=int, default=60, help='first of 20 ROS domains')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    keep_off_shared_memory()
    robot = find_panda(None)
    if robot is None:
        raise SystemExit('no Panda URDF: pip install example-robot-data')
    outcomes: list[Outcome] = []
    for number, seed in enumerate(range(options.seed, options.seed + options.count)):
        task = generate(robot, seed)
        try:
            outcome = run(robot, task, options.domain + number % 20, {'method': options.method},
                          {'mass_error': options.mass_error, 'lag': options.lag})
        except PlannerError as error:
            raise SystemExit(f'scenario {seed}: {error}') from None
        outcomes.append(outcome)
        print(f'{seed}: {"good" if outcome.good else "NOT GOOD"}'
              f'{"" if outcome.completed else ", not completed"}, {outcome}', flush=True)
        if options.json:
            options.json.write_text(json.dumps(
                {'options': {key: str(value) for key, value in vars(options).items()},
                 'outcomes': [asdict(o) for o in outcomes]}, indent=2) + '\n')
    print_table(f'Panda with mass error {options.mass_error:g}, {options.method}', outcomes)


if __name__ == '__main__':
    main()
