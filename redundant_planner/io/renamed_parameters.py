"""Names that parameters had once: refused in files, translated in bags."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from redundant_planner.core.errors import known

RENAMED: Mapping[str, str] = {
    'k_alpha': 'criteria.k_alpha',
    'k_fixed': 'criteria.k_fixed',
    'k_w': 'criteria.k_w',
    'k_s': 'criteria.k_s',
    'k_f': 'criteria.k_f',
    'joint_weights': 'criteria.joint_weights',
    'clearance_margin': 'clearance.margin',
    'influence_distance': 'clearance.influence_distance',
    'self_collision_margin': 'clearance.self_margin',
    'barrier_gain': 'clearance.gain',
    'obstacle_lead': 'clearance.lead',
    'position_margin': 'limits.position_margin',
    'linear_speed_max': 'limits.linear_speed',
    'angular_speed_max': 'limits.angular_speed',
    'singularity_margin': 'singularity.margin',
    'horizon': 'horizon.duration',
    'look_ahead': 'horizon.look_ahead',
    'drift_gain': 'feedback.gain',
}
# Constants now; bags still say what they were.
_CONSTANT: Mapping[str, str] = {
    'k_m': 'criteria.k_m',
    'clearance_smoothing': 'clearance.smoothing',
    'horizon_held': 'horizon.held_duration',
    'horizon_nodes': 'horizon.nodes',
    'evasion_horizon': 'clearance.evasion_horizon',
    'damping': 'singularity.damping',
    'damping_threshold': 'singularity.damping_threshold',
    'drift_speed': 'feedback.speed',
    'drift_angular_speed': 'feedback.angular_speed',
    'drift_distance': 'feedback.distance',
    'drift_angle': 'feedback.angle',
}
_GONE = {
    **dict.fromkeys((*_CONSTANT, *_CONSTANT.values(), 'position_tolerance', 'diagnostics_rate',
                     'marker_rate'), 'it is a constant now'),
    **dict.fromkeys(('safety_filter', 'clearance_points'),
                    "the paper's method to the letter is 'method: paper' now"),
    'locked_positions': "'locked_joints' takes 'joint=position' now",
    'lock_where_measured': "'locked_joints' takes '*=measured' now",
}
# The first parts of grouped names, of those that came later too.
GROUPS = tuple(sorted({'cone', 'drive', 'follow', 'posture', 'scene', 'target', *(
    name.partition('.')[0] for name in RENAMED.values())}))


def what_became_of(name: str) -> str:
    """Return what to do about a name of an earlier version, as a sentence; empty for others."""
    if name in RENAMED:
        return f"parameter '{name}' is called '{RENAMED[name]}' now"
    if name in _GONE:
        return f"parameter '{name}' is not set any more: {_GONE[name]}"
    return ''


def flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameter values with those of a group under their full names, `group.name`."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if name in GROUPS and isinstance(value, Mapping):
            found |= {f'{name}.{key}': inner for key, inner in value.items()}
        else:
            found[name] = value
    return found


# What the paper's method to the letter was recorded with.
_LETTER: Mapping[str, float] = {
    'criteria.k_m': 0.0, 'clearance.smoothing': 0.0, 'clearance.influence_distance': math.inf,
    'clearance.margin': 0.0, 'limits.position_margin': 0.0, 'singularity.damping_threshold': 0.0,
    'feedback.gain': 0.0,
}


def _locked(found: dict[str, Any]) -> Any:
    """Take names and positions of locked joints out of recorded values; return today's entries.

    What was locked where it was measured is among them. Values that do not fit are left for
    `RobotParameters` to refuse.
    """
    names, positions = found.get('locked_joints', []), found.pop('locked_positions', [])
    found.pop('lock_where_measured', None)
    if not isinstance(names, (list, tuple)) or not isinstance(positions, (list, tuple)):
        return names
    return [f'{name}={position!r}' for name, position in zip(names, positions)]


def translated(values: Mapping[str, Any], notes: list[str]) -> dict[str, Any]:
    """Return the values of a recorded configuration under the names of today.

    Args:
        values: as recorded.
        notes: takes a sentence about what has no equal today.
    """
    found = {RENAMED.get(name) or _CONSTANT.get(name, name): value
             for name, value in flat(values).items()}
    if 'locked_positions' in found or 'lock_where_measured' in found:
        found['locked_joints'] = _locked(found)
    letter = found.pop('clearance_points', 'links') == 'joints'
    filtered = found.pop('safety_filter', True)
    fixed = found.get('method') == 'gradient_projection'
    if letter and not filtered and (fixed or found.get('method') == 'dynamic_factor'):
        found['method'] = 'paper_gradient_projection' if fixed else 'paper'
        differing = [name for name, value in _LETTER.items() if found.get(name, value) != value]
        if differing:
            notes.append("it was recorded without a safety filter, which is 'method: paper' now; "
                         f'that does not use {known(differing)}')
    elif letter or not filtered:
        notes.append("it was recorded with 'safety_filter' or 'clearance_points' as they cannot "
                     'be set any more: other commands come out today')
    return found
