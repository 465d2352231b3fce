"""Every parameter is checked and described; what each does is in test_parameter_effects.py."""

from __future__ import annotations

from dataclasses import fields

import pytest

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.parameters import PlannerParameters, spec_of


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
