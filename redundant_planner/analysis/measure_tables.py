"""What the printed tables, the JSON file and the report show of an analysis."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from redundant_planner.analysis.joint_measures import JointMeasures
from redundant_planner.analysis.joint_units import joint_units
from redundant_planner.analysis.metrics import reduction
from redundant_planner.analysis.motion_interval import at_rest
from redundant_planner.analysis.results import Analysis
from redundant_planner.io.printable import printable

# Measure of every joint's measured motion → its title.
MEASURES = {
    'displacement': 'displacement', 'path': 'path ∫|q̇|', 'effort': '∫q̇²',
    'initial_velocity': 'initial velocity', 'velocity_change': 'velocity change',
    'acceleration_change': 'acceleration change'}
# The units of these, and of the peaks, where a joint's own is `u`.
UNITS = {'displacement': 'u', 'path': 'u', 'effort': 'u²/s', 'initial_velocity': 'u/s',
         'velocity_change': 'u/s', 'acceleration_change': 'u/s²',
         'velocity': 'u/s', 'acceleration': 'u/s²', 'jerk': 'u/s³'}
# Largest of a joint's commands → the robot's limit.
PEAKS = {'velocity': 'velocity_max', 'acceleration': 'acceleration_max', 'jerk': 'jerk_max'}
# Those that Table 1 and the text of the paper compare.
COMPARED = ('displacement', 'path', 'effort', 'initial_velocity', 'velocity_change',
             'acceleration_change')


class Measure(NamedTuple):
    """A measure of the whole motion: its title, its unit, and how many of it make one."""

    title: str
    unit: str
    scale: float = 1.0


# Those of `motion_measures` that are numbers.
MOTION = {
    'joint_path': Measure('Joint path, all joints', 'rad + m'),
    'effort': Measure('∫q̇ᵀq̇ dt', 'rad²/s + m²/s'),
    'tool_path_m': Measure('Path of the tip', 'm'),
    'largest_path_error_mm': Measure('Tip off its path, at most', 'mm'),
    'smallest_distance_mm': Measure('Smallest distance', 'mm'),
    'smallest_clearance_level': Measure('Smallest level S (Eq. 6)', '–'),
    'twist_scale_mean': Measure('Commanded twist that was followed, mean', '%', 100.0),
    'factor_k_mean': Measure('Factor k (Eq. 2), mean', '–'),
    'chunk_lag_median_ms': Measure('Behind its chunks, median', 'ms'),
    'chunk_lag_longest_ms': Measure('Behind its chunks, longest', 'ms'),
    'chunk_off_joint': Measure('Joint off its chunks, at most', 'rad or m'),
    'chunk_off_tip_mm': Measure('Tip off its chunks, at most', 'mm'),
    'chunk_turned_tip_deg': Measure('Tip turned off its chunks, at most', '°'),
    'command_period_median_ms': Measure('Command period, median', 'ms'),
    'command_period_p99_ms': Measure('Command period, 99 of 100 within', 'ms'),
    'command_period_longest_ms': Measure('Command period, longest', 'ms')}

# What `chunk_rows` tells.
CHUNKS = ('chunks', 'from – to', 'behind, median / longest', 'off, at most',
          'planner said then', 'ended by')


def telling(joints: JointMeasures) -> tuple[str, ...]:
    """Return those of `MEASURES` that tell something of a motion.

    The paper's initial velocity and changes are of a motion that begins, or ends, under way.
    """
    left_out: set[str] = set()
    if at_rest(joints.initial_velocity, joints.peak_velocity):
        left_out.add('initial_velocity')
        if at_rest(joints.velocity_change, joints.peak_velocity):
            left_out |= {'velocity_change', 'acceleration_change'}
    return tuple(key for key in MEASURES if key not in left_out)


def motion_measures(analysis: Analysis) -> dict[str, Any]:
    """Return the measures of a whole motion; None for what the bag does not tell."""
    curves, periods = analysis.curves, analysis.periods

    def known(values: Any, statistic: Any) -> float | None:
        finite = values[np.isfinite(values)]
        return float(statistic(finite)) if len(finite) else None

    tips = curves.tips[np.isfinite(curves.tips).all(axis=1)]
    clearance, runs = analysis.clearance, [run for run, _ in analysis.chunks]
    of_tip = [run for run in runs if not run.of_joints]
    return {
        'joint_path': float(analysis.joints.path.sum()),
        'effort': float(analysis.joints.effort.sum()),
        'tool_path_m': (float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())
                        if len(tips) > 1 else None),
        'largest_path_error_mm': known(1e3 * curves.path_error, np.max),
        'smallest_clearance_level': clearance.level if clearance else None,
        'smallest_distance_mm': 1e3 * analysis.distance if clearance else None,
        'nearest_pair': f'{clearance.link} to {clearance.obstacle}' if clearance else None,
        'twist_scale_mean': known(curves.scale, np.mean),
        'factor_k_mean': (float(analysis.factor[:, 1].mean()) if len(analysis.factor)
                          else None),
        'chunk_lag_median_ms': (float(np.median([1e3 * run.lag_median for run in runs]))
                                if runs else None),
        'chunk_lag_longest_ms': max((1e3 * run.lag_longest for run in runs), default=None),
        'chunk_off_joint': max((run.off for run in runs if run.of_joints), default=None),
        'chunk_off_tip_mm': max((1e3 * run.off for run in of_tip), default=None),
        'chunk_turned_tip_deg': max((float(np.degrees(run.turned)) for run in of_tip),
                                    default=None),
        'command_period_median_ms': 1e3 * periods.median if periods else None,
        'command_period_p99_ms': 1e3 * periods.p99 if periods else None,
        'command_period_longest_ms': 1e3 * periods.longest if periods else None,
    }


def reductions(base: Analysis, improved: Analysis) -> dict[str, dict[str, float]]:
    """Return joint → measure → reduction [%]; 'all joints' has those of the sums.

    NaN where the base has nothing to reduce.
    """
    order = [improved.joint_names.index(name) for name in base.joint_names]
    told = telling(base.joints)
    values = {key: (getattr(base.joints, key) if key in told else np.zeros(len(order)),
                    getattr(improved.joints, key)[order]) for key in COMPARED}
    rows = {name: {key: float(reduction(*pair)[i]) for key, pair in values.items()}
            for i, name in enumerate(base.joint_names)}
    rows['all joints'] = {key: float(reduction(np.array(pair[0].sum()), np.array(pair[1].sum())))
                          for key, pair in values.items()}
    return rows


def chunk_rows(analysis: Analysis) -> list[tuple[str, ...]]:
    """Return a row for each run of chunks, of as many cells as `CHUNKS` has titles."""
    units = dict(zip(analysis.joint_names, joint_units(analysis)))
    rows: list[tuple[str, ...]] = []
    for run, word in analysis.chunks:
        off = (f'{run.off:.3g} {units[run.joint]} ({run.joint})' if run.of_joints else
               f'{1e3 * run.off:.3g} mm, {np.degrees(run.turned):.2g}°')
        rows.append((
            f'{run.chunks} of ' + ('the joints' if run.of_joints else run.tip or 'the tip'),
            f'{run.begin:.2f} – {run.end:.2f} s',
            f'{1e3 * run.lag_median:.0f} / {1e3 * run.lag_longest:.0f} ms at {run.lag_at:.2f} s',
            f'{off} at {run.off_at:.2f} s', printable(word) or '–', run.ended or '–'))
    return rows


def as_text(value: Any) -> str:
    """Return a measure as it stands in a table."""
    if value is None:
        return '–'
    return f'{value:.5g}' if isinstance(value, float) else printable(str(value))
