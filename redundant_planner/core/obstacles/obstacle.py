"""One obstacle, as messages and files give it."""

from __future__ import annotations

from dataclasses import dataclass

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
        from redundant_planner.core.obstacles.scene import rotations  # compiled: not at the start
        return rotations(self.orientation[None])[0]
