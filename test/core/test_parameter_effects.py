"""Each parameter moves what its description names, and in the direction it says.

A case runs one closed loop twice, with a low and with a high value of one parameter, and compares
one quantity, most of them such as a user sees.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
import math

from motion_quantities import (
    distance_at_first_evasion,
    distance_between_links,
    distance_left,
    effort,
    fastest_joint,
    fastest_least_norm,
    largest_jump_of_the_null_space,
    largest_path_error,
    least_norm_at_the_end,
    null_space_share,
    off_mid_range,
    off_preferred,
    path_length,
    room_to_limits,
    smallest_distance,
    smallest_singular_value,
    time_lost,
    time_the_first_tip_loses,
    time_to_the_first_motion,
    turn_of_the_tip,
    way_of_the_first_joint,
    way_of_the_tip,
)
from parameter_scenarios import (
    across_the_first_link,
    after_a_moving_target,
    between_two_balls,
    fast,
    folding,
    free,
    free_announced,
    free_position,
    held_up,
    held_up_announced,
    into_a_rail_end,
    into_the_first_link,
    into_the_forearm,
    Motion,
    past_a_singularity,
    pushed,
    pushed_far,
    stretching,
    tilting,
    to_a_target_behind_a_ball,
    to_a_target_in_a_ball,
    towards_a_ball,
    towards_each_other,
    with_slow_drives,
)
import pytest

from redundant_planner.core.parameters import PlannerParameters

# The two values of a quantity differ by at least this share of the larger one.
LEAST_SHARE = 0.05

DEFAULTS = PlannerParameters()
# Eq. 2 alone, without the joint path ahead; then with one index of Eq. 18 at most.
EQ_2 = PlannerParameters(horizon_look_ahead=0.0)
NO_CLEARANCE = replace(EQ_2, criteria_k_w=0.0)
ONLY_CLEARANCE = replace(EQ_2, criteria_k_f=0.0)
FIXED = PlannerParameters(method='gradient_projection')
LAG, DEAD_TIME = PlannerParameters(drive_lag=0.06), PlannerParameters(drive_dead_time=0.04)
VARIATIONAL = PlannerParameters(method='variational')
PREFERRED = replace(EQ_2, posture_preferred=('panda_joint3=0.5',))
CONE = PlannerParameters(cone_angle=0.3, cone_direction=(0.0, 0.0, -1.0))
# Where the filter lets the arm into a singularity, and damping is what is left.
SINGULAR = PlannerParameters(singularity_margin=0.0)


@dataclass(frozen=True)
class Case:
    """With `high` instead of `low` a quantity of a scenario grows (`+`) or shrinks (`-`)."""

    name: str
    low: object
    high: object
    scenario: Callable[[PlannerParameters], Motion]
    quantity: Callable[[Motion], float]
    sign: str
    others: PlannerParameters = DEFAULTS


CASES = [
    Case('method', 'gradient_projection', 'dynamic_factor', held_up, time_lost, '-'),
    Case('method', 'gradient_projection', 'variational', held_up, time_lost, '-'),
    Case('method', 'dynamic_factor', 'variational', free_announced, effort, '-', EQ_2),
    Case('method', 'paper', 'dynamic_factor', towards_a_ball, smallest_distance, '+'),
    Case('method', 'paper_gradient_projection', 'gradient_projection', towards_a_ball,
         smallest_distance, '+'),
    Case('path_priority', 'strict', 'yield', into_the_forearm, smallest_distance, '+'),
    Case('path_priority', 'strict', 'yield', into_the_forearm, largest_path_error, '+'),
    Case('path_priority', 'yield', 'slide', held_up, time_lost, '-'),
    Case('target_path', 'straight', 'free', to_a_target_behind_a_ball, distance_left, '-'),
    Case('target_lag', 0.05, 0.2, after_a_moving_target, distance_left, '+'),
    Case('target_effort', 0.3, 0.05, to_a_target_behind_a_ball, time_to_the_first_motion, '+'),
    Case('target_margin', 0.0, -1.0, to_a_target_behind_a_ball, smallest_distance, '+'),
    Case('target_gives_way', False, True, to_a_target_in_a_ball, distance_left, '+'),
    Case('posture_preferred', (), ('panda_joint3=0.5',), free, off_preferred, '-', EQ_2),
    Case('posture_preferred', (), ('panda_joint3=0.5',), free, off_preferred, '-', VARIATIONAL),
    Case('posture_weight', 0.0, 5.0, free, off_preferred, '-', PREFERRED),
    Case('posture_weight', 0.0, 5.0, free, off_preferred, '-',
         replace(PREFERRED, method='variational')),
    Case('cone_angle', math.pi, 0.2, tilting, turn_of_the_tip, '-', CONE),
    Case('cone_tip_axis', (0.0, 0.0, 1.0), (0.0, -0.2, 1.0), tilting, turn_of_the_tip, '-', CONE),
    Case('cone_direction', (0.0, 0.0, -1.0), (0.0, -0.2, -1.0), tilting, turn_of_the_tip, '-',
         CONE),
    Case('drive_lag', 0.0, 0.06, with_slow_drives, largest_path_error, '-', DEAD_TIME),
    Case('drive_dead_time', 0.0, 0.04, with_slow_drives, largest_path_error, '-', LAG),
    Case('tip_order', ('left_hand',), ('right_hand',), towards_each_other,
         time_the_first_tip_loses, '+'),
    Case('criteria_k_alpha', 0.2, 0.9, held_up, null_space_share, '+', EQ_2),
    Case('criteria_k_alpha', 0.2, 0.9, held_up, time_lost, '-', EQ_2),
    Case('criteria_k_alpha', 0.9, 3.0, held_up, path_length, '+', EQ_2),
    Case('criteria_k_fixed', 2e-5, 1e-3, held_up, time_lost, '-', FIXED),
    Case('criteria_k_fixed', 1e-3, 1e-1, towards_a_ball, smallest_distance, '+', FIXED),
    Case('criteria_k_w', 0.0, 30.0, held_up, time_lost, '-', EQ_2),
    Case('criteria_k_w', 0.03, 30.0, towards_a_ball, distance_at_first_evasion, '+',
         ONLY_CLEARANCE),
    Case('criteria_k_s', 0.0, 10.0, free_position, off_mid_range, '-', NO_CLEARANCE),
    Case('criteria_k_s', 0.0, 10.0, free_position, path_length, '+', NO_CLEARANCE),
    Case('criteria_k_f', 0.0, 100.0, free, least_norm_at_the_end, '-', NO_CLEARANCE),
    Case('criteria_k_m', 0.0, 100.0, past_a_singularity, smallest_singular_value, '+',
         replace(EQ_2, singularity_margin=0.15)),
    Case('criteria_joint_weights', (1.0,) * 7, (5.0, *(1.0,) * 6), free, way_of_the_first_joint,
         '-'),
    Case('clearance_margin', 0.01, 0.05, towards_a_ball, smallest_distance, '+'),
    Case('slow_down', (), ('ball0=0.1:1.0',), towards_a_ball, time_lost, '+'),
    Case('clearance_influence_distance', 0.05, 0.1, towards_a_ball, distance_at_first_evasion,
         '+', ONLY_CLEARANCE),
    Case('clearance_smoothing', 0.0, 0.5, between_two_balls, largest_jump_of_the_null_space, '-',
         ONLY_CLEARANCE),
    Case('clearance_self_margin', -1.0, 0.005, folding, distance_between_links, '+'),
    Case('clearance_self_margin', 0.005, 0.05, folding, way_of_the_tip, '-'),
    Case('clearance_gain', 0.5, 5.0, towards_a_ball, smallest_distance, '-', NO_CLEARANCE),
    Case('clearance_gain', 0.5, 5.0, towards_a_ball, way_of_the_tip, '+', NO_CLEARANCE),
    Case('clearance_lead', 0.0, 0.1, across_the_first_link, smallest_distance, '+'),
    Case('clearance_evasion_horizon', 0.0, 2.0, into_the_first_link, smallest_distance, '+'),
    Case('allowed_contacts', (), tuple(f'{link}:ball0' for link in ('link3', 'link4', 'link5')),
         towards_a_ball, smallest_distance, '-'),
    Case('limits_position_margin', 0.01, 0.05, into_a_rail_end, room_to_limits, '+'),
    Case('limits_linear_speed', 0.05, 1.0, fast, way_of_the_tip, '+'),
    Case('limits_angular_speed', 0.1, 2.0, fast, turn_of_the_tip, '+'),
    Case('singularity_margin', 0.04, 0.1, stretching, smallest_singular_value, '+'),
    Case('singularity_margin', 0.04, 0.1, stretching, way_of_the_tip, '-'),
    Case('singularity_margin', 0.04, 0.1, stretching, fastest_joint, '-'),
    Case('singularity_damping', 0.02, 0.2, stretching, fastest_least_norm, '-', SINGULAR),
    Case('singularity_damping_threshold', 0.03, 0.1, stretching, fastest_least_norm, '-',
         SINGULAR),
    Case('horizon_duration', 0.3, 3.0, held_up_announced, time_lost, '-', VARIATIONAL),
    Case('horizon_held_duration', 0.2, 1.0, held_up, time_lost, '-', VARIATIONAL),
    Case('horizon_nodes', 2, 12, held_up_announced, time_lost, '-', VARIATIONAL),
    Case('horizon_look_ahead', 0.0, 1.5, held_up, time_lost, '-'),
    Case('feedback_gain', 1.0, 10.0, pushed, way_of_the_tip, '-'),
    Case('feedback_speed', 0.02, 0.1, pushed, way_of_the_tip, '-'),
    Case('feedback_angular_speed', 0.05, 0.5, pushed, turn_of_the_tip, '-'),
    Case('feedback_distance', 0.02, 0.3, pushed_far, way_of_the_tip, '-'),
    Case('feedback_angle', 0.05, 0.5, pushed_far, turn_of_the_tip, '-'),
]


@cache  # some compare the same motion
def motion_of(scenario, parameters):
    return scenario(parameters)


def test_every_parameter_has_a_case():
    assert {case.name for case in CASES} == {entry.name for entry in fields(PlannerParameters)}


@pytest.mark.first_alone
@pytest.mark.parametrize('case', CASES, ids=lambda case: f'{case.name}-{case.quantity.__name__}')
def test_a_parameter_acts_in_the_direction_that_it_says(case):
    low, high = (
        case.quantity(motion_of(case.scenario, replace(case.others, **{case.name: value})))
        for value in (case.low, case.high))
    growth = high - low if case.sign == '+' else low - high
    assert growth > LEAST_SHARE * max(abs(low), abs(high)), f'{low:.4g} → {high:.4g}'
