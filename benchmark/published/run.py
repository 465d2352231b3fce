"""One published scene with one method, and what it came to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import time
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.judge import accelerations, limit_violation, reversals
from benchmark.peers import library, PEERS
from benchmark.problem_sets.problem import tip_pose
from benchmark.problem_sets.servo import servo_twist
from benchmark.published.scene import Scene
from benchmark.robots import make_robot
from redundant_planner.analysis.metrics import distance_to_path
from redundant_planner.core.obstacles.scene import Scene as Obstacles
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import integrate, Pose, pose_error

Array = npt.NDArray[np.float64]

METHODS = {name: PlannerParameters(method=name) for name in ('dynamic_factor', 'variational')}
DT = 0.004
# A goal's orientation is reached within this [rad].
_NEAR_ANGLE = 0.02
# A path is completed within this of its end [m].
_NEAR_END = 0.005
# An arm that has moved less than this in that time will not go on [rad, s].
_STANDING, _PATIENCE = 1e-3, 5.0


@dataclass(frozen=True)
class Outcome:
    """What one run came to.

    Attributes:
        scene: its name.
        reached: whether the tip came to the goal, or to the path's end.
        obstacle, itself: the nearest that capsules came to an obstacle and to each other [m].
        limit_violation: see `benchmark.judge`.
        path_error: the farthest that the tip was off the path [m]; NaN where there is none.
        path: Σ|Δq| over all joints [rad].
        reversals: see `Verdict`.
        tick_us: (k,) times of the ticks [us].
    """

    scene: str
    reached: bool
    obstacle: float
    itself: float
    limit_violation: float
    path_error: float
    path: float
    reversals: int
    tick_us: Array


class Runner:
    """The Panda, with 3 and 6 axes, and its judge."""

    def __init__(self, margin: float) -> None:
        """Prepare; everybody keeps the margin from obstacles [m]."""
        self._robots = {axes: make_robot('panda', axes) for axes in (3, 6)}
        self._capsules = {axes: capsules_of(robot) for axes, robot in self._robots.items()}
        self._margin = margin

    def fault(self, scene: Scene) -> str:
        """Return why nobody can begin a scene, empty if they can."""
        robot, motion = self._robots[scene.axes], self._motion(scene, scene.start[None])
        if (scene.start < robot.position_min).any() or (scene.start > robot.position_max).any():
            return 'the start is beyond a limit'
        if motion.to_obstacles(scene.obstacles, DT).distance < self._margin:
            return 'the start is too near to an obstacle'
        return ''

    def run(self, scene: Scene, method: str) -> Outcome:
        """Run a method on a scene, with an ideal arm."""
        robot = self._robots[scene.axes]
        step = self._step(robot, scene, method)
        postures, velocities, ticks, reached = (
            _to_goal(robot, scene, step) if scene.path is None
            else _along(robot, scene, step))
        motion = self._motion(scene, postures)
        off = np.nan
        if scene.path is not None:
            tips = np.array([robot.kinematics(q).tip_position for q in postures])
            line = np.array([pose.position for pose in poses_of(robot, scene)])
            off = float(distance_to_path(tips[::5], line[::5]).max())
        return Outcome(
            scene.name, reached, motion.to_obstacles(scene.obstacles, DT).distance,
            motion.to_itself().distance, limit_violation(robot, postures, velocities, DT), off,
            float(np.abs(np.diff(postures, axis=0)).sum()),
            reversals(accelerations(velocities, DT), robot.acceleration_max), ticks)

    def _motion(self, scene: Scene, postures: Array) -> Motion:
        return Motion.through(self._capsules[scene.axes], postures)

    def _step(self, robot: Robot, scene: Scene, method: str) -> Callable[..., Array]:
        """Return posture, pose due after the tick, twist to it and obstacles → velocity."""
        if method in PEERS:
            peer = library(method)(robot, scene.obstacles, self._margin,
                                   PlannerParameters().clearance_self_margin)

            def peer_step(q: Array, due: Pose, twist: Array, now: float) -> Array:
                peer.move(scene.at(now))
                return peer.step(q, due, DT)

            return peer_step
        planner = Planner(robot, replace(METHODS[method], clearance_margin=self._margin))
        still, around = not _moves(scene), Obstacles.of(scene.obstacles)
        planner.prepare(around)

        def own_step(q: Array, due: Pose, twist: Array, now: float) -> Array:
            here = around if still else Obstacles.of(scene.at(now))
            return planner.step(q, twist, here, DT).dq

        return own_step


def _moves(scene: Scene) -> bool:
    return any(o.velocity.any() or o.angular_velocity.any() for o in scene.obstacles)


def _to_goal(
    robot: Robot, scene: Scene, step: Callable[..., Array],
) -> tuple[Array, Array, Array, bool]:
    """Servo to the goal, as in `benchmark.problem_sets`; all methods get the same twist."""
    q = scene.start
    goal = scene.goal_pose(tip_pose(robot, q))
    assert goal is not None
    postures, velocities, ticks, reached = [q], [], [], False
    standing, count = round(_PATIENCE / DT), round(scene.longest / DT)
    for i in range(count):
        pose = tip_pose(robot, q)
        error = pose_error(goal, pose, robot.in_tool)
        reached = bool(np.linalg.norm(error[:3]) < scene.near and (
            robot.m == 3 or np.linalg.norm(error[3:]) < _NEAR_ANGLE))
        if reached or (not _moves(scene) and i >= standing
                       and np.abs(q - postures[i - standing]).max() < _STANDING):
            break
        twist = servo_twist(robot, pose, goal)
        if robot.m == 3:
            twist = robot.full_twist(robot.task_rows(twist))
        due = integrate(pose, twist, DT, robot.in_tool)
        begin = time.perf_counter()
        dq = step(q, due, twist, i * DT)
        ticks.append(time.perf_counter() - begin)
        q = q + DT * dq
        postures.append(q)
        velocities.append(dq)
    return (np.array(postures), np.array(velocities).reshape(-1, robot.n), 1e6 * np.array(ticks),
            reached)


def poses_of(robot: Robot, scene: Scene) -> list[Pose]:
    """Return where the tip shall be at each tick of a path, and first where it starts."""
    assert scene.path is not None
    offsets, turns, times = scene.path
    first = tip_pose(robot, scene.start)
    at = np.arange(0.0, times[-1] + 0.5 * DT, DT)
    moved = np.array([np.interp(at, times, offsets[:, k]) for k in range(3)]).T
    nearest = np.searchsorted(times, at, side='right').clip(1, len(times) - 1)
    poses = []
    for i, (time_now, offset) in enumerate(zip(at, moved)):
        one, other = nearest[i] - 1, nearest[i]
        share = np.clip((time_now - times[one]) / (times[other] - times[one]), 0.0, 1.0)
        turn = integrate(Pose(np.zeros(3), turns[one]), share * pose_error(
            Pose(np.zeros(3), turns[other]), Pose(np.zeros(3), turns[one]), False), 1.0, False)
        poses.append(Pose(first.position + offset, turn.rotation @ first.rotation))
    return poses


def _along(
    robot: Robot, scene: Scene, step: Callable[..., Array],
) -> tuple[Array, Array, Array, bool]:
    """Follow the path: this package by its twist, the others by the pose that is due."""
    poses, q = poses_of(robot, scene), scene.start
    count = len(poses) - 1
    postures, velocities = np.empty((count + 1, robot.n)), np.empty((count, robot.n))
    ticks = np.empty(count)
    postures[0] = q
    for i in range(count):
        twist = pose_error(poses[i + 1], poses[i], robot.in_tool) / DT
        begin = time.perf_counter()
        velocities[i] = step(q, poses[i + 1], twist, i * DT)
        ticks[i] = time.perf_counter() - begin
        q = postures[i + 1] = q + DT * velocities[i]
    left = np.linalg.norm(tip_pose(robot, q).position - poses[-1].position)
    return postures, velocities, 1e6 * ticks, bool(left < _NEAR_END)


def summarise(outcomes: Sequence[Outcome], left_out: int) -> dict[str, Any]:
    """Return the JSON entry of one method; joint paths are those of the runs that arrived."""
    off = [o.path_error for o in outcomes if np.isfinite(o.path_error)]
    paths = [o.path for o in outcomes if o.reached]
    nearest = [o.obstacle for o in outcomes if np.isfinite(o.obstacle)]
    ticks = [o.tick_us for o in outcomes if len(o.tick_us)]
    return {
        'count': len(outcomes),
        'left_out': left_out,
        'reached': sum(o.reached for o in outcomes),
        'collisions': sum(o.obstacle < 0.0 for o in outcomes),
        'self_collisions': sum(o.itself < 0.0 for o in outcomes),
        'limit_violations': sum(o.limit_violation > 0.0 for o in outcomes),
        'min_distance_mm': 1e3 * min(nearest) if nearest else None,
        'max_path_error_mm': 1e3 * max(off) if off else None,
        'path_median': float(np.median(paths)) if paths else None,
        'reversals_median': float(np.median([o.reversals for o in outcomes])),
        'reversals_max': max(o.reversals for o in outcomes),
        'tick_us_median': float(np.median(np.concatenate(ticks))) if ticks else None,
        'scenes': {o.scene: {
            'reached': o.reached, 'min_distance_mm': _mm(o.obstacle),
            'self_distance_mm': _mm(o.itself), 'limit_violation': o.limit_violation,
            'path_error_mm': _mm(o.path_error), 'path': o.path, 'reversals': o.reversals}
            for o in outcomes},
    }


def _mm(length: float) -> float | None:
    return 1e3 * length if np.isfinite(length) else None
