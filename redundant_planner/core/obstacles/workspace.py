"""The walls of a workspace: half-spaces that links keep out of."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.obstacle import Obstacle

_HALF = math.sqrt(0.5)
# Side → quaternion (x, y, z, w) that turns z into the direction away from that wall.
_INWARD = {
    'x_min': (0.0, _HALF, 0.0, _HALF), 'y_min': (-_HALF, 0.0, 0.0, _HALF),
    'z_min': (0.0, 0.0, 0.0, 1.0), 'x_max': (0.0, -_HALF, 0.0, _HALF),
    'y_max': (_HALF, 0.0, 0.0, _HALF), 'z_max': (1.0, 0.0, 0.0, 0.0)}


def check_box(name: str, box: Sequence[float]) -> None:
    """Make sure that a parameter is a box or empty.

    Args:
        name: of the parameter, for the message.
        box: x_min, y_min, z_min, x_max, y_max, z_max [m].

    Raises:
        ParameterError: it has another length, or the box is empty.
    """
    if not len(box):
        return
    if len(box) != len(_INWARD):
        raise ParameterError(f"parameter '{name}' has {len(box)} entries; it takes 6, "
                             'x_min y_min z_min x_max y_max z_max, or none')
    for axis, least, most in zip('xyz', box[:3], box[3:]):
        if not least < most:
            raise ParameterError(f"parameter '{name}' has {axis}_min {least} and {axis}_max "
                                 f'{most}; {axis}_min must be less')


def walls(workspace: Sequence[float]) -> tuple[Obstacle, ...]:
    """Return the six walls of a box, or none of an empty list.

    Args:
        workspace: x_min, y_min, z_min, x_max, y_max, z_max in the base frame [m].

    Raises:
        ParameterError: it has another length, or the box is empty.
    """
    check_box('workspace', workspace)
    if not len(workspace):
        return ()
    corners = {'min': np.array(workspace[:3]), 'max': np.array(workspace[3:])}
    return tuple(
        Obstacle.half_space(f'workspace {side}', corners[side[2:]], orientation=inward)
        for side, inward in _INWARD.items())
