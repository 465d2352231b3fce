"""One obstacle, as messages and files give it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ObstacleError

Array = npt.NDArray[np.float64]

# Quaternions further from unit length than this are a mistake, not round-off.
_QUATERNION_TOLERANCE = 0.01


@dataclass(frozen=True, init=False)
class Obstacle:
    """One ellipsoid in the base frame (Eqs. 4 and 5); its arrays are read-only.

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
    orientation: Array
    velocity: Array

    def __init__(
        self, name: str, center: npt.ArrayLike, semi_axes: npt.ArrayLike,
        orientation: npt.ArrayLike = (0.0, 0.0, 0.0, 1.0),
        velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        """Check the numbers and normalise the quaternion; the class says what they are.

        Raises:
            ObstacleError: a value has the wrong length, is not finite, a semi-axis is not
                positive or the quaternion is not of unit length.
        """
        object.__setattr__(self, 'name', name)
        values = {'center': (center, 3), 'semi_axes': (semi_axes, 3),
                  'orientation': (orientation, 4), 'velocity': (velocity, 3)}
        for field, (given, size) in values.items():
            value = np.array(given, dtype=float)
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
        for field in values:
            getattr(self, field).setflags(write=False)

    @property
    def rotation(self) -> Array:
        """(3, 3) ellipsoid axes in the base frame."""
        from redundant_planner.core.obstacles.scene import rotations  # compiled: not at the start
        return rotations(self.orientation[None])[0]
