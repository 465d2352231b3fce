"""Whether what hit an arm could have been evaded at all."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from benchmark.generator import DURATION, Task
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Of the grid over the first joints, and between the moments looked at [rad, s].
_CELL = 0.01
_STEP = 0.04
_JOINTS = 2
# An arc is longer than its chord, by much less than this.
_ROUND = 1.05


def unavoidable(robot: Robot, task: Task) -> bool:
    """Return whether something hits the links that the first two joints move, whatever these do.

    All postures of the two joints are followed through time as a grid of cells, each reaching
    those that the limits of velocity allow, and of acceleration as far as an arm that started at
    rest is not faster yet, until an obstacle covers the cell. That no cell is left is a proof: a
    cell counts as covered only where the link is hit in all of its postures. That some are left
    proves nothing.
    """
    axes = [np.arange(low + 0.5 * _CELL, high + 0.5 * _CELL, _CELL) for low, high in zip(
        robot.position_min[:_JOINTS], robot.position_max[:_JOINTS])]
    shape = tuple(len(axis) for axis in axes)
    postures = np.tile(task.start, (shape[0] * shape[1], 1))
    postures[:, :_JOINTS] = list(itertools.product(*axes))
    arms = robot.kinematics_along(postures)
    # How far any point of a link can be from where it is in the middle of the cell.
    ends = np.stack((arms.segment_start, arms.segment_end)).reshape(2, *shape, -1, 3)
    slack = 0.5 * _ROUND * sum(
        np.linalg.norm(np.diff(ends, axis=1 + axis), axis=-1).max(axis=(0, 1, 2))
        for axis in range(_JOINTS))
    middles = ends.mean(axis=(0, 1, 2))
    reaches = np.linalg.norm(ends - middles, axis=-1).max(axis=(0, 1, 2))
    links = [i for i, moves in enumerate(robot.supports)
             if not moves[_JOINTS:].any() and robot.capsules[i].radius >= slack[i]]

    def uncovered(cells: Mask, obstacles: tuple[Obstacle, ...]) -> Mask:
        chosen = np.flatnonzero(cells)
        free = np.ones(len(chosen), dtype=bool)
        for i in links:
            capsule = robot.capsules[i]
            scene = Scene.of([
                _within(o, capsule, slack[i]) for o in obstacles
                if np.linalg.norm(o.center - middles[i])
                <= reaches[i] + capsule.radius + o.half_extents.max()])
            if not scene.names:
                continue
            pairs = link_clearance(
                inflated_obstacles(scene, np.zeros(1)), arms.segment_start[chosen, i:i + 1],
                arms.segment_end[chosen, i:i + 1], np.zeros(len(chosen)))
            free &= (pairs.normalized_distance >= 0.0).all(axis=(1, 2))
        left = np.zeros(len(postures), dtype=bool)
        left[chosen[free]] = True
        return left.reshape(shape)

    there = np.zeros(shape, dtype=bool)
    there[tuple(int(abs(axis - q).argmin()) for axis, q in zip(axes, task.start))] = True
    for time in np.arange(0.0, DURATION, _STEP):
        there = uncovered(there, task.obstacles_at(time))
        if not there.any():
            return True
        speeds = np.minimum(robot.velocity_max, robot.acceleration_max * (time + _STEP))
        for axis in range(_JOINTS):
            there = _widened(there, axis, int(speeds[axis] * _STEP / _CELL + 1.0))
    return False


def _within(obstacle: Obstacle, capsule: Capsule, slack: float) -> Obstacle:
    """Return an ellipsoid inside obstacle ⊕ ball of the capsule's radius less the slack.

    The support functions say so: √Σ (a + r)² u² ≤ √Σ a² u² + r for every unit u and r ≥ 0.
    """
    return Obstacle(obstacle.name, obstacle.center,
                    np.maximum(obstacle.half_extents + capsule.radius - slack, 1e-6),
                    obstacle.orientation)


def _widened(mask: Mask, axis: int, cells: int) -> Mask:
    """Return a mask that is set wherever one of the cells around was."""
    sums = np.cumsum(np.concatenate((np.zeros_like(mask.take([0], axis)), mask), axis), axis)
    last = mask.shape[axis]
    at = np.arange(last)
    return (sums.take(np.minimum(at + cells + 1, last), axis)
            > sums.take(np.maximum(at - cells, 0), axis))
