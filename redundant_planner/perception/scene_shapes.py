"""Shapes of MoveIt's collision objects as the planner takes them.

The messages are read by the names of their fields alone: moveit_msgs need not be installed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError, shown
from redundant_planner.core.obstacles.scene import rotations
from redundant_planner.io.marker_reader import CUBE, CYLINDER, SPHERE
from redundant_planner.io.obstacle_bounds import FARTHEST, LARGEST, SMALLEST

Array = npt.NDArray[np.float64]

# A solid that is a plane: all points of its frame whose z is 0. No type of marker has this number.
PLANE = 0
# The numbers of shape_msgs/SolidPrimitive.
_BOX, _SPHERE, _CYLINDER, _CONE, _PRISM = range(1, 6)
_PRIMITIVES = {_BOX: ('box', 3), _SPHERE: ('sphere', 1), _CYLINDER: ('cylinder', 2),
               _CONE: ('cone', 2), _PRISM: ('prism', 1)}
# Vertices of a mesh that are read.
MOST_VERTICES = 1_000_000
# What a box around a flat mesh is thick at least [m].
_THINNEST = 10.0 * SMALLEST
# Along the mesh's own axes, unless a box along its principal axes is smaller than this share.
_MUCH_SMALLER = 0.9


class Solid(NamedTuple):
    """One shape of an object.

    Attributes:
        kind: a type of marker, SPHERE, CUBE or CYLINDER, or `PLANE`.
        size: (3,) full extents along the axes of its own frame [m].
        pose: (4, 4) of the shape in the frame of the object, as messages give it.
        inner: (4, 4) of the solid's frame in that of the shape: a mesh's box, a plane's normal.
    """

    kind: int
    size: Array
    pose: Array
    inner: Array

    @property
    def in_object(self) -> Array:
        """(4, 4) the pose of the solid in the frame of the object."""
        return self.pose @ self.inner


class Shapes(NamedTuple):
    """What a message says of an object.

    Attributes:
        pose: (4, 4) of the object in the frame of its header.
        solids: those that can be used.
        remarks: a sentence for each that cannot, or is taken for something else.
    """

    pose: Array
    solids: tuple[Solid, ...]
    remarks: tuple[str, ...]


def inverse(pose: Array) -> Array:
    """Return the inverse of a pose (4, 4)."""
    back = np.eye(4)
    back[:3, :3] = pose[:3, :3].T
    back[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return back


def placement(position: npt.ArrayLike, rotation: npt.ArrayLike) -> Array:
    """Return the pose (4, 4) of a position (3,) and a rotation matrix (3, 3)."""
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = position, rotation
    return pose


def pose_of_message(message: Any) -> Array:
    """Return a geometry_msgs/Pose as (4, 4).

    Quaternions are normalised, and one of zeros is none, as MoveIt has it.

    Raises:
        ObstacleError: a number is not finite or absurd.
    """
    at, turn = message.position, message.orientation
    return _pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))


def pose_of_transform(message: Any) -> Array:
    """Return a geometry_msgs/Transform as `pose_of_message` does."""
    at, turn = message.translation, message.rotation
    return _pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> Array:
    numbers = np.array([*position, *quaternion], dtype=float)
    if not (np.abs(numbers) <= FARTHEST).all():
        raise ObstacleError(f'has the pose {numbers.tolist()} (x y z, quaternion x y z w); it '
                            f'takes finite numbers up to {FARTHEST:g}')
    turn = numbers[3:]
    largest = np.abs(turn).max()
    if largest == 0.0:
        return placement(numbers[:3], np.eye(3))
    # Squares of tiny numbers would be zero.
    return placement(numbers[:3], rotations((turn / largest)[None])[0])


def shapes_of(message: Any) -> Shapes:
    """Return pose and shapes of a moveit_msgs/CollisionObject.

    A shape without a pose of its own has the object's. The pose of the only shape of an object
    whose own pose says nothing is the object's, as MoveIt has it: that pose is what MOVE replaces.

    Raises:
        ObstacleError: the object's pose is of no use, or it has more poses than shapes.
    """
    groups: tuple[tuple[str, Sequence[Any], Sequence[Any], Callable[[Any], _Read]], ...] = (
        ('primitive', message.primitives, message.primitive_poses, _primitive),
        ('mesh', message.meshes, message.mesh_poses, _mesh),
        ('plane', message.planes, message.plane_poses, _plane))
    for what, shapes, poses, _ in groups:
        if len(poses) > len(shapes):
            raise ObstacleError(f'has {len(poses)} poses of {what} shapes, and {len(shapes)} such '
                                'shapes; it takes one for each, or none')
    own = pose_of_message(message.pose)
    remarks: list[str] = []
    solids = []
    for what, shapes, poses, read in groups:
        if 0 < len(poses) < len(shapes):
            remarks.append(f'{what} {len(poses)} and those after it have no pose: they are where '
                           'the object is')
        for number, shape in enumerate(shapes):
            try:
                pose = pose_of_message(poses[number]) if number < len(poses) else np.eye(4)
                kind, size, inner, remark = read(shape)
            except ObstacleError as error:
                remarks.append(f'{what} {number} {error}; it is left out')
                continue
            solids.append(Solid(kind, size, pose, inner))
            if remark:
                remarks.append(f'{what} {number} {remark}')
    if sum(len(shapes) for _, shapes, _, _ in groups) == 1 and solids and _says_nothing(
            message.pose):
        own, solids = solids[0].pose, [solids[0]._replace(pose=own)]
    return Shapes(own, tuple(solids), tuple(remarks))


def _says_nothing(pose: Any) -> bool:
    at, turn = pose.position, pose.orientation
    return (at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w) == (0, 0, 0, 0, 0, 0, 1)


# Kind, size, inner pose, and a remark, '' for none.
_Read = tuple[int, Array, Array, str]


def _primitive(shape: Any) -> _Read:
    """Return a shape_msgs/SolidPrimitive.

    Raises:
        ObstacleError: it is of a type that is not known, or its dimensions are none.
    """
    kind = int(shape.type)
    if kind not in _PRIMITIVES:
        names = ', '.join(f'{name} ({number})' for number, (name, _) in _PRIMITIVES.items())
        raise ObstacleError(f'has the type {kind}; it must be {names}')
    name, count = _PRIMITIVES[kind]
    given = np.array([float(number) for number in shape.dimensions])
    if len(given) < count:
        raise ObstacleError(f'is a {name} with the dimensions {given.tolist()}; it takes {count}')
    given = given[:count]
    if not ((given >= SMALLEST) & (given <= 0.5 * LARGEST)).all():
        raise ObstacleError(f'is a {name} with the dimensions {given.tolist()}; they must be from '
                            f'{SMALLEST:g} to {0.5 * LARGEST:g} m')
    if kind == _BOX:
        return CUBE, given, np.eye(4), ''
    if kind == _SPHERE:
        return SPHERE, np.full(3, 2.0 * given[0]), np.eye(4), ''
    if kind == _PRISM:
        corners = np.array([[point.x, point.y, end * given[0]] for point in shape.polygon.points
                            for end in (-0.5, 0.5)], dtype=float).reshape(-1, 3)
        size, inner = _box_around(corners, 'prism')
        return CUBE, size, inner, 'is a prism: it counts as the box around it'
    height, radius = given.tolist()
    remark = 'is a cone: it counts as the cylinder around it' if kind == _CONE else ''
    return CYLINDER, np.array([2.0 * radius, 2.0 * radius, height]), np.eye(4), remark


def _mesh(shape: Any) -> _Read:
    """Return the box around a shape_msgs/Mesh.

    Raises:
        ObstacleError: it has no vertices, too many, or one that is no point.
    """
    if len(shape.vertices) > MOST_VERTICES:
        raise ObstacleError(f'is a mesh of {len(shape.vertices)} vertices; up to {MOST_VERTICES} '
                            'are read')
    size, inner = _box_around(np.array(
        [(v.x, v.y, v.z) for v in shape.vertices], dtype=float).reshape(-1, 3), 'mesh')
    return CUBE, size, inner, 'is a mesh: it counts as the box around it'


def _box_around(points: Array, what: str) -> tuple[Array, Array]:
    """Return size (3,) and pose (4, 4) of a box around points (k, 3) [m].

    Raises:
        ObstacleError: there are no points, or some are not finite or absurdly far.
    """
    if not len(points):
        raise ObstacleError(f'is a {what} without vertices')
    if not (np.abs(points) <= FARTHEST).all():
        bad = points[~(np.abs(points) <= FARTHEST).all(axis=1)][0]
        raise ObstacleError(f'is a {what} with a vertex at {bad.tolist()}; it takes finite '
                            f'numbers up to {FARTHEST:g} m')
    boxes = [_box_along(np.eye(3), points)]
    centered = points - points.mean(axis=0)
    _, principal = np.linalg.eigh(centered.T @ centered)
    principal[:, 0] *= np.sign(np.linalg.det(principal)) or 1.0
    boxes.append(_box_along(principal, points))
    volumes = [float(np.prod(size)) for size, _ in boxes]
    return boxes[int(volumes[1] < _MUCH_SMALLER * volumes[0])]


def _box_along(axes: Array, points: Array) -> tuple[Array, Array]:
    """Return size and pose of the box around points (k, 3) along axes (3, 3), its columns."""
    along = points @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    return np.maximum(high - low, _THINNEST), placement(axes @ (0.5 * (low + high)), axes)


def _plane(shape: Any) -> _Read:
    """Return a shape_msgs/Plane, a x + b y + c z + d = 0.

    Raises:
        ObstacleError: it has other coefficients, or they make no plane.
    """
    given = np.array([float(number) for number in shape.coef])
    length = float(np.linalg.norm(given[:3])) if len(given) == 4 else 0.0
    if not 0.0 < length < np.inf or not abs(given[3]) <= FARTHEST * length:
        raise ObstacleError(f'is a plane with the coefficients {shown(given.tolist())}; it takes '
                            'a b c d of a x + b y + c z + d = 0, not all of a b c zero, within '
                            f'{FARTHEST:g} m')
    normal = given[:3] / length
    # Any axis that is not along the normal makes a frame with it.
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    axes = np.column_stack([across, np.cross(normal, across), normal])
    return PLANE, np.zeros(3), placement(-given[3] / length * normal, axes), ''


def moved(solids: Sequence[Solid], poses: Iterable[Any]) -> tuple[Solid, ...]:
    """Return solids at other poses within their object, which a message gives.

    Raises:
        ObstacleError: a pose is of no use, or there are not as many as solids.
    """
    read = [pose_of_message(pose) for pose in poses]
    if len(read) != len(solids):
        raise ObstacleError(f'is given {len(read)} poses of shapes, and it has {len(solids)}')
    return tuple(solid._replace(pose=pose) for solid, pose in zip(solids, read))
