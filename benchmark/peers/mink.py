"""mink, driven tick by tick: it limits no accelerations, which is in its favour."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import mink
import mujoco
import numpy as np
import numpy.typing as npt

from benchmark.peers.arm import costs, poses_of
from benchmark.peers.mjcf import mjcf
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses

Array = npt.NDArray[np.float64]

# A share of the task's weight on every joint: without it the least norm is not well defined.
_DAMPING = 1e-8
# Distance from which it looks at a pair [m].
_DETECTION = 0.1
_SOLVER = 'daqp'


class Mink:
    """mink with its frame task, its limits and its collision avoidance."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
    ) -> None:
        """Build the MuJoCo model; margins to obstacles and between links in [m]."""
        self._model = mujoco.MjModel.from_xml_string(mjcf(robot, obstacles))
        self._configuration = mink.Configuration(self._model)
        position, rotation = costs(robot)
        self._tasks = [mink.FrameTask(f'tip{t}', 'site', position, rotation)
                       for t in range(len(robot.tips))]
        links = [f'link{i}' for i in range(len(robot.capsules))]
        self._limits = [
            mink.ConfigurationLimit(self._model),
            mink.VelocityLimit(self._model, dict(zip(
                robot.joint_names, robot.velocity_max.tolist()))),
        ]
        others = [f'obstacle{i}' for i in range(len(obstacles))]
        own = [([links[i]], [links[j]]) for i, j in robot.self_pairs]
        moved = list(compress(links, robot.moved))
        for pairs, distance in (([(moved, others)], margin), (own, self_margin)):
            if pairs and all(first and second for first, second in pairs):
                self._limits.append(mink.CollisionAvoidanceLimit(
                    self._model, pairs, minimum_distance_from_collisions=distance,
                    collision_detection_distance=_DETECTION))

    def step(self, q: Array, target: Pose | Poses, dt: float) -> Array:
        """See `Peer`."""
        self._configuration.update(q)
        for task, pose in zip(self._tasks, poses_of(target)):
            task.set_target(mink.SE3.from_rotation_and_translation(
                mink.SO3.from_matrix(pose.rotation), pose.position))
        try:
            return np.array(mink.solve_ik(
                self._configuration, self._tasks, dt, _SOLVER, damping=_DAMPING,
                limits=self._limits))
        except mink.NoSolutionFound:
            return np.zeros(len(q))

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """See `Peer`."""
        for i, obstacle in enumerate(obstacles):
            x, y, z, w = obstacle.orientation
            self._configuration.data.mocap_pos[i] = obstacle.center
            self._configuration.data.mocap_quat[i] = w, x, y, z
