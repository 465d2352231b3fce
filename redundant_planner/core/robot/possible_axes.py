"""Which axes of a twist a chain can follow: a planar arm, or one with five joints, has fewer."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
import numpy.typing as npt

from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Random postures that are looked at: the best of them is far from every singularity.
_POSTURES = 100
# A singular value below this share of the largest, at the best posture, is none: arms that can
# move along every axis have 0.08 and more, and rounded angles of a URDF leave 1e-3 and less.
_NONE = 0.01
# A tip whose places lie no further apart only turns [m].
_IN_PLACE = 1e-6


def possible_axes(robot: Robot) -> tuple[str, ...]:
    """Return the axes that a twist may have, of an arm that controls all six of one tip.

    They are the first of these that the arm can follow independently of each other:

    - all axes along and about which the arm moves: all six, or those of a planar arm or a SCARA;
    - the position. The rotations that an arm of five joints has change with its posture;
    - one axis after the other, as far as each adds a motion.
    """
    jacobians = _scaled_jacobians(robot)
    sizes = np.abs(jacobians).max(axis=(0, 2))
    moving = np.flatnonzero(sizes > _NONE * sizes.max()).tolist()
    position = [row for row in moving if row < 3]
    chosen: list[int] = []
    if _rank(jacobians, moving) == len(moving):
        chosen = moving
    elif len(position) == 3 == _rank(jacobians, position):
        chosen = position
    else:
        for row in moving:
            if _rank(jacobians, [*chosen, row]) > len(chosen):
                chosen = [*chosen, row]
    return tuple(AXES[row] for row in chosen)


def is_overdetermined(robot: Robot) -> bool:
    """Return whether there is no posture at which the arm can follow any twist of its axes."""
    return robot.n < robot.m or _rank(_scaled_jacobians(robot), range(robot.m)) < robot.m


def _scaled_jacobians(robot: Robot) -> Array:
    """Return J at random postures (k, m, n), its angular rows times the size of the workspace."""
    limited = np.isfinite(robot.position_max - robot.position_min)
    low = np.where(limited, robot.position_min, -math.pi)
    high = np.where(limited, robot.position_max, math.pi)
    arms = robot.kinematics_along(
        np.random.default_rng(0).uniform(low, high, (_POSTURES, robot.n)))
    size = 0.5 * float(np.linalg.norm(np.ptp(arms.tip_positions.reshape(-1, 3), axis=0)))
    if size < _IN_PLACE:
        size = 1.0
    return np.where(robot.rows[:, None] % 6 < 3, 1.0, size) * arms.jacobian


def _rank(jacobians: Array, rows: Sequence[int]) -> int:
    """Return how many independent motions along some rows of J (k, m, n) there are at best."""
    values = np.linalg.svd(jacobians[:, list(rows)], compute_uv=False)
    return int((values > _NONE * values[:, :1]).sum(axis=1).max(initial=0))
