"""The reference pose: where the tip would be had every commanded twist been followed exactly.

Integrating q̇ drifts (the paper says so in §1 and leaves it). The reference integrates the twist
on SE(3) instead, and the error of the measured pose against it is fed back into ẋ.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import shown, StateError
from redundant_planner.core.kernels import compiled, kernel, Matrix, Stack, Vector

Array = npt.NDArray[np.float64]

# Below this the series is exact to round-off [rad].
_SMALL_ANGLE = 1e-4
# How far R Rᵀ of a rotation matrix may be from the identity.
_NO_ROTATION = 1e-6
# No tip gets further from its base, nor does a target lie further away [m].
_FARTHEST = 1e6


class Pose(NamedTuple):
    """A tip pose in the base frame.

    Attributes:
        position: (3,) [m].
        rotation: (3, 3) tip axes in the base frame.
    """

    position: Vector
    rotation: Matrix


class Poses(NamedTuple):
    """Poses of several tips, or of one at several times, in the base frame.

    Attributes:
        position: (k, 3) [m].
        rotation: (k, 3, 3) tip axes in the base frame.
    """

    position: Matrix
    rotation: Stack

    @classmethod
    def of(cls, *poses: Pose) -> Poses:
        """Return single poses together."""
        return cls(np.array([pose.position for pose in poses]),
                   np.array([pose.rotation for pose in poses]))

    @property
    def first(self) -> Pose:
        """The first of them."""
        return Pose(self.position[0], self.rotation[0])

    @property
    def each(self) -> tuple[Pose, ...]:
        """All of them, one by one."""
        return tuple(map(Pose, self.position, self.rotation))


class Place(NamedTuple):
    """A point or vector as plain numbers, which the compiler keeps in registers [m]."""

    x: float
    y: float
    z: float


@kernel
def one_pose(poses: Poses, i: int) -> Pose:
    """Return one of several poses, as views."""
    return Pose(poses.position[i], poses.rotation[i])


@kernel
def place(points: Matrix, i: int) -> Place:
    """Return a point (k, 3) as numbers."""
    return Place(points[i, 0], points[i, 1], points[i, 2])


def _is_rotation(matrix: Array) -> bool:
    """Return whether rows (3, 3) are unit vectors at right angles, and right-handed.

    In plain Python: it is looked at in every tick, and NumPy takes 40 µs for it.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    off = (a * a + b * b + c * c - 1.0, d * d + e * e + f * f - 1.0, g * g + h * h + i * i - 1.0,
           a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i)
    volume = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return all(abs(number) < _NO_ROTATION for number in off) and volume > 0.0


def same_poses(one: Pose | Poses, other: Pose | Poses) -> bool:
    """Return whether poses are the same numbers."""
    return (one.position.tolist() == other.position.tolist()
            and one.rotation.tolist() == other.rotation.tolist())


def checked_pose(pose: Pose) -> Pose:
    """Return a pose as arrays of numbers.

    Raises:
        StateError: the position is not three finite numbers or absurdly far, or the rotation is
            no rotation matrix.
    """
    try:
        position = np.asarray(pose.position, dtype=float)
        rotation = np.asarray(pose.rotation, dtype=float)
    except (TypeError, ValueError):
        raise StateError(f'the pose is {shown(pose)}; it takes numbers') from None
    if position.shape != (3,) or not all(map(math.isfinite, position.tolist())):
        raise StateError(f'the position of the pose is {shown(position)}; it takes three finite '
                         'numbers [m]')
    if max(map(abs, position.tolist())) > _FARTHEST:
        raise StateError(f'the position of the pose is {shown(position)}; it must be within '
                         f'{_FARTHEST:g} m')
    if rotation.shape != (3, 3) or not _is_rotation(rotation):
        raise StateError(f'the rotation of the pose is {shown(rotation)}; it takes a rotation '
                         'matrix (3, 3)')
    return Pose(position, rotation)


@kernel
def rotation_of(vector: Vector) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    x, y, z = vector
    squared = x * x + y * y + z * z
    angle = math.sqrt(squared)
    small = angle < _SMALL_ANGLE
    first = 1.0 - squared / 6.0 if small else math.sin(angle) / angle
    second = 0.5 - squared / 24.0 if small else (1.0 - math.cos(angle)) / squared
    return np.array((
        (1.0 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y),
        (second * x * y + first * z, 1.0 - second * (x * x + z * z), second * y * z - first * x),
        (second * x * z - first * y, second * y * z + first * x, 1.0 - second * (x * x + y * y))))


@kernel
def rotation_vector(rotation: Matrix) -> Array:
    """Return the rotation vector (3,) of a rotation matrix (3, 3), no longer than π [rad].

    By way of the quaternion, from its largest entry (Shepperd 1978): exact at any angle.
    """
    r = rotation
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    largest = 0
    for axis in range(1, 3):
        if r[axis, axis] > r[largest, largest]:
            largest = axis
    quaternion = np.empty(3)
    if trace > r[largest, largest]:
        scalar = 1.0 + trace
        quaternion[0], quaternion[1] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0]
        quaternion[2] = r[1, 0] - r[0, 1]
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        scalar = r[k, j] - r[j, k]
        quaternion[i] = 1.0 + r[i, i] - r[j, j] - r[k, k]
        quaternion[j], quaternion[k] = r[j, i] + r[i, j], r[k, i] + r[i, k]
    x, y, z = quaternion
    size = math.sqrt(x * x + y * y + z * z)
    if size > 0.0:
        quaternion *= 2.0 * math.atan2(size, abs(scalar)) / (size if scalar >= 0.0 else -size)
    return quaternion


@kernel
def cross(a: Vector, b: Vector) -> Array:
    """Return a × b, (3,)."""
    return np.array((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                     a[0] * b[1] - a[1] * b[0]))


@kernel
def _product(a: Matrix, b: Matrix) -> Array:
    product = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                product[i, j] += a[i, k] * b[k, j]
    return product


@kernel
def _turned(rotation: Matrix, vector: Vector) -> Array:
    turned = np.zeros(3)
    for i in range(3):
        for k in range(3):
            turned[i] += rotation[i, k] * vector[k]
    return turned


@compiled
def integrate(pose: Pose, twist: Vector, dt: float, in_tool: bool) -> Pose:
    """Return the pose after a constant twist has acted for `dt`, exactly.

    A twist in base axes is the tip point's velocity and the angular velocity, so position and
    orientation integrate separately; a twist in tool axes turns with the tool, a screw motion.

    Args:
        pose: where it starts.
        twist: (6,) [m/s, rad/s] of the tip point.
        dt: [s].
        in_tool: whether the twist is in tool axes.
    """
    v, w = twist[:3] * dt, twist[3:] * dt
    turn = rotation_of(w)
    if not in_tool:
        return Pose(pose.position + v, _product(turn, pose.rotation))
    # The tool turns while it moves: ∫ exp(w s) v ds over the tick.
    squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    angle = math.sqrt(squared)
    small = angle < _SMALL_ANGLE
    first = 0.5 - squared / 24.0 if small else (1.0 - math.cos(angle)) / squared
    second = (1.0 / 6.0 - squared / 120.0 if small
              else (angle - math.sin(angle)) / (squared * angle))
    sideways = cross(w, v)
    moved = v + first * sideways + second * cross(w, sideways)
    return Pose(pose.position + _turned(pose.rotation, moved), _product(pose.rotation, turn))


def stacked(pose: Pose | Poses) -> Poses:
    """Return one pose, or several, as several."""
    return Poses.of(pose) if isinstance(pose, Pose) else pose


def composed(outer: Pose, inner: Pose) -> Pose:
    """Return a pose that is given relative to another one, in the frame of that one."""
    return Pose(outer.position + outer.rotation @ inner.position, outer.rotation @ inner.rotation)


def turned(twist: Array, rotation: Array) -> Array:
    """Return a twist (6,) in the axes that `rotation` (3, 3) takes its own to."""
    return np.concatenate((rotation @ twist[:3], rotation @ twist[3:]))


@compiled
def pose_error(reference: Pose, actual: Pose, in_tool: bool) -> Array:
    """Return the displacement (6,) [m, rad] from `actual` to `reference`, in command axes.

    Position and orientation errors are separate vectors: the difference of positions, and the
    rotation vector of the remaining rotation.
    """
    displacement = reference.position - actual.position
    rotation = rotation_vector(_product(reference.rotation, actual.rotation.T))
    if in_tool:
        displacement = _turned(actual.rotation.T, displacement)
        rotation = _turned(actual.rotation.T, rotation)
    error = np.empty(6)
    for axis in range(3):
        error[axis], error[3 + axis] = displacement[axis], rotation[axis]
    return error


@compiled
def poses_error(reference: Poses, actual: Poses, in_tool: bool) -> Array:
    """Return the displacements (6 t,) [m, rad] of t tips, see `pose_error`."""
    error = np.empty(6 * len(actual.position))
    for t in range(len(actual.position)):
        error[6 * t:6 * t + 6] = pose_error(one_pose(reference, t), one_pose(actual, t), in_tool)
    return error


@compiled
def displaced(pose: Pose, error: Vector, in_tool: bool) -> Pose:
    """Return the pose whose `pose_error` against `pose` is `error`."""
    displacement, rotation = error[:3].copy(), error[3:].copy()
    if in_tool:
        displacement = _turned(pose.rotation, displacement)
        rotation = _turned(pose.rotation, rotation)
    return Pose(pose.position + displacement, _product(rotation_of(rotation), pose.rotation))


@kernel
def bounded(error: Vector, distance: float, angle: float) -> Array:
    """Return the error (6,) with its linear and angular parts no longer than the caps.

    Args:
        error: (6,) from `pose_error` [m, rad].
        distance: cap of the linear part [m].
        angle: cap of the angular part [rad].
    """
    result = error.copy()
    for part in range(2):
        x = result[3 * part:3 * part + 3]
        size = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        cap = angle if part else distance
        if size > cap:
            x *= cap / size
    return result


@compiled
def feedback(error: Vector, gain: float, speed: float, angular_speed: float) -> Array:
    """Return the twist (6,) that takes the error back at `gain`, never faster than the caps.

    Args:
        error: (6,) from `pose_error` [m, rad].
        gain: [1/s].
        speed: cap of the linear part [m/s].
        angular_speed: cap of the angular part [rad/s].
    """
    return bounded(gain * error, speed, angular_speed)
