"""Does an arm come to rest under a constant twist? `python -m benchmark.smoothness --edges`.

Every arm of example-robot-data with six or seven joints, from random postures, is sent in each of
twelve directions until something stops it: a singularity, the end of its reach, a joint limit,
another link. What counts is the second half of the time, of the arms that have been stopped by
then: a tip that turns on about its own axis meets nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from multiprocessing import Pool
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.example_arms import arms, load_arm
from benchmark.judge import accelerations, limit_violation, reversals
from redundant_planner.core.constants import robot_constants
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

VARIANTS = {
    'dynamic_factor': PlannerParameters(),
    'variational': PlannerParameters(method='variational'),
    'slide': PlannerParameters(path_priority='slide'),
}
SECONDS = 12.0
# Speeds of the commanded twist, along and about an axis: most arms meet what stops them in the
# first half of the time [m/s], [rad/s].
_LINEAR, _ANGULAR = 0.25, 1.0
# Random postures lie so far from limits of joints that turn by no more than a turn, as a share of
# their range, and keep so much room between links beyond the margin [m].
_FROM_LIMITS, _ROOM = 0.05, 0.005
# Arms whose tip is slower than this share of the command, over so long before half-time, have been
# stopped [s].
_STOPPED, _BEFORE = 0.1, 1.0
# A tip that stays within this has got nowhere [m], [rad]; joints that travel further meanwhile are
# restless: a tip may move that much by round-off and a slow end, joints may follow [rad, m].
_NOWHERE, _NOWHERE_ANGLE, _TRAVEL = 1e-3, 5e-3, 0.05
# How many runs the table shows, the worst first.
_SHOWN = 12


class Case(NamedTuple):
    """One run.

    Attributes:
        urdf: of the arm.
        seed, number: of the posture.
        axis: which entry of the twist is commanded.
        way: 1 or −1, its sign.
        variant: a key of `VARIANTS`.
    """

    urdf: Path
    seed: int
    number: int
    axis: int
    way: int
    variant: str

    def __str__(self) -> str:
        """Name it."""
        sign = '+' if self.way > 0 else '-'
        return (f'{self.urdf.stem}, posture {self.number}, {sign}{AXES[self.axis]}, '
                f'{self.variant}')

    @property
    def twist(self) -> Array:
        """What is commanded, (6,) [m/s, rad/s]."""
        twist = np.zeros(6)
        twist[self.axis] = self.way * (_LINEAR if self.axis < 3 else _ANGULAR)
        return twist


@dataclass(frozen=True)
class Rest:
    """How a run ended.

    Attributes:
        stopped: whether the arm had been stopped by half-time.
        reversals: see `Verdict`, of the second half of the time.
        tip, tip_angle: how far the tip got from where it was at half-time, at most [m], [rad].
        travel: of the joint that travelled furthest in the second half [rad, m].
        violation: see `limit_violation`, of all of the time.
        clearance: smallest distance between links beyond their margin [m].
        reason: what the planner said in the end.
    """

    stopped: bool
    reversals: int
    tip: float
    tip_angle: float
    travel: float
    violation: float
    clearance: float
    reason: str

    @property
    def restless(self) -> bool:
        """Whether joints move while the tip goes nowhere."""
        return (self.tip < _NOWHERE and self.tip_angle < _NOWHERE_ANGLE
                and self.travel > _TRAVEL)


class Arm:
    """An arm that may run into itself.

    Attributes:
        robot: which.
    """

    def __init__(self, robot: Robot) -> None:
        """Prepare to measure its links, with the margin that is kept by default."""
        self.robot = robot
        self._constants = robot_constants(robot, PlannerParameters())

    def room(self, q: Array) -> float:
        """Return the smallest distance between links beyond their margin [m]."""
        arm, constants = self.robot.kinematics(q), self._constants
        return float(link_distances(arm.segment_start, arm.segment_end, constants.radii,
                                    constants.self_pairs).distance.min(initial=np.inf))


@cache
def arm_of(urdf: Path) -> Arm:
    """Return an arm, loaded once a process."""
    return Arm(load_arm(urdf))


def start_of(arm: Arm, seed: int, number: int) -> Array:
    """Return a random posture (n,) that has room on all sides."""
    robot = arm.robot
    random = np.random.default_rng([seed, number])
    low, high = np.maximum(robot.position_min, -np.pi), np.minimum(robot.position_max, np.pi)
    spare = _FROM_LIMITS * (high - low)
    while True:
        q = random.uniform(low + spare, high - spare)
        if arm.room(q) > _ROOM:
            return q


class Driven(NamedTuple):
    """A motion of k ticks.

    Attributes:
        postures: (k + 1, n) [rad, m].
        velocities: (k, n) [rad/s, m/s].
        reason: what the planner said in the end.
    """

    postures: Array
    velocities: Array
    reason: str


def driven(
    robot: Robot, parameters: PlannerParameters, start: Array, twist: Array, dt: float,
) -> Driven:
    """Command a twist (6,) for the whole time, from rest at a posture (n,)."""
    planner, scene, count = Planner(robot, parameters), Scene.of([]), round(SECONDS / dt)
    postures, velocities, reason = np.empty((count + 1, robot.n)), np.empty((count, robot.n)), ''
    postures[0] = start
    for i in range(count):
        result = planner.step(postures[i], twist, scene, dt)
        velocities[i], reason = result.dq, result.reason
        postures[i + 1] = postures[i] + dt * result.dq
    return Driven(postures, velocities, reason)


def rest_of(arm: Arm, motion: Driven, dt: float) -> Rest:
    """Return how a motion ended."""
    robot, half = arm.robot, len(motion.velocities) // 2
    then, *late = (robot.kinematics(q) for q in (
        motion.postures[half - round(_BEFORE / dt)], *motion.postures[half:]))
    way = np.linalg.norm(late[0].tip_position - then.tip_position)
    moved = way / _LINEAR + _turned(then, late[0]) / _ANGULAR
    tips = np.array([at.tip_position for at in late])
    room = np.array([arm.room(q) for q in motion.postures])
    return Rest(
        bool(moved < _STOPPED * _BEFORE),
        reversals(accelerations(motion.velocities, dt)[half:], robot.acceleration_max),
        float(np.linalg.norm(tips - tips[0], axis=1).max()),
        max(_turned(late[0], at) for at in late),
        float(np.abs(motion.velocities[half:]).sum(axis=0).max() * dt),
        limit_violation(robot, motion.postures, motion.velocities, dt),
        float(room.min()), motion.reason)


def _turned(one: Kinematics, other: Kinematics) -> float:
    """Return the angle between two orientations of the tip [rad]."""
    return float(np.linalg.norm(pin.log3(one.tip_rotation.T @ other.tip_rotation)))


def run(case: Case, dt: float) -> Rest:
    """Run a case."""
    arm = arm_of(case.urdf)
    start = start_of(arm, case.seed, case.number)
    motion = driven(arm.robot, VARIANTS[case.variant], start, case.twist, dt)
    return rest_of(arm, motion, dt)


def cases(count: int, seed: int, names: list[str], variants: list[str]) -> Iterator[Case]:
    """Yield the runs of some arms, all if none is named, from `count` postures each."""
    for urdf, _ in arms():
        if names and urdf.stem not in names:
            continue
        for number in range(count):
            for axis in range(len(AXES)):
                for way in (1, -1):
                    for variant in variants:
                        yield Case(urdf, seed, number, axis, way, variant)


def summarise(found: list[Rest]) -> dict[str, Any]:
    """Return the JSON entry of some runs; `stopped` are those stopped by half-time."""
    counts = [rest.reversals for rest in found]
    stopped = [rest.reversals for rest in found if rest.stopped] or [0]
    return {
        'runs': len(found),
        'reversals_p99': float(np.percentile(counts, 99)),
        'reversals_max': max(counts),
        'restless': sum(rest.restless for rest in found),
        'stopped': sum(rest.stopped for rest in found),
        'reversals_p99_stopped': float(np.percentile(stopped, 99)),
        'reversals_max_stopped': max(stopped),
        'violations': sum(rest.violation > 0.0 for rest in found),
        'closest_mm': 1e3 * min(rest.clearance for rest in found),
    }


def _job(job: tuple[Case, float]) -> tuple[Case, Rest]:
    return job[0], run(*job)


def edges(
    count: int, seed: int, *, names: list[str], variants: list[str], dt: float, jobs: int,
) -> tuple[dict[str, Any], list[tuple[Case, Rest]]]:
    """Run the cases; return what they came to, and each of them.

    Args:
        count, seed, names, variants: see `cases`.
        dt: period of the loop [s].
        jobs: processes.
    """
    todo = [(case, dt) for case in cases(count, seed, names, variants)]
    with Pool(jobs) as pool:
        found = list(track(pool.imap(_job, todo, chunksize=12), 'runs', total=len(todo),
                           console=Console(stderr=True)))
    return summarise([rest for _, rest in found]), found


def print_worst(found: list[tuple[Case, Rest]]) -> None:
    """Print the least restful runs."""
    table = Table(title='the least restful')
    for heading in ('run', 'reversals', 'tip [mm]', 'tip [mrad]', 'joint [rad]', 'reason'):
        table.add_column(heading)
    for case, rest in sorted(
            found, reverse=True,
            key=lambda f: (f[1].restless, f[1].reversals))[:_SHOWN]:
        table.add_row(str(case), str(rest.reversals), f'{1e3 * rest.tip:.2f}',
                      f'{1e3 * rest.tip_angle:.2f}', f'{rest.travel:.3f}', rest.reason)
    Console(width=160).print(table)
