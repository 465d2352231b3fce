"""When and where: the times of a joint path's nodes, and the tip poses due at them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.kernels import compiled, entry, Indices, kernel, Matrix, Vector
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import one_pose, Poses

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


@entry
def poses_ahead(start: Poses, twists: Matrix, times: Vector, in_tool: bool) -> Poses:
    """Return where the tips have to be at times[1:], all of them at the first time first.

    Args:
        start: the reference poses at times[0].
        twists: (N, 6 t) the mean ones from each time to the next [m/s, rad/s].
        times: (N + 1,) from now [s].
        in_tool: whether twists are in tool axes.
    """
    count, tips = len(twists), len(start.position)
    ahead = Poses(np.empty((count * tips, 3)), np.empty((count * tips, 3, 3)))
    for t in range(tips):
        pose = one_pose(start, t)
        for i in range(count):
            pose = se3.integrate(
                pose, twists[i, 6 * t:6 * t + 6], times[i + 1] - times[i], in_tool)
            ahead.position[i * tips + t], ahead.rotation[i * tips + t] = pose
    return ahead


@kernel
def poses_at(poses: Poses, node: int, tips: int) -> Poses:
    """Return the poses of the tips at a node, of those at all nodes, as views."""
    first, last = node * tips, (node + 1) * tips
    return Poses(poses.position[first:last], poses.rotation[first:last])


@kernel
def error_to(due: Poses, tips: Poses, rows: Indices, in_tool: bool) -> Array:
    """Return the controlled error (m,) of tips' poses against those that are due [m, rad]."""
    error = np.empty(len(rows))
    for t in range(len(tips.position)):
        apart = se3.pose_error(one_pose(due, t), one_pose(tips, t), in_tool)
        for i in range(len(rows)):
            if 0 <= rows[i] - 6 * t < 6:
                error[i] = apart[rows[i] - 6 * t]
    return error
