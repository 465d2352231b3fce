"""An arm that is pressed against an obstacle comes to rest on it, and stays quiet."""

from __future__ import annotations

from closed_loop import DT
from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

from benchmark.judge import reversals
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.stage import Stage
from redundant_planner.simulation import simulate

PANDA = make_panda()


def pressed(seed, method, seconds=4.0):
    """Return a motion at 0.15 m/s into a ball on the way, 2 cm off its centre."""
    random = np.random.default_rng(seed)
    q = PANDA_READY + random.uniform(-0.3, 0.3, PANDA.n)
    way, aside = random.normal(size=(2, 3))
    way /= np.linalg.norm(way)
    aside -= aside @ way * way
    aside /= np.linalg.norm(aside)
    ball = Obstacle('ball', PANDA.kinematics(q).tip_position + 0.25 * way + 0.02 * aside,
                    [0.08] * 3)
    return simulate(
        Planner(PANDA, PlannerParameters(method=method)), q,
        np.concatenate((0.15 * way, np.zeros(3))), Scene.of([ball]), seconds, DT)


# Without each of these three some of the motions failed: the bending of the links' ways (FORCED,
# seeds 7 and 10; braking in every other tick, seed 13), the easing of slight intrusions (FORCED,
# seed 17), and slowing down on a path that leads nowhere (variational, seeds 1, 6 and 8).
@pytest.mark.first_alone
@pytest.mark.parametrize('seed, method', [
    (7, 'dynamic_factor'), (10, 'dynamic_factor'), (13, 'dynamic_factor'), (17, 'dynamic_factor'),
    (1, 'variational'), (6, 'variational'), (8, 'variational')])
def test_a_pressed_arm_neither_shakes_nor_gives_up_its_clearance(seed, method):
    motion = pressed(seed, method)
    commands = np.array([result.dq for result in motion.results])
    assert motion.results[-1].scale < 0.01
    assert Stage.FORCED not in {result.stage for result in motion.results}
    assert min(result.nearest.beyond_margin for result in motion.results) > -1e-6
    assert reversals(np.diff(commands, axis=0) / DT, PANDA.acceleration_max) <= 40
