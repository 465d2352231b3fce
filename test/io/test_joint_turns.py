"""Wrapped measurements are unwrapped: continuous joints, and those whose driver wraps them."""

from __future__ import annotations

from conftest import planar_urdf
from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.turns import nearest_turn, TURN
from redundant_planner.io.joint_turns import Seams, Unwrapping, wrapped


def seams(kind='continuous', lower=-2.5, upper=2.5):
    """Those of an arm with one joint."""
    urdf = planar_urdf((kind,), (0.3,)).replace('-2.5', str(lower)).replace('"2.5', f'"{upper}')
    return Seams.of(Robot(urdf, 'tip', axes=('vx',), link_radius=0.0))


def as_driven(q):
    return wrapped(np.atleast_1d(q), np.array([np.inf]))


@given(st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=60), st.floats(-3.0, 3.0))
def test_any_motion_of_a_continuous_joint_is_measured_as_it_was(steps, start):
    q = start + np.cumsum([0.0, *steps])
    one, rows = Unwrapping(seams()), Unwrapping(seams())
    found = [one.posture(as_driven(value))[0] for value in q]
    np.testing.assert_allclose(found, q, atol=1e-12)
    split = len(q) // 2
    measured = np.array([as_driven(value) for value in q])
    parts = [rows.rows(part) for part in (measured[:split], measured[split:]) if len(part)]
    np.testing.assert_allclose(np.vstack(parts)[:, 0], q, atol=1e-12)
    for unwrapping in (one, rows):  # what goes out is where the driver is
        np.testing.assert_allclose(q[-1] + unwrapping.turned, as_driven(q[-1]), atol=1e-12)


def test_noise_at_the_seam_is_noise():
    joint, random = Unwrapping(seams()), np.random.default_rng(0)
    found = [joint.posture(as_driven(np.pi + 1e-4 * random.normal()))[0] for _ in range(200)]
    assert np.ptp(found) < 1e-3


def test_a_continuous_joint_whose_driver_does_not_wrap_is_measured_as_it_is():
    joint = Unwrapping(seams())
    for q in np.arange(0.0, 40.0, 0.3):
        assert joint.posture(np.array([q]))[0] == q
    assert not joint.turned.any()
    # A driver that begins to count anew after a restart measures the same place.
    assert joint.posture(np.array([39.9 - 6.0 * TURN]))[0] == pytest.approx(39.9)
    assert joint.turned[0] == pytest.approx(-6.0 * TURN)


def test_a_joint_with_limits_is_unwrapped_where_its_driver_wraps_it():
    wide = Unwrapping(seams('revolute', -6.28, 6.28))
    way = np.concatenate((np.arange(3.0, 4.5, 0.01), np.arange(4.5, -4.0, -0.01)))
    found = [wide.posture(as_driven(q))[0] for q in way]
    np.testing.assert_allclose(found, way, atol=1e-12)


@pytest.mark.parametrize('leap', [1.0, 3.5, 5.5, 7.0])
def test_another_leap_of_a_joint_with_limits_stays_one(leap):
    joint = Unwrapping(seams('revolute', -6.28, 6.28))
    joint.posture(np.array([-3.0]))
    assert joint.posture(np.array([-3.0 + leap]))[0] == -3.0 + leap


def test_a_sliding_joint_never_turns():
    joint = Unwrapping(seams('prismatic', -7.0, 7.0))
    joint.posture(np.array([-3.0]))
    assert joint.posture(np.array([-3.0 + TURN]))[0] == -3.0 + TURN


@pytest.mark.parametrize('kind, lower, upper, measured, meant', [
    ('continuous', 0.0, 0.0, 9.0, 9.0),  # as measured, whatever that is
    ('revolute', 0.0, 6.2, -1.0, TURN - 1.0),  # a turn further it is within its limits
    ('revolute', -6.2, 0.0, 1.0, 1.0 - TURN),
    ('revolute', -6.28, 6.28, -3.0, -3.0),  # both would do
    ('revolute', -3.1, 3.1, 3.14, 3.14),  # a little beyond its limit
    ('revolute', -6.2, 6.2, 6.25, 6.25),  # too, though a turn from there it would be within
    ('revolute', -6.2, 6.2, -6.25, -6.25),
    ('revolute', -1.0, 1.0, 2.0, 2.0),  # no turn helps
    ('prismatic', 0.0, 6.2, -1.0, -1.0)])
def test_at_the_start_a_turn_counts_only_where_the_limits_ask_for_it(
        kind, lower, upper, measured, meant):
    joint = Unwrapping(seams(kind, lower, upper))
    assert joint.posture(np.array([measured]))[0] == pytest.approx(meant)
    assert joint.posture(np.array([measured + 0.01]))[0] == pytest.approx(meant + 0.01)


def test_joints_that_come_later_begin_as_they_are_measured():
    urdf = planar_urdf(('continuous', 'continuous'), (0.3, 0.3))
    joints = Unwrapping(Seams.of(Robot(urdf, 'tip', axes=('vx',), link_radius=0.0)))
    found = [joints.posture(np.array(q)) for q in (
        [3.1, np.nan], [-3.1, np.nan], [-3.0, 3.0], [-2.9, -3.1])]
    expected = [[3.1, np.nan], [TURN - 3.1, np.nan], [TURN - 3.0, 3.0], [TURN - 2.9, TURN - 3.1]]
    np.testing.assert_allclose(found, expected)


@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
def test_the_nearest_turn_is_within_half_a_turn_and_the_same_place(q, near):
    ends = np.array([np.inf, 3.0])
    found = nearest_turn(np.array([q, q]), np.array([near, near]), ends)
    assert abs(found[0] - near) <= np.pi + 1e-9 and found[1] == q
    assert np.cos(found[0] - q) == pytest.approx(1.0)
    assert np.array_equal(nearest_turn(found, found, ends), found)


@given(st.floats(-50.0, 50.0))
def test_drivers_give_positions_above_minus_pi_up_to_pi(q):
    found, = as_driven(q)
    assert -np.pi < found <= np.pi + 1e-12 and np.cos(found - q) == pytest.approx(1.0)
