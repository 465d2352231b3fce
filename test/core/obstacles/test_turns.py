"""Turns followed through time, against brute force."""

from __future__ import annotations

from conftest import random_postures
import numpy as np
import pytest
from test_evasion import HORIZON, joints_of, maps_of, passing

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.turns import (
    best_turn,
    next_velocities,
    TIME_STEP,
    turn_point,
)


def test_points_go_along_with_the_joints_that_turn(robot):
    random = np.random.default_rng(0)
    for q in random_postures(robot, 20):
        arm, turns = robot.kinematics(q), random.uniform(-1.0, 1.0, 2)
        there = robot.kinematics(q + np.pad(turns, (0, robot.n - 2)))
        for link, moves in enumerate(robot.supports):
            for before, after in ((arm.segment_start, there.segment_start),
                                  (arm.segment_end, there.segment_end)):
                point = before[link].copy()
                for j in (1, 0):
                    if moves[j]:
                        turn_point(arm.joint_screws[:, j], turns[j], point)
                np.testing.assert_allclose(point, after[link], atol=1e-12)


def shortage_of(robot, joints, q, velocities, maps, turn, enough):
    """What a turn falls short, every link measured at every step."""
    turned, speeds, least = np.zeros(2), velocities, np.full(len(robot.capsules), enough)
    for step in range(1, round(HORIZON / TIME_STEP) + 1):
        before = speeds
        speeds = next_velocities(turn - turned, before, joints, TIME_STEP)
        turned += 0.5 * TIME_STEP * (before + speeds)
        arm = robot.kinematics(q + np.pad(turned, (0, robot.n - 2)))
        distance = link_clearance(maps, arm.segment_start[None], arm.segment_end[None],
                                  np.array([step * TIME_STEP])).distance[0].min(axis=1)
        least = np.minimum(least, distance)
    return (joints.weights * (enough - least) ** 2)[joints.links].sum()


def test_the_first_turn_that_keeps_clear_is_chosen_else_the_least_short_one(robot):
    random, joints, clear, given_up = np.random.default_rng(2), joints_of(robot), 0, 0
    for q in random_postures(robot, 12):
        arm, maps = robot.kinematics(q), maps_of(robot, passing(robot, random))
        velocities = random.uniform(-0.5, 0.5, 2) * robot.velocity_max[:2]
        turns = random.uniform(-1.2, 1.2, (8, 2)) * robot.velocity_max[:2]
        expected = np.array([shortage_of(robot, joints, q, velocities, maps, turn, 0.005)
                             for turn in turns])
        arguments = (robot.links(arm), maps, joints, velocities)
        enough = 10**9
        for turn, shortage in zip(turns, expected):
            assert best_turn(*arguments, turn[None], np.inf, enough, True)[1] == (
                pytest.approx(shortage, abs=1e-12))
        at, shortage, done, spent = best_turn(
            *arguments, turns, np.inf, enough, True)
        assert at == int(np.argmin(expected)) and shortage == pytest.approx(
            expected.min(), abs=1e-12)
        clear += shortage == 0.0
        # No turn falls short of less than the best one.
        assert shortage == 0.0 or best_turn(
            *arguments, turns, shortage, enough, True)[0] == -1
        # In several ticks, a few turns each, it comes to the same.
        assert done == len(turns)
        best, begin, rounds = (-1, np.inf), 0, 0
        while begin < len(turns) and best[1] > 0.0:
            found, least, done, some = best_turn(
                *arguments, turns[begin:], best[1], spent // 4, True)
            best = (begin + found, least) if found >= 0 else best
            begin, rounds = begin + done, rounds + 1
            assert some <= spent
        assert best[0] == at and (rounds > 1 or clear)
        # Without leave for one turn it ends with the step that takes it over its bound.
        step = 3 * maps.smallest.size + 3 * len(joints.links)
        for budget in (spent // 20, spent // 4):
            found, _, done, some = best_turn(*arguments, turns, np.inf, budget, False)
            assert some <= budget + step and found < done
            given_up += done == 0
    assert clear > 0 and given_up > 0


def test_a_turn_keeps_the_limits_and_ends_where_it_should(panda):
    joints, turned, speeds = joints_of(panda), np.zeros(2), np.array([1.0, -0.5])
    turn, dt = np.array([0.6, 0.9]), 0.004
    for _ in range(500):
        before = speeds
        speeds = next_velocities(turn - turned, before, joints, dt)
        turned += dt * speeds
        assert (np.abs(speeds) <= panda.velocity_max[:2]).all()
        assert (np.abs(speeds - before) <= panda.acceleration_max[:2] * dt).all()
    np.testing.assert_allclose(turned, turn, atol=1e-3)
    np.testing.assert_allclose(speeds, 0.0, atol=1e-3)
