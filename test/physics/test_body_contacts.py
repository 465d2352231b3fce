"""Obstacles as bodies: they appear, move, vanish, and are met where geometry says."""

from __future__ import annotations

import coal
from conftest import make_panda, PANDA_READY
import numpy as np
import pinocchio as pin
import pytest

from benchmark.bodies import capsules_of, shape_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.io.physics_parameters import PhysicsParameters
from redundant_planner.physics.arm import PhysicsArm
from redundant_planner.physics.contacts import ContactLog
from redundant_planner.physics.model import PLACES

# Two shapes that are nearer to touching than this may be told apart either way [m].
DOUBT = 2e-4


@pytest.fixture
def arm():
    robot = make_panda()
    arm = PhysicsArm(robot, PhysicsParameters(), dict(zip(robot.joint_names, PANDA_READY)))
    arm.advance(0.0)
    return arm


def random_obstacles(random, count, scale=1.0):
    """Obstacles of all shapes around the arm."""
    found = []
    for i in range(count):
        center = random.uniform((-0.3, -0.4, 0.1), (0.7, 0.4, 1.0))
        orientation = random.normal(size=4)
        place = {'orientation': orientation / np.linalg.norm(orientation)}
        x, y, z = scale * random.uniform(0.02, 0.1, 3)
        found.append((
            Obstacle(f'o{i}', center, (x, y, z), **place),
            Obstacle.box(f'o{i}', center, (2 * x, 2 * y, 2 * z), **place),
            Obstacle.cylinder(f'o{i}', center, x, 2 * z, **place),
            Obstacle.capsule(f'o{i}', center, x, 2 * z, **place),
        )[random.integers(4)])
    return found


def distances(robot, q, obstacles):
    """(capsule, obstacle) → distance by coal, an independent library [m]."""
    bodies = capsules_of(robot)
    data = bodies.model.createData()
    pin.forwardKinematics(bodies.model, data, q)
    found = {}
    for name, joint, placement, shape in zip(
            bodies.names, bodies.joints, bodies.placements, bodies.shapes):
        if joint == 0:  # neither the base nor what stands around it moves
            continue
        pose = data.oMi[joint] * placement
        for o in obstacles:
            found[name, o.name] = coal.distance(
                shape, coal.Transform3s(pose.rotation, pose.translation), shape_of(o),
                coal.Transform3s(o.rotation, o.center), coal.DistanceRequest(),
                coal.DistanceResult())
    return found


@pytest.mark.parametrize('seed', range(4))
def test_who_touches_is_who_overlaps_by_another_library(arm, seed):
    """Also after all places have changed their shapes."""
    random = np.random.default_rng(seed)
    arm.surround(Scene.of(random_obstacles(random, 40, scale=0.3)))
    obstacles = random_obstacles(random, 60)
    expected = distances(make_panda(), PANDA_READY, obstacles)
    arm.surround(Scene.of(obstacles))
    arm.advance(arm.step)
    touching = {(c.link, c.other) for c in arm.contacts.contacts}
    assert {pair for pair, distance in expected.items() if distance < -DOUBT} <= touching
    assert touching <= {pair for pair, distance in expected.items() if distance < DOUBT}
    assert len(touching) > 10


def test_an_obstacle_in_the_way_is_met_and_named_and_left_again(arm):
    """The ball stands 5 cm before the hand's own radius; the arm turns into it and back."""
    hand = make_panda().kinematics(PANDA_READY).tip_position
    ball = Obstacle('ball', hand + (0.0, 0.25, 0.0), (0.06, 0.06, 0.06))
    arm.surround(Scene.of([ball]))
    turn = np.zeros(8)
    turn[0] = 0.4

    def go(velocity, count):
        now = arm.steps * arm.step
        for i in range(count):
            arm.command(now + i * 0.004, velocity)
            arm.advance(now + (i + 1) * 0.004)

    go(turn, 20)
    assert arm.contacts.count == 0
    go(turn, 300)
    (contact,) = {c.other for c in arm.contacts.contacts}
    assert contact == 'ball' and any(c.touching for c in arm.contacts.contacts)
    assert {c.link for c in arm.contacts.contacts} <= {'hand', 'fingers', 'link7'}
    assert 0.0 < max(c.deepest for c in arm.contacts.contacts) < 0.02
    assert arm.q[0] < 0.8  # it is held back
    go(-turn, 250)
    assert not any(c.touching for c in arm.contacts.contacts)
    assert 1 <= arm.contacts.count < 10
    before = arm.contacts.count
    # Gone, the ball is in nobody's way.
    arm.surround(Scene.of())
    go(turn, 400)
    assert arm.contacts.count == before and arm.q[0] > 0.7 and arm.obstacles == 0


def test_an_obstacle_that_moves_into_the_arm_touches_it(arm):
    hand = make_panda().kinematics(PANDA_READY).tip_position
    for i in range(100):
        center = hand + (0.4 - 0.003 * i, 0.0, 0.05)
        arm.surround(Scene.of([Obstacle.box('cart', center, (0.1, 0.1, 0.1))]))
        arm.advance((i + 1) * 0.004)
    assert {c.other for c in arm.contacts.contacts} == {'cart'}
    assert min(c.first for c in arm.contacts.contacts) > 0.1


def test_of_too_many_obstacles_the_nearest_are_bodies(arm):
    robot, random = make_panda(), np.random.default_rng(0)
    far = [Obstacle(f'far{i}', center, (0.02, 0.02, 0.02)) for i, center in enumerate(
        random.uniform(-1.0, 1.0, (600, 3)) + (0.0, 0.0, 3.0))]
    middle = robot.kinematics(PANDA_READY).segment_start[robot.moved]
    near = [Obstacle(f'near{i}', center, (0.02, 0.02, 0.02)) for i, center in enumerate(middle)]
    arm.surround(Scene.of(far[:300] + near + far[300:]))
    arm.advance(arm.step)
    assert arm.obstacles == PLACES
    assert {o.name for o in near} <= {c.other for c in arm.contacts.contacts}


def test_the_nearest_are_nearest_to_the_links_not_to_their_middles(arm):
    """Balls at the shoulder's end of a long link, and more balls not as far from its middle."""
    robot = make_panda()
    where = robot.kinematics(PANDA_READY)
    lengths = np.linalg.norm(where.segment_end - where.segment_start, axis=1)
    longest = int(lengths.argmax())
    end, middle = where.segment_end[longest], 0.5 * (
        where.segment_start[longest] + where.segment_end[longest])
    aside = np.linalg.svd((end - middle)[None])[2][1]
    reach = 0.9 * np.linalg.norm(end - middle)
    rivals = [Obstacle(f'rival{i}', middle + reach * aside, (0.01, 0.01, 0.01))
              for i in range(PLACES)]
    arm.surround(Scene.of([*rivals, Obstacle('end', end, (0.01, 0.01, 0.01))]))
    arm.advance(arm.step)
    assert 'end' in {c.other for c in arm.contacts.contacts}


def test_others_are_chosen_once_the_arm_has_moved(arm):
    robot, hand = make_panda(), make_panda().kinematics(PANDA_READY).tip_position
    there = np.array(PANDA_READY)
    there[0] = 1.2
    goal = robot.kinematics(there).tip_position
    crowd = [Obstacle(f'here{i}', hand + (0.3, -0.1, 0.0), (0.02, 0.02, 0.02))
             for i in range(PLACES)]
    scene = Scene.of([*crowd, Obstacle('there', goal, (0.03, 0.03, 0.03))])
    turn = np.zeros(8)
    turn[0] = 0.8
    for i in range(400):
        arm.surround(scene)
        arm.command(i * 0.004, turn * (arm.q[0] < 1.2))
        arm.advance((i + 1) * 0.004)
    assert {c.other for c in arm.contacts.contacts} == {'there'}


def test_links_that_can_meet_do():
    """The forearm folded back onto the upper arm: the planner's own pairs are watched."""
    robot = make_panda()
    folded = dict(zip(robot.joint_names, (0.0, -1.5, 0.0, -3.0, 0.0, 0.3, 0.0)))
    arm = PhysicsArm(robot, PhysicsParameters(), folded)
    arm.advance(0.0)
    arm.advance(0.01)
    q = np.array(list(folded.values()))
    kinematics = robot.kinematics(q)
    from redundant_planner.core.obstacles.self_collision import link_distances
    pairs = link_distances(kinematics.segment_start, kinematics.segment_end,
                           np.array([c.radius for c in robot.capsules]), robot.self_pairs)
    expected = {frozenset(robot.capsules[i].name for i in pair) for pair, distance in zip(
        robot.self_pairs.tolist(), pairs.distance) if distance < -DOUBT}
    assert expected and {frozenset((c.link, c.other)) for c in arm.contacts.contacts} == expected


def test_a_log_counts_beginnings_not_steps():
    log = ContactLog()
    for time, touches in enumerate((
            [('a', 'x', 0.01)], [('a', 'x', 0.03), ('b', 'x', 0.01)], [('b', 'x', 0.01)], [],
            [('a', 'x', 0.02), ('a', 'x', 0.01)])):
        log.note(touches, float(time))
    first, second = log.contacts
    assert first == ('a', 'x', 2, 0.03, 0.0, 4.0, True)
    assert second == ('b', 'x', 1, 0.01, 1.0, 2.0, False)
    assert log.count == 3


def test_a_bounce_is_one_contact():
    log = ContactLog()
    for time in (0.0, 0.05, 0.1, 0.3):
        log.note([('a', 'x', 0.01)], time)
        log.note([], time + 0.02)
    assert log.count == 2
