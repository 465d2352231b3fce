"""All obstacles at one moment, as arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.kernels import compiled, Matrix
from redundant_planner.core.obstacles.obstacle import Obstacle

Array = npt.NDArray[np.float64]


@compiled
def rotations(quaternions: Matrix) -> Array:
    """Return the rotation matrices (k, 3, 3) of quaternions (k, 4), x y z w, of any length."""
    result = np.empty((len(quaternions), 3, 3))
    for i in range(len(quaternions)):
        x, y, z, w = quaternions[i]
        size = math.sqrt(x * x + y * y + z * z + w * w)
        x, y, z, w = x / size, y / size, z / size, w / size
        r = result[i]
        r[0, 0], r[1, 1], r[2, 2] = (
            1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z), 1 - 2 * (x * x + y * y))
        r[0, 1], r[0, 2], r[1, 2] = (
            2 * (x * y - z * w), 2 * (x * z + y * w), 2 * (y * z - x * w))
        r[1, 0], r[2, 0], r[2, 1] = (
            2 * (x * y + z * w), 2 * (x * z - y * w), 2 * (y * z + x * w))
    return result


@dataclass(frozen=True)
class Scene:
    """All obstacles, stacked; built once when something changes, not once per tick.

    Attributes:
        names: k names.
        centers: (k, 3) [m].
        rotations: (k, 3, 3) ellipsoid axes → base axes.
        semi_axes: (k, 3) [m].
        velocities: (k, 3) [m/s].
    """

    names: tuple[str, ...]
    centers: Array
    rotations: Array
    semi_axes: Array
    velocities: Array

    @classmethod
    def of(cls, obstacles: Iterable[Obstacle] = ()) -> Scene:
        """Stack obstacles into a scene."""
        obstacles = tuple(obstacles)
        arrays = (
            np.array([o.center for o in obstacles]).reshape(-1, 3),
            np.array([o.rotation for o in obstacles]).reshape(-1, 3, 3),
            np.array([o.semi_axes for o in obstacles]).reshape(-1, 3),
            np.array([o.velocity for o in obstacles]).reshape(-1, 3))
        for array in arrays:
            array.setflags(write=False)
        return cls(tuple(o.name for o in obstacles), *arrays)

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return the obstacles one by one."""
        return tuple(
            Obstacle(name, center, axes, pin.Quaternion(rotation).coeffs(), velocity)
            for name, center, axes, rotation, velocity in zip(
                self.names, self.centers, self.semi_axes, self.rotations, self.velocities))
