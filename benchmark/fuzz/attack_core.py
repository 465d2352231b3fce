"""Attacks on the mathematics: absurd scenes, commands, previews, postures and parameters."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmark.fuzz.tally import Tally
from benchmark.scenarios import make_robot
from redundant_planner.core.horizon.preview import Preview
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import METHODS, PATH_PRIORITIES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

_EXTREMES = np.array([0.0, 5e-324, 2e-162, 1e-30, 1e-9, 1.0, 1e3, 1e9, 1e150, 1e308, np.inf,
                      -np.inf, np.nan])
_TICKS = 40
_robots: dict[tuple[str, int], Robot] = {}


def _robot(random: np.random.Generator) -> Robot:
    key = (str(random.choice(['panda', 'paper'])), int(random.choice([3, 6])))
    if key not in _robots:
        _robots[key] = make_robot(*key)
    return _robots[key]


def _extreme(random: np.random.Generator, shape: Any, share: float) -> Array:
    """Return ordinary numbers with a share of extreme ones among them."""
    values = random.normal(size=shape) * 10.0 ** random.uniform(-3.0, 1.0)
    return np.where(random.random(shape) < share,
                    random.choice(_EXTREMES, shape) * random.choice([-1.0, 1.0], shape), values)


def _scene(random: np.random.Generator, share: float, around: Array) -> Scene:
    """Return a scene; obstacles that cannot be are left out by their own check."""
    found = []
    for i in range(int(random.choice([0, 1, 3, 30, 300], p=[0.1, 0.3, 0.3, 0.2, 0.1]))):
        turn = random.normal(size=4)
        center = around[random.integers(len(around))] + 0.3 * random.normal(size=3)
        try:
            found.append(Obstacle(
                f'o{i}', np.where(random.random(3) < share, _extreme(random, 3, 1.0), center),
                np.abs(_extreme(random, 3, share)) + 1e-300, turn / np.linalg.norm(turn),
                random.choice([0.0, 1.0]) * _extreme(random, 3, share)))
        except ValueError:
            continue
    return Scene.of(found)


def _preview(random: np.random.Generator, share: float) -> Preview:
    times = np.sort(np.abs(_extreme(random, int(random.integers(1, 6)), share)))
    return Preview(times, _extreme(random, (len(times), 6), share))


def _parameters(random: np.random.Generator) -> PlannerParameters:
    return PlannerParameters(
        method=str(random.choice(METHODS)), path_priority=str(random.choice(PATH_PRIORITIES)),
        horizon_nodes=int(random.choice([2, 12, 32], p=[0.2, 0.7, 0.1])),
        clearance_gain=float(10.0 ** random.uniform(-1.0, 3.0)),
        criteria_k_alpha=float(random.choice([0.0, 0.9, 10.0])),
        clearance_margin=float(random.choice([0.0, 0.01, 0.2])),
        limits_position_margin=float(random.choice([0.0, 0.01])),
        clearance_lead=float(random.choice([0.0, 0.1, 2.0])),
        clearance_influence_distance=float(random.choice([1e-3, 0.1, 1e6])),
        clearance_smoothing=float(random.choice([0.0, 0.5])),
        horizon_look_ahead=float(random.choice([0.0, 1.5, 10.0])))


def attack(random: np.random.Generator, folder: Path, tally: Tally) -> None:
    """Drive an arm for a while by inputs of which some are absurd."""
    robot = _robot(random)
    planner = Planner(robot, _parameters(random))
    low = np.where(np.isfinite(robot.position_min), robot.position_min, -np.pi)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, np.pi)
    q = low + random.uniform(0.02, 0.98, robot.n) * (high - low)
    previous, dt, share = np.zeros(robot.n), float(random.choice([0.001, 0.004, 0.05])), 0.05
    scene, twist, ahead = Scene.of(), np.zeros(6), None
    for _ in range(_TICKS):
        if random.random() < 0.3:
            arm = robot.kinematics(q)
            found = tally.attempt(partial(_scene, random, share, arm.segment_end))
            scene = scene if found is None else found
        if random.random() < 0.3:
            twist = _extreme(random, 6, share)
        if random.random() < 0.1:
            preview = tally.attempt(partial(_preview, random, share))
            ahead = None if preview is None else preview.between
        asked = q if random.random() > 0.02 else _extreme(random, robot.n, 0.3)
        step = dt if random.random() > 0.02 else float(random.choice(_EXTREMES))
        result = tally.attempt(partial(planner.step, asked, twist, scene, step, ahead))
        if result is None:
            continue
        if asked is not q or step != dt:
            tally.check_finite(result.dq)
            planner.reset()
            previous = np.zeros(robot.n)
            continue
        if not tally.check_finite(result.dq, result.scale):
            return
        change = np.abs(result.dq - previous)
        beyond = (np.abs(result.dq) > robot.velocity_max * (1.0 + 1e-9)) | (
            change > robot.acceleration_max * dt * (1.0 + 1e-6) + 1e-9)
        q, previous = q + dt * result.dq, result.dq
        beyond |= (q > robot.position_max + 1e-9) | (q < robot.position_min - 1e-9)
        tally.limit_violations += bool(beyond.any())
