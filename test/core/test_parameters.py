"""Every parameter is checked, and every parameter does something."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

from closed_loop import drive
from conftest import make_paper_arm
import numpy as np
import pytest

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters, spec_of
from redundant_planner.core.planner import Planner

# A start in which everything matters: near an obstacle, off the reference, in a hurry.
BASE = PlannerParameters(
    criteria_k_s=0.1, singularity_damping_threshold=3.0, limits_linear_speed=0.2)
CHANGES = {
    'method': 'gradient_projection', 'path_priority': 'strict',
    'criteria_k_fixed': 0.5, 'criteria_k_alpha': 0.3, 'criteria_k_w': 0.1, 'criteria_k_s': 1.0,
    'criteria_k_f': 30.0, 'criteria_k_m': 1000.0,
    'criteria_joint_weights': (5.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
    'clearance_margin': 0.05, 'clearance_influence_distance': 0.08, 'clearance_smoothing': 5.0,
    'clearance_self_margin': 0.3, 'clearance_gain': 0.5, 'clearance_lead': 0.5,
    'clearance_evasion_horizon': 0.0,
    'limits_position_margin': 0.0, 'limits_linear_speed': 0.1, 'limits_angular_speed': 0.1,
    'singularity_margin': 1.2, 'singularity_damping': 1.0, 'singularity_damping_threshold': 0.0,
    'horizon_duration': 0.5, 'horizon_held_duration': 0.2, 'horizon_nodes': 3,
    'horizon_look_ahead': 0.0,
    'feedback_gain': 1.0, 'feedback_speed': 0.001, 'feedback_angular_speed': 0.001,
    'feedback_distance': 0.001, 'feedback_angle': 0.001,
}


@cache  # most compare with the same motion
def motion(parameters, start=(0.1, 0.1, 0, 0.5233, -0.5233, 1.0467, 0.1), axes=None,
           other=(0.05, 0.5, 0.5), drift=(0.0, 0.0, 0.0), known=False):
    robot = make_paper_arm(**({'axes': axes} if axes else {}))
    scene = Scene.of([
        Obstacle('o', np.array([0, 0.55, 0.45]), np.array([0.05, 0.03, 0.03])),
        Obstacle('p', np.array(other), np.array([0.05, 0.03, 0.03]), velocity=drift)])
    planner = Planner(robot, parameters)
    twist = np.array([-0.1, -0.2, 0.3, 0.0, 0.5, 0.0])
    ahead = (lambda times: np.tile(twist, (len(times) - 1, 1))) if known else None
    postures, _ = drive(planner, start, twist, scene, 0.2, ahead=ahead)
    more, _ = drive(planner, postures[-1] + 0.02, twist, scene, 3.0, ahead=ahead)
    return np.vstack((postures, more))


def test_the_list_of_changes_is_complete():
    assert set(CHANGES) == {entry.name for entry in fields(PlannerParameters)}


@pytest.mark.parametrize('name', CHANGES)
def test_every_parameter_has_an_effect(name):
    base = BASE
    if name == 'criteria_k_fixed':
        base = replace(base, method='gradient_projection')
    if name == 'criteria_k_m':
        base = replace(base, singularity_margin=0.5)
    if name.startswith('horizon') and name != 'horizon_look_ahead':
        base = replace(base, method='variational')
    options = {}
    if 'angular' in name or 'angle' in name:
        options['axes'] = ('vx', 'vy', 'vz', 'wy')
    if name == 'limits_position_margin':
        options['start'] = (0.38, 0.1, 0, 0.5233, -0.5233, 1.0467, 0.1)
    if name == 'horizon_duration':
        options['known'] = True
    if name in ('path_priority', 'clearance_lead'):
        options['drift'] = (-0.5, 0.5, -0.5)
    if name == 'clearance_evasion_horizon':
        options |= {'other': (0.12, 0.3, 0.15), 'drift': (-0.3, 0.0, 0.0)}
    before = motion(base, **options)
    after = motion(replace(base, **{name: CHANGES[name]}), **options)
    assert np.abs(before - after).max() > 1e-6


@pytest.mark.parametrize(('change', 'message'), [
    ({'method': 'magic'}, r"'method' is 'magic'; it must be one of 'gradient_projection'"),
    ({'method': 3}, r"'method' is 3; it must be a string"),
    ({'criteria_k_alpha': -1.0}, r"'criteria.k_alpha' is -1.0; it must lie in \[0, 10\]"),
    ({'criteria_k_alpha': 'fast'}, r"'criteria.k_alpha' is 'fast'; it must be a number"),
    ({'criteria_k_alpha': True}, r"'criteria.k_alpha' is True; it must be a number"),
    ({'criteria_k_alpha': float('nan')}, r"'criteria.k_alpha' is nan; it must be a number"),
    ({'criteria_joint_weights': 3.0}, r"'criteria.joint_weights' is 3.0; it must be a list"),
    ({'criteria_joint_weights': (1.0, -1.0)}, r"'criteria.joint_weights' is -1.0; it must lie in"),
    ({'feedback_gain': 1e6}, r"'feedback.gain' is 1000000.0; it must lie in \[0, 100\] 1/s"),
    ({'singularity_damping': 0.0},
     r"'singularity.damping' is 0 while 'singularity.damping_threshold'"),
])
def test_wrong_values_are_refused_with_the_reason(change, message):
    with pytest.raises(ParameterError, match=message):
        PlannerParameters(**change)


def test_whole_numbers_serve_as_numbers_and_lists_as_tuples():
    parameters = PlannerParameters(criteria_k_alpha=1, criteria_joint_weights=[1, 2, 3])
    assert parameters.criteria_k_alpha == 1.0 and isinstance(parameters.criteria_k_alpha, float)
    assert parameters.criteria_joint_weights == (1.0, 2.0, 3.0)


def test_every_parameter_is_described():
    for entry in fields(PlannerParameters):
        assert len(spec_of(entry).description) > 20, entry.name
        assert spec_of(entry).description.endswith('.'), entry.name
