"""A depth camera that sees obstacles and the arm: rays against shapes, in closed form."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, Indices, kernel, Matrix, Stack, Vector
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.shapes import BOX, CAPSULE, CYLINDER, HALF_SPACE

Array = npt.NDArray[np.float64]


class Bodies(NamedTuple):
    """Solid shapes in the base frame.

    Attributes:
        shapes, centers, rotations, half_extents: of the k bodies, as in `Scene`.
    """

    shapes: Indices
    centers: Matrix
    rotations: Stack
    half_extents: Matrix


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole camera.

    Its axes are those of an image: x to the right, y down, z forward.

    Attributes:
        width, height: of the image [pixels].
        field_of_view: angle between the left and right edge [rad].
        farthest: what is further away is not seen [m].
        noise: standard deviation of the distance along each ray [m].
    """

    width: int
    height: int
    field_of_view: float
    farthest: float
    noise: float = 0.0

    def rays(self) -> Array:
        """Return the direction of every pixel in the camera's frame (h, w, 3), of unit length."""
        focal = 0.5 * self.width / math.tan(0.5 * self.field_of_view)
        directions = np.empty((self.height, self.width, 3))
        directions[:, :, 0] = (np.arange(self.width) + 0.5 - 0.5 * self.width) / focal
        directions[:, :, 1] = ((np.arange(self.height) + 0.5 - 0.5 * self.height) / focal)[:, None]
        directions[:, :, 2] = 1.0
        return directions / np.linalg.norm(directions, axis=2)[:, :, None]

    def points(
        self, origin: Array, axes: Array, bodies: Bodies,
        random: np.random.Generator | None = None,
    ) -> Array:
        """Return what the camera sees (h, w, 3) in its own frame, NaN where that is nothing [m].

        Args:
            origin: (3,) of the camera in the base frame [m].
            axes: (3, 3) of the camera in the base frame.
            bodies: what there is to see.
            random: of the noise; None for none.
        """
        rays = self.rays()
        flat = rays.reshape(-1, 3)
        away = distances(np.ascontiguousarray(flat @ axes.T), origin, bodies, self.farthest)
        if random is not None and self.noise > 0.0:
            away = away + random.normal(0.0, self.noise, away.shape)
        away[~np.isfinite(away)] = np.nan
        return (away[:, None] * flat).reshape(rays.shape)


def bodies_of(scene: Scene) -> Bodies:
    """Return the obstacles of a scene as bodies; walls without end are no bodies."""
    solid = scene.shapes != HALF_SPACE
    return Bodies(scene.shapes[solid], scene.centers[solid], scene.rotations[solid],
                  scene.half_extents[solid])


def arm_bodies(start: Array, end: Array, radii: Array) -> Bodies:
    """Return an arm's capsules as bodies.

    Args:
        start, end: (c, 3) segments in the base frame [m].
        radii: (c,) [m].
    """
    count = len(radii)
    rotations = np.empty((count, 3, 3))
    extents = np.empty((count, 3))
    for i in range(count):
        axis = end[i] - start[i]
        length = float(np.linalg.norm(axis))
        z = axis / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        # Any direction that is not nearly along z will do.
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        rotations[i] = np.column_stack([x, np.cross(z, x), z])
        extents[i] = radii[i], radii[i], 0.5 * length + radii[i]
    return Bodies(np.full(count, CAPSULE, np.intp), 0.5 * (start + end), rotations, extents)


def together(*groups: Bodies) -> Bodies:
    """Return several groups of bodies as one."""
    return Bodies(*map(np.concatenate, zip(*groups)))


@kernel
def _ball(o: Vector, d: Vector, e: Vector) -> tuple[float, float]:
    """Return where a ray enters and leaves an ellipsoid, in its own frame [m].

    A ray that misses leaves before it enters; so in all functions here.
    """
    a, b, c = 0.0, 0.0, -1.0
    for axis in range(3):
        u, v = d[axis] / e[axis], o[axis] / e[axis]
        a, b, c = a + u * u, b + u * v, c + v * v
    root = b * b - a * c
    if root < 0.0:
        return np.inf, -np.inf
    root = math.sqrt(root)
    return (-b - root) / a, (-b + root) / a


@kernel
def _slab(o: float, d: float, e: float) -> tuple[float, float]:
    """Return where a ray enters and leaves the space between two planes at ±e."""
    if d == 0.0:
        return (-np.inf, np.inf) if abs(o) <= e else (np.inf, -np.inf)
    one, other = (-e - o) / d, (e - o) / d
    return min(one, other), max(one, other)


@kernel
def _box(o: Vector, d: Vector, e: Vector) -> tuple[float, float]:
    """Return where a ray enters and leaves a box, in its own frame [m]."""
    near, far = -np.inf, np.inf
    for axis in range(3):
        enter, leave = _slab(o[axis], d[axis], e[axis])
        near, far = max(near, enter), min(far, leave)
    return near, far


@kernel
def _tube(o: Vector, d: Vector, e: Vector, half: float) -> tuple[float, float]:
    """Return where a ray enters and leaves a cylinder of a half height, in its own frame [m]."""
    a = (d[0] / e[0]) ** 2 + (d[1] / e[1]) ** 2
    b = o[0] * d[0] / (e[0] * e[0]) + o[1] * d[1] / (e[1] * e[1])
    c = (o[0] / e[0]) ** 2 + (o[1] / e[1]) ** 2 - 1.0
    near, far = _slab(o[2], d[2], half)
    if a == 0.0:
        return (near, far) if c <= 0.0 else (np.inf, -np.inf)
    root = b * b - a * c
    if root < 0.0:
        return np.inf, -np.inf
    root = math.sqrt(root)
    return max(near, (-b - root) / a), min(far, (-b + root) / a)


@kernel
def _capsule(o: Vector, d: Vector, e: Vector) -> tuple[float, float]:
    """Return where a ray enters and leaves a capsule, in its own frame [m].

    It is a tube and two balls, convex together: from where the ray enters the first of them to
    where it leaves the last.
    """
    half = max(e[2] - e[0], 0.0)
    r = np.array([e[0], e[0], e[0]])
    end = o.copy()
    near, far = _tube(o, d, e, half)
    if near > far:
        near, far = np.inf, -np.inf
    for side in (-half, half):
        end[2] = o[2] - side
        enter, leave = _ball(end, d, r)
        near, far = min(near, enter), max(far, leave)
    return near, far


@compiled
def distances(rays: Matrix, origin: Vector, bodies: Bodies, farthest: float) -> Array:
    """Return how far rays from one point go until they hit a body (n,), infinite for never [m].

    Args:
        rays: (n, 3) directions in the base frame, of unit length.
        origin: (3,) in the base frame [m].
        bodies: what they may hit.
        farthest: beyond which nothing is hit [m].
    """
    away = np.full(len(rays), np.inf)
    o, d = np.empty(3), np.empty(3)
    for body in range(len(bodies.shapes)):
        rotation, extents = bodies.rotations[body], bodies.half_extents[body]
        shape = bodies.shapes[body]
        gap = origin - bodies.centers[body]
        for axis in range(3):
            o[axis] = (rotation[0, axis] * gap[0] + rotation[1, axis] * gap[1]
                       + rotation[2, axis] * gap[2])
        # A ball around the body tells most rays at once.
        around = math.sqrt(extents[0] ** 2 + extents[1] ** 2 + extents[2] ** 2)
        squared = gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2 - around * around
        for i in range(len(rays)):
            x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
            along = gap[0] * x + gap[1] * y + gap[2] * z
            if squared > 0.0 and (along > 0.0 or along * along < squared):
                continue
            for axis in range(3):
                d[axis] = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
            if shape == BOX:
                near, far = _box(o, d, extents)
            elif shape == CYLINDER:
                near, far = _tube(o, d, extents, extents[2])
            elif shape == CAPSULE:
                near, far = _capsule(o, d, extents)
            else:
                near, far = _ball(o, d, extents)
            hit = near if near > 0.0 else far  # from inside, the far side is seen
            if near <= far and 0.0 < hit < away[i] and hit <= farthest:
                away[i] = hit
    return away
