"""pink, driven tick by tick: its acceleration limit is off, as it is by default."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import coal
import numpy as np
import numpy.typing as npt
import pink
from pink.barriers import SelfCollisionBarrier
from pink.exceptions import NoSolutionFound
from pink.limits import ConfigurationLimit, VelocityLimit
import pinocchio as pin

from benchmark.bodies import rotation_to, shape_of
from benchmark.peers.arm import costs, in_joint, poses_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose, Poses

Array = npt.NDArray[np.float64]

# A share of the task's weight on every joint: without it the least norm is not well defined.
_DAMPING = 1e-8
_GAIN = 5.0  # of the barrier [1/s]
_SOLVER = 'daqp'


class Pink:
    """pink with its frame task, its limits and its collision barrier."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
    ) -> None:
        """Add the capsules and obstacles to Pinocchio's geometry model; margins as for `Mink`.

        pink's barrier knows one margin for all pairs, that to obstacles: among themselves the
        links are as much thinner as makes it theirs.
        """
        self._robot, self._model = robot, robot.model.copy()
        self._model.velocityLimit = robot.velocity_max
        geometry = pin.GeometryModel()
        links = _add_links(geometry, robot, 'link', 0.0)
        own = _add_links(geometry, robot, 'own_link', 0.5 * (margin - self_margin))
        for one, other in robot.self_pairs.tolist():
            geometry.addCollisionPair(pin.CollisionPair(own[one], own[other]))
        self._obstacle_ids = []
        for i, obstacle in enumerate(obstacles):
            body = geometry.addGeometryObject(pin.GeometryObject(
                f'obstacle{i}', 0, pin.SE3(obstacle.rotation, obstacle.center),
                shape_of(obstacle)))
            self._obstacle_ids.append(body)
            for link in compress(links, robot.moved):
                geometry.addCollisionPair(pin.CollisionPair(link, body))
        self._configuration = pink.Configuration(
            self._model, self._model.createData(), pin.neutral(self._model),
            collision_model=geometry)
        position, rotation = costs(robot)
        self._tasks = [pink.FrameTask(tip, position, rotation) for tip in robot.tips]
        self._barriers = [SelfCollisionBarrier(
            len(geometry.collisionPairs), gain=_GAIN, safe_displacement_gain=0.0,
            d_min=margin)] if len(geometry.collisionPairs) else []
        self._limits = [ConfigurationLimit(self._model, 1.0), VelocityLimit(self._model)]

    def step(self, q: Array, target: Pose | Poses, dt: float) -> Array:
        """See `Peer`."""
        self._configuration.update(q)
        for task, pose in zip(self._tasks, poses_of(target)):
            task.set_target(pin.SE3(pose.rotation, pose.position))
        try:
            return np.array(pink.solve_ik(
                self._configuration, self._tasks, dt, _SOLVER, damping=_DAMPING,
                limits=self._limits, barriers=self._barriers, safety_break=False))
        except NoSolutionFound:
            return np.zeros(len(q))

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """See `Peer`."""
        for body, obstacle in zip(self._obstacle_ids, obstacles):
            self._configuration.collision_model.geometryObjects[body].placement = pin.SE3(
                obstacle.rotation, obstacle.center)


def _add_links(
    geometry: pin.GeometryModel, robot: Robot, name: str, thinner: float,
) -> list[int]:
    """Add the capsules, their radii less by so much [m], and return their indices."""
    indices = []
    for i, capsule in enumerate(robot.capsules):
        joint, start, end = in_joint(robot, capsule)
        shape = coal.Capsule(
            max(capsule.radius - thinner, 1e-5), max(float(np.linalg.norm(end - start)), 1e-6))
        indices.append(geometry.addGeometryObject(pin.GeometryObject(
            f'{name}{i}', joint, pin.SE3(rotation_to(end - start), 0.5 * (start + end)), shape)))
    return indices
