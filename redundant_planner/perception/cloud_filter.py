"""Clouds to obstacles: crop, take the arm out, voxels, and what the clouds before have shown."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot
from redundant_planner.io.perception_parameters import CloudParameters
from redundant_planner.perception.own_shape import (
    keep_outside,
    own_shape,
    OwnShape,
    reach_of,
    surface_distances,
)
from redundant_planner.perception.posture_buffer import Posture
from redundant_planner.perception.sensor_rays import fill_rays, no_rays, seen_through
from redundant_planner.perception.voxel_grid import centers_of, counted, cropped, Keys
from redundant_planner.perception.voxel_memory import Flags, VoxelMemory

Array = npt.NDArray[np.float64]
Result = TypeVar('Result')

# Voxels that count at any time, as many obstacles as planner_node keeps; the nearest to the arm.
MOST_VOXELS = 20_000


class SensorPose(NamedTuple):
    """Where the frame of a cloud is.

    Attributes:
        origin: (3,) in the base frame [m].
        axes: (3, 3) in the base frame.
        at_sensor: whether the origin is the sensor itself, where its rays begin.
    """

    origin: Array
    axes: Array
    at_sensor: bool


class CloudFilter:
    """Turns one cloud after another into occupied voxels.

    Attributes:
        parameters: all but voxel_size may be replaced at any time.
        memory: the occupied voxels.
        left_out: how many voxels the last cloud had beyond `MOST_VOXELS`.
        times: step → how long it took for the last cloud [s].
    """

    def __init__(self, robot: Robot, parameters: CloudParameters) -> None:
        """Begin without voxels.

        Args:
            robot: its capsules are what is not an obstacle.
            parameters: of the node.
        """
        self.parameters = parameters
        self.memory = VoxelMemory()
        self.left_out = 0
        self.times: dict[str, float] = {}
        self.hold(robot)
        self._rays = no_rays()
        # For the points that are left; fresh memory for each cloud costs milliseconds.
        self._room = np.empty((3, 0))

    def hold(self, robot: Robot) -> None:
        """Go on with the same arm, and other things in its hand."""
        self._robot = robot
        self._center, self._reach = reach_of(robot)

    def see(self, points: Array, pose: SensorPose, posture: Posture, stamp: float) -> Array:
        """Take in a cloud.

        Args:
            points: (3, n) in the sensor's frame, NaN where there is none [m].
            pose: of that frame.
            posture: of the arm at the stamp.
            stamp: of the cloud [s].

        Returns:
            (k, 3) centres of the occupied voxels in the base frame [m].
        """
        p, self.times = self.parameters, {}
        own = own_shape(
            self._robot, posture.q, posture.speed, p.self_margin, p.stamp_uncertainty)
        clears = p.ray_clearing and pose.at_sensor
        if clears:
            self._timed('rays', lambda: fill_rays(points, self._rays))
        if self._room.shape[1] < points.shape[1]:
            self._room = np.empty_like(points)
        ball = np.append(self._center, self._reach + p.reach_margin)
        count = self._timed('crop', lambda: cropped(
            points, pose.origin, pose.axes, ball, self._box(), self._room))
        count = self._timed('self filter', lambda: keep_outside(self._room[:, :count], own))
        keys, counts = self._timed('voxels', lambda: counted(
            self._room[:, :count], p.voxel_size))

        def judge(unseen: Keys) -> tuple[Flags, Flags]:
            return self._judge(unseen, own, pose, clears)

        self._timed('memory', lambda: self.memory.update(
            keys[counts >= p.min_points], stamp, p.persistence, judge))
        return self._nearest(own)

    def _timed(self, step: str, work: Callable[[], Result]) -> Result:
        begin = time.perf_counter()
        result = work()
        self.times[step] = time.perf_counter() - begin
        return result

    def _box(self) -> Array:
        """Return the corners (2, 3) of the box that points must lie in [m]."""
        if not self.parameters.crop_box:
            return np.array([[-np.inf] * 3, [np.inf] * 3])
        return np.array(self.parameters.crop_box).reshape(2, 3)

    def _judge(
        self, unseen: Keys, own: OwnShape, pose: SensorPose, clears: bool,
    ) -> tuple[Flags, Flags]:
        """Return which unseen voxels are free, and which the cloud says nothing about, (k,) each.

        Free are those that the sensor sees through, those that the arm itself is in, and those
        that no longer count. Points close to the arm were taken out with the arm's own, so the
        cloud says nothing about voxels there: an obstacle must not vanish as the arm comes near.
        """
        p = self.parameters
        centers = centers_of(unseen, p.voxel_size)
        to_arm, to_thick = surface_distances(centers, own).T
        free = to_arm < 0.0
        if clears and len(centers):
            free |= seen_through((centers - pose.origin) @ pose.axes, p.voxel_size,
                                 float(p.min_points), self._rays) > 0.0
        # Even the far corner of such a voxel may have been taken out.
        return free, to_thick < 0.5 * np.sqrt(3.0) * p.voxel_size

    def _nearest(self, own: OwnShape) -> Array:
        """Return the voxels' centres (k, 3); of too many, only the nearest to the arm stay."""
        centers = centers_of(self.memory.keys, self.parameters.voxel_size)
        self.left_out = max(len(centers) - MOST_VOXELS, 0)
        if not self.left_out:
            return centers
        away = surface_distances(centers, own)[:, 0]
        kept = np.zeros(len(centers), dtype=bool)
        kept[np.argpartition(away, MOST_VOXELS)[:MOST_VOXELS]] = True
        self.memory.keep(kept)
        return centers[kept]
