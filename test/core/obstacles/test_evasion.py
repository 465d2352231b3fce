"""Turns out of obstacles' courses, against brute force."""

from __future__ import annotations

import numpy as np
import pytest

from redundant_planner.core.obstacles.evasion import Evasion, NO_TURN
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters

PARAMETERS = PlannerParameters(
    clearance_evasion_horizon=2.0, clearance_margin=0.01, clearance_lead=0.1)
HORIZON, MARGIN = PARAMETERS.clearance_evasion_horizon, PARAMETERS.clearance_margin
LEAD = PARAMETERS.clearance_lead


def passing(robot, random, count=2, speed=0.3):
    """Obstacles of any shape on their way through where the arm may be."""
    found = []
    for i in range(count):
        course = random.normal(size=3)
        velocity = speed * random.uniform(0.2, 1.0) * course / np.linalg.norm(course)
        through = random.uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 1.0])
        orientation = random.normal(size=4)
        center = through - random.uniform(0.0, 3.0) * velocity
        size = random.uniform(0.04, 0.1, 3)
        place = {'orientation': orientation / np.linalg.norm(orientation), 'velocity': velocity}
        found.append(random.choice([
            Obstacle(f'o{i}', center, size, **place),
            Obstacle.box(f'o{i}', center, 2.0 * size, **place),
            Obstacle.cylinder(f'o{i}', center, size[0], 2.0 * size[1], **place),
            Obstacle.capsule(f'o{i}', center, size[0], 2.0 * size[1], **place)]))
    return Scene.of(found)


def maps_of(robot, scene):
    return inflated_obstacles(scene, [c.radius + MARGIN for c in robot.capsules], LEAD)


def evasion_of(robot):
    return Evasion(robot, PARAMETERS)


def joints_of(robot):
    return evasion_of(robot)._joints


def turn_of(robot, planner, q, scene, leaving=False):
    return planner.turn(
        robot.kinematics(q), maps_of(robot, scene), np.zeros(robot.n), leaving, False, 0.004)


def test_only_what_is_on_its_way_into_a_link_makes_it_turn(panda):
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    arm = panda.kinematics(q)
    upper, hand = ([c.name for c in panda.capsules].index(name) for name in ('link2', 'hand'))

    def comes(link, velocity, distance=0.4):
        middle = 0.5 * (arm.segment_start[link] + arm.segment_end[link])
        way = np.array(velocity) / np.linalg.norm(velocity)
        return Scene.of([Obstacle('o', middle - distance * way, np.full(3, 0.06),
                                  velocity=np.array(velocity))])

    assert turn_of(panda, evasion_of(panda), q, comes(upper, [0.0, 0.3, 0.0])) is not NO_TURN
    # Not from further away than the horizon, past it, next to a link, or to what others may save.
    for scene in (comes(upper, [0.0, 0.3, 0.0], 0.8), comes(upper, [0.0, 0.3, 0.0], -0.4),
                  comes(upper, [0.0, 0.001, 0.0], 0.25), comes(hand, [0.0, 0.3, 0.0])):
        assert turn_of(panda, evasion_of(panda), q, scene) is NO_TURN
    # Where the path is being left, that leads the right way.
    assert turn_of(
        panda, evasion_of(panda), q, comes(hand, [0.0, 0.3, 0.0]), leaving=True) is not NO_TURN


@pytest.mark.parametrize('size', [1e-3, 1e3, 1e150, 1e200])
def test_absurd_obstacles_raise_nothing(panda, size):
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    scene = Scene.of([Obstacle('o', np.zeros(3), np.full(3, size),
                               velocity=np.array([size, 0.0, 0.0]))])
    turn = turn_of(panda, evasion_of(panda), q, scene, leaving=True)
    assert np.isfinite(turn.velocities).all()
    assert (np.abs(turn.velocities) <= panda.velocity_max[:len(turn.velocities)]).all()
