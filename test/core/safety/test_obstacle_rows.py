"""How much clearance the barrier of a link and an obstacle has to use up."""

from __future__ import annotations

from closed_loop import mixed_scene
from conftest import make_panda, random_postures
import numpy as np

from redundant_planner.core.constants import robot_constants
from redundant_planner.core.kernels import compiled, Vector
from redundant_planner.core.obstacles.inflation import inflated_obstacles, InflatedObstacles
from redundant_planner.core.obstacles.near_pairs import near_pairs, NearPairs
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.safety.barriers import (
    barriers_in,
    barriers_in_compiled,
    obstacle_rows,
    room_for_rows,
    Rows,
)

PANDA = make_panda()
RADII = [capsule.radius for capsule in PANDA.capsules]


@compiled
def write_rows(
    rows: Rows, near: NearPairs, maps: InflatedObstacles, strayed: Vector,
) -> int:
    """Write the rows and return how many they are."""
    return obstacle_rows(
        barriers_in_compiled(rows, len(near.acting)), 0, near, maps, 0.0, strayed)


def test_a_link_that_has_strayed_has_that_much_less_to_use_up():
    """But one that is inside the margin already is not asked to get out any faster."""
    random, rows = np.random.default_rng(4), room_for_rows(
        robot_constants(PANDA, PlannerParameters()))
    shrunk = used_up = inside = 0
    for seed, q in enumerate(random_postures(PANDA, 30)):
        arm, maps = PANDA.kinematics(q), inflated_obstacles(
            Scene.of(mixed_scene(seed)), RADII, moved=PANDA.moved)
        near = near_pairs(maps, PANDA.links(arm), PANDA.velocity_max, np.full(len(RADII), 2.0),
                          2.0, 0.1, np.full(len(RADII), np.inf))
        strayed = random.uniform(0.0, 0.3, len(RADII))
        found = barriers_in(rows, write_rows(rows, near, maps, strayed))
        left = found.value * maps.smallest[found.first, found.second]
        for before, after, by in zip(near.distance[near.acting], left, strayed[found.first]):
            if before < 0.0:
                inside += 1
                assert abs(after - before) < 1e-12
            elif before > by:
                shrunk += 1
                assert abs(before - by - after) < 1e-12
            else:
                used_up += 1
                assert after == 0.0
    assert min(shrunk, used_up, inside) > 5
