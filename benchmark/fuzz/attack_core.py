"""Attacks on the mathematics: absurd scenes, commands, targets, postures, ticks and parameters.

The arms are the Panda, the paper's and random ones. Some begin at speed, in a crowd, with their
links near each other. Several planners take turns in one process.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmark.fuzz.motion_judge import MotionJudge
from benchmark.fuzz.mutations import pick
from benchmark.fuzz.random_arms import random_arm
from benchmark.fuzz.tally import Tally
from benchmark.robots import make_robot
from redundant_planner.core.horizon.preview import Preview, TwistAhead
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PATH_PRIORITIES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.goal import Target

Array = npt.NDArray[np.float64]
Random = np.random.Generator

_EXTREMES = np.array([0.0, 5e-324, 2e-162, 1e-30, 1e-9, 1.0, 1e3, 1e9, 1e150, 1e308, np.inf,
                      -np.inf, np.nan])
# How many of the numbers of an input are extreme.
_SHARE = 0.05
# Of all planners of an attack together.
_TICKS = 48
# Of one tick, the longest that an arm which begins at speed must be able to stop after [s].
_LONGEST_TICK = 0.05

_VALUES: dict[str, tuple[Any, ...]] = {
    'method': METHODS, 'path_priority': PATH_PRIORITIES, 'horizon_nodes': (2, 12, 12, 12, 32),
    'clearance_gain': (0.1, 1.0, 5.0, 50.0, 1000.0), 'criteria_k_alpha': (0.0, 0.9, 10.0),
    'clearance_margin': (0.0, 0.01, 0.2), 'clearance_self_margin': (-1.0, 0.0, 0.005, 0.1),
    'limits_position_margin': (0.0, 0.01, 0.1), 'clearance_lead': (0.0, 0.1, 2.0),
    'clearance_influence_distance': (1e-3, 0.1, 1e6), 'clearance_smoothing': (0.0, 0.5),
    'clearance_evasion_horizon': (0.0, 2.0), 'horizon_look_ahead': (0.0, 1.5, 10.0),
    'cone_angle': (np.pi, 2.0, 0.3, 1e-3), 'cone_tip_axis': ((0.0, 0.0, 1.0), (1.0, 2.0, 0.0)),
    'cone_direction': ((0.0, 0.0, 1.0), (0.0, -1.0, 1e-3)), 'target_path': ('free', 'straight'),
    'target_gives_way': (False, True), 'singularity_margin': (0.0, 0.04, 0.2),
    'limits_linear_speed': (0.0, 1.0, 100.0), 'limits_angular_speed': (0.0, 2.0, 100.0),
    'feedback_gain': (0.0, 10.0, 100.0), 'slow_down': ((), ('o1=0.1:0.3',), ('o=0:1', 'o2=1:2'))}

# The latest planners stay in memory: what is written beyond an array may be theirs.
_kept: deque[Planner] = deque(maxlen=8)


def attack(random: Random, folder: Path, tally: Tally) -> None:
    """Drive arms by inputs of which some are absurd, and see what stood beside them."""
    count = int(random.choice([1, 2, 4], p=[0.6, 0.3, 0.1]))
    bystanders()  # before anything can go wrong
    drives = [drive for _ in range(count) if (drive := tally.attempt(
        partial(_Drive, random))) is not None]
    for _ in range(_TICKS // count):
        drives = [drive for drive in drives if drive.goes_on(random, tally)]
    tally.attempt(_see_bystanders)


class _Drive:
    """One arm in motion, its planner, and what it is told."""

    def __init__(self, random: Random) -> None:
        """Place an arm, at rest or at speed."""
        self.robot = robot = _robot(random)
        self.planner = Planner(robot, _parameters(random, robot, PlannerParameters(), 0.6))
        _kept.append(self.planner)
        low = np.where(np.isfinite(robot.position_min), robot.position_min, -np.pi)
        high = np.where(np.isfinite(robot.position_max), robot.position_max, np.pi)
        self.low, self.high = low, high
        q = low + random.uniform(0.02, 0.98, robot.n) * (high - low)
        self.judge = MotionJudge(robot, q)
        self.dt, self.jitter = float(random.choice([0.001, 0.004, 0.02, 0.05])), pick(
            random, (0.0, 0.2, 1.0))
        self.prepares, self.crowded = bool(random.random() < 0.5), bool(random.random() < 0.3)
        self.scene, self.twist = Scene.of(), np.zeros(6)
        self.ahead: TwistAhead | None = None
        self.target: Target | None = None
        if random.random() < 0.3:
            self.planner.hold(_things(random))
        if random.random() < 0.5:
            self._start(random)

    def _start(self, random: Random) -> None:
        """Let the arm be at a speed at which it can stop within its range, in proportion."""
        robot, q, planner = self.robot, self.judge.q, self.planner
        margin = planner.parameters.limits_position_margin
        velocity = random.uniform(-1.0, 1.0, robot.n) * robot.velocity_max
        room = np.maximum(np.where(
            velocity > 0.0, robot.position_max - q, q - robot.position_min) - margin, 0.0)
        stop = float((np.abs(velocity) / robot.acceleration_max).max())
        velocity *= min(1.0, float((room / (np.abs(velocity) * (
            0.5 * stop + _LONGEST_TICK))).min()))
        for _ in range(2):  # twice, so that the planner knows of no acceleration
            planner.braked(velocity, self.dt)
        self.judge.begin(velocity)

    def goes_on(self, random: Random, tally: Tally) -> bool:
        """Take a tick; return whether the next one can go on from it."""
        planner, judge = self.planner, self.judge
        self._change_inputs(random, tally)
        dt = float(np.clip(self.dt * np.exp(self.jitter * random.normal()), 5e-4, 0.05))
        chance = random.random()
        if chance < 0.02:
            planner.reset()
            judge.begin(np.zeros(self.robot.n))
        elif chance < 0.04:  # as hard as each joint may
            change = self.robot.acceleration_max * dt
            velocity = judge.velocity - np.clip(judge.velocity, -change, change)
            planner.braked(velocity, dt)
            return judge.carry_out(velocity, dt, tally, jerk_kept=False)
        q, step = judge.q, dt
        if random.random() < 0.02:
            q = _extreme(random, self.robot.n, 0.3)
        if random.random() < 0.02:
            step = float(random.choice(_EXTREMES))
        result = tally.attempt(partial(
            planner.step, q, self.twist, self.scene, step, self.ahead, self.target))
        if result is None:
            return True
        if not tally.check_finite(result.dq, result.scale):
            return False
        if self.prepares:
            tally.attempt(partial(planner.prepare, self.scene))
        if q is not judge.q or step != dt:
            planner.reset()
            judge.begin(np.zeros(self.robot.n))
            return True
        return judge.carry_out(result.dq, dt, tally, jerk_kept=result.jerk_kept)

    def _change_inputs(self, random: Random, tally: Tally) -> None:
        """Change the scene, the command, what is announced, the parameters or the load."""
        robot, planner = self.robot, self.planner
        if random.random() < 0.3:
            found = tally.attempt(lambda: _scene(random, self._around(), self.crowded))
            self.scene = self.scene if found is None else found
        if random.random() < 0.3:
            self.twist = _extreme(random, 6, _SHARE)
        if random.random() < 0.1:
            preview = tally.attempt(partial(_preview, random))
            self.ahead = None if preview is None else preview.between
        if random.random() < 0.05:
            self.target = tally.attempt(lambda: self._any_target(random))
        if random.random() < 0.05:
            def change() -> None:
                planner.parameters = _parameters(random, robot, planner.parameters, 0.15)

            tally.attempt(change)
        if random.random() < 0.02:
            tally.attempt(lambda: planner.hold(_things(random)))

    def _around(self) -> Array:
        """Return points (k, 3) of the links [m]."""
        arm = self.robot.kinematics(self.judge.q)
        return np.vstack((arm.segment_start, arm.segment_end, arm.tip_position))

    def _any_target(self, random: Random) -> Target | None:
        """Return a target that the arm reaches, a chunk, an absurd one, or none."""
        q = random.uniform(self.low, self.high)
        kind = random.integers(5)
        if kind == 0:
            return None
        if kind == 1:
            return q
        if kind == 2:
            arm = self.robot.kinematics(q)
            return Pose(arm.tip_position, arm.tip_rotation)
        if kind == 3:
            return self._any_chunk(random, q)
        if random.random() < 0.5:
            return np.where(random.random(len(q)) < 0.3, _extreme(random, len(q), 1.0), q)
        return Pose(_extreme(random, 3, 0.5), self.robot.kinematics(q).tip_rotation)

    def _any_chunk(self, random: Random, end: Array) -> Chunk:
        """Return a chunk towards a posture (n,), of the joints or the tip, of any pace."""
        count = int(random.integers(1, 30))
        times = np.cumsum(random.exponential(float(random.choice([1e-3, 0.03, 0.3])), count))
        share = np.sort(random.random(count))[:, None]
        points = self.judge.q + share * (end - self.judge.q)
        points = np.clip(points + random.normal(0.0, 0.02, points.shape),
                         self.robot.position_min, self.robot.position_max)
        late = float(random.choice([0.0, 0.1, -0.1, 10.0, -10.0]))
        if random.random() < 0.5:
            rates = random.normal(0.0, 1.0, points.shape) if random.random() < 0.3 else None
            return Chunk(times, points, rates, late)
        arms = [self.robot.kinematics(q) for q in points]
        return Chunk(times, [Pose(arm.tip_position, arm.tip_rotation) for arm in arms], late=late)


@cache
def _known_robot(name: str, axes: int) -> Robot:
    return make_robot(name, axes)


def _robot(random: Random) -> Robot:
    if random.random() < 0.4:
        return _known_robot(pick(random, ('panda', 'paper')), pick(random, (3, 6)))
    return random_arm(random)


def _parameters(
    random: Random, robot: Robot, now: PlannerParameters, share: float,
) -> PlannerParameters:
    """Return parameters of which a share is drawn anew."""
    link = robot.capsules[0].name if robot.capsules else 'nothing'
    values = {**_VALUES, 'allowed_contacts': ((), (f'{link}:o1', f'{link}:o2'))}
    return replace(now, **{name: pick(random, choices) for name, choices in values.items()
                           if random.random() < share})


def _extreme(random: Random, shape: Any, share: float) -> Array:
    """Return ordinary numbers with a share of extreme ones among them."""
    values = random.normal(size=shape) * 10.0 ** random.uniform(-3.0, 1.0)
    return np.where(random.random(shape) < share,
                    random.choice(_EXTREMES, shape) * random.choice([-1.0, 1.0], shape), values)


def _scene(random: Random, around: Array, crowded: bool) -> Scene:
    """Return a scene about some points; obstacles that cannot be are left out by their checks."""
    count = pick(random, (30, 100, 250) if crowded else (0, 1, 3, 3, 30))
    spread, size = pick(random, (0.05, 0.3)), pick(random, (0.02, 0.1))
    found = []
    for i in range(count):
        center = around[random.integers(len(around))] + spread * random.normal(size=3)
        extents = size * random.uniform(0.1, 1.0, 3)
        if random.random() < _SHARE:
            center, extents = _extreme(random, 3, 0.5), np.abs(_extreme(random, 3, 0.5)) + 1e-300
        turn = random.normal(size=4)
        place = {'orientation': turn / np.linalg.norm(turn)}
        if random.random() < 0.3:
            place |= {'velocity': _extreme(random, 3, _SHARE),
                      'angular_velocity': _extreme(random, 3, _SHARE)}
        try:
            found.append(_obstacle(random, f'o{i}', center, extents, place))
        except ValueError:
            continue
    return Scene.of(found)


def _obstacle(
    random: Random, name: str, center: Array, extents: Array, place: dict[str, Array],
) -> Obstacle:
    """Return an obstacle of any shape; half-spaces are rare, as nothing gets past one."""
    kind = random.integers(30)
    if kind == 0:
        return Obstacle.half_space(name, center, **place)
    if kind < 8:
        return Obstacle.box(name, center, extents, **place)
    if kind < 12:
        return Obstacle.cylinder(name, center, extents[0], extents[1], **place)
    if kind < 16:
        return Obstacle.capsule(name, center, extents[0], extents[1], **place)
    return Obstacle(name, center, extents, **place)


def _things(random: Random) -> list[Obstacle]:
    """Return things in the hand, some of which cannot be held; flat boxes take many capsules."""
    things = []
    for i in range(int(random.integers(0, 5))):
        center, extents = random.uniform(-0.2, 0.2, 3), random.uniform(0.01, 0.4, 3)
        if random.random() < _SHARE:
            center = _extreme(random, 3, 0.5)
        things.append(_obstacle(random, f't{i}', center, extents, {}))
    return things


def _preview(random: Random) -> Preview:
    times = np.sort(np.abs(_extreme(random, int(random.integers(1, 6)), _SHARE)))
    return Preview(times, _extreme(random, (len(times), 6), _SHARE))


@cache
def bystanders() -> tuple[tuple[Planner, bytes], ...]:
    """Return planners that nobody attacks, with what they answered before any attack."""
    robots = (_known_robot('panda', 6), _known_robot('paper', 3),
              random_arm(np.random.default_rng(0)))
    planners = [Planner(robot, PlannerParameters()) for robot in robots]
    return tuple((planner, _answers(planner)) for planner in planners)


def _answers(planner: Planner) -> bytes:
    """Return what a planner answers to the same inputs."""
    planner.reset()
    random, robot = np.random.default_rng(0), planner.robot
    q = 0.5 * np.clip(robot.position_max, -1.0, 1.0) + 0.5 * np.clip(robot.position_min, -1.0, 1.0)
    scene = _scene(random, robot.kinematics(q).segment_end, crowded=False)
    told = []
    for _ in range(5):
        result = planner.step(q, np.full(6, 0.1), scene, 0.004)
        q = q + 0.004 * result.dq
        told.append(result.dq)
    return np.array(told).tobytes()


def _see_bystanders() -> None:
    for planner, answers in bystanders():
        assert _answers(planner) == answers, (
            f"the planner of '{planner.robot.name}', which stood beside, answers otherwise now")
