"""How long a way is over the shortest one between the same ends."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from benchmark.optimum import Optimum
from benchmark.problem_sets.problem import Problem, tip_pose
from benchmark.problem_sets.servo import DT
from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]


def path_ratio(robot: Robot, problem: Problem, postures: Array, margin: float) -> float:
    """Return the length of a joint path, postures (k, n), over that of the shortest one near it.

    The tip may be anywhere but at the end. NaN where no shortest one was found.
    """
    poses = [None] * (len(postures) - 1) + [tip_pose(robot, problem.goal)]
    best = Optimum(robot, problem.start, poses, DT, problem.obstacles, margin).best([postures])
    return float('nan') if best is None else _length(postures) / _length(best[1])


def _length(postures: Array) -> float:
    return float(np.linalg.norm(np.diff(postures, axis=0), axis=1).sum())
