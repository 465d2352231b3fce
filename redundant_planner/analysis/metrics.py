"""Measures of a motion: pure functions on arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.clearance import link_clearance, pseudo_distance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose

Array = npt.NDArray[np.float64]

# A measure below this is round-off, of which nothing can be a share.
_NOTHING = 1e-9


def displacement(positions: Array) -> Array:
    """Return |q_end − q_start| of every joint, (n,): the paper's Table 1 against its start."""
    return np.abs(positions[-1] - positions[0])


def joint_path(positions: Array) -> Array:
    """Return Σ |q_c − q_t| of every joint over all samples, (n,): Eq. 10."""
    return np.abs(np.diff(positions, axis=0)).sum(axis=0)


def effort(velocities: Array, times: Array) -> float:
    """Return ∫ q̇ᵀq̇ dt of Eq. 11, each velocity held until the next sample.

    Args:
        velocities: (k, n) [rad/s, m/s].
        times: (k,) [s].
    """
    return float((np.square(velocities[:-1]).sum(axis=1) * np.diff(times)).sum())


def reduction(base: npt.ArrayLike, improved: npt.ArrayLike) -> Array:
    """Return by how much a measure became smaller [%], NaN where there was nothing."""
    base = np.asarray(base, dtype=float)
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where(np.abs(base) > _NOTHING,
                        100.0 * (base - np.asarray(improved, dtype=float)) / base, np.nan)


class Clearance(NamedTuple):
    """The smallest level value over a motion.

    Attributes:
        level: S of Eq. 6, negative inside an obstacle; infinite without obstacles.
        link, obstacle: where.
        sample: at which sample.
    """

    level: float
    link: str
    obstacle: str
    sample: int


def smallest_clearance(
    robot: Robot, positions: Array, obstacles: Sequence[Obstacle], *, points: str = 'links',
) -> Clearance:
    """Return the smallest S over all samples, without any margin.

    Args:
        robot: the arm.
        positions: (k, n) postures [rad, m].
        obstacles: the ellipsoids.
        points: 'links' for whole links with their radii, 'joints' for Eq. 7 to the letter.
    """
    scene = Scene.of(obstacles)
    best = Clearance(np.inf, '', '', 0)
    if not scene.names:
        return best
    if points == 'links':
        names = [c.name for c in robot.capsules]
        maps = inflated_obstacles(
            scene, [c.radius for c in robot.capsules], moved=robot.moved)
    else:
        names = [*robot.joint_names, robot.tip_frame]
        maps = inflated_obstacles(scene, np.zeros(robot.n + 1))
    for i, q in enumerate(positions):
        if points == 'links':
            arm = robot.kinematics(q)
            ends = arm.segment_start, arm.segment_end
        else:
            ends = (robot.joint_points(q),) * 2
        levels = pseudo_distance(link_clearance(maps, *ends).normalized_distance)
        link, obstacle = divmod(int(levels.argmin()), len(scene.names))
        if levels[link, obstacle] < best.level:
            best = Clearance(float(levels[link, obstacle]), names[link],
                             scene.names[obstacle], i)
    return best


def tip_positions(robot: Robot, positions: Array) -> Array:
    """Return the tip's path (k, 3) in the base frame [m]."""
    return np.array([robot.kinematics(q).tip_position for q in positions])


def commanded_path(robot: Robot, start: Array, times: Array, twists: Array) -> Array:
    """Return the positions (k, 3) that the twists, each held until the next, lead through.

    Args:
        robot: the arm.
        start: (n,) posture at the first twist.
        times: (k,) [s].
        twists: (k, 6) in the robot's command frame.
    """
    arm = robot.kinematics(start)
    pose = Pose(arm.tip_position, arm.tip_rotation)
    path = [pose.position]
    for dt, twist in zip(np.diff(times), twists):
        pose = integrate(pose, twist, float(dt), robot.in_tool)
        path.append(pose.position)
    return np.array(path)


def distance_to_path(points: Array, path: Array) -> Array:
    """Return the distance (p,) of each point to a polyline (k, 3) [m]."""
    start, along = path[:-1], np.diff(path, axis=0)
    moving = (along != 0.0).any(axis=1)
    if not moving.any():
        return np.linalg.norm(points - path[0], axis=1)
    start, along = start[moving], along[moving]
    squared = (along * along).sum(axis=1)
    distances = np.empty(len(points))
    for i, point in enumerate(points):
        t = np.clip(((point - start) * along).sum(axis=1) / squared, 0.0, 1.0)
        distances[i] = np.linalg.norm(start + t[:, None] * along - point, axis=1).min()
    return distances


class Periods(NamedTuple):
    """Time between consecutive messages [s]."""

    median: float
    p99: float
    longest: float


def periods(times: Array) -> Periods:
    """Return the statistics of the intervals between stamps (k,) [s]."""
    steps = np.diff(times)
    return Periods(float(np.median(steps)), float(np.percentile(steps, 99)),
                   float(steps.max()))
