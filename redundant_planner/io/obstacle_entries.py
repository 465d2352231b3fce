"""Obstacles as parameter and scenario files give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, ObstacleError, ParameterError, shown
from redundant_planner.core.numbers import floats_of
from redundant_planner.core.obstacles.obstacle import BOX, CAPSULE, CYLINDER, ELLIPSOID, Obstacle
from redundant_planner.io.parameter_files import check_keys, entries_of
from redundant_planner.io.poses import pose_of

Array = npt.NDArray[np.float64]

# What the shape of a static obstacle may be.
SHAPES = (ELLIPSOID, BOX, CYLINDER, CAPSULE)
# How far the two widths of what is round may differ [m].
_ROUND = 1e-9


def obstacle_of(name: str, entry: Mapping[str, Any]) -> Obstacle:
    """Return an obstacle from its entry in a parameter or scenario file.

    The entry has a `shape`, the full extents `size` and a `pose`. Of an ellipsoid, which is what
    it is without a shape, `semi_axes` may stand for the size; `center` and `orientation` may
    stand for the pose.

    Raises:
        ObstacleError, ParameterError: with what is wrong.
    """
    if not isinstance(entry, Mapping):
        raise ParameterError(f"obstacle '{name}' is {shown(entry)}; it takes 'shape', 'size' and "
                             "'pose'")
    shape = entry.get('shape', ELLIPSOID)
    if shape not in SHAPES:
        raise ObstacleError(f"obstacle '{name}': shape is {shown(shape)}; it must be one of "
                            f'{known(SHAPES)}')
    where = ('pose',) if 'pose' in entry else ('center',)
    size = ('semi_axes',) if shape == ELLIPSOID and 'size' not in entry else ('size',)
    check_keys(f"obstacle '{name}'", entry, (*where, *size), (
        'shape', 'velocity', 'angular_velocity', 'name',
        *(() if 'pose' in entry else ('orientation',))))
    numbers = {key: _numbers(name, key, entry[key]) for key in entry
               if key not in ('name', 'shape')}
    place: dict[str, Array] = {
        key: numbers[key] for key in ('orientation', 'velocity', 'angular_velocity')
        if key in numbers}
    center = numbers.get('center', np.zeros(3))
    if 'pose' in entry:
        center, place['orientation'] = pose_of(f"obstacle '{name}': pose", numbers['pose'])
    if 'semi_axes' in numbers:
        return Obstacle(name, center, numbers['semi_axes'], **place)
    return _of_size(name, shape, numbers['size'], center, place)


def _of_size(
    name: str, shape: str, size: Array, center: Array, place: dict[str, Array],
) -> Obstacle:
    """Return an obstacle by its full extents (3,)."""
    box = Obstacle.box(name, center, size, **place)  # which checks the numbers
    x, y, z = size.tolist()
    if shape == BOX:
        return box
    if shape == ELLIPSOID:
        return Obstacle(name, center, 0.5 * size, **place)
    if abs(x - y) > _ROUND:
        raise ObstacleError(f"obstacle '{name}': size is {size.tolist()}; the first two numbers "
                            f'of a {shape}, its width, must be the same')
    if shape == CYLINDER:
        return Obstacle.cylinder(name, center, 0.5 * x, z, **place)
    if z < x:
        raise ObstacleError(f"obstacle '{name}': size is {size.tolist()}; the last number of a "
                            'capsule, its length with both round ends, must not be less than its '
                            'width')
    return Obstacle.capsule(name, center, 0.5 * x, z - x, **place)


def _numbers(name: str, key: str, given: Any) -> Array:
    numbers = floats_of(given)
    if numbers.ndim != 1:
        raise ObstacleError(f"obstacle '{name}': {key} is {shown(given)}; it takes a list of "
                            'numbers')
    return numbers


def static_obstacles(values: Mapping[str, Any]) -> list[Obstacle]:
    """Return the static obstacles among parameter values.

    Raises:
        ObstacleError, ParameterError: with what is wrong.
    """
    return [obstacle_of(name, entry)
            for name, entry in entries_of(values, 'static_obstacle').items()]
