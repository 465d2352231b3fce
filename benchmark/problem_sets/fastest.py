"""How long the fastest motion along a joint path takes: TOPP-RA (Pham and Pham 2018)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from redundant_planner.core.robot.model import Robot

Array = npt.NDArray[np.float64]

# Points of a path are this far apart for its spline, and this many are the fewest [rad, m].
_SPACING, _FEWEST = 0.02, 6
# Pieces of the path in TOPP-RA's grid.
_GRID = 400


def fastest_time(robot: Robot, postures: Array) -> float:
    """Return the time of the fastest motion along postures (k, n), from rest to rest [s].

    Within the joints' limits of velocity and acceleration; those of jerk and of the tip do not
    count. NaN where TOPP-RA finds none.
    """
    import toppra
    toppra.setup_logging('ERROR')
    steps = np.linalg.norm(np.diff(postures, axis=0), axis=1)
    along = np.concatenate((np.zeros(1), np.cumsum(steps)))
    if along[-1] <= 0.0:
        return float('nan')
    count = max(int(along[-1] / _SPACING), _FEWEST)
    at = np.linspace(0.0, along[-1], count + 1)
    moved = np.concatenate((np.ones(1, dtype=bool), steps > 0.0))
    points = np.array([np.interp(at, along[moved], column[moved]) for column in postures.T]).T
    path = toppra.SplineInterpolator(at, points)
    fastest = toppra.algorithm.TOPPRA(
        [toppra.constraint.JointVelocityConstraint(robot.velocity_max),
         toppra.constraint.JointAccelerationConstraint(robot.acceleration_max)],
        path, gridpoints=np.linspace(0.0, along[-1], _GRID + 1),
        solver_wrapper='seidel', parametrizer='ParametrizeConstAccel')
    found = fastest.compute_trajectory(0.0, 0.0)
    return float('nan') if found is None else float(found.duration)
