"""Scenes to plan in, and the loop that a planner closes with an ideal arm."""

from __future__ import annotations

import numpy as np

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene

DT = 0.004
NOTHING = Scene.of()


def random_scene(robot, seed, count=3):
    random = np.random.default_rng(seed)
    obstacles = []
    for i in range(count):
        quaternion = random.normal(size=4)
        obstacles.append(Obstacle(
            f'o{i}', random.uniform(-0.6, 0.6, 3) + [0.0, 0.0, 0.4],
            random.uniform(0.03, 0.2, 3), quaternion / np.linalg.norm(quaternion),
            random.uniform(-0.3, 0.3, 3)))
    return obstacles


def random_obstacle(random, name='o', low=-0.6, high=0.6):
    """Return an obstacle of any shape that moves and turns, somewhere in a cube."""
    quaternion = random.normal(size=4)
    place = {'orientation': quaternion / np.linalg.norm(quaternion),
             'velocity': random.uniform(-0.3, 0.3, 3),
             'angular_velocity': random.uniform(-0.5, 0.5, 3)}
    center, half = random.uniform(low, high, 3), random.uniform(0.03, 0.2, 3)
    make = [lambda: Obstacle(name, center, half, **place),
            lambda: Obstacle.box(name, center, 2.0 * half, **place),
            lambda: Obstacle.cylinder(name, center, half[0], 2.0 * half[1], **place),
            lambda: Obstacle.capsule(name, center, half[0], half[1], **place)]
    return make[random.integers(len(make))]()


def mixed_scene(seed, count=3):
    """Return obstacles of all shapes around an arm."""
    random = np.random.default_rng(seed)
    return [random_obstacle(random, f'o{i}') for i in range(count)]


def drive(planner, q, twist, scene=NOTHING, seconds=1.0, dt=DT, ahead=None):
    """Integrate the closed loop; return the postures and results of every tick."""
    postures, results = [np.array(q, dtype=float)], []
    for i in range(round(seconds / dt)):
        now = twist(i * dt) if callable(twist) else twist
        results.append(planner.step(postures[-1], now, scene, dt, ahead))
        postures.append(postures[-1] + dt * results[-1].dq)
    return np.array(postures), results


def smallest_level(robot, postures, scene):
    maps = inflated_obstacles(scene, [c.radius for c in robot.capsules])
    levels = []
    for q in postures:
        arm = robot.kinematics(q)
        pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
        levels.append(pairs.normalized_distance.min())
    return min(levels)
