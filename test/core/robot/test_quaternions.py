"""Quaternions are those of their rotations, and cost no memory."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given, strategies as st
import numpy as np
import pinocchio as pin

from redundant_planner.core.robot.quaternions import quaternion_of


@given(st.lists(st.floats(-7.0, 7.0), min_size=3, max_size=3).map(np.array))
def test_it_is_the_rotation(turn):
    rotation = pin.exp3(turn)
    quaternion = quaternion_of(rotation)
    assert np.linalg.norm(quaternion) <= 1.0 + 1e-9
    np.testing.assert_allclose(
        pin.Quaternion(quaternion).toRotationMatrix(), rotation, atol=1e-9)


def test_an_hour_of_markers_leaves_nothing_behind():
    """So many take a MiB and a half if each loses 80 bytes."""
    rotation = np.eye(3)

    def memory():
        status = Path('/proc/self/status').read_text()
        return int(status.split('RssAnon:')[1].split()[0])

    for _ in range(2000):
        quaternion_of(rotation)
    before = memory()
    for _ in range(20_000):
        quaternion_of(rotation)
    assert memory() - before < 500
