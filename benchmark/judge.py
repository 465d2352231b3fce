"""An independent judge: exact distances from coal, limits, tracking."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.generator import path_of_tips, Task
from redundant_planner.analysis.metrics import distance_to_path
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# Every that many ticks the tip's distance from its path is measured.
_STRIDE = 2
_TOLERANCE = 1e-6
# A joint's acceleration counts from this share of its limit on.
_COUNTS = 0.05


@dataclass(frozen=True)
class Verdict:
    """What one run came to.

    Attributes:
        min_distance: smallest distance of a link to an obstacle, or of a body with several tips to
            another link; negative inside [m].
        nearest: names of that link and obstacle, and when [s].
        limit_violation: largest excess over a limit of position, velocity, acceleration or jerk,
            as a share of that limit (positions: in rad, m).
        path_error: largest distance of a tip from the commanded path [m].
        turn_error: largest angle between a tip's orientation and the path's nearest one [rad];
            0 where orientation is not controlled.
        final_error: distance of a tip from its path at the end [m].
        completed: whether all tips reached the ends of their paths, to 1 mm.
        cost: ∫q̇ᵀq̇ dt.
        path: Σ|Δq| over all joints.
        reversals: changes of the sign of a joint's acceleration, summed over the joints;
            accelerations below 5 % of the limit have none.
    """

    min_distance: float
    nearest: str
    limit_violation: float
    path_error: float
    turn_error: float
    final_error: float
    completed: bool
    cost: float
    path: float
    reversals: int


class Judge:
    """Judges runs of one robot.

    Attributes:
        robot: which.
    """

    def __init__(self, robot: Robot) -> None:
        """Prepare the robot's capsules as coal has them."""
        self.robot = robot
        self._capsules = capsules_of(robot)

    def judge(self, task: Task, postures: Array, velocities: Array, dt: float) -> Verdict:
        """Return the verdict on postures (k + 1, n) and the velocities (k, n) between them."""
        robot = self.robot
        motion = Motion.through(self._capsules, postures)
        nearest = motion.to_obstacles(task.obstacles, dt)
        if len(robot.tips) > 1:
            nearest = min(nearest, motion.to_itself(), key=lambda found: found.distance)
        paths = path_of_tips(robot, task, dt)
        tips = [robot.kinematics(q).tips for q in postures]
        off = [_off_path([poses.each[t] for poses in paths], [poses.each[t] for poses in tips])
               for t in range(len(robot.tips))]
        whole = robot.m == 6 * len(robot.tips)
        return Verdict(
            nearest.distance, f'{nearest} at {nearest.index * dt:.2f} s' if nearest.first else '',
            limit_violation(robot, postures, velocities, dt),
            max(found.distance for found in off),
            max(found.angle for found in off) if whole else 0.0,
            max(found.at_the_end for found in off), all(found.completed for found in off),
            float(np.square(velocities).sum() * dt),
            float(np.abs(np.diff(postures, axis=0)).sum()),
            reversals(accelerations(velocities, dt), robot.acceleration_max))


class _OffPath(NamedTuple):
    """How far a tip was off its path: at most [m, rad], at its end [m]; whether it got there."""

    distance: float
    angle: float
    at_the_end: float
    completed: bool


def _off_path(path: list[Pose], way: list[Pose]) -> _OffPath:
    """Return how far a way was off a path: where along it the tip is does not matter."""
    line = np.array([pose.position for pose in path])
    places = np.array([pose.position for pose in way])
    errors = distance_to_path(places[::_STRIDE], line[::10])
    angle = max(_angle(pose.rotation, path[nearest_index(line, pose.position)].rotation)
                for pose in way[::_STRIDE])
    return _OffPath(float(errors.max()), angle, float(errors[-1]),
                    bool(np.linalg.norm(places[-1] - line[-1]) < 1e-3))


def limit_violation(robot: Robot, postures: Array, velocities: Array, dt: float) -> float:
    """Return the largest excess over a limit, as a share of it; of positions in rad or m.

    Args:
        robot: the arm, at rest before the first tick.
        postures: (k + 1, n).
        velocities: (k, n) between them.
        dt: [s].
    """
    excess = max(
        float((postures - robot.position_max).max()),
        float((robot.position_min - postures).max()),
        float((np.abs(velocities) / robot.velocity_max).max() - 1.0),
        float((np.abs(accelerations(velocities, dt)) / robot.acceleration_max).max() - 1.0),
        float((np.abs(jerks(velocities, dt)) / robot.jerk_max).max() - 1.0))
    return excess if excess > _TOLERANCE else 0.0


def accelerations(velocities: Array, dt: float) -> Array:
    """Return accelerations (k, n) of velocity commands (k, n), from rest on."""
    return np.diff(velocities, axis=0, prepend=0.0) / dt


def jerks(velocities: Array, dt: float) -> Array:
    """Return jerks (k, n) of velocity commands (k, n), from rest on."""
    return np.diff(accelerations(velocities, dt), axis=0, prepend=0.0) / dt


def reversals(acceleration: Array, acceleration_max: Array) -> int:
    """Return how often accelerations (k, n) change sign beyond 5 % of their limits (n,)."""
    count = 0
    for joint, most in zip(acceleration.T, acceleration_max):
        signs = np.sign(joint[np.abs(joint) > _COUNTS * most])
        count += int((signs[1:] != signs[:-1]).sum())
    return count


def nearest_index(path: Array, point: Array) -> int:
    """Return the index of the path's point (k, 3) nearest to a point."""
    return int(np.square(path - point).sum(axis=1).argmin())


def _angle(first: Array, second: Array) -> float:
    return float(np.linalg.norm(pin.log3(first.T @ second)))
