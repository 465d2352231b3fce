"""Poses on SE(3): integration is exact, errors invert it."""

from __future__ import annotations

from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.robot.se3 import displaced, feedback, integrate, Pose, pose_error

twists = arrays(float, 6, elements=st.floats(-1.0, 1.0))


def pose_of(numbers):
    return Pose(numbers[:3].copy(), np.ascontiguousarray(pin.exp3(numbers[3:])))


@pytest.mark.parametrize('in_tool', [False, True])
@given(start=twists, twist=twists)
def test_one_long_step_equals_many_short_ones(in_tool, start, twist):
    once = integrate(pose_of(start), twist, 1.0, in_tool)
    many = pose_of(start)
    for _ in range(50):
        many = integrate(many, twist, 0.02, in_tool)
    np.testing.assert_allclose(once.position, many.position, atol=1e-9)
    np.testing.assert_allclose(once.rotation, many.rotation, atol=1e-9)


@given(start=twists, twist=twists)
def test_frames_agree_on_the_same_motion(start, twist):
    # To first order a tool twist ξ is the base twist (Rv, Rω) of the same tip point.
    pose, dt = pose_of(start), 1e-6
    tool = integrate(pose, twist, dt, True)
    base = integrate(pose, np.concatenate((pose.rotation @ twist[:3], pose.rotation @ twist[3:])),
                     dt, False)
    np.testing.assert_allclose(tool.position, base.position, atol=1e-11)
    np.testing.assert_allclose(tool.rotation, base.rotation, atol=1e-11)


@pytest.mark.parametrize('in_tool', [False, True])
def test_a_pure_rotation_leaves_the_tip_where_it_is(in_tool):
    pose = pose_of(np.array([0.4, 0.1, 0.5, 0.3, -0.2, 0.9]))
    turned = integrate(pose, np.array([0, 0, 0, 0.4, -1.0, 0.7]), 2.0, in_tool)
    np.testing.assert_allclose(turned.position, pose.position, atol=1e-15)


@pytest.mark.parametrize('in_tool', [False, True])
@given(start=twists, error=twists)
def test_error_is_the_inverse_of_displacement(in_tool, start, error):
    pose = pose_of(start)
    np.testing.assert_allclose(
        pose_error(displaced(pose, error, in_tool), pose, in_tool), error, atol=1e-9)


@given(twists, st.floats(0.0, 50.0))
def test_feedback_points_at_the_reference_and_is_capped(error, gain):
    twist = feedback(error, gain, 0.1, 0.5)
    for part, source, cap in ((twist[:3], error[:3], 0.1), (twist[3:], error[3:], 0.5)):
        assert np.linalg.norm(part) <= cap * (1 + 1e-12)
        assert part @ source >= 0.0
        expected = gain * np.linalg.norm(source)
        assert np.linalg.norm(part) == pytest.approx(min(expected, cap))


def test_feedback_does_not_change_its_argument():
    error = np.ones(6)
    feedback(error, 100.0, 0.1, 0.1)
    np.testing.assert_array_equal(error, 1.0)
