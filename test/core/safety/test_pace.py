"""How near what a tick does not look at may be."""

from __future__ import annotations

from conftest import make_panda, random_postures
from hypothesis import given, strategies as st
import numpy as np

from redundant_planner.core.kernels import compiled, Matrix, Vector
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.safety.pace import unseen_distances

PANDA = make_panda()
RADII = [capsule.radius for capsule in PANDA.capsules]


@compiled
def distances(
    start: Matrix, end: Matrix, start_then: Matrix, end_then: Matrix, ranges: Vector,
) -> Vector:
    """Return `unseen_distances`, a kernel, to Python."""
    return unseen_distances(start, end, start_then, end_then, ranges)


@given(seed=st.integers(0, 2**32 - 1), step=st.just(0.0) | st.floats(1e-3, 0.3))
def test_what_is_not_looked_at_is_no_nearer_than_is_thought(seed, step):
    random = np.random.default_rng(seed)
    ball = Obstacle('ball', random.uniform(-0.8, 0.8, 3), np.full(3, 0.05))
    then = random_postures(PANDA, 1, seed)[0]
    before, after = (PANDA.kinematics(q) for q in (
        then, then + step * random.uniform(-1.0, 1.0, PANDA.n)))
    maps = inflated_obstacles(Scene.of([ball]), RADII)
    was, now = (link_clearance(maps, arm.segment_start, arm.segment_end).distance[:, 0]
                for arm in (before, after))
    least = distances(after.segment_start, after.segment_end, before.segment_start,
                      before.segment_end, was)
    assert (least <= now + 1e-9).all()
    if step == 0.0:
        np.testing.assert_allclose(least, was, atol=1e-12)
    else:
        assert (least <= was).all() and (least[-1] < was[-1])
