"""When and where: the times of a joint path's nodes, and the tip poses due at them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, entry, Indices, kernel, Matrix, Stack, Vector
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose

Array = npt.NDArray[np.float64]

# The nodes lie at duration · (i/N)^exponent: dense where the velocity of now is decided.
_TIME_EXPONENT = 1.5


def node_times(duration: float, nodes: int) -> Array:
    """Return the times t₀ = 0 … t_N = duration of N nodes, dense at the beginning [s]."""
    return duration * (np.arange(nodes + 1) / nodes) ** _TIME_EXPONENT


@compiled
def middles(times: Vector) -> Array:
    """Return the times (N,) half way between N + 1 others."""
    return 0.5 * (times[:-1] + times[1:])


class Poses(NamedTuple):
    """Tip poses in the base frame.

    Attributes:
        position: (N, 3) [m].
        rotation: (N, 3, 3) tip axes in the base frame.
    """

    position: Matrix
    rotation: Stack


def poses_of(poses: Sequence[Pose]) -> Poses:
    """Return single poses together."""
    return Poses(np.array([pose.position for pose in poses]),
                 np.array([pose.rotation for pose in poses]))


@entry
def poses_ahead(start: Pose, twists: Matrix, times: Vector, in_tool: bool) -> Poses:
    """Return where the tip has to be at times[1:].

    Args:
        start: the reference pose at times[0].
        twists: (N, 6) the mean ones from each time to the next [m/s, rad/s].
        times: (N + 1,) from now [s].
        in_tool: whether twists are in tool axes.
    """
    position, rotation = np.empty((len(twists), 3)), np.empty((len(twists), 3, 3))
    pose = start
    for i in range(len(twists)):
        pose = se3.integrate(pose, twists[i], times[i + 1] - times[i], in_tool)
        position[i], rotation[i] = pose
    return Poses(position, rotation)


@kernel
def error_to(due: Pose, tip: Pose, rows: Indices, in_tool: bool) -> Array:
    """Return the controlled error (m,) of a tip pose against the one that is due [m, rad]."""
    return se3.pose_error(due, tip, in_tool)[rows]
