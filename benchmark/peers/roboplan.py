"""RoboPlan's OInK, driven tick by tick, as its examples set it up.

A frame task of priority 1 and a posture task of priority 2; limits of position, velocity and
acceleration; the barrier for pairs of bodies, and `enforceBarriers` on what comes out. The barrier
is made for an arm's own links. Obstacles take part in it as bodies on joints of their own, which
OInK does not move: its scene takes no ellipsoids and capsules otherwise. The barrier's term in the
objective is left out, as in pink: with many pairs it holds the arm back from its path.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, compress
from pathlib import Path
import tempfile

import numpy as np
import numpy.typing as npt
from roboplan.core import CartesianConfiguration, loadMjcfModel, Scene
from roboplan.optimal_ik import (
    AccelerationLimit,
    ConfigurationTask,
    ConfigurationTaskOptions,
    FrameTask,
    FrameTaskOptions,
    Oink,
    PositionLimit,
    SelfCollisionBarrier,
    SelfCollisionBarrierOptions,
    VelocityLimit,
)
from scipy.spatial.transform import Rotation

from benchmark.peers.arm import costs
from benchmark.peers.mjcf import mjcf
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# As in the examples: the tasks' damping and weights, the QP's regularisation, the barrier's gain.
_DAMPING, _REGULARISATION, _GAIN = 0.01, 1e-6, 10.0
_POSTURE_GAIN, _POSTURE_WEIGHT = 0.1, 0.05
# Nothing farther apart is looked at [m]; 0.25 m unless told otherwise.
_SEEN = 0.25
# So many of the nearest pairs have a row in the QP.
_MOST_PAIRS = 30


class RoboPlan:
    """OInK; see the module."""

    def __init__(
        self, robot: Robot, obstacles: Sequence[Obstacle], margin: float, self_margin: float,
    ) -> None:
        """Load arm and obstacles; margins to obstacles and between links in [m].

        The barrier knows one margin, that to obstacles: among themselves the links are as much
        thinner as makes it theirs.
        """
        self._robot, self._count = robot, len(obstacles)
        self._scene = _scene(mjcf(robot, obstacles, 0.5 * (margin - self_margin)))
        links = range(len(robot.capsules))
        names = [f'{kind}{i}' for kind in ('link', 'own') for i in links]
        others = [f'obstacle{i}' for i in range(self._count)]
        self._scene.setCollisions(list(combinations(names + others, 2)), False)
        pairs = [(f'link{i}', other) for i in compress(links, robot.moved)
                 for other in others]
        pairs += [(f'own{i}', f'own{j}') for i, j in robot.self_pairs.tolist()]
        if pairs:
            self._scene.setCollisions(pairs, True)
        self._pairs, self._margin = len(pairs), margin
        self._scene.addGroup('arm', list(robot.joint_names))
        self._q = np.array(self._scene.getCurrentJointPositions())
        self._full = np.zeros(robot.n + 6 * self._count)
        self.move(obstacles)
        self._oink = Oink(self._scene, 'arm')
        self._dt, self._last = 0.0, np.zeros(robot.n)

    def step(self, q: Array, target: Pose, dt: float) -> Array:
        """See `Peer`."""
        self._q[self._oink.q_indices] = q
        if dt != self._dt:
            self._set_up(q, dt)
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = target.rotation, target.position
        self._task.setTargetFrameTransform(place)
        self._limits[-1].setLastVelocity(self._last)
        found = np.zeros(self._robot.n)
        self._scene.setJointPositions(self._q)
        try:
            self._oink.solveIk(self._scene, self._tasks, self._limits, self._barriers, found,
                               _REGULARISATION)
            self._full[:] = 0.0
            self._full[self._oink.v_indices] = found
            if self._barriers:
                self._oink.enforceBarriers(self._scene, self._barriers, self._full)
            self._last = self._full[self._oink.v_indices] / dt
        except RuntimeError:
            self._last = np.zeros(self._robot.n)
        return self._last.copy()

    def move(self, obstacles: Sequence[Obstacle]) -> None:
        """See `Peer`."""
        for i, obstacle in enumerate(obstacles):
            at = self._scene.getJointPositionIndices(
                [f'{kind}_{axis}{i}' for kind in ('slide', 'hinge') for axis in 'xyz'])
            turns = Rotation.from_quat(obstacle.orientation).as_euler('XYZ')
            self._q[at] = np.concatenate((obstacle.center, turns))

    def _set_up(self, q: Array, dt: float) -> None:
        """Make tasks, limits and barrier, which know the period."""
        oink, robot, self._dt = self._oink, self._robot, dt
        position, rotation = costs(robot)
        goal = CartesianConfiguration('universe', 'tip0', np.eye(4))
        self._task = FrameTask(oink, self._scene, goal, FrameTaskOptions(
            position_cost=position[0], orientation_cost=rotation[0], lm_damping=_DAMPING))
        posture = ConfigurationTask(
            oink, q, np.full(robot.n, _POSTURE_WEIGHT),
            ConfigurationTaskOptions(task_gain=_POSTURE_GAIN, priority=2))
        self._tasks = [self._task, posture]
        self._limits = [PositionLimit(oink), VelocityLimit(oink, dt, robot.velocity_max),
                        AccelerationLimit(oink, dt, robot.acceleration_max)]
        self._barriers = [SelfCollisionBarrier(
            oink, self._scene, dt, SelfCollisionBarrierOptions(
                n_collision_pairs=min(self._pairs, _MOST_PAIRS), gain=_GAIN,
                safe_displacement_gain=0.0,
                d_min=self._margin, d_max=_SEEN))] if self._pairs else []


def _scene(xml: str) -> Scene:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'arm.xml'
        path.write_text(xml)
        return Scene('arm', loadMjcfModel(path))
