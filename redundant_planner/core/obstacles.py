"""Ellipsoidal obstacles and how far points and links are from them (Eqs. 4–7).

The level value of an ellipsoid with centre c, axes R and semi-axes a is, with
y = diag(1/a) Rᵀ (x − c),

    S(x) = |y|² − 1        (Eq. 6; 0 on the surface, −1 in the centre)
    ρ(x) = |y| − 1         (the same level, linear in distance)

Along a segment S is a parabola in the segment's parameter, so its smallest value over a whole
link has a closed form. A link's radius r enters through the ellipsoid: the trace-minimal outer
ellipsoid of ellipsoid ⊕ ball has the same axes and the semi-axes √((1+β) a² + (1+1/β) r²).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from redundant_planner.core.errors import ObstacleError

Array = npt.NDArray[np.float64]

# Quaternions further from unit length than this are a mistake, not round-off.
_QUATERNION_TOLERANCE = 0.01


@dataclass(frozen=True)
class Obstacle:
    """One ellipsoid in the base frame.

    Attributes:
        name: what messages call it.
        center: (3,) [m].
        semi_axes: (3,) positive [m].
        orientation: (4,) unit quaternion (x, y, z, w), ellipsoid axes → base axes.
        velocity: (3,) of the centre [m/s].
    """

    name: str
    center: Array
    semi_axes: Array
    orientation: Array = (0.0, 0.0, 0.0, 1.0)  # type: ignore[assignment]
    velocity: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """Check the numbers, normalise the quaternion and make the arrays read-only.

        Raises:
            ObstacleError: a value has the wrong length, is not finite, a semi-axis is not
                positive or the quaternion is not of unit length.
        """
        sizes = {'center': 3, 'semi_axes': 3, 'orientation': 4, 'velocity': 3}
        for field, size in sizes.items():
            value = np.array(getattr(self, field), dtype=float)
            if value.shape != (size,) or not np.isfinite(value).all():
                raise ObstacleError(f"obstacle '{self.name}': {field} is {value.tolist()}; "
                                    f'it takes {size} finite numbers')
            object.__setattr__(self, field, value)
        if not (self.semi_axes > 0.0).all():
            raise ObstacleError(f"obstacle '{self.name}': semi_axes are "
                                f'{self.semi_axes.tolist()}; all three must be positive [m]')
        norm = float(np.linalg.norm(self.orientation))
        if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
            raise ObstacleError(
                f"obstacle '{self.name}': the orientation quaternion "
                f'{self.orientation.tolist()} has length {norm:.3g}; it must be 1')
        object.__setattr__(self, 'orientation', self.orientation / norm)
        for field in sizes:
            getattr(self, field).setflags(write=False)

    @property
    def rotation(self) -> Array:
        """(3, 3) ellipsoid axes in the base frame."""
        return rotations(self.orientation)


def rotations(quaternions: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of unit quaternions (..., 4), x y z w."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
            2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y))
    return np.stack(rows, axis=-1).reshape(*quaternions.shape[:-1], 3, 3)


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


def inflated_semi_axes(semi_axes: Array, radius: npt.ArrayLike) -> Array:
    """Return the semi-axes of the trace-minimal ellipsoid around ellipsoid ⊕ ball.

    With A² = diag(a²): (1+β) A² + (1+1/β) r² I, β = √(3 r² / tr A²). Adding r to the semi-axes
    instead would not contain the sum.

    Args:
        semi_axes: (..., 3) [m].
        radius: (...) ball radius, 0 or more [m].
    """
    squares = np.square(semi_axes)
    r2 = np.square(np.asarray(radius, dtype=float))[..., None]
    trace = squares.sum(axis=-1, keepdims=True)
    # (1+β) a² + (1+1/β) r² without the division by β, which is 0 for a bare segment.
    return np.sqrt(squares + r2 + np.sqrt(3.0 * r2 / trace) * squares
                   + np.sqrt(r2 * trace / 3.0))


class Whitening(NamedTuple):
    """The maps y = A x − b that turn each inflated ellipsoid into the unit ball.

    Attributes:
        maps: (c, 4, 3k) rows (x, 1) → the three entries of y, each for all k obstacles; one
            map per link, as links differ in radius.
        inverse: (c, k, 3) 1 / inflated semi-axes a [1/m]; A = diag(1/a) Rᵀ.
        rotations: (k, 3, 3) R.
        smallest: (c, k) smallest inflated semi-axis [m].
        velocities: (k, 3) obstacle velocities in the base frame [m/s].
        speeds: (k,) their size [m/s].
        moving: whether any obstacle has a velocity.
    """

    maps: Array
    inverse: Array
    rotations: Array
    smallest: Array
    velocities: Array
    speeds: Array
    moving: bool


def whitening(scene: Scene, radii: npt.ArrayLike) -> Whitening:
    """Prepare a scene for links of the given radii (c,) [m]."""
    radii = np.asarray(radii, dtype=float)
    inverse = 1.0 / inflated_semi_axes(scene.semi_axes[None], radii[:, None])
    # Rᵀ and −Rᵀ c, with the obstacles last: what the links share, but for the scale of its rows.
    shared = np.empty((4, 3, len(scene.names)))
    shared[:3] = scene.rotations.transpose(1, 2, 0)
    shared[3] = -(scene.centers[:, None] @ scene.rotations)[:, 0].T
    maps = shared * inverse.transpose(0, 2, 1)[:, None]
    speeds = np.sqrt(np.square(scene.velocities).sum(axis=-1))
    return Whitening(maps.reshape(len(radii), 4, -1), inverse, scene.rotations,
                     1.0 / inverse.max(axis=-1), scene.velocities,
                     speeds, bool(speeds.any()))


class Pairs(NamedTuple):
    """Every link × every obstacle, at one posture or at each of N postures (then N leads).

    Attributes:
        whitened: (c, 3, k) y at the link's nearest point, |y| = ρ + 1.
        clearance: (c, k) ρ there; negative inside.
        distance: (c, k) [m] ρ times the smallest semi-axis: never more than the true distance.
        parameter: (c, k) where on the segment, 0 at its start, 1 at its end.
    """

    whitened: Array
    clearance: Array
    distance: Array
    parameter: Array


def link_clearance(
    maps: Whitening, start: Array, end: Array, times: Array | None = None,
) -> Pairs:
    """Return the smallest ρ of every obstacle over every whole link, in closed form.

    S(t) = |y₀ + t d|² − 1 has its minimum over [0, 1] at t = clip(−y₀·d / d·d).

    Args:
        maps: from `whitening`, with one row per link.
        start: (c, 3) segment starts in the base frame [m], or (N, c, 3).
        end: likewise, segment ends.
        times: (N,) with N postures, when each of them is reached: obstacles that move have
            moved by then [s].
    """
    ends = np.zeros((*start.shape[:-1], 2, 4))
    ends[..., 0, :3] = start
    ends[..., 0, 3] = 1.0
    ends[..., 1, :3] = end - start
    # One product takes every link's start and direction to every obstacle's coordinates.
    whitened = (ends @ maps.maps).reshape(*start.shape[:-1], 2, 3, -1)
    first, along = whitened[..., 0, :, :], whitened[..., 1, :, :]
    if times is not None and maps.moving:
        local = (maps.velocities[:, None] @ maps.rotations)[:, 0]
        flow = (maps.inverse * local).transpose(0, 2, 1)
        first = first - times[:, None, None, None] * flow
    squared = (along * along).sum(axis=-2)
    parameter = -(first * along).sum(axis=-2) / np.maximum(squared, np.finfo(float).tiny)
    parameter = np.minimum(np.maximum(parameter, 0.0), 1.0)
    nearest = first + parameter[..., None, :] * along
    clearance = np.sqrt((nearest * nearest).sum(axis=-2)) - 1.0
    return Pairs(nearest, clearance, clearance * maps.smallest, parameter)


def surface_point(scene: Scene, obstacle: int, start: Array, end: Array) -> tuple[Array, Array]:
    """Return a segment's point of smallest ρ and, towards the centre, the ellipsoid's surface.

    Args:
        scene: the obstacles.
        obstacle: which.
        start, end: (3,) of the segment [m].

    Returns:
        (3,) and (3,): x and c + (x − c) / (ρ + 1) [m].
    """
    one = slice(obstacle, obstacle + 1)
    maps = whitening(Scene(scene.names[one], scene.centers[one], scene.rotations[one],
                           scene.semi_axes[one], scene.velocities[one]), np.zeros(1))
    pairs = link_clearance(maps, start[None], end[None])
    point = start + float(pairs.parameter[0, 0]) * (end - start)
    center = scene.centers[obstacle]
    return point, center + (point - center) / max(float(pairs.clearance[0, 0]) + 1.0, 1e-9)


def pseudo_distance(clearance: Array) -> Array:
    """Return S (Eq. 6) of the level ρ: S = (ρ + 1)² − 1."""
    return clearance * (clearance + 2.0)


def clearance_gradients(
    maps: Whitening, pairs: Pairs, chosen: tuple[npt.NDArray[np.intp], ...], start: Array,
    end: Array, columns: Array, moves: Array,
) -> tuple[Array, Array]:
    """Return ∂ρ/∂q and ∂ρ/∂t of the chosen pairs.

    At the minimising point x of the link, ∇ₓρ = Aᵀ y/|y|; the parameter t of that point does
    not contribute (envelope theorem). With joint screws [v; w] at the base origin,
    ∂ρ/∂q_j = ∇ₓρ · v_j + (x × ∇ₓρ) · w_j for the joints that move the link.

    Args:
        maps, pairs: of the same scene and posture, or postures.
        chosen: (p,) indices of links and of obstacles; with N postures theirs come first.
        start, end: the segments, as for `link_clearance` [m].
        columns: (6, n) joint screws at the base origin, or (N, 6, n).
        moves: (c, n) 1 where a joint moves a link, else 0.

    Returns:
        (p, n) gradients in q, and (p,) rates of ρ caused by the obstacles' own motion.
    """
    segments, link, obstacles = chosen[:-1], chosen[-2], chosen[-1]
    y = np.moveaxis(pairs.whitened, -2, -1)[chosen]
    # In an ellipsoid's very centre every direction is as good: the guard leaves a zero gradient.
    y /= np.maximum(pairs.clearance[chosen] + 1.0, 1e-9)[:, None]
    slope = (maps.rotations[obstacles] @ (y * maps.inverse[link, obstacles])[:, :, None])[..., 0]
    first = start[segments]
    point = first + pairs.parameter[chosen][:, None] * (end[segments] - first)
    wrench = wrenches(point, slope)
    if len(segments) == 1:
        gradient = wrench @ columns
    else:
        gradient = (wrench[:, None] @ columns[segments[0]])[:, 0]
    gradient *= moves[link]
    if not maps.moving:
        return gradient, np.zeros(len(y))
    return gradient, -(slope * maps.velocities[obstacles]).sum(axis=-1)


def wrenches(points: Array, forces: Array) -> Array:
    """Return the rows [f, x × f], (p, 6), of forces (p, 3) acting at points (p, 3).

    Their products with the joint screws are the joints' shares in f · ẋ.
    """
    result = np.empty((len(points), 6))
    result[:, :3] = forces
    x, f = points.T, forces.T
    result[:, 3] = x[1] * f[2] - x[2] * f[1]
    result[:, 4] = x[2] * f[0] - x[0] * f[2]
    result[:, 5] = x[0] * f[1] - x[1] * f[0]
    return result
