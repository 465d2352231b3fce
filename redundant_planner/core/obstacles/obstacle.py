"""One obstacle, as messages and files give it."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError

Array = npt.NDArray[np.float64]

# What an obstacle may be; the numbers by which compiled code knows them are their places here.
ELLIPSOID, BOX, CYLINDER, CAPSULE, HALF_SPACE = (
    'ellipsoid', 'box', 'cylinder', 'capsule', 'half_space')
SHAPES = (ELLIPSOID, BOX, CYLINDER, CAPSULE, HALF_SPACE)

# Quaternions further from unit length than this are a mistake, not round-off.
_QUATERNION_TOLERANCE = 0.01
# Where a distance from a half-space is to count in proportion to a size, this is it [m].
_SIZE_OF_HALF_SPACE = 0.1


@dataclass(frozen=True, init=False)
class Obstacle:
    """One obstacle in the base frame; its arrays are read-only.

    The class itself makes an ellipsoid (Eqs. 4 and 5); `box`, `cylinder`, `capsule` and
    `half_space` make the other shapes.

    Attributes:
        name: what messages call it.
        shape: one of `SHAPES`.
        center: (3,) [m]; of a half-space any point of its surface.
        half_extents: (3,) positive, along the obstacle's own axes [m]: the semi-axes of an
            ellipsoid, half the size of a box, (r, r, h/2) of a cylinder, (r, r, l/2 + r) of a
            capsule.
        orientation: (4,) unit quaternion (x, y, z, w), the obstacle's axes → base axes.
        velocity: (3,) of the centre [m/s].
        angular_velocity: (3,) about the centre, in base axes [rad/s].
    """

    name: str
    shape: str
    center: Array
    half_extents: Array
    orientation: Array
    velocity: Array
    angular_velocity: Array

    def __init__(
        self, name: str, center: npt.ArrayLike, semi_axes: npt.ArrayLike,
        orientation: npt.ArrayLike = (0.0, 0.0, 0.0, 1.0),
        velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """Make an ellipsoid; the quaternion is normalised.

        Raises:
            ObstacleError: a value has the wrong length, is not finite, a semi-axis is not
                positive or the quaternion is not of unit length.
        """
        set_field = object.__setattr__  # of a frozen dataclass
        set_field(self, 'name', name)
        set_field(self, 'shape', ELLIPSOID)
        for field, given, count in (
                ('center', center, 3), ('half_extents', self._extents('semi_axes', semi_axes), 3),
                ('orientation', orientation, 4), ('velocity', velocity, 3),
                ('angular_velocity', angular_velocity, 3)):
            set_field(self, field, self._numbers(field, given, count))
        norm = float(np.linalg.norm(self.orientation))
        if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
            raise ObstacleError(
                f"obstacle '{name}': the orientation quaternion {self.orientation.tolist()} has "
                f'length {norm:.3g}; it must be 1')
        set_field(self, 'orientation', self._numbers('orientation', self.orientation / norm, 4))

    @classmethod
    def box(
        cls, name: str, center: npt.ArrayLike, size: npt.ArrayLike, **place: npt.ArrayLike,
    ) -> Obstacle:
        """Make a box.

        Args:
            name, center: as of an ellipsoid.
            size: (3,) full extents [m].
            place: orientation, velocity and angular_velocity, as of an ellipsoid.

        Raises:
            ObstacleError: as for an ellipsoid.
        """
        return cls._of(name, BOX, center, ('size', size, 0.5), place)

    @classmethod
    def cylinder(
        cls, name: str, center: npt.ArrayLike, radius: float, height: float,
        **place: npt.ArrayLike,
    ) -> Obstacle:
        """Make a cylinder around its own z axis.

        Args:
            name, center, place: as of a box.
            radius, height: [m].

        Raises:
            ObstacleError: as for an ellipsoid.
        """
        return cls._of(name, CYLINDER, center, (
            'radius, radius and half the height', (radius, radius, 0.5 * height), 1.0), place)

    @classmethod
    def capsule(
        cls, name: str, center: npt.ArrayLike, radius: float, length: float,
        **place: npt.ArrayLike,
    ) -> Obstacle:
        """Make a capsule: all within a radius of a segment, which lies along its own z axis.

        Args:
            name, center, place: as of a box.
            radius: [m].
            length: of the segment, 0 or more [m].

        Raises:
            ObstacleError: as for an ellipsoid, or the length is negative.
        """
        if length < 0.0:
            raise ObstacleError(
                f"obstacle '{name}': length is {length}; it must be 0 or more [m]")
        return cls._of(name, CAPSULE, center, (
            'radius, radius and half of all its length',
            (radius, radius, 0.5 * length + radius), 1.0), place)

    @classmethod
    def half_space(
        cls, name: str, center: npt.ArrayLike, **place: npt.ArrayLike,
    ) -> Obstacle:
        """Make all that lies below a plane through the centre, where its own z is negative.

        Raises:
            ObstacleError: as for an ellipsoid.
        """
        return cls._of(name, HALF_SPACE, center, ('size', [_SIZE_OF_HALF_SPACE] * 3, 1.0), place)

    @classmethod
    def _of(
        cls, name: str, shape: str, center: npt.ArrayLike, size: tuple[str, npt.ArrayLike, float],
        place: dict[str, npt.ArrayLike],
    ) -> Obstacle:
        """Make any shape; `size` is its name in messages, the numbers, and their factor."""
        made = cls(name, center, np.ones(3), **place)
        what, given, factor = size
        extents = factor * made._extents(what, given)
        object.__setattr__(made, 'shape', shape)
        object.__setattr__(made, 'half_extents', made._numbers(what, extents, 3))
        return made

    def after(self, time: float) -> Obstacle:
        """Return the obstacle as it is after moving and turning on for a time [s]."""
        moved = copy.copy(self)
        center = self.center + time * self.velocity
        object.__setattr__(moved, 'center', self._numbers('center', center, 3))
        turn = time * self.angular_velocity
        if turn.any():
            import pinocchio as pin  # which nodes that only read obstacles do without
            x, y, z, w = self.orientation.tolist()
            turned = (pin.Quaternion(pin.exp3(turn)) * pin.Quaternion(w, x, y, z)).coeffs()
            object.__setattr__(moved, 'orientation', self._numbers('orientation', turned, 4))
        return moved

    def _extents(self, what: str, given: npt.ArrayLike) -> Array:
        """Return three positive numbers, or say what is wrong with them."""
        value = self._numbers(what, given, 3)
        if not (value > 0.0).all():
            raise ObstacleError(f"obstacle '{self.name}': {what} are {value.tolist()}; all three "
                                'must be positive [m]')
        return value

    def _numbers(self, what: str, given: npt.ArrayLike, count: int) -> Array:
        """Return finite numbers, read-only, or say what is wrong with them."""
        value = np.array(given, dtype=float)
        if value.shape != (count,) or not np.isfinite(value).all():
            raise ObstacleError(f"obstacle '{self.name}': {what} is {value.tolist()}; "
                                f'it takes {count} finite numbers')
        value.setflags(write=False)
        return value

    @property
    def rotation(self) -> Array:
        """(3, 3) the obstacle's axes in the base frame."""
        from redundant_planner.core.obstacles.scene import rotations  # compiled: not at the start
        return rotations(self.orientation[None])[0]
