"""Turns out of obstacles' courses, against brute force."""

from __future__ import annotations

from conftest import random_postures
import numpy as np
import pytest

from redundant_planner.core.obstacles import evasion
from redundant_planner.core.obstacles.clearance import inflated_ellipsoids, link_clearance, Scene
from redundant_planner.core.obstacles.evasion import Evasion, NO_TURN
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import PlannerParameters

PARAMETERS = PlannerParameters(
    clearance_evasion_horizon=2.0, clearance_margin=0.01, clearance_lead=0.1)
HORIZON, MARGIN = PARAMETERS.clearance_evasion_horizon, PARAMETERS.clearance_margin
LEAD = PARAMETERS.clearance_lead


def passing(robot, random, count=2, speed=0.3):
    """Ellipsoids on their way through where the arm may be."""
    found = []
    for i in range(count):
        course = random.normal(size=3)
        velocity = speed * random.uniform(0.2, 1.0) * course / np.linalg.norm(course)
        through = random.uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 1.0])
        orientation = random.normal(size=4)
        found.append(Obstacle(
            f'o{i}', through - random.uniform(0.0, 3.0) * velocity,
            random.uniform(0.04, 0.1, 3), orientation / np.linalg.norm(orientation), velocity))
    return Scene.of(found)


def maps_of(robot, scene):
    return inflated_ellipsoids(scene, [c.radius + MARGIN for c in robot.capsules], LEAD)


def evasion_of(robot):
    return Evasion(robot, PARAMETERS)


def joints_of(robot):
    return evasion._Joints(*evasion_of(robot)._joints)


def test_points_go_along_with_the_joints_that_turn(robot):
    random = np.random.default_rng(0)
    for q in random_postures(robot, 20):
        arm, turns = robot.kinematics(q), random.uniform(-1.0, 1.0, 2)
        there = robot.kinematics(q + np.pad(turns, (0, robot.n - 2)))
        for link, moves in enumerate(robot.moves):
            for before, after in ((arm.segment_start, there.segment_start),
                                  (arm.segment_end, there.segment_end)):
                point = before[link].copy()
                for j in (1, 0):
                    if moves[j]:
                        evasion._turned_about(arm.columns[:, j], turns[j], point)
                np.testing.assert_allclose(point, after[link], atol=1e-12)


def test_a_course_into_a_link_is_found(panda):
    random, joints, outcomes = np.random.default_rng(1), joints_of(panda), []
    times = np.linspace(0.0, HORIZON, 1001)
    for q in random_postures(panda, 60):
        arm, scene = panda.kinematics(q), passing(panda, random)
        maps = maps_of(panda, scene)
        still = [np.tile(ends, (len(times), 1, 1)) for ends in (
            arm.segment_start, arm.segment_end)]
        depth = (link_clearance(maps, *still, times).distance.min(axis=0) + MARGIN
                 + LEAD * maps.speeds)[joints.links]
        link, obstacle = evasion._threat(
            tuple(arm), tuple(maps), tuple(joints), HORIZON, MARGIN, LEAD)
        if abs(depth.min()) > 1e-3:
            assert (link >= 0) == (depth.min() < 0.0)
        if link >= 0:
            at = joints.links.tolist().index(link)
            assert depth[at, obstacle] == pytest.approx(depth.min(), abs=1e-3)
        outcomes.append(link >= 0)
    assert 10 < sum(outcomes) < 50


def shortage_of(robot, joints, q, velocities, maps, turn, enough):
    """What a turn falls short, every link measured at every step."""
    turned, speeds, least = np.zeros(2), velocities, np.full(len(robot.capsules), enough)
    for step in range(1, round(HORIZON / evasion._STEP) + 1):
        before = speeds
        speeds = evasion._heading(turn - turned, before, tuple(joints), evasion._STEP)
        turned += 0.5 * evasion._STEP * (before + speeds)
        arm = robot.kinematics(q + np.pad(turned, (0, robot.n - 2)))
        distance = link_clearance(maps, arm.segment_start[None], arm.segment_end[None],
                                  np.array([step * evasion._STEP])).distance[0].min(axis=1)
        least = np.minimum(least, distance)
    return (joints.shares * (enough - least) ** 2)[joints.links].sum()


def test_the_first_turn_that_keeps_clear_is_chosen_else_the_least_short_one(robot):
    random, joints, clear = np.random.default_rng(2), joints_of(robot), 0
    for q in random_postures(robot, 12):
        arm, maps = robot.kinematics(q), maps_of(robot, passing(robot, random))
        velocities = random.uniform(-0.5, 0.5, 2) * robot.velocity_max[:2]
        turns = random.uniform(-1.2, 1.2, (8, 2)) * robot.velocity_max[:2]
        expected = np.array([shortage_of(robot, joints, q, velocities, maps, turn, 0.005)
                             for turn in turns])
        arguments = (tuple(arm), tuple(maps), tuple(joints), velocities)
        enough = 10**9
        for turn, shortage in zip(turns, expected):
            assert evasion._best(*arguments, turn[None], HORIZON, 0.005, np.inf, enough)[1] == (
                pytest.approx(shortage, abs=1e-12))
        at, shortage, done, spent = evasion._best(
            *arguments, turns, HORIZON, 0.005, np.inf, enough)
        assert at == int(np.argmin(expected)) and shortage == pytest.approx(
            expected.min(), abs=1e-12)
        clear += shortage == 0.0
        worst = float(expected.min())
        assert worst == 0.0 or evasion._best(
            *arguments, turns, HORIZON, 0.005, worst, enough)[0] == -1
        # In several ticks, a few turns each, it comes to the same.
        assert done == len(turns)
        best, begin, rounds = (-1, np.inf), 0, 0
        while begin < len(turns) and best[1] > 0.0:
            found, least, done, some = evasion._best(
                *arguments, turns[begin:], HORIZON, 0.005, best[1], spent // 4)
            best = (begin + found, least) if found >= 0 else best
            begin, rounds = begin + done, rounds + 1
            assert some <= spent
        assert best[0] == at and (rounds > 1 or clear)
    assert clear > 0


def test_a_turn_keeps_the_limits_and_ends_where_it_should(panda):
    joints, turned, speeds = joints_of(panda), np.zeros(2), np.array([1.0, -0.5])
    turn, dt = np.array([0.6, 0.9]), 0.004
    for _ in range(500):
        before = speeds
        speeds = evasion._heading(turn - turned, before, tuple(joints), dt)
        turned += dt * speeds
        assert (np.abs(speeds) <= panda.velocity_max[:2]).all()
        assert (np.abs(speeds - before) <= panda.acceleration_max[:2] * dt).all()
    np.testing.assert_allclose(turned, turn, atol=1e-3)
    np.testing.assert_allclose(speeds, 0.0, atol=1e-3)


def turn_of(robot, planner, q, scene, leaving=False):
    return planner.turn(robot.kinematics(q), maps_of(robot, scene), np.zeros(robot.n), leaving,
                        0.004)


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
