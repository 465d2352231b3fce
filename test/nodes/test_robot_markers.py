"""~/markers show what there is, and nothing that has gone since the tick they tell of."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.step_result import Nearest
from redundant_planner.nodes.robot_markers import RobotMarkers

PANDA = make_panda()
ARM = PANDA.kinematics(PANDA_READY)
BALL = Obstacle('ball', ARM.tip_position + (0.3, 0.0, 0.0), (0.05,) * 3)
HAND = PANDA.capsules[-1].name


def line(scene, nearest):
    """The ends of the line between the nearest pair."""
    markers = RobotMarkers(PANDA).message(PANDA, ARM, scene, nearest, None).markers
    (found,) = [marker for marker in markers if marker.ns == 'nearest']
    return [(p.x, p.y, p.z) for p in found.points]


def test_the_line_ends_on_the_nearest_obstacle():
    ends = line(Scene.of([BALL]), Nearest(HAND, 'ball', 1.0, 0.2))
    assert len(ends) == 2
    assert np.linalg.norm(np.array(ends[1]) - BALL.center) == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize('nearest', [
    Nearest(HAND, 'gone', 1.0, 0.2), Nearest('let go of', 'ball', 1.0, 0.2), None])
def test_what_is_gone_has_no_line(nearest):
    assert not line(Scene.of([BALL]), nearest)
    assert not line(Scene.of(), nearest)
