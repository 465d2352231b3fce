"""How far the tip was from the path that it was commanded along."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis import metrics
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.io.joint_chunk import GAP

Array = npt.NDArray[np.float64]

# How many samples of the commanded path are searched for the one next to the tip.
_BEHIND, _AHEAD = 20, 400
# For how long an arm whose command has ended goes on along its path until it rests [s].
_BRAKING = 0.5


def path_errors(
    robot: Robot, times: Array, twists: Array, tips: Array, rotations: Array, ends: Array,
) -> Array:
    """Return the distance (k,) of the tip from the path it was commanded along [m].

    A path begins where the tip is when a command begins, and leads where the twists do, each
    held until the next sample, and on along the last one while the arm brakes. How fast the tip
    goes along it does not count. NaN before the first command, and from a target on: nothing says
    where the tip shall be on its way.

    Args:
        robot: the arm.
        times: (k,) [s].
        twists: (k, 6) in the command frame.
        tips, rotations: (k, 3) and (k, 3, 3) of the tip.
        ends: when targets came [s], ascending.
    """
    moving = np.asarray(twists.any(axis=1))
    errors = np.full(len(times), np.nan)
    fresh = np.zeros(len(times) + 1, bool)
    fresh[np.searchsorted(times, ends)] = True
    begins = np.flatnonzero(moving & (~np.append(False, moving[:-1]) | fresh[:-1]))
    stops = np.append(np.union1d(begins, np.flatnonzero(fresh)), len(times))
    for begin in begins:
        after = int(stops[np.searchsorted(stops, begin, side='right')])
        pose = Pose(tips[begin], rotations[begin])
        points, last = [pose.position], int(begin)
        for i in range(begin, after - 1):
            if moving[i]:
                last = i
            elif times[i] > times[last] + _BRAKING:
                break
            step = float(times[i + 1] - times[i])
            pose = se3.integrate(
                pose, twists[last], step if 0.0 < step <= GAP else 0.0, robot.in_tool)
            points.append(pose.position)
        path: Array = np.array(points)
        at = 0
        for i in range(begin, after):
            low, high = max(at - _BEHIND, 0), min(at + _AHEAD, len(path))
            window = path[low:high]
            apart = ((window - tips[i]) ** 2).sum(axis=1)
            nearest = int(apart.argmin())
            at = low + nearest
            around = window[max(nearest - 1, 0):nearest + 2]
            errors[i] = metrics.distance_to_path(tips[i:i + 1], around)[0]
    return errors
