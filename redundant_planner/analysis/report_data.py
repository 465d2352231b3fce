"""What the report's script draws: samples, diagrams with their limits, and the 3-D views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from redundant_planner.analysis.joint_units import joint_units, UNKNOWN
from redundant_planner.analysis.motion_interval import (
    command_begin,
    motion_interval,
    shown_together,
)
from redundant_planner.analysis.report_figures import accelerations_of, velocities_of
from redundant_planner.analysis.report_numbers import number_text
from redundant_planner.analysis.report_tiles import PATH_ERROR_LIMIT
from redundant_planner.analysis.report_view import packed_numbers
from redundant_planner.analysis.results import Analysis

Array = npt.NDArray[np.float64]

# Samples of a curve in the motion, and before and after it: what a screen can show.
_IN_MOTION, _AROUND = 1500, 300
# Joints with diagrams of their own.
MOST_JOINTS = 32
# The smallest span of a vertical axis: what is less is round-off or noise [the unit's].
_LEAST = {'mm': 0.1, '%': 5.0}
_LEAST_OF_JOINTS = {'position': 0.01, 'velocity': 0.01, 'acceleration': 0.1}


def page_data(
    analyses: Sequence[Analysis], views: Sequence[dict[str, Any] | None],
) -> dict[str, Any]:
    """Return what the page's script draws; times count from the begin of each command [s]."""
    shown = shown_together([analysis.curves for analysis in analyses])
    samples = [drawn_samples(analysis, shown) for analysis in analyses]
    bags = []
    for analysis, chosen, view in zip(analyses, samples, views):
        times = analysis.curves.times
        begin = command_begin(analysis.curves)
        motion = motion_interval(analysis.curves)
        bags.append({
            'name': analysis.name, 'time': packed_numbers(times[chosen] - begin),
            'motion': [time - begin for time in motion],
            'shown': list(shown),
            'whole': [float(times.min()) - begin, float(times.max()) - begin], 'view': view})
    return {'bags': bags, 'panels': [*_arm_panels(analyses, samples),
                                     *_joint_panels(analyses, samples)]}


def drawn_samples(
    analysis: Analysis, shown: tuple[float, float],
) -> npt.NDArray[np.intp]:
    """Return which samples of the curves are drawn, (k,): most of them of the motion.

    Args:
        analysis: of a bag.
        shown: from when to when, from the begin of the command [s].
    """
    times = analysis.curves.times - command_begin(analysis.curves)
    moving = np.flatnonzero((times >= shown[0]) & (times <= shown[1]))
    return np.union1d(
        moving[np.linspace(0, len(moving) - 1, _IN_MOTION).astype(int)],
        np.linspace(0, len(times) - 1, _AROUND).astype(int)).astype(np.intp)


def _arm_panels(
    analyses: Sequence[Analysis], samples: Sequence[npt.NDArray[np.intp]],
) -> list[dict[str, Any]]:
    margins = {1e3 * analysis.facts.margin for analysis in analyses
               if analysis.facts.margin is not None}
    found = []
    for title, unit, limits, values in (
            ('Smallest distance', 'mm',
             [_limit(0.0, -1, 'contact'), *(_limit(one, -1, 'margin') for one in margins)],
             [1e3 * analysis.curves.clearance for analysis in analyses]),
            ('Tip off its path', 'mm', [_limit(PATH_ERROR_LIMIT, 1)],
             [1e3 * analysis.curves.path_error for analysis in analyses]),
            ('Commanded twist that is followed', '%', [],
             [100.0 * analysis.curves.scale for analysis in analyses])):
        curves = [{'bag': i, 'style': 'measured', 'values': packed_numbers(
                       np.where(np.isfinite(one), one, np.nan)[chosen])}
                  for i, (one, chosen) in enumerate(zip(values, samples))
                  if np.isfinite(one).any()]
        if curves:
            found.append({'group': 'arm', 'title': title, 'unit': unit, 'limits': limits,
                          'least': _LEAST[unit], 'note': '', 'curves': curves})
    return found


def _joint_panels(
    analyses: Sequence[Analysis], samples: Sequence[npt.NDArray[np.intp]],
) -> list[dict[str, Any]]:
    first = analyses[0]
    units = [('[rad, m]' if unit == UNKNOWN else unit) for unit in joint_units(first)]
    found = []
    for group, per in (('position', ''), ('velocity', '/s'), ('acceleration', '/s²')):
        for i, name in enumerate(first.joint_names[:MOST_JOINTS]):
            curves, peaks = [], []
            for bag, (analysis, chosen) in enumerate(zip(analyses, samples)):
                joint = analysis.joint_names.index(name)
                for style, values in _series(analysis, group).items():
                    curves.append({'bag': bag, 'style': style,
                                   'values': packed_numbers(values[chosen, joint])})
                if group != 'position':
                    peaks.append(number_text(_peak(analysis, group, joint)))
            limits = _limits(first, group, i)
            note = f'peak {" and ".join(peaks)}' if peaks else ''
            if limits:
                told = (f'{number_text(limits[0]["at"])} to {number_text(limits[1]["at"])}'
                        if group == 'position' else f'±{number_text(limits[1]["at"])}')
                note += f'{", " if note else ""}limit {told}'
            found.append({'group': group, 'title': name, 'unit': f'{units[i]}{per}',
                          'limits': limits, 'least': _LEAST_OF_JOINTS[group], 'note': note,
                          'curves': curves})
    return found


def _series(analysis: Analysis, group: str) -> dict[str, Array]:
    if group == 'position':
        return {'measured': analysis.curves.positions}
    return (velocities_of if group == 'velocity' else accelerations_of)(analysis.curves)


def _peak(analysis: Analysis, group: str, joint: int) -> float:
    """Return the largest of all samples, the thinned out ones too, as commanded if possible."""
    if analysis.commanded is not None:
        return float(getattr(analysis.commanded, group)[joint])
    return float(getattr(analysis.joints, f'peak_{group}')[joint])


def _limit(at: float, side: int, label: str = 'limit') -> dict[str, Any]:
    """Return a limit as the script draws it, with what is beyond it above (1) or below (-1)."""
    return {'at': at, 'side': side, 'label': label}


def _limits(analysis: Analysis, group: str, joint: int) -> list[dict[str, Any]]:
    robot = analysis.robot
    if robot is None:
        return []
    if group == 'position':
        limits = [float(robot.position_min[joint]), float(robot.position_max[joint])]
    else:
        largest = float(getattr(robot, f'{group}_max')[joint])
        limits = [-largest, largest]
    if not np.isfinite(limits).all():
        return []
    return [_limit(limits[0], -1), _limit(limits[1], 1)]
