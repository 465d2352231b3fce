"""Pairs along a path against those of every posture."""

from __future__ import annotations

from closed_loop import random_obstacle, random_scene
from conftest import random_postures
import numpy as np
import pytest
from test_clearance import all_clearances

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.clearance_gradients import clearance_gradients
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.near_pairs import (
    MOST_ACTING,
    MOST_AHEAD_PAIRS,
    near_pairs,
    near_pairs_along,
)
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


@pytest.mark.parametrize('count', [5, 80])
def test_of_too_many_pairs_along_a_path_the_nearest_are_taken(robot, count):
    """Also where a pair's distance is only known from the posture before."""
    times, random, crowds = np.linspace(0.02, 2.0, 12), np.random.default_rng(4), 0
    for seed in range(10):
        one, other = random_postures(robot, 2, seed)
        arms = robot.kinematics_along(np.linspace(one, one + 0.3 * (other - one), len(times)))
        scene = Scene.of([random_obstacle(random, f'{i}') for i in range(count)])
        maps = inflated_obstacles(scene, [c.radius for c in robot.capsules])
        every = link_clearance(maps, arms.segment_start, arms.segment_end, times)
        near = near_pairs_along(maps, arms, robot.chain, times, 0.15)
        within = np.append(np.sort(every.distance.ravel()), np.inf)[
            min(MOST_AHEAD_PAIRS, every.distance.size)]
        chosen = (every.distance < min(within, 0.15)).nonzero()
        np.testing.assert_array_equal(near.postures, chosen[0])
        np.testing.assert_array_equal(
            near.normalized_distance, every.normalized_distance[chosen])
        assert near.nearest == every.distance.min()
        crowds += within < 0.15
    assert (crowds > 2) == (count == 80)


@pytest.mark.parametrize('shape', ['ellipsoids', 'boxes'])
def test_a_barrier_that_is_left_out_holds_at_any_velocity_of_the_tick(robot, shape):
    """However fast the joints are: among few things at rest nothing needs to slow them down."""
    random, left_out = np.random.default_rng(8), 0
    for seed in range(25):
        q = random_postures(robot, 1, seed)[0]
        things = [random_obstacle(random, f'{i}') for i in range(7)]
        kind = Obstacle.box if shape == 'boxes' else Obstacle
        things = [kind(o.name, o.center, o.half_extents, orientation=o.orientation)
                  for o in things]
        arm, maps, pairs = all_clearances(robot, q, things)
        fastest, rate = random.uniform(0.2, 1.0) * robot.velocity_max, random.uniform(2.0, 8.0)
        speeds = robot.lever_arm_bounds @ fastest
        near = near_pairs(maps, robot.links(arm), fastest, speeds, rate, 0.1,
                          np.full(len(speeds), np.inf))
        assert len(near.acting) <= MOST_ACTING
        acting = {(near.links[i], near.obstacles[i]) for i in near.acting}
        dq = random.choice((-1.0, 1.0), (200, robot.n)) * fastest
        every = np.ones_like(pairs.distance, dtype=bool).nonzero()
        gradient, _ = clearance_gradients(maps, pairs, every, robot.links(arm))
        for link, obstacle, row in zip(*every, gradient):
            rho = pairs.normalized_distance[link, obstacle]
            within = near.unseen[link] <= pairs.distance[link, obstacle]
            if (link, obstacle) not in acting and rho > 0.0 and not within:
                assert (dq @ row >= -rate * rho).all()
                left_out += pairs.distance[link, obstacle] < speeds[link] / rate
    assert left_out > 100, 'the lever arms alone said as much'
