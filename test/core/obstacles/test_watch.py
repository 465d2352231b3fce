"""The obstacles that a watch remembers are those of the scene that it looked at last."""

from __future__ import annotations

from conftest import make_panda, PANDA_READY
import numpy as np

from redundant_planner.core.constants import gains_of, limits_of, robot_constants
from redundant_planner.core.obstacles.nearby import FEW
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.watch import ObstacleWatch
from redundant_planner.core.parameters import PlannerParameters

PANDA, DEFAULTS = make_panda(), PlannerParameters()


def in_a_row(y):
    """Balls, of which most are far from the arm, at this place along y [m]."""
    return Scene.of(Obstacle(f'ball{i}', np.array([0.5 * i, y, 0.3]), np.full(3, 0.05))
                    for i in range(FEW + 5))


def test_everywhere_is_the_same_until_another_scene_is_looked_at():
    watch = ObstacleWatch(PANDA, DEFAULTS, limits_of(PANDA, DEFAULTS),
                          robot_constants(PANDA, DEFAULTS), gains_of(DEFAULTS), None)
    arm, rest, before = PANDA.kinematics(PANDA_READY), np.zeros(PANDA.n), None
    for y in (0.6, -0.6, 0.6):
        scene = in_a_row(y)
        around = watch.look(scene, arm, rest, 0.004, by_target=False)
        assert not around.complete
        every = watch.everywhere()
        np.testing.assert_array_equal(every.centers.T, scene.centers)
        assert every is not before
        watch.look(scene, arm, rest, 0.004, by_target=False)
        assert watch.everywhere() is every
        before = every
