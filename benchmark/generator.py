"""Seeded hard motions: a twist that an arm can follow, with obstacles in the way of its links.

Whether all of a random scene's obstacles can be passed at once is hard to tell. Here a way comes
first: postures that follow the whole twist well inside every limit, bent aside from the
least-norm motion. The obstacles then lie where the latter sweeps, but clear of the former. What
a method does not complete is then its own doing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.redundancy import null_space
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose, Poses, poses_error

Array = npt.NDArray[np.float64]

DURATION = 4.0
# Samples along the least-norm motion at which obstacles are placed and checked.
_SAMPLES = 81
# Of the tip's path, between two of these.
_STEPS = 10
# Clearance at the start, and around what the command alone determines [m].
_START_CLEARANCE = 0.04
_TIP_CLEARANCE = 0.03
# Distance from what would cut a motion off: joint limits [rad, m], and the singular value.
_LIMIT_DISTANCE = 0.05
_LEAST_SINGULAR_VALUE = 0.08
# What the way known to be free keeps from obstacles and between links [m], and the shares of the
# velocity and acceleration limits that it takes. It bends aside by that much [rad].
_WAY_CLEARANCE = 0.015
_WAY_SPEED, _WAY_ACCELERATION = 0.8, 0.7
_WAY_ASIDE = (0.4, 1.5)
# In how many tasks least-norm motion is made to run into an obstacle, and how deep [m].
_HIT_SHARE = 0.9
_HIT_DEPTH = 0.02
_FASTEST_OBSTACLE = 0.3
_SIZE = (0.04, 0.10)
_MOVING_SIZE = (0.04, 0.08)


@dataclass(frozen=True)
class Task:
    """One motion to follow.

    Attributes:
        seed: reproduces it.
        start: (n,) posture [rad, m].
        twist: (6 t,) peak twists of the tips; the commanded ones are their multiples sin²(πt/4 s),
            or zero.
        obstacles: at time 0, with their velocities.
        way: (k, n) postures, evenly over the time, of a motion that keeps clear of obstacles that
            stand still; None where none is known.
    """

    seed: int
    start: Array
    twist: Array
    obstacles: tuple[Obstacle, ...]
    way: Array | None = None

    def twist_at(self, time: float | Array) -> Array:
        """Return the commanded twists (6 t,), or (k, 6 t) at k times."""
        share = np.minimum(np.maximum(np.asarray(time) / DURATION, 0.0), 1.0)
        return np.sin(np.pi * share)[..., None] ** 2 * self.twist

    def obstacles_at(self, time: float) -> tuple[Obstacle, ...]:
        """Return the obstacles where they are at `time`."""
        return tuple(o.after(time) for o in self.obstacles)


def generate(
    robot: Robot, seed: int, *, moving: bool = False, impossible_too: bool = False,
) -> Task:
    """Return the task of a seed: deterministic, and hard for whoever looks only at the tip.

    Args:
        robot: the arm.
        seed: of the task.
        moving: whether obstacles move through the arm.
        impossible_too: whether no way needs to be known; so it is if they move.
    """
    random = np.random.default_rng([seed, moving])
    must_hit = random.uniform() < _HIT_SHARE
    while True:
        start = _random_start(robot, random)
        # A third of the moving tasks hold the arm still: what comes at it then must be evaded.
        resting = moving and random.uniform() < 1.0 / 3.0
        twist = (np.zeros(6 * len(robot.tips)) if resting else
                 _random_twist(robot, random))
        path = _least_norm_path(robot, start, twist)
        if path is None:
            continue
        if moving:
            obstacles, way = _moving_obstacles(robot, path, random), None
        else:
            way = None if impossible_too else _way(robot, Task(seed, start, twist, ()), random)
            if way is None and not impossible_too:
                continue
            obstacles = _static_obstacles(robot, path, way, must_hit, random)
        if obstacles is not None:
            return Task(seed, start, twist, obstacles, way)


def _random_start(robot: Robot, random: np.random.Generator) -> Array:
    low = np.where(np.isfinite(robot.position_min), robot.position_min, -np.pi)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, np.pi)
    return random.uniform(low + 0.15 * (high - low), high - 0.15 * (high - low))


def _random_twist(robot: Robot, random: np.random.Generator) -> Array:
    """Peak twists of motions over 0.1 to 0.3 m and, where it is controlled, up to 0.5 rad."""
    parts = []
    for _ in robot.tips:
        direction = random.normal(size=3)
        axis = random.normal(size=3)
        parts += [direction / np.linalg.norm(direction) * random.uniform(0.1, 0.3),
                  axis / np.linalg.norm(axis) * random.uniform(0.0, 0.5)]
    twist = robot.full_twist(robot.task_rows(np.concatenate(parts)))
    return twist * 2.0 / DURATION  # ∫ sin² = half the duration


def _least_norm_path(robot: Robot, start: Array, twist: Array) -> Array | None:
    """Return the least-norm postures (k, n), None where limits or a singularity cut them off."""
    if not _inside(robot, start):
        return None
    dt = DURATION / (_SAMPLES - 1)
    q, path = start, [start]
    for i in range(_SAMPLES - 1):
        parts = null_space.decompose(robot.kinematics(q).jacobian)
        if parts.singular_values[-1] < _LEAST_SINGULAR_VALUE:
            return None
        share = np.sin(np.pi * (i + 0.5) / (_SAMPLES - 1)) ** 2
        dq = null_space.least_norm(
            parts, 1.0 / parts.singular_values, robot.task_rows(twist * share))
        q = q + dt * dq
        if not _inside(robot, q):
            return None
        path.append(q)
    return np.array(path)


def _inside(robot: Robot, postures: Array) -> bool:
    return bool(((postures > robot.position_min + _LIMIT_DISTANCE)
                 & (postures < robot.position_max - _LIMIT_DISTANCE)).all())


def _way(robot: Robot, task: Task, random: np.random.Generator) -> Array | None:
    """Return the postures (k, n) of a motion bent aside, None where something cuts it off."""
    dt = DURATION / (_SAMPLES - 1)
    aside = random.normal(size=robot.n)
    distance, duration = random.uniform(*_WAY_ASIDE), random.uniform(0.4, 1.0) * DURATION
    q, way = task.start, [task.start]
    # Looked at before the way costs anything: it rules out a quarter of a TIAGo's postures.
    if _self_clearance(robot, q[None]) <= _WAY_CLEARANCE:
        return None
    poses = islice(_poses_of_tips(robot, task, dt / _STEPS), _STEPS, None, _STEPS)
    for i, pose in enumerate(poses):
        parts = null_space.decompose(robot.kinematics(q).jacobian)
        aside = null_space.project(parts, aside)
        aside /= np.linalg.norm(aside)
        share = np.sin(np.pi * min((i + 0.5) * dt / duration, 1.0)) ** 2
        q = q + 2.0 * distance / duration * share * dt * aside
        for _ in range(3):
            arm = robot.kinematics(q)
            parts = null_space.decompose(arm.jacobian)
            if parts.singular_values[-1] < _LEAST_SINGULAR_VALUE:
                return None
            error = poses_error(pose, arm.tips, robot.in_tool)
            q = q + null_space.least_norm(
                parts, 1.0 / parts.singular_values, robot.task_rows(error))
        if not _inside(robot, q):
            return None
        way.append(q)
    postures = np.array(way)
    at_rest = np.zeros((1, robot.n))
    speeds = np.diff(postures, axis=0) / dt
    accelerations = np.diff(np.vstack((at_rest, speeds, at_rest)), axis=0) / dt
    possible = ((np.abs(speeds) < _WAY_SPEED * robot.velocity_max).all()
                and (np.abs(accelerations) < _WAY_ACCELERATION * robot.acceleration_max).all()
                and _self_clearance(robot, postures) > _WAY_CLEARANCE)
    return postures if possible else None


def _self_clearance(robot: Robot, postures: Array) -> float:
    """Return the smallest distance between links that can run into each other [m]."""
    radii = np.array([capsule.radius for capsule in robot.capsules])
    return min(float(link_distances(start, end, radii, robot.self_pairs).distance.min(
        initial=np.inf)) for start, end in zip(*_segments(robot, postures)))


def _segments(robot: Robot, postures: Array) -> tuple[Array, Array]:
    arms = [robot.kinematics(q) for q in postures]
    return (np.array([a.segment_start for a in arms]), np.array([a.segment_end for a in arms]))


def _clearances(robot: Robot, obstacle: Obstacle, ends: tuple[Array, Array], margin: float,
                ) -> Array:
    """Return ρ (k, c) of one obstacle against links widened by `margin` along a path."""
    k, c = ends[0].shape[:2]
    radii = np.tile([capsule.radius + margin for capsule in robot.capsules], k)
    maps = inflated_obstacles(Scene.of([obstacle]), radii, moved=np.tile(robot.moved, k))
    pairs = link_clearance(maps, ends[0].reshape(-1, 3), ends[1].reshape(-1, 3))
    return pairs.normalized_distance.reshape(k, c)


def _random_ellipsoid(
    name: str, center: Array, sizes: tuple[float, float], random: np.random.Generator,
    velocity: Array | None = None,
) -> Obstacle:
    quaternion = random.normal(size=4)
    return Obstacle(name, center, random.uniform(*sizes, 3),
                    quaternion / np.linalg.norm(quaternion),
                    np.zeros(3) if velocity is None else velocity)


def _static_obstacles(
    robot: Robot, path: Array, way: Array | None, must_hit: bool, random: np.random.Generator,
) -> tuple[Obstacle, ...] | None:
    """Place 1 to 3 ellipsoids on the links' swept volume, clear of the start and of the tip.

    And of the way, if there is one.
    """
    ends = _segments(robot, path)
    way_ends = None if way is None else _segments(robot, way)
    # What the last two joints before a tip carry goes where the tip's pose takes it.
    wrists = [np.flatnonzero(joints)[-2] for joints in robot.chain.tip_supports]
    tip = (robot.supports[:, wrists] > 0.0).any(axis=1)
    links = np.flatnonzero(~tip)
    wanted = int(random.integers(1, 4))
    found: list[Obstacle] = []
    hits = False
    for _ in range(60):
        if len(found) == wanted:
            break
        sample, link = random.integers(_SAMPLES // 3, _SAMPLES), random.choice(links)
        t = random.uniform()
        on_link = (1 - t) * ends[0][sample, link] + t * ends[1][sample, link]
        # From well into the link to just clear of it, on average.
        direction = random.normal(size=3)
        offset = random.uniform(0.8, 1.3) * (robot.capsules[link].radius + sum(_SIZE) / 2.0)
        center = on_link + offset * direction / np.linalg.norm(direction)
        obstacle = _random_ellipsoid(f'obstacle{len(found)}', center, _SIZE, random)
        clear_start = _clearances(robot, obstacle, (ends[0][:1], ends[1][:1]),
                                  _START_CLEARANCE).min() > 0.0
        around_tip = _clearances(robot, obstacle, ends, _TIP_CLEARANCE)[:, tip]
        clear_way = way_ends is None or _clearances(
            robot, obstacle, way_ends, _WAY_CLEARANCE).min() > 0.0
        if clear_start and clear_way and (not tip.any() or around_tip.min() > 0.0):
            found.append(obstacle)
            hits |= bool(_clearances(robot, obstacle, ends, -_HIT_DEPTH).min() < 0.0)
    return tuple(found) if found and (hits or not must_hit) else None


def _moving_obstacles(
    robot: Robot, path: Array, random: np.random.Generator,
) -> tuple[Obstacle, ...] | None:
    """Send one or two ellipsoids through where the links will be, at up to 0.3 m/s."""
    ends = _segments(robot, path)
    dt = DURATION / (_SAMPLES - 1)
    found: list[Obstacle] = []
    for i in range(int(random.integers(1, 3))):
        sample = int(random.integers(_SAMPLES // 3, 2 * _SAMPLES // 3))
        link = int(random.integers(len(robot.capsules) // 3, len(robot.capsules)))
        target = 0.5 * (ends[0][sample, link] + ends[1][sample, link])
        direction = random.normal(size=3)
        velocity = (direction / np.linalg.norm(direction)
                    * random.uniform(0.1, _FASTEST_OBSTACLE))
        obstacle = _random_ellipsoid(f'obstacle{i}', target - velocity * sample * dt,
                                     _MOVING_SIZE, random, velocity)
        clear = _clearances(robot, obstacle, (ends[0][:1], ends[1][:1]), _START_CLEARANCE)
        if clear.min() <= 0.0:
            return None
        found.append(obstacle)
    return tuple(found)


def path_of_tips(robot: Robot, task: Task, dt: float) -> list[Poses]:
    """Return where the tips are at every tick if the whole motion is followed at full speed."""
    return list(_poses_of_tips(robot, task, dt))


def _poses_of_tips(robot: Robot, task: Task, dt: float) -> Iterator[Poses]:
    tips = list(robot.kinematics(task.start).tips.each)
    yield Poses.of(*tips)
    for i in range(round(DURATION / dt)):
        twists = task.twist_at(i * dt).reshape(-1, 6)
        tips = [integrate(pose, twist, dt, robot.in_tool) for pose, twist in zip(tips, twists)]
        yield Poses.of(*tips)


def path_poses(robot: Robot, task: Task, dt: float) -> list[Pose]:
    """Return where the tip of an arm with one is, likewise."""
    return [poses.first for poses in path_of_tips(robot, task, dt)]
