"""All obstacles at one moment, as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.kernels import compiled, Matrix
from redundant_planner.core.obstacles.obstacle import (
    BOX,
    CAPSULE,
    CYLINDER,
    HALF_SPACE,
    Obstacle,
    SHAPES,
)
from redundant_planner.core.robot.quaternions import quaternion_of

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


@compiled
def surface_speeds(half_extents: Matrix, velocities: Matrix, angular_velocities: Matrix) -> Array:
    """Return bounds on how fast any point of the obstacles moves (k,) [m/s].

    Args:
        half_extents: (k, 3) [m].
        velocities, angular_velocities: (k, 3) [m/s, rad/s].
    """
    speeds = np.empty(len(half_extents))
    for i in range(len(half_extents)):
        arm, linear, angular = 0.0, 0.0, 0.0
        for axis in range(3):
            arm += half_extents[i, axis] * half_extents[i, axis]
            linear += velocities[i, axis] * velocities[i, axis]
            angular += angular_velocities[i, axis] * angular_velocities[i, axis]
        speeds[i] = math.sqrt(linear) + math.sqrt(arm) * math.sqrt(angular)
    return speeds


@compiled
def _fastest(half_extents: Matrix, velocities: Matrix, angular_velocities: Matrix) -> float:
    """Return the largest of `surface_speeds`, 0 without any."""
    fastest = 0.0
    for speed in surface_speeds(half_extents, velocities, angular_velocities):
        fastest = max(fastest, speed)
    return fastest


@dataclass(frozen=True)
class Scene:
    """All obstacles, stacked; built once when something changes, not once per tick.

    Attributes:
        names: k names.
        shapes: (k,) what each is, an index into `SHAPES`.
        centers: (k, 3) [m].
        rotations: (k, 3, 3) obstacle axes → base axes.
        half_extents: (k, 3) along the obstacle's axes, see `Obstacle` [m].
        velocities: (k, 3) [m/s].
        angular_velocities: (k, 3) in base axes [rad/s].
    """

    names: tuple[str, ...]
    shapes: npt.NDArray[np.intp]
    centers: Array
    rotations: Array
    half_extents: Array
    velocities: Array
    angular_velocities: Array

    def __post_init__(self) -> None:
        """Check that there is one of each for every obstacle: machine code does not.

        Raises:
            ObstacleError: there is not.
        """
        k = len(self.names)
        if not (self.shapes.shape == (k,) and self.rotations.shape == (k, 3, 3)
                and self.centers.shape == self.half_extents.shape == self.velocities.shape
                == self.angular_velocities.shape == (k, 3)):
            given = ', '.join(f'{field.name} {getattr(self, field.name).shape}'
                              for field in fields(self)[1:])
            raise ObstacleError(f'a scene of {k} names has {given}; it takes shapes ({k},), '
                                f'rotations ({k}, 3, 3), and ({k}, 3) of the others')

    @classmethod
    def of(cls, obstacles: Iterable[Obstacle] = ()) -> Scene:
        """Stack obstacles into a scene."""
        obstacles = tuple(obstacles)
        arrays = (
            np.array([SHAPES.index(o.shape) for o in obstacles], dtype=np.intp),
            np.array([o.center for o in obstacles]).reshape(-1, 3),
            np.array([o.rotation for o in obstacles]).reshape(-1, 3, 3),
            np.array([o.half_extents for o in obstacles]).reshape(-1, 3),
            np.array([o.velocity for o in obstacles]).reshape(-1, 3),
            np.array([o.angular_velocity for o in obstacles]).reshape(-1, 3))
        for array in arrays:
            array.setflags(write=False)
        return cls(tuple(o.name for o in obstacles), *arrays)

    @property
    def speeds(self) -> Array:
        """(k,) the fastest that any point of an obstacle moves, at most [m/s]."""
        return surface_speeds(self.half_extents, self.velocities, self.angular_velocities)

    @property
    def fastest(self) -> float:
        """The largest of `speeds`, 0 without obstacles [m/s]."""
        return _fastest(self.half_extents, self.velocities, self.angular_velocities)

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Return the obstacles one by one."""
        return tuple(map(self.obstacle, range(len(self.names))))

    def obstacle(self, i: int) -> Obstacle:
        """Return one of the obstacles."""
        name, center, (x, y, z) = self.names[i], self.centers[i], self.half_extents[i].tolist()
        place = {'orientation': quaternion_of(self.rotations[i]),
                 'velocity': self.velocities[i],
                 'angular_velocity': self.angular_velocities[i]}
        shape = SHAPES[self.shapes[i]]
        if shape == BOX:
            return Obstacle.box(name, center, 2.0 * self.half_extents[i], **place)
        if shape == CYLINDER:
            return Obstacle.cylinder(name, center, x, 2.0 * z, **place)
        if shape == CAPSULE:
            return Obstacle.capsule(name, center, x, max(2.0 * (z - x), 0.0), **place)
        if shape == HALF_SPACE:
            return Obstacle.half_space(name, center, **place)
        return Obstacle(name, center, (x, y, z), **place)


def selected(scene: Scene, rows: Sequence[int]) -> Scene:
    """Return some obstacles of a scene."""
    index = np.array(rows, dtype=np.intp)
    return Scene(tuple(scene.names[i] for i in rows),
                 *(getattr(scene, entry.name)[index] for entry in fields(Scene)[1:]))


def joined(scenes: Iterable[Scene]) -> Scene:
    """Return all obstacles of several scenes as one, in their order."""
    scenes = tuple(scenes)
    arrays = [np.concatenate([getattr(scene, entry.name) for scene in scenes])
              for entry in fields(Scene)[1:]]
    for array in arrays:
        array.setflags(write=False)
    return Scene(tuple(name for scene in scenes for name in scene.names), *arrays)
