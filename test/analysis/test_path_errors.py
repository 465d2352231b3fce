"""The distance between the tip and the path that it was commanded along."""

from __future__ import annotations

from conftest import planar_urdf
import numpy as np
import pytest

from redundant_planner import Robot
from redundant_planner.analysis.path_errors import path_errors

PERIOD = 0.004
ROBOT = Robot(planar_urdf(), 'tip', link_radius=0.02)


def errors_of(places):
    """Of a tip at places (k, 3) [m] that is commanded along x at 0.1 m/s for the first half."""
    times = PERIOD * np.arange(len(places))
    twists = np.zeros((len(places), 6))
    twists[:len(places) // 2, 0] = 0.1
    rotations = np.tile(np.eye(3), (len(places), 1, 1))
    return path_errors(ROBOT, times, twists, places, rotations, np.empty(0))


def test_a_tip_that_brakes_on_its_path_is_not_off_it():
    # The recording begins while the arm moves, so its way to rest leads beyond the last command's.
    places = np.zeros((200, 3))
    speed = np.clip(0.1 - 0.1 / 12 * (np.arange(200) - 100), 0.0, 0.1)  # [m/s], 12 ticks to rest
    places[1:, 0] = np.cumsum(PERIOD * speed[:-1])
    assert places[-1, 0] > 0.1 * 100 * PERIOD + 0.001
    np.testing.assert_allclose(errors_of(places), 0.0, atol=1e-12)


def test_a_tip_beside_its_path_is_off_it_while_it_brakes_too():
    places = np.zeros((200, 3))
    places[1:, 0] = np.cumsum(np.full(199, 0.1 * PERIOD))
    places[120:, 1] = 0.003
    assert errors_of(places).max() == pytest.approx(0.003)
