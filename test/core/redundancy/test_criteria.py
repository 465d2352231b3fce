"""Every index against finite differences, and Eq. 18's signs."""

from __future__ import annotations

from closed_loop import random_scene
from conftest import central_difference, make_panda, make_paper_arm, random_postures
import numpy as np
import pytest

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.clearance_gradients import clearance_gradients
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.redundancy import criteria, null_space as ns
from redundant_planner.core.robot.capsules import supports_of
from redundant_planner.core.robot.jacobian import derivative_between
from redundant_planner.core.robot.kinematics import Links


def test_joint_limit_index_is_equation_3(robot):
    low, high = robot.position_min, robot.position_max
    for q in random_postures(robot, 20):
        value, gradient = criteria.joint_limit_index(q, low, high)
        limited = np.isfinite(high)
        q_, l, h = q[limited], low[limited], high[limited]
        expected = np.sum(((q_ - (l + h) / 2) / (h - l)) ** 2)
        assert value == pytest.approx(expected)
        np.testing.assert_allclose(gradient, central_difference(
            lambda p: criteria.joint_limit_index(p, low, high)[0], q), atol=1e-8)


def clearance_of(robot, q, obstacles, points, smoothing=0.0, influence_distance=np.inf):
    arm = robot.kinematics(q)
    scene = Scene.of(obstacles)
    if points == 'links':
        radii = [c.radius for c in robot.capsules]
        links = robot.links(arm)
    else:
        radii = np.zeros(robot.n + 1)
        points = robot.joint_points(q)
        joints = np.append(np.arange(1, robot.n + 1), robot.chain.tip_joints[0])
        parents = robot.chain.parents
        links = Links(
            points, points, arm.joint_screws, supports_of(joints, parents), parents)
    maps = inflated_obstacles(scene, radii)
    pairs = link_clearance(maps, links.start, links.end)
    every = np.isfinite(pairs.normalized_distance).nonzero()
    gradient, _ = clearance_gradients(maps, pairs, every, links)
    return criteria.clearance_index(
        pairs.normalized_distance.ravel(), pairs.distance.ravel(), gradient, smoothing,
        influence_distance)


def change(robot, arm, left, dq):
    """uᵀ (∂J/∂q_k) q̇."""
    return derivative_between(
        left, arm.tip_jacobian, dq, arm.tip_rotations, robot.in_tool, robot.rows)


@pytest.mark.parametrize('points', ['links', 'joints'])
@pytest.mark.parametrize('smoothing', [0.0, 0.5, 5.0])
def test_clearance_index_gradient(robot, points, smoothing):
    for seed, q in enumerate(random_postures(robot, 20)):
        obstacles = random_scene(robot, seed)
        _, gradient = clearance_of(robot, q, obstacles, points, smoothing=smoothing)
        expected = central_difference(
            lambda p, o=obstacles: clearance_of(robot, p, o, points, smoothing=smoothing)[0], q)
        # Relative: S reaches thousands, where a difference of 1e-6 rad has few digits left.
        assert np.linalg.norm(gradient - expected) <= 1e-5 * (1.0 + np.linalg.norm(expected))


def test_smoothing_approaches_equation_7_from_below(robot):
    for seed, q in enumerate(random_postures(robot, 20)):
        obstacles = random_scene(robot, seed)
        hard, _ = clearance_of(robot, q, obstacles, 'links')
        values = [clearance_of(robot, q, obstacles, 'links', smoothing=w)[0]
                  for w in (1.0, 0.1, 0.001)]
        assert values[0] <= values[1] <= values[2] <= hard + 1e-12
        assert values[2] == pytest.approx(hard, abs=0.001 * np.log(100))


def test_influence_fades_to_nothing_and_keeps_everything_at_contact(planar):
    from redundant_planner.core.obstacles.obstacle import Obstacle
    q = np.array([0.0, 0.3, 0.2])

    def at(distance, influence):
        ball = Obstacle('ball', np.array([0.25, 0.1 + distance, 0.0]), np.full(3, 0.1))
        return clearance_of(planar, q, [ball], 'links', influence_distance=influence)[1]

    np.testing.assert_array_equal(at(0.3, 0.2), 0.0)
    np.testing.assert_allclose(at(0.0, 0.2), at(0.0, np.inf), rtol=1e-9)
    sizes = [np.linalg.norm(at(d, 0.2)) / np.linalg.norm(at(d, np.inf))
             for d in np.linspace(0.0, 0.199, 12)]
    assert (np.diff(sizes) < 0.0).all()


def test_without_obstacles_nothing_pushes(robot):
    q = random_postures(robot, 1)[0]
    value, gradient = clearance_of(robot, q, [], 'links')
    assert value == np.inf
    np.testing.assert_array_equal(gradient, 0.0)


def shortest_path(robot, q, twist):
    arm = robot.kinematics(q)
    parts = ns.decompose(arm.jacobian)
    gains = ns.inverse_gains(parts.singular_values, 0.0, 0.0)
    least = ns.least_norm(parts, gains, twist)
    dual = ns.dual(parts, gains, twist)
    np.testing.assert_allclose(arm.jacobian @ arm.jacobian.T @ dual, twist, atol=1e-8)
    return criteria.shortest_path_index(least, change(robot, arm, dual, least))


def test_shortest_path_index_gradient(robot):
    random = np.random.default_rng(5)
    for q in random_postures(robot, 20, seed=1):
        twist = random.normal(size=robot.m)
        value, gradient = shortest_path(robot, q, twist)
        jacobian = robot.kinematics(q).jacobian
        assert value == pytest.approx(0.5 * np.sum((np.linalg.pinv(jacobian) @ twist) ** 2))
        expected = central_difference(lambda p, t=twist: shortest_path(robot, p, t)[0], q)
        assert np.linalg.norm(gradient - expected) <= 1e-5 * (1.0 + np.linalg.norm(expected))


def manipulability(robot, q):
    arm = robot.kinematics(q)
    parts = ns.decompose(arm.jacobian)
    return criteria.manipulability_index(parts, np.array([
        change(robot, arm, u, v) for u, v in zip(parts.left.T, parts.right)]))


def test_manipulability_index_gradient(robot):
    for q in random_postures(robot, 20, seed=2):
        value, gradient = manipulability(robot, q)
        jacobian = robot.kinematics(q).jacobian
        assert value == pytest.approx(np.sqrt(np.linalg.det(jacobian @ jacobian.T)), rel=1e-6)
        expected = central_difference(lambda p: manipulability(robot, p)[0], q)
        np.testing.assert_allclose(gradient, expected, atol=1e-6 * (1 + np.abs(expected).max()))


def test_shortest_path_index_with_joint_weights_and_prismatic_joints(paper_arm):
    # ½‖J̃⁺ẋ‖² with J̃ = J W^−½, as the planner calls it.
    scaling = 1.0 / np.sqrt(np.array([4.0, 9.0, 1.0, 1.0, 2.0, 1.0, 1.0]))
    twist = np.array([0.1, -0.2, 0.05])

    def value(q):
        return 0.5 * np.sum(
            (np.linalg.pinv(paper_arm.kinematics(q).jacobian * scaling) @ twist) ** 2)

    for q in random_postures(paper_arm, 20):
        arm = paper_arm.kinematics(q)
        parts = ns.decompose(arm.jacobian * scaling)
        gains = ns.inverse_gains(parts.singular_values, 0.0, 0.0)
        least = ns.least_norm(parts, gains, twist)
        dual = ns.dual(parts, gains, twist)
        actual, gradient = criteria.shortest_path_index(
            least, change(paper_arm, arm, dual, scaling * least))
        assert actual == pytest.approx(value(q))
        expected = central_difference(value, q)
        assert np.linalg.norm(gradient - expected) <= 1e-5 * (1.0 + np.linalg.norm(expected))


def test_total_gradient_maximises_clearance_and_minimises_the_rest():
    w, s, f, m, p = np.eye(5)
    np.testing.assert_array_equal(
        criteria.total_gradient(w, s, f, m, p, criteria.IndexWeights(2.0, 3.0, 4.0, 5.0, 6.0)),
        [2.0, -3.0, -4.0, 5.0, -6.0])


def test_the_posture_index_is_that_of_the_joints_that_prefer_a_position():
    preferred = np.array([0.5, np.nan, -0.2])
    q = np.array([0.1, 2.0, 0.3])
    limits = np.array([np.pi, np.pi, np.inf])

    def index(q):
        return criteria.posture_index(q, preferred, limits)

    value, gradient = index(q)
    assert value == pytest.approx(0.5 * (0.4**2 + 0.5**2))
    np.testing.assert_allclose(
        gradient, central_difference(lambda q: index(q)[0], q), atol=1e-8)
    assert gradient[1] == 0.0
    # Whole turns of a joint without limits make no difference; those of others are far away.
    turned = q + [0.0, 0.0, 6.0 * np.pi]
    np.testing.assert_allclose(index(turned)[1], gradient, atol=1e-12)
    assert index(q - [2.0 * np.pi, 0.0, 0.0])[1][0] == pytest.approx(-0.4 - 2.0 * np.pi)
    # The short way round leads across π.
    assert index(np.array([0.1, 2.0, np.pi]))[1][2] == pytest.approx(-np.pi + 0.2)


@pytest.mark.parametrize('make', [make_panda, make_paper_arm])
def test_following_the_gradient_raises_the_index(make):
    robot = make()
    for seed, q in enumerate(random_postures(robot, 10)):
        obstacles = random_scene(robot, seed)
        value, gradient = clearance_of(robot, q, obstacles, 'links', smoothing=0.5)
        step = q + 1e-7 * gradient / np.linalg.norm(gradient)
        assert clearance_of(robot, step, obstacles, 'links', smoothing=0.5)[0] > value
