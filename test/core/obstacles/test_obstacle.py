"""What an obstacle may be."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.obstacle import Obstacle


@pytest.mark.parametrize(('change', 'message'), [
    ({'semi_axes': [0.1, 0.0, 0.1]}, r'semi_axes are \[0.1, 0.0, 0.1\]; all three must be'),
    ({'semi_axes': [0.1, -0.1, 0.1]}, r'all three must be positive'),
    ({'semi_axes': [0.1, 0.1]}, r'it takes 3 finite numbers'),
    ({'center': [0.0, np.nan, 0.0]}, r'center is \[0.0, nan, 0.0\]'),
    ({'orientation': [0.0, 0.0, 0.0, 0.0]}, r'has length 0; it must be 1'),
    ({'orientation': [0.0, 0.0, 0.0, 2.0]}, r'has length 2; it must be 1'),
    ({'velocity': [np.inf, 0.0, 0.0]}, r'velocity'),
])
def test_bad_obstacles_are_refused_by_name(change, message):
    values = {'center': np.zeros(3), 'semi_axes': np.full(3, 0.1), **change}
    with pytest.raises(ObstacleError, match=f"obstacle 'column': .*{message}"):
        Obstacle('column', **values)


def test_an_obstacle_is_not_changed_from_outside():
    center = np.zeros(3)
    obstacle = Obstacle('o', center, np.ones(3))
    center[0] = 5.0
    assert obstacle.center[0] == 0.0
    with pytest.raises(ValueError, match='read-only'):
        obstacle.center[0] = 1.0
