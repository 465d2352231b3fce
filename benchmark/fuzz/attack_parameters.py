"""Parameters of any type and size: through the dataclasses, and onto a planner in motion.

Each attack sets random values on every dataclass as the nodes do, one by one and several at once,
through what stands behind `ros2 param set` as well; what is taken goes onto a planner that moves.
"""

from __future__ import annotations

import array
from dataclasses import fields
from functools import cache
import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.fuzz.tally import Tally
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters, ros_name, spec_of
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.obstacle_bounds import checked
from redundant_planner.io.obstacle_entries import obstacle_of
from redundant_planner.io.parameter_files import SETTINGS
from redundant_planner.io.resources import share_directory
from redundant_planner.io.robot_files import load_robot
from redundant_planner.nodes.ros_parameters import (
    CAPSULE,
    changed,
    changed_entries,
    STATIC_OBSTACLE,
)

Random = np.random.Generator

DT = 0.004
START = np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])
NUMBERS = (0, 1, -1, 2, 12, 200, 2**31, 2**63 - 1, -2**63, 2**63, 10**400, 0.0, -0.0, 0.5, 1e-6,
           1e-12, 1e-300, 5e-324, 1e6, 1e9, 1e154, 1e308, math.inf, -math.inf, math.nan)
TEXTS = ('', 'hello', 'variational', 'yield', '1.0', 'nan', 'a' * 100_000, 'ü\n\x1b', '\ud800',
         '%s{}', '../../etc')
NAMES = ('wall', 'my.wall', '.', '', 'a.b.c', 'center', 'ü')
SCENE = Scene.of([Obstacle('ball', np.array([0.0, 0.55, 0.45]), np.array([0.05, 0.03, 0.03]))])
TWIST = np.array([-0.029, -0.05, 0.004, 0.0, 0.0, 0.0])


@cache
def paper_arm() -> Robot:
    """Return the arm whose planner is attacked."""
    return load_robot(share_directory() / 'config' / 'robots' / 'paper_2p5r.yaml')


def attack(random: Random, folder: Path, tally: Tally) -> None:
    """Set parameters at random, then move with those that were taken."""
    for _ in range(30):
        settings = SETTINGS[int(random.integers(len(SETTINGS)))]
        names = [entry.name for entry in fields(settings)]
        changes = {str(random.choice(names)): any_value(random)
                   for _ in range(int(random.integers(1, 3)))}
        tally.attempt(lambda: changed([settings()], changes))  # noqa: B023
    for prefix, sizes in (('static_obstacle', STATIC_OBSTACLE), ('capsule', CAPSULE)):
        for _ in range(10):
            key = str(random.choice([*sizes, 'magic']))
            full = f'{prefix}.{random.choice(NAMES)}.{key}'
            value = any_value(random)
            entries = tally.attempt(
                lambda: changed_entries(prefix, sizes, {full: value}))  # noqa: B023
            if entries and prefix == 'static_obstacle':
                wall = {'center': [0.0] * 3, 'semi_axes': [0.1] * 3, key: value}
                tally.attempt(lambda: checked([obstacle_of('wall', wall)]))  # noqa: B023
    _move(random, tally)


def _move(random: Random, tally: Tally) -> None:
    """Change a planner's parameters while it moves, each of them within its range or not."""
    robot = paper_arm()
    planner, q, dq = Planner(robot, PlannerParameters()), START.copy(), np.zeros(robot.n)
    for _ in range(6):
        for _ in range(3):
            result = tally.attempt(lambda: planner.step(q, TWIST, SCENE, DT))  # noqa: B023
            if result is None or not tally.check_finite(result.dq):
                return
            fast = np.abs(result.dq) > robot.velocity_max * (1.0 + 1e-6)
            hard = np.abs(result.dq - dq) > (
                robot.acceleration_max * DT * (1.0 + 1e-6) + 1e-9)
            tally.limit_violations += bool(fast.any() or hard.any())
            dq = result.dq
            q = q + DT * dq
        changes = {}
        for entry in random.choice(fields(PlannerParameters),  # type: ignore[arg-type]
                                   int(random.integers(1, 6))):
            if spec_of(entry).runtime:
                changes[ros_name(entry)] = (
                    any_value(random) if random.random() < 0.1 else fitting_value(random, entry))

        def change(changes: dict[str, Any] = changes) -> None:
            planner.parameters = changed([planner.parameters], changes)[0]

        tally.attempt(change)


def fitting_value(random: Random, entry: Any) -> Any:
    """Return a value within a parameter's range, its ends and tiny numbers more often."""
    spec, default = spec_of(entry), entry.default
    if spec.choices:
        return str(random.choice(spec.choices))
    if isinstance(default, bool):
        return bool(random.integers(2))
    if isinstance(default, tuple):
        return ()
    high = min(spec.high, 1e12)
    value = random.choice([spec.low, spec.high, default, random.uniform(spec.low, high),
                           np.clip(10.0 ** random.uniform(-320.0, 10.0), spec.low, high)])
    return int(value) if isinstance(default, int) else float(value)


def any_value(random: Random) -> Any:
    """Return a value of any type that ROS parameters and YAML have."""
    kind = random.choice(['number', 'number', 'text', 'bool', 'none', 'list', 'texts', 'bytes',
                          'array', 'nested', 'dict', 'mixed'])
    count = int(random.choice([0, 1, 3, 4, 6, 7, 1000]))
    if kind == 'number':
        return NUMBERS[int(random.integers(len(NUMBERS)))]
    if kind == 'text':
        return TEXTS[int(random.integers(len(TEXTS)))]
    if kind in ('list', 'mixed'):
        pool = NUMBERS if kind == 'list' else (*NUMBERS, *TEXTS, None, True, [], {})
        return [pool[int(random.integers(len(pool)))] for _ in range(count)]
    return {
        'bool': bool(random.integers(2)), 'none': None, 'texts': ['vx'] * count,
        'bytes': random.bytes(count), 'array': array.array('d', random.normal(size=count)),
        'nested': [[1.0] * 3] * count, 'dict': {'a': count}}[str(kind)]
