"""The smallest clearance along a motion, a block of postures at a time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis import metrics
from redundant_planner.core.obstacles.clearance import link_clearance, pseudo_distance
from redundant_planner.core.obstacles.inflation import inflated_obstacles, InflatedObstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Links × obstacles × postures that are looked at together.
_BLOCK = 2_000_000


class SmallestClearance:
    """The smallest clearance of every posture, and the smallest of all.

    Attributes:
        smallest: the smallest level and where it was, None without any.
        distance: the smallest distance [m].
    """

    def __init__(self, robot: Robot) -> None:
        """Begin without a posture."""
        self._robot = robot
        self._radii = np.array([capsule.radius for capsule in robot.capsules])
        self._maps: tuple[Scene, InflatedObstacles] | None = None
        self.smallest: metrics.Clearance | None = None
        self.distance = np.inf

    def hold(self, robot: Robot) -> None:
        """Go on with the same arm, and other things in its hand."""
        self._robot, self._maps = robot, None
        self._radii = np.array([capsule.radius for capsule in robot.capsules])

    def of(self, postures: Array, scene: Scene, first_sample: int) -> Array:
        """Return the smallest distance (k,) at postures (k, n) [m].

        Args:
            postures: joint positions [rad, m].
            scene: the obstacles at all of them.
            first_sample: the number of the first posture.
        """
        result = np.full(len(postures), np.inf)
        if not scene.names or not len(self._radii):
            return result
        if self._maps is None or self._maps[0] is not scene:
            self._maps = scene, inflated_obstacles(
                scene, self._radii, moved=self._robot.moved)
        maps = self._maps[1]
        step = max(_BLOCK // (len(self._radii) * len(scene.names)), 1)
        for begin in range(0, len(postures), step):
            arms = self._robot.kinematics_along(postures[begin:begin + step])
            pairs = link_clearance(maps, arms.segment_start, arms.segment_end)
            # Of an obstacle that is too far away or too large for the numbers: NaN.
            result[begin:begin + step] = np.fmin.reduce(pairs.distance, axis=(1, 2))
            clearance = np.where(
                np.isfinite(pairs.normalized_distance), pairs.normalized_distance, np.inf)
            sample, link, obstacle = np.unravel_index(
                int(clearance.argmin()), clearance.shape)
            level = float(pseudo_distance(clearance[sample, link, obstacle]))
            if np.isfinite(level) and (self.smallest is None or level < self.smallest.level):
                self.smallest = metrics.Clearance(
                    level, self._robot.capsules[int(link)].name, scene.names[int(obstacle)],
                    first_sample + begin + int(sample))
        result = np.where(np.isfinite(result), result, np.inf)
        self.distance = min(self.distance, float(result.min(initial=np.inf)))
        return result
