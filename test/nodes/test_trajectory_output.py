"""The points of joint_trajectory make joint_trajectory_controller move as smoothly as commands."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.nodes.command_output import TRAJECTORY_PERIODS, trajectory_point

PERIOD = 0.004


def followed(positions, velocities, late):
    """Where the controller takes a joint: each cycle goes on in a line to the latest point.

    A trajectory without a stamp begins on arrival, from where the joint is; at its end it stands.

    Args:
        positions, velocities: (k,) of the commands, one a cycle.
        late: (k,) how much later in its cycle each comes, as a share of the period.
    """
    q = [positions[0]]
    for i in range(1, len(positions)):
        point = trajectory_point(positions[i:i + 1], velocities[i:i + 1], PERIOD)[0]
        left = TRAJECTORY_PERIODS - late[i]
        q.append(q[-1] + (point - q[-1]) * min(1.0 / left, 1.0))
    return np.array(q)


@pytest.mark.parametrize('jitter', [0.0, 0.2])
def test_it_is_as_smooth_as_the_commands_and_stops_as_gently(jitter):
    random = np.random.default_rng(0)
    t = np.arange(1500) * PERIOD
    velocities = np.where(t < 5.0, 0.4 * np.sin(2.0 * t) * np.minimum(t, 1.0), 0.0)
    stop = t >= 4.0
    velocities[stop] = velocities[~stop][-1] * np.clip(1.0 - (t[stop] - 4.0) / 0.05, 0.0, 1.0)
    positions = np.cumsum(velocities) * PERIOD
    q = followed(positions, velocities, jitter * random.random(len(t)))
    speed = np.diff(q) / PERIOD
    assert abs(q[-1] - positions[-1]) < 1e-9
    assert np.abs(q - positions).max() < 2.0 * PERIOD * 0.4
    if not jitter:
        moving = np.abs(velocities[1:]) > 0.02
        assert (np.abs(speed[moving]) > 1e-3).all()  # no cycle without motion
        rms = [np.sqrt(np.mean((np.diff(v) / PERIOD) ** 2)) for v in (speed, velocities)]
        assert rms[0] < 1.3 * rms[1]
