"""A joint path ahead, for tests."""

from __future__ import annotations

import numpy as np

from redundant_planner.core.horizon.least_norm_path import PathJoints
from redundant_planner.core.horizon.path_qp import PathQP
from redundant_planner.core.horizon.poses_ahead import middles, node_times, poses_ahead
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.cone import Cone

NO_CONE = Cone(np.array((0.0, 0.0, 1.0)), np.array((0.0, 0.0, 1.0)), np.pi)


def smooth(twist, seconds=3.0):
    """Twists (k, 6) at times (k,): a motion that starts and ends at rest."""
    def at(times):
        share = np.clip(np.asarray(times) / seconds, 0.0, 1.0)
        return np.sin(np.pi * share)[..., None] ** 2 * twist
    return at


def problem(robot, q, twist, obstacles=(), nodes=6, seconds=1.0, weights=None):
    """A path problem, the poses ahead and the obstacles."""
    scaling = 1.0 / np.sqrt(np.ones(robot.n) if weights is None else weights)
    qp = PathQP(robot, node_times(seconds, nodes), PathJoints(
        scaling, np.array(robot.position_min), np.array(robot.position_max),
        np.full(robot.n, np.nan), 0.0, NO_CONE))
    arm = robot.kinematics(q)
    poses = poses_ahead(arm.tips,
                        smooth(twist, seconds)(middles(qp.times)), qp.times,
                        robot.in_tool)
    return qp, poses, inflated_obstacles(
        Scene.of(obstacles), [c.radius for c in robot.capsules])
