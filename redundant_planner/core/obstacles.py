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
        x, y, z, w = self.orientation
        return np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


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
        axes: (k, 3, 3) rotation into the ellipsoid's axes, Rᵀ.
        offsets: (k, 3) Rᵀ c [m].
        scales: (c, k, 3) 1 / inflated semi-axes, one row per link radius [1/m].
        steepest: (c, k) the largest of `scales`, 1 / smallest inflated semi-axis [1/m].
        velocities: (k, 3) obstacle velocities in the base frame [m/s].
        speeds: (k,) their size [m/s].
    """

    axes: Array
    offsets: Array
    scales: Array
    steepest: Array
    velocities: Array
    speeds: Array


def whitening(scene: Scene, radii: npt.ArrayLike) -> Whitening:
    """Prepare a scene for links of the given radii (c,) [m]."""
    axes = scene.rotations.transpose(0, 2, 1).copy()
    offsets = (axes @ scene.centers[:, :, None])[:, :, 0]
    radii = np.asarray(radii, dtype=float)
    inflated = inflated_semi_axes(scene.semi_axes[None], radii[:, None])
    scales = 1.0 / inflated
    return Whitening(axes, offsets, scales, scales.max(axis=-1), scene.velocities,
                     np.sqrt(np.square(scene.velocities).sum(axis=-1)))


class Pairs(NamedTuple):
    """Every link × every obstacle.

    Attributes:
        whitened: (c, k, 3) y at the link's nearest point, |y| = ρ + 1.
        clearance: (c, k) ρ there; negative inside.
        parameter: (c, k) where on the segment, 0 at its start, 1 at its end.
    """

    whitened: Array
    clearance: Array
    parameter: Array


def link_clearance(maps: Whitening, start: Array, end: Array) -> Pairs:
    """Return the smallest ρ of every obstacle over every whole link, in closed form.

    S(t) = |y₀ + t d|² − 1 has its minimum over [0, 1] at t = clip(−y₀·d / d·d).

    Args:
        maps: from `whitening`, with one row of scales per link.
        start: (c, 3) segment starts in the base frame [m].
        end: (c, 3) segment ends in the base frame [m].
    """
    links, obstacles = len(start), len(maps.axes)
    # One product rotates both ends of all links into all obstacles' axes: (3k, 3) @ (3, 2c).
    ends = np.concatenate((start, end - start)).T
    turned = (maps.axes.reshape(-1, 3) @ ends).reshape(obstacles, 3, 2, links)
    first = (turned[:, :, 0].transpose(2, 0, 1) - maps.offsets) * maps.scales
    along = turned[:, :, 1].transpose(2, 0, 1) * maps.scales
    squared = (along * along).sum(axis=-1)
    parameter = -(first * along).sum(axis=-1) / np.maximum(squared, np.finfo(float).tiny)
    parameter = np.minimum(np.maximum(parameter, 0.0), 1.0)
    whitened = first + parameter[:, :, None] * along
    clearance = np.sqrt((whitened * whitened).sum(axis=-1)) - 1.0
    return Pairs(whitened, clearance, parameter)


def pseudo_distance(clearance: Array) -> Array:
    """Return S (Eq. 6) of the level ρ: S = (ρ + 1)² − 1."""
    return clearance * (clearance + 2.0)


def clearance_gradients(
    maps: Whitening, pairs: Pairs, links: npt.NDArray[np.intp], obstacles: npt.NDArray[np.intp],
    start: Array, end: Array, columns: Array, joint_count: npt.NDArray[np.intp],
) -> tuple[Array, Array]:
    """Return ∂ρ/∂q and ∂ρ/∂t of the chosen pairs.

    At the minimising point x of the link, ∇ₓρ = Aᵀ y/|y|; the parameter t of that point does
    not contribute (envelope theorem). With joint screws [v; w] at the base origin,
    ∂ρ/∂q_j = ∇ₓρ · v_j + (x × ∇ₓρ) · w_j for the joints that move the link.

    Args:
        maps, pairs: of the same scene and posture.
        links, obstacles: (p,) indices of the chosen pairs.
        start, end: (c, 3) the segments [m].
        columns: (6, n) joint screws at the base origin.
        joint_count: (c,) number of leading joints that move each link.

    Returns:
        (p, n) gradients in q, and (p,) rates of ρ caused by the obstacles' own motion.
    """
    y = pairs.whitened[links, obstacles]
    # In an ellipsoid's very centre every direction is as good: the guard leaves a zero gradient.
    length = np.maximum(pairs.clearance[links, obstacles] + 1.0, 1e-9)
    scaled = y / length[:, None] * maps.scales[links, obstacles]
    slope = (scaled[:, None, :] @ maps.axes[obstacles])[:, 0]
    first = start[links]
    point = first + pairs.parameter[links, obstacles][:, None] * (end[links] - first)
    wrench = np.empty((len(y), 6))
    wrench[:, :3] = slope
    x, f = point.T, slope.T
    wrench[:, 3] = x[1] * f[2] - x[2] * f[1]
    wrench[:, 4] = x[2] * f[0] - x[0] * f[2]
    wrench[:, 5] = x[0] * f[1] - x[1] * f[0]
    gradient = wrench @ columns
    gradient[np.arange(columns.shape[1]) >= joint_count[links][:, None]] = 0.0
    return gradient, -(slope * maps.velocities[obstacles]).sum(axis=-1)
