"""How late an arm follows its commands: lag and dead time of its drives, fitted to a motion.

The model is that of the planner's observer: τ v̇ + v = u(t − θ), with u the commanded velocity, and
the measured position the integral of v. An unknown offset and a slow drift are fitted along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.signal import lfilter

from redundant_planner.core.errors import StateError

Array = npt.NDArray[np.float64]

# Grid on which the drive's response is computed [s].
_STEP = 1e-3
# What lag and dead time may be [s], and where the search for them starts.
LONGEST = 0.5
_STARTS = (1e-3, 0.01, 0.03, 0.1)
# What the search counts in [s].
_SCALE = 0.01
# A time that is within so many of its standard errors cannot be told from none.
_TOLD = 2.0
# A joint takes part if its commands move it this far [rad, m].
LEAST_MOTION = 5e-3
# An arm did something else than it was told, if more than this share of its motion is unexplained.
_UNEXPLAINED = 0.05
# Without a command for so long one motion ends and another begins [s]; states are looked at for as
# long after the last one.
_PAUSE = 0.3


@dataclass(frozen=True)
class Motion:
    """Commands and measurements of n joints, by one clock.

    Attributes:
        command_times: (k,) from when on each command held [s].
        commands: (k, n) velocities [rad/s, m/s].
        times: (m,) of the measurements [s].
        positions: (m, n) [rad, m].
    """

    command_times: Array
    commands: Array
    times: Array
    positions: Array


@dataclass(frozen=True)
class DriveFit:
    """How late the drives are.

    Attributes:
        lag, dead_time: τ and θ [s]; 0 where the motion cannot tell it from none.
        lag_error, dead_time_error: their standard errors [s]; None where that is so. One can
            stand in for the other in a part: their sum is known better.
        noise: what is left, root mean square [rad, m].
        joints: how many took part.
    """

    lag: float
    dead_time: float
    lag_error: float | None
    dead_time_error: float | None
    noise: float
    joints: int


def longest_motion(motion: Motion) -> Motion:
    """Return the part between two pauses of the commands in which the joints moved furthest.

    Raises:
        StateError: there are no commands, or no measurements beside them.
    """
    times, commands = motion.command_times, motion.commands
    if len(times) < 2:
        raise StateError('there are no commands; the arm has to be moved by the planner meanwhile')
    cuts = np.flatnonzero(np.diff(times) > _PAUSE) + 1
    parts = [part for part in np.split(np.arange(len(times)), cuts) if len(part) > 1]
    ways = [np.abs(commands[part[:-1]] * np.diff(times[part])[:, None]).sum() for part in parts]
    if not parts:
        raise StateError(f'the commands are more than {_PAUSE:g} s apart')
    best = parts[int(np.argmax(ways))]
    begin, end = times[best[0]], times[best[-1]] + _PAUSE
    inside = (motion.times >= begin) & (motion.times <= end)
    if inside.sum() < 20:
        raise StateError(f'there are {int(inside.sum())} measurements beside the commands; are '
                         'their stamps of the same clock?')
    return Motion(times[best], commands[best], motion.times[inside], motion.positions[inside])


def drive_fit(motion: Motion, names: Sequence[str]) -> tuple[DriveFit, dict[str, DriveFit]]:
    """Return the fit of all joints that moved, and of each of them: joint → fit.

    Args:
        motion: commands and measurements; the longest motion in it is used.
        names: of the n joints.

    Raises:
        StateError: no joint moved enough, or the arm did something else than it was told.
    """
    motion = longest_motion(motion)
    grid = np.arange(motion.command_times[0], motion.times[-1] + _STEP, _STEP)
    way = _integral(motion, grid)
    moved = np.flatnonzero(np.ptp(way, axis=0) >= LEAST_MOTION)
    if not len(moved):
        raise StateError(f'the commands move no joint by {LEAST_MOTION:g} rad or m; move the arm '
                         'further')
    fits = {names[j]: _fit(motion, grid, way, moved[moved == j]) for j in moved.tolist()}
    whole = _fit(motion, grid, way, moved)
    motion_size = float(np.sqrt(np.var(way[:, moved], axis=0).mean()))
    if whole.noise > _UNEXPLAINED * motion_size:
        raise StateError(
            f'{100.0 * whole.noise / motion_size:.0f} % of the motion is not explained by lag and '
            'dead time: the arm was held, does not take velocities, or the stamps of commands and '
            'joint states are of different clocks')
    return whole, fits


def _integral(motion: Motion, grid: Array) -> Array:
    """Return where the commands lead (g, n), from the first one on."""
    held = np.diff(np.append(motion.command_times, grid[-1] + _STEP))[:, None]
    steps = motion.commands * held
    way = np.vstack((np.zeros(steps.shape[1]), np.cumsum(steps, axis=0)))
    at = np.append(motion.command_times, grid[-1] + _STEP)
    return np.column_stack([np.interp(grid, at, column) for column in way.T])


def _response(way: Array, lag: float) -> Array:
    """Return a way (g, n) behind a first-order lag: exact for velocities held over grid steps."""
    if lag < 1e-6:
        return way
    kept = np.exp(-_STEP / lag)
    velocity = np.diff(way, axis=0, append=way[-1:]) / _STEP
    # The speed relaxes towards the command; its integral in closed form.
    speed = lfilter([0.0, 1.0 - kept], [1.0, -kept], velocity, axis=0)
    steps = velocity * _STEP + (speed - velocity) * lag * (1.0 - kept)
    return way[0] + np.vstack((np.zeros(way.shape[1]), np.cumsum(steps, axis=0)[:-1]))


def _fit(motion: Motion, grid: Array, way: Array, joints: npt.NDArray[np.intp]) -> DriveFit:
    """Return the fit of some joints, with as many of lag and dead time as the motion tells.

    A short delay can be either, each with a large error. Then one of them alone is fitted, which
    has a small one.
    """
    measured, way = motion.positions[:, joints], way[:, joints]
    both = _search(motion.times, measured, grid, way, (0, 1))
    if both.lag_error is not None and both.dead_time_error is not None:
        return both
    return min((_search(motion.times, measured, grid, way, (free,)) for free in (0, 1)),
               key=lambda fit: fit.noise)


def _search(
    times: Array, measured: Array, grid: Array, way: Array, free: tuple[int, ...],
) -> DriveFit:
    """Return the best fit of lag (0), dead time (1) or both; one that is not fitted is none.

    Args:
        times: (m,) of the measurements [s].
        measured: (m, j) [rad, m].
        grid: (g,) [s].
        way: (g, j) where the commands lead [rad, m].
        free: what is fitted.
    """
    # Offset and drift are eliminated: what of a curve these two cannot explain is left.
    basis, _ = np.linalg.qr(np.column_stack((np.ones(len(times)), times)))

    def unexplained(scaled: Array) -> Array:
        late = np.zeros(2)
        late[list(free)] = (scaled - 1.0) * _SCALE
        behind = _response(way, float(late[0]))
        expected = np.column_stack([
            np.interp(times - late[1], grid, column) for column in behind.T])
        rest = measured - expected
        return np.asarray((rest - basis @ (basis.T @ rest)).ravel())

    starts = [1.0 + np.array(start) / _SCALE for start in product(_STARTS, repeat=len(free))]
    start = min(starts, key=lambda x: float(np.square(unexplained(x)).sum()))
    # The derivative's steps are a share of the value, which must not be 0 therefore.
    found = least_squares(
        unexplained, start, bounds=(1.0, 1.0 + LONGEST / _SCALE), diff_step=0.01)
    freedom = max(len(found.fun) - len(free) - 2 * measured.shape[1], 1)
    variance = float(np.square(found.fun).sum()) / freedom
    spread = np.diag(np.linalg.pinv(found.jac.T @ found.jac))
    errors = _SCALE * np.sqrt(variance * np.maximum(spread, 0.0))
    told = {which: (float(value), float(error))
            for which, value, error in zip(free, (found.x - 1.0) * _SCALE, errors)
            if value > _TOLD * error}
    (lag, lag_error), (dead_time, dead_time_error) = (told.get(i, (0.0, None)) for i in (0, 1))
    return DriveFit(lag, dead_time, lag_error, dead_time_error, float(np.sqrt(variance)),
                    measured.shape[1])
