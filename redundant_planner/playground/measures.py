"""What the page measures of an arm among obstacles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.clearance_gradients import surface_point
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.kinematics import Kinematics
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]


class NearestPair(NamedTuple):
    """A link and an obstacle that are nearer to each other than all others.

    Attributes:
        link, obstacle: their names.
        distance: between their surfaces, negative inside [m].
        ends: (2, 3) points of both surfaces [m].
    """

    link: str
    obstacle: str
    distance: float
    ends: Array


def nearest_pair(robot: Robot, arm: Kinematics, scene: Scene) -> NearestPair | None:
    """Return what is nearest to each other; None without obstacles or link shapes."""
    if not scene.names or not robot.moved.any():
        return None
    maps = inflated_obstacles(scene, [capsule.radius for capsule in robot.capsules],
                              moved=robot.moved)
    pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
    link, obstacle = np.unravel_index(int(pairs.distance.argmin()), pairs.distance.shape)
    here, there = surface_point(
        scene, np.array([obstacle]), arm.segment_start[link], arm.segment_end[link])
    away = there - here
    length = float(np.linalg.norm(away))
    if length > 0.0:
        here = here + min(robot.capsules[link].radius / length, 1.0) * away
    return NearestPair(robot.capsules[link].name, scene.names[obstacle],
                       float(pairs.distance[link, obstacle]), np.array((here, there)))


class Tally:
    """Joint path and clearance of an arm since some moment, counted up.

    Attributes:
        path: ∫|q̇| dt over all joints together [rad, m].
        smallest: the smallest distance to an obstacle so far [m].
        distance: the latest one [m].
    """

    def __init__(self, q: Array) -> None:
        """Begin at a posture (n,)."""
        self.path, self.smallest, self.distance = 0.0, np.inf, np.inf
        self._q = q

    def take(self, q: Array, distance: float) -> None:
        """Note a posture (n,), and how far the nearest obstacle is [m]."""
        self.path += float(np.linalg.norm(q - self._q))
        self.smallest, self.distance, self._q = min(self.smallest, distance), distance, q
