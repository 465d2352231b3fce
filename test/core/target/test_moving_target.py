"""A target between two messages."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.moving_target import MovingTarget

DT = 0.004
ORIGIN = Pose(np.zeros(3), np.eye(3))
TWIST = np.array([0.1, -0.05, 0.2, 0.3, 0.0, -0.2])


def along(t):
    return se3.integrate(ORIGIN, TWIST, t, False)


@pytest.mark.parametrize('every', [1, 2, 8, 25])
def test_a_steady_stream_is_known_between_its_messages(every):
    target, now = MovingTarget(), 0
    for now in range(500):
        found = target.at(along(now // every * every * DT), DT)
    assert target.moving
    np.testing.assert_allclose(target.velocity, TWIST, rtol=0.02, atol=1e-3)
    np.testing.assert_allclose(found.position, along(now * DT).position, atol=1e-3)


def test_single_targets_stand_where_they_are():
    target = MovingTarget()
    for now in range(300):
        given = along(now // 100)  # 0.4 s apart
        np.testing.assert_array_equal(target.at(given, DT).position, given.position)
    assert not target.moving and not target.velocity.any()


def test_a_silent_stream_stands_at_its_last_pose():
    target = MovingTarget()
    for now in range(100):
        target.at(along(now * DT), DT)
    last = along(99 * DT)
    for _ in range(15):
        found = target.at(last, DT)
    assert not target.moving
    np.testing.assert_array_equal(found.position, last.position)


def test_a_leap_is_another_target():
    target = MovingTarget()
    for now in range(100):
        target.at(along(now * DT), DT)
    far = Pose(np.array([1.0, 0.0, 0.0]), np.eye(3))
    assert target.at(far, DT) is far and not target.moving
