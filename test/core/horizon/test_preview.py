"""What will be commanded, announced or guessed."""

from __future__ import annotations

import itertools

from hypothesis import given, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import StateError
from redundant_planner.core.horizon.held_twist import continued
from redundant_planner.core.horizon.preview import Preview


def test_a_preview_is_linear_between_its_points_steps_at_equal_times_and_ends():
    one = np.ones(6)
    preview = Preview(np.array([0.0, 1.0, 1.0, 2.0, 3.0]), np.outer([0, 1, 3, 3, 0], one))
    values = preview.at(np.array([-0.1, 0.0, 0.25, 1.0, 1.5, 2.5, 3.0, 9.0]))[:, 0]
    np.testing.assert_allclose(values, [0.0, 0.0, 0.25, 3.0, 3.0, 1.5, 0.0, 0.0])
    assert not Preview(np.zeros(1), one[None]).at(np.array([-1.0, 0.0, 1.0])).any()


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_the_mean_twists_between_times_are_those_of_the_preview_integrated(seed, points):
    random = np.random.default_rng(seed)
    gaps = random.uniform(size=points - 1) * random.integers(0, 2, points - 1)
    preview = Preview(0.3 + np.append(0.0, gaps.cumsum()), random.normal(size=(points, 6)))
    times = np.sort(random.uniform(-0.5, preview.times[-1] + 0.5, 4))
    for i, mean in enumerate(preview.between(times)):
        # Piece by piece, as the twist may make steps.
        knots = np.unique(np.clip(np.append(preview.times, times), times[i], times[i + 1]))
        total = sum((b - a) * preview.at(np.array([0.5 * (a + b)]))[0]
                    for a, b in itertools.pairwise(knots))
        np.testing.assert_allclose(
            mean, total / (times[i + 1] - times[i]), atol=1e-9)


@pytest.mark.parametrize(('times', 'twists', 'message'), [
    ([], np.empty((0, 6)), 'has 0 times'),
    ([0.0, 1.0], np.zeros((1, 6)), 'one or more points with six numbers each'),
    ([0.0, np.nan], np.zeros((2, 6)), 'not finite'),
    ([0.0, 2.0, 1.0], np.zeros((3, 6)), 'go backwards, from 2.0 to 1.0 s'),
])
def test_a_bad_preview_is_refused(times, twists, message):
    with pytest.raises(StateError, match=message):
        Preview(np.array(times), twists)


def test_a_held_command_goes_on_as_it_did():
    command = np.array([0.1, 0.0, -0.2, 0.0, 0.3, 0.0])
    times = np.array([0.0, 0.5, 1.0, 4.0])
    for growth, shares in ((0.0, [1, 1, 1, 1]), (1.0, [1, 1.5, 2, 2]), (-1.0, [1, 0.5, 0, 0])):
        np.testing.assert_allclose(
            continued(command, growth, times), np.outer(shares, command))


def test_a_preview_tells_when_its_motion_is_over():
    one, still = np.ones(6), np.zeros(6)
    ramp = Preview([0.0, 1.0, 2.0, 5.0], [one, one, still, still])
    assert ramp.end == 2.0 and ramp.ahead(0.5).rest == pytest.approx(1.5)
    assert Preview([0.0, 1.0, 1.0, 5.0], [one, one, still, still]).end == 1.0
    assert Preview([0.0, 3.0], [one, one]).end == 3.0
    assert Preview([1.0, 3.0], [still, still]).end == 1.0
    times = np.array([0.0, 0.2, 0.9])
    np.testing.assert_array_equal(ramp.ahead(0.5)(times), ramp.between(times + 0.5))
