"""Pairs along a path against those of every posture."""

from __future__ import annotations

from closed_loop import random_scene
from conftest import random_postures
import numpy as np
import pytest
from test_clearance import all_clearances

from redundant_planner.core.obstacles.clearance_gradients import clearance_gradients
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.near_pairs import near_pairs_along
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene


def test_pairs_along_a_path_are_those_of_each_posture(robot):
    times, within = np.array([0.1, 0.5, 2.0]), 0.2
    for seed in range(10):
        postures, obstacles = random_postures(robot, 3, seed), random_scene(robot, seed)
        arms = robot.kinematics_along(postures)
        maps = inflated_obstacles(Scene.of(obstacles), [c.radius for c in robot.capsules])
        near = near_pairs_along(maps, arms, robot.chain, times, within)
        found, nearest = 0, np.inf
        for at, (q, time) in enumerate(zip(postures, times)):
            there = [Obstacle(o.name, o.center + time * o.velocity, o.half_extents, o.orientation)
                     for o in obstacles]
            arm, maps, pairs = all_clearances(robot, q, there)
            chosen = (pairs.distance < within).nonzero()
            gradient, _ = clearance_gradients(maps, pairs, chosen, robot.links(arm))
            here = slice(found, found + len(gradient))
            assert (near.postures[here] == at).all()
            np.testing.assert_allclose(
                near.normalized_distance[here], pairs.normalized_distance[chosen], atol=1e-12)
            np.testing.assert_allclose(near.smallest[here], maps.smallest[chosen])
            np.testing.assert_allclose(near.gradient[here], gradient, atol=1e-9)
            found, nearest = here.stop, min(nearest, pairs.distance.min())
        assert found == len(near.normalized_distance) and near.nearest == pytest.approx(nearest)
