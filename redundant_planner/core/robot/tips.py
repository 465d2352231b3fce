"""The tips of an arm or a body: which links they are, and which axes of each are controlled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import known, RobotError
from redundant_planner.core.parameters import AXES

# Controlled axes of every tip, or tip → its own.
Axes = Sequence[str] | Mapping[str, Sequence[str]]


def checked_tips(tip_frame: str, tips: Sequence[str]) -> tuple[str, ...]:
    """Return the tips, which are given as one or as several.

    Raises:
        RobotError: both are given, or neither, or a tip twice.
    """
    if (tip_frame and tips) or not (tip_frame or tips) or len(set(tips)) != len(tips):
        raise RobotError(f"tip_frame is '{tip_frame}' and tips are {list(tips)}; one of them "
                         'names the end effector, or several different ones')
    return tuple(tips) or (tip_frame,)


def checked_axes(axes: Axes, tips: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the controlled axes of each tip, in the order of `AXES`.

    Raises:
        RobotError: axes are missing, unknown, or given twice, or a tip is unknown.
    """
    if not isinstance(axes, Mapping):
        return [_in_order(axes)] * len(tips)
    if set(axes) != set(tips):
        raise RobotError(f'axes are given for {known(axes)}; the tips are {known(tips)}')
    return [_in_order(axes[tip]) for tip in tips]


def _in_order(axes: Sequence[str]) -> tuple[str, ...]:
    unknown = [axis for axis in axes if axis not in AXES]
    if unknown or not axes or len(set(axes)) != len(axes):
        raise RobotError(
            f'axes are {list(axes)}; they must be a non-empty choice, without repetition, '
            f'of {known(AXES)}')
    return tuple(axis for axis in AXES if axis in axes)


def controlled_rows(axes_of_tips: Sequence[Sequence[str]]) -> npt.NDArray[np.intp]:
    """Return which of the six axes of each tip are controlled (m,): 6 · tip + axis."""
    return np.array([6 * tip + AXES.index(axis) for tip, axes in enumerate(axes_of_tips)
                     for axis in axes], dtype=np.intp)
