"""What the hand holds: capsules that contain it, and an arm that minds them."""

from __future__ import annotations

from closed_loop import drive, random_obstacle, smallest_level
from conftest import examples, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import ObstacleError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.payload import payload_capsules

METHODS = ['dynamic_factor', 'variational']
ROD = Obstacle.cylinder(
    'rod', (0.0, 0.0, 0.1), 0.02, 0.5, orientation=(0.0, 0.5**0.5, 0.0, 0.5**0.5))


def surface_points(thing, random, count=500):
    """Points on a thing's surface, the corners of a box among them."""
    half = thing.half_extents
    ball = random.normal(size=(count, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    side = random.choice([-1.0, 1.0], size=(count, 1))
    if thing.shape == 'box':
        local = np.vstack((random.uniform(-1.0, 1.0, (count, 3)), np.sign(ball))) * half
    elif thing.shape == 'cylinder':
        ring = ball[:, :2] / np.linalg.norm(ball[:, :2], axis=1, keepdims=True)
        local = np.hstack((ring, side)) * half
    elif thing.shape == 'capsule':
        local = half[0] * ball + np.hstack((np.zeros((count, 2)), side)) * (half[2] - half[0])
    else:
        local = ball * half
    return thing.center + local @ Scene.of([thing]).rotations[0].T


def outside(capsules, points):
    """How far the outermost of points (k, 3) is outside of all capsules [m]."""
    nearest = np.full(len(points), np.inf)
    for c in capsules:
        way = c.end - c.start
        t = np.clip((points - c.start) @ way / max(way @ way, 1e-300), 0.0, 1.0)
        away = np.linalg.norm(points - c.start - t[:, None] * way, axis=1)
        nearest = np.minimum(nearest, away - c.radius)
    return nearest.max()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=examples(60), deadline=None)
def test_the_capsules_contain_what_is_held(seed):
    random = np.random.default_rng(seed)
    thing = random_obstacle(random, low=-0.2, high=0.2)
    capsules = payload_capsules([thing], 'tip')
    assert outside(capsules, surface_points(thing, random)) < 1e-9
    assert 1 <= len(capsules) <= 8
    assert {capsule.frame for capsule in capsules} == {'tip'}


@pytest.mark.parametrize(('thing', 'most'), [
    (Obstacle.capsule('c', (0, 0, 0), 0.03, 0.2), 0.0),
    (Obstacle('e', (0, 0, 0), (0.03, 0.03, 0.2)), 0.03),
    (Obstacle('ball', (0, 0, 0), (0.04, 0.04, 0.04)), 0.0),
    (Obstacle.box('rod', (0, 0, 0), (0.04, 0.04, 0.5)), 0.01),
    (Obstacle.box('carton', (0, 0, 0), (0.2, 0.15, 0.1)), 0.012),
    (Obstacle.box('crate', (0, 0, 0), (0.4, 0.3, 0.3)), 0.035),
    (Obstacle.cylinder('can', (0, 0, 0), 0.033, 0.115), 0.02)])
def test_they_stand_out_little(thing, most):
    """Sideways, of the two shorter extents."""
    capsules = payload_capsules([thing], 'tip')
    order = np.argsort(-thing.half_extents, kind='stable')
    reach = max(max(np.abs(point).take(order[1:]) + c.radius - thing.half_extents[order[1:]])
                for c in capsules for point in (c.start, c.end))
    assert reach <= most + 1e-9


def test_what_is_held_is_kept_from_all_links_but_the_hand(panda):
    held = panda.holding([ROD])
    assert [c.name for c in held.capsules[len(panda.capsules):]] == ['attached/rod']
    others = {held.capsules[i].frame for i, j in held.self_pairs if j == len(panda.capsules)}
    assert others == {f'panda_link{i}' for i in range(7)}
    kept = {tuple(pair) for pair in panda.self_pairs} - {tuple(p) for p in held.self_pairs}
    assert not kept and len(panda.capsules) == len(held.capsules) - 1
    # An empty hand is the arm as it was.
    empty = held.holding([])
    assert empty.capsules == panda.capsules
    np.testing.assert_array_equal(empty.self_pairs, panda.self_pairs)
    np.testing.assert_array_equal(empty.lever_arm_bounds, panda.lever_arm_bounds)


@pytest.mark.parametrize('method', METHODS)
def test_what_is_held_touches_nothing_on_the_way(panda, method):
    """An arm that passes an obstacle with an empty hand keeps a rod in it away, too."""
    post = Scene.of([Obstacle.box('post', (0.55, 0.45, 0.5), (0.08, 0.08, 0.6))])
    twist = np.array([0.0, 0.15, 0.0, 0.0, 0.0, 0.0])
    planner = Planner(panda, PlannerParameters(method=method))
    planner.hold([ROD])
    held = planner.robot
    assert smallest_level(held, [PANDA_READY], post) > 0.1
    postures, results = drive(planner, PANDA_READY, twist, post, 4.0)
    assert smallest_level(held, postures, post) > 0.0
    assert results[-1].nearest.link == 'attached/rod'
    assert any("'attached/rod' near obstacle 'post'" in result.reason for result in results)
    # Without knowing of it, the arm takes it into the post.
    postures, _ = drive(Planner(panda, PlannerParameters(method=method)), PANDA_READY, twist, post,
                        4.0)
    assert smallest_level(held, postures, post) < 0.0


def test_what_is_held_does_not_hit_the_arm_itself(panda):
    planner = Planner(panda, PlannerParameters())
    planner.hold([Obstacle.cylinder('pole', (0.0, 0.0, -0.1), 0.015, 0.7)])
    held = planner.robot
    radii = np.array([c.radius for c in held.capsules])
    twist = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    least = []
    for sign in (1.0, -1.0):
        planner.reset()
        postures, _ = drive(planner, PANDA_READY, sign * twist, seconds=4.0)
        for q in postures:
            arm = held.kinematics(q)
            least.append(link_distances(
                arm.segment_start, arm.segment_end, radii, held.self_pairs).distance)
    assert np.min(np.minimum.accumulate(least) - np.minimum(least[0], 0.0)) > -1e-6


def test_the_motion_goes_on_while_a_thing_is_taken_and_let_go(panda):
    planner, q = Planner(panda, PlannerParameters()), np.array(PANDA_READY)
    twist, before = np.array([0.1, 0.05, 0.0, 0.0, 0.0, 0.1]), np.zeros(7)
    for i in range(300):
        if i in (100, 200):
            planner.hold([ROD] if i == 100 else [])
        dq = planner.step(q, twist, Scene.of(), 0.004).dq
        assert (np.abs(dq - before) <= panda.acceleration_max * 0.004 + 1e-9).all()
        q, before = q + 0.004 * dq, dq
    assert np.linalg.norm(before) > 0.05
    assert planner.robot.capsules == panda.capsules


def test_what_nothing_can_hold_is_refused_and_changes_nothing(panda):
    planner = Planner(panda, PlannerParameters())
    planner.hold([ROD])
    held = planner.robot
    with pytest.raises(ObstacleError, match="'wall' is a half_space"):
        planner.hold([Obstacle.half_space('wall', (0.0, 0.0, 0.0))])
    with pytest.raises(ObstacleError, match=r'takes 80 capsules; .*64 capsules at most'):
        planner.hold([Obstacle(f'b{i}', (0.0, 0.0, 0.1), (0.01, 0.01, 0.01)) for i in range(80)])
    assert planner.robot is held
