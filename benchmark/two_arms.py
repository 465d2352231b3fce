"""Two Pandas in each other's reach, each with targets of its own: `--help`.

They stand one metre apart and face each other. Both planners run with what real nodes tell each
other: `~/body` fifty times a second, nothing else. A pair of targets is two postures that are free
of each other; both tips end where the other arm reaches, too. What counts is that nothing is
touched and that both arrive.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
import json
from multiprocessing import Pool
from pathlib import Path
import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.judge import limit_violation
from benchmark.robots import make_robot
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import METHODS, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.progress import TargetState
from redundant_planner.io.obstacle_sources import ObstacleSources
from redundant_planner.nodes.body_writer import BodyWriter

Array = npt.NDArray[np.float64]

DT = 0.004
_LONGEST = 30.0  # [s]
# ~/body comes every that many ticks, and is a tick old when it is used.
_BODY_TICKS = 5
_APART = 1.0  # [m]
_READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
_CLEAR, _CLEAR_OF_ITSELF = 0.05, 0.03  # [m]
_LIMIT_DISTANCE, _LOWEST = 0.1, 0.1  # [rad], [m]
_SHARED, _SHOULDER = 0.75, np.array([0.0, 0.0, 0.333])  # of the other arm's shoulder [m]
_NAMES = ('left', 'right')
# Seeds of the pairs where crowded arms start are these further on.
_OTHER_SEEDS = 1_000_000


class Outcome(NamedTuple):
    """What a run came to.

    Attributes:
        seed: of the pair of targets.
        states: of both targets at the end.
        seconds: when each arm arrived for good [s].
        clearance: smallest distance between the arms, or of one to the other's base or itself [m].
        violation: see `limit_violation`.
        nearest: which links that were.
    """

    seed: int
    states: tuple[str, str]
    seconds: tuple[float, float]
    clearance: float
    violation: float
    nearest: str


def arms() -> tuple[Robot, Robot]:
    """Return both arms in the frame of their cell."""
    poses = ((0.0,) * 6, (_APART, 0.0, 0.0, 0.0, 0.0, np.pi))
    left, right = (make_robot('panda', 6, mount_frame='cell', mount_pose=pose) for pose in poses)
    return left, right


def base(side: int) -> Obstacle:
    """Return what stands still of an arm."""
    x = (-0.03, _APART + 0.03)[side]
    return Obstacle.box(f'base of {_NAMES[side]}', (x, 0.0, 0.075), (0.24, 0.2, 0.15))


def targets(robots: tuple[Robot, Robot], seed: int) -> tuple[Array, Array]:
    """Return a pair of postures (n,) that are free of each other."""
    random = np.random.default_rng(seed)
    shoulders = [np.array((_APART * side, 0.0, 0.0)) + _SHOULDER for side in (0, 1)]

    def posture(side: int) -> Array:
        robot = robots[side]
        radii = np.array([capsule.radius for capsule in robot.capsules])
        while True:
            q = random.uniform(robot.position_min + _LIMIT_DISTANCE,
                               robot.position_max - _LIMIT_DISTANCE)
            arm = robot.kinematics(q)
            apart = link_distances(arm.segment_start, arm.segment_end, radii, robot.self_pairs)
            if (apart.distance.min() > _CLEAR_OF_ITSELF and arm.tip_position[2] > _LOWEST
                    and np.linalg.norm(arm.tip_position - shoulders[1 - side]) < _SHARED):
                return np.asarray(q)

    while True:
        pair = posture(0), posture(1)
        motions = [Motion.through(capsules_of(robot), q[None]) for robot, q in zip(robots, pair)]
        if motions[0].to_other(motions[1]).distance > _CLEAR and all(
                motions[side].to_obstacles((base(1 - side),), DT).distance > _CLEAR
                for side in (0, 1)):
            return pair


class Together(NamedTuple):
    """How two planners moved their arms.

    Attributes:
        states: of both targets at the end.
        since: when each arm arrived for good [s].
        positions: of each arm, (k + 1, n) [rad, m].
        velocities: of each arm, (k, n) [rad/s, m/s].
        ticks: how long both planners took, of each tick [s].
    """

    states: tuple[TargetState, TargetState]
    since: tuple[float, float]
    positions: tuple[Array, Array]
    velocities: tuple[Array, Array]
    ticks: list[float]


def moved(
    robots: tuple[Robot, Robot], starts: tuple[Array, Array], poses: tuple[Pose, Pose],
    still: tuple[Sequence[Obstacle], Sequence[Obstacle]], parameters: PlannerParameters,
    longest: float = _LONGEST,
) -> Together:
    """Let each arm go to a pose with a planner of its own; they tell each other `~/body`.

    Args:
        robots: the arms, in one frame.
        starts, poses: of each (n,), and where it is to go.
        still: the obstacles at rest that each knows.
        parameters: of both; the second gives way.
        longest: after this time it ends [s].
    """
    # The order in which they give way is fixed.
    planners = [Planner(robot, replace(parameters, target_gives_way=side == 1))
                for side, robot in enumerate(robots)]
    books = [ObstacleSources.of(
        1, still[side], (robots[side].base_frame,), transform=None, estimate_velocity=False)
        for side in (0, 1)]
    writers = [BodyWriter(robot, name) for robot, name in zip(robots, _NAMES)]
    q, dq = list(starts), [np.zeros(robot.n) for robot in robots]
    positions: list[list[Array]] = [[posture] for posture in starts]
    velocities: list[list[Array]] = [[], []]
    since, ticks = [0.0, 0.0], []
    states = [TargetState.MOVING, TargetState.MOVING]
    for tick in range(round(longest / DT)):
        if tick % _BODY_TICKS == 0:
            told = [writers[side].message(round(1e9 * (1.0 + tick * DT)),
                                          robots[side].kinematics(q[side]), dq[side])
                    for side in (0, 1)]
        if tick % _BODY_TICKS == 1 or tick == 0:
            for side in (0, 1):
                refused = books[side].update(told[1 - side], tick * DT)
                assert not refused, refused
        begin = time.perf_counter()
        for side in (0, 1):
            result = planners[side].step(
                q[side], np.zeros(6), books[side].scene, DT, target=poses[side])
            dq[side] = result.dq
            assert result.progress is not None
            state = result.progress.state
            if state is not TargetState.REACHED:
                since[side] = (tick + 1) * DT
            states[side] = state
        ticks.append(time.perf_counter() - begin)
        for side in (0, 1):
            q[side] = q[side] + DT * dq[side]
            positions[side].append(q[side])
            velocities[side].append(dq[side])
        if states == [TargetState.REACHED] * 2 and tick * DT > max(since) + 0.5:
            break
    return Together(
        (states[0], states[1]), (since[0], since[1]),
        (np.array(positions[0]), np.array(positions[1])),
        (np.array(velocities[0]), np.array(velocities[1])), ticks)


def run(
    robots: tuple[Robot, Robot], seed: int, parameters: PlannerParameters, crowded: bool = False,
) -> Outcome:
    """Send both arms to a pair of targets, from their home or from another such pair."""
    goals = targets(robots, seed)
    starts = targets(robots, _OTHER_SEEDS + seed) if crowded else (_READY, _READY)
    poses = [robot.kinematics(q).tips.first for robot, q in zip(robots, goals)]
    found = moved(robots, starts, (poses[0], poses[1]), ((base(1),), (base(0),)), parameters)
    motions = [Motion.through(capsules_of(robot), path)
               for robot, path in zip(robots, found.positions)]
    nearest = min((motions[0].to_other(motions[1]), *(motion.to_itself() for motion in motions),
                   *(motions[side].to_obstacles((base(1 - side),), DT) for side in (0, 1))),
                  key=lambda approach: approach.distance)
    return Outcome(
        seed, (found.states[0].value, found.states[1].value), found.since, nearest.distance,
        max(limit_violation(robot, path, speeds, DT) for robot, path, speeds in zip(
            robots, found.positions, found.velocities)), str(nearest))


def _job(job: tuple[int, str, bool]) -> Outcome:
    seed, method, crowded = job
    return run(arms(), seed, PlannerParameters(method=method), crowded)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(prog='benchmark.two_arms', description=__doc__)
    parser.add_argument('--count', type=int, default=100)
    parser.add_argument('--seed', type=int, default=0, help='first seed')
    parser.add_argument('--method', choices=METHODS, default='dynamic_factor')
    parser.add_argument('--crowded', action='store_true',
                        help='they start at another pair of targets, not from their home')
    parser.add_argument('--jobs', type=int, default=2, help='processes')
    parser.add_argument('--json', type=Path, help='file for every outcome')
    options = parser.parse_args()
    with Pool(options.jobs) as pool:
        jobs = [(options.seed + i, options.method, options.crowded)
                for i in range(options.count)]
        found = list(track(pool.imap(_job, jobs), options.method, len(jobs),
                           console=Console(stderr=True)))
    reached = TargetState.REACHED.value
    table = Table(title=f'{options.count} pairs from seed {options.seed}, {options.method}')
    for heading in ('both arrive', 'one arrives', 'none', 'contacts', 'violations',
                    'nearest [mm]', 'seconds', '90 %'):
        table.add_column(heading)
    counts = [sum(state == reached for state in outcome.states) for outcome in found]
    seconds = [max(o.seconds) for o, count in zip(found, counts) if count == 2] or [np.nan]
    table.add_row(
        *(str(counts.count(number)) for number in (2, 1, 0)),
        str(sum(o.clearance < 0.0 for o in found)), str(sum(o.violation > 0.0 for o in found)),
        f'{1e3 * min(o.clearance for o in found):.1f}', f'{np.median(seconds):.1f}',
        f'{np.percentile(seconds, 90):.1f}')
    Console().print(table)
    if options.json is not None:
        options.json.write_text(json.dumps([o._asdict() for o in found]))


if __name__ == '__main__':
    main()
