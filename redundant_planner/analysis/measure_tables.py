"""What the printed tables, the JSON file and the report show of an analysis."""

from __future__ import annotations

from typing import Any

import numpy as np

from redundant_planner.analysis.joint_measures import JointMeasures
from redundant_planner.analysis.metrics import reduction
from redundant_planner.analysis.motion_interval import at_rest
from redundant_planner.analysis.results import Analysis
from redundant_planner.io.printable import printable

# Measure of every joint's measured motion → its title.
MEASURES = {
    'displacement': 'displacement', 'path': 'path ∫|q̇|', 'effort': '∫q̇²',
    'initial_velocity': 'initial velocity', 'velocity_change': 'velocity change',
    'acceleration_change': 'acceleration change', 'peak_velocity': 'peak velocity, measured',
    'peak_acceleration': 'peak acceleration, measured'}
# Largest of a joint's commands → its title, and the robot's limit.
PEAKS = {'velocity': ('peak velocity, commanded', 'velocity_max'),
         'acceleration': ('peak acceleration, commanded', 'acceleration_max'),
         'jerk': ('peak jerk, commanded', 'jerk_max')}
# Those that Table 1 and the text of the paper compare.
COMPARED = ('displacement', 'path', 'effort', 'initial_velocity', 'velocity_change',
             'acceleration_change')


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
    clearance = analysis.clearance
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


def as_text(value: Any) -> str:
    """Return a measure as it stands in a table."""
    if value is None:
        return '–'
    return f'{value:.5g}' if isinstance(value, float) else printable(str(value))
