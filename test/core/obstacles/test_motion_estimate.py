"""Velocities from successive positions, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.core.obstacles.motion_estimate import (
    forget,
    next_change,
    SHORTEST_STEP,
    Sightings,
    STATIC_AFTER,
    stop_silent,
    take_in,
    TELEPORT_SPEED,
    unseen,
)

BEGIN = 100.0


def seen(
    tracks, at, stamp=0.0, now=BEGIN, *, removed=0, lifetime=0.0, estimate=True, twist=None,
):
    """One sighting of the first obstacle; what `take_in` returns."""
    return take_in(tracks, Sightings(
        np.zeros(1, np.intp), np.array([removed]), np.array([at], dtype=float),
        np.eye(3)[None].copy(), np.zeros(1, np.intp), np.full((1, 3), 0.1), np.array([stamp]),
        np.array([lifetime]),
        np.empty((0, 6)) if twist is None else np.array([twist])), now, estimate)


@pytest.fixture
def tracks():
    """An obstacle that was seen at the origin."""
    made = unseen(1)
    assert seen(made, (0.0, 0.0, 0.0), BEGIN) == (True, np.inf)
    np.testing.assert_array_equal(made.velocities, 0.0)
    return made


@pytest.mark.parametrize(('step', 'elapsed', 'moves'), [
    (0.1, 0.1, True), (0.1, 0.2, True), (1e-9, 0.1, True),
    (0.99 * TELEPORT_SPEED, 1.0, True), (1.01 * TELEPORT_SPEED, 1.0, False),
    (0.1, 0.9 * SHORTEST_STEP, False), (0.1, -STATIC_AFTER, False), (0.1, -0.5 * BEGIN, False)])
def test_the_velocity_is_the_step_over_the_time_between_stamps(tracks, step, elapsed, moves):
    changed, soonest = seen(tracks, (step, 0.0, -step / 9.0), BEGIN + elapsed, now=BEGIN + 7.0)
    assert changed and (soonest < np.inf) == moves
    expected = np.array([step, 0.0, -step / 9.0]) / elapsed if moves else np.zeros(3)
    np.testing.assert_allclose(tracks.velocities[0], expected, rtol=1e-6)
    np.testing.assert_array_equal(tracks.centers[0], [step, 0.0, -step / 9.0])


def test_without_stamps_the_time_of_arrival_counts(tracks):
    seen(tracks, (0.1, 0.0, 0.0), now=BEGIN + 0.5)
    np.testing.assert_allclose(tracks.velocities[0], [0.2, 0.0, 0.0])


def test_a_velocity_is_not_estimated_unasked(tracks):
    seen(tracks, (0.1, 0.0, 0.0), BEGIN + 0.1, estimate=False)
    assert not tracks.velocities.any() and next_change(tracks) == np.inf


def test_the_same_sighting_once_more_changes_nothing(tracks):
    assert seen(tracks, (0.0, 0.0, 0.0), BEGIN, now=BEGIN + 1.0) == (False, np.inf)


def test_a_silent_obstacle_counts_as_static(tracks):
    seen(tracks, (0.1, 0.0, 0.0), BEGIN + 0.1, now=BEGIN + 0.1)
    due = next_change(tracks)
    assert due == pytest.approx(BEGIN + 0.1 + STATIC_AFTER)
    assert not stop_silent(tracks, due - 1e-3) and tracks.velocities.any()
    assert stop_silent(tracks, due) and not tracks.velocities.any()


def test_a_removed_obstacle_ends_at_once_and_leaves_no_trace(tracks):
    seen(tracks, (0.1, 0.0, 0.0), BEGIN + 0.1, lifetime=2.0)
    assert tracks.expiry[0] == BEGIN + 2.0
    seen(tracks, (np.nan,) * 3, removed=1)
    assert tracks.expiry[0] == -np.inf and np.isnan(tracks.centers).all()
    seen(tracks, (0.2, 0.0, 0.0), BEGIN + 0.2)
    assert not tracks.velocities.any(), 'seen for the first time'


def test_forgotten_obstacles_keep_their_places_only(tracks):
    seen(tracks, (0.1, 0.0, 0.0), BEGIN + 0.1)
    forget(tracks)
    assert not tracks.velocities.any() and (tracks.stamps == -np.inf).all()
