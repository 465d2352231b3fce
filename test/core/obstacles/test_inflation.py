"""Inflated ellipsoids contain ellipsoid ⊕ ball."""

from __future__ import annotations

from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest

from redundant_planner.core.obstacles.inflation import inflated_semi_axes

axes = arrays(float, 3, elements=st.floats(0.01, 0.5))


@given(axes, st.floats(0.0, 0.3), arrays(float, (2, 3), elements=st.floats(-1, 1)))
def test_inflation_contains_ellipsoid_plus_ball(semi_axes, radius, directions):
    inflated = inflated_semi_axes(semi_axes[None], np.full((1, 1), radius))[0, 0]
    norms = np.linalg.norm(directions, axis=1)
    if (norms < 1e-3).any():
        return
    on_ellipsoid = semi_axes * directions[0] / norms[0]
    on_ball = radius * directions[1] / norms[1]
    assert np.sum(((on_ellipsoid + on_ball) / inflated) ** 2) <= 1.0 + 1e-9
    # Trace-minimal: (√tr A² + √3 r)² exactly.
    expected = (np.sqrt(np.sum(semi_axes**2)) + np.sqrt(3.0) * radius) ** 2
    assert np.sum(inflated**2) == pytest.approx(expected, rel=1e-9)


def test_adding_the_radius_to_the_semi_axes_would_not_be_conservative():
    # The reason for the inflation: a long thin ellipsoid and a ball beside its shoulder.
    semi_axes, radius = np.array([1.0, 0.1, 0.1]), 0.3
    angles = np.linspace(0.0, np.pi / 2, 200)
    surface = np.stack((np.cos(angles), 0.1 * np.sin(angles)), axis=1)
    normals = np.stack((np.cos(angles), np.sin(angles) / 0.1), axis=1)
    touching = surface + radius * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    assert ((touching / (semi_axes[:2] + radius)) ** 2).sum(axis=1).max() > 1.1
    inflated = inflated_semi_axes(semi_axes[None], np.full((1, 1), radius))[0, 0]
    assert ((touching / inflated[:2]) ** 2).sum(axis=1).max() <= 1
