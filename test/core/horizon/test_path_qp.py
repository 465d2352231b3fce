"""The joint path ahead: its linearisation, its optimality conditions, and the closed loop."""

from __future__ import annotations

import itertools

from closed_loop import random_scene
from conftest import (
    central_difference,
    make_panda,
    make_paper_arm,
    MAKERS,
    PANDA_READY,
    random_postures,
)
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import StateError
from redundant_planner.core.horizon.path_qp import (
    _DAMPING,
    _step_to_pose,
    Horizon,
    middles,
    node_times,
    Poses,
    poses_ahead,
)
from redundant_planner.core.horizon.preview import continued, Preview
from redundant_planner.core.obstacles.clearance import inflated_ellipsoids, link_clearance, Scene
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.null_space import orthogonal_factors
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.io.resources import share_directory
from redundant_planner.io.scenario import load_scenario

DT = 0.004
VARIATIONAL = PlannerParameters(method='variational')


def smooth(twist, seconds=3.0):
    """Twists (k, 6) at times (k,): a motion that starts and ends at rest."""
    def at(times):
        share = np.clip(np.asarray(times) / seconds, 0.0, 1.0)
        return np.sin(np.pi * share)[..., None] ** 2 * twist
    return at


def problem(robot, q, twist, obstacles=(), nodes=6, seconds=1.0, weights=None):
    """A horizon, the poses ahead and the obstacles' maps."""
    scaling = 1.0 / np.sqrt(np.ones(robot.n) if weights is None else weights)
    horizon = Horizon(
        robot, node_times(seconds, nodes), scaling, robot.position_min, robot.position_max)
    arm = robot.kinematics(q)
    poses = poses_ahead(Pose(arm.tip_position, arm.tip_rotation),
                        smooth(twist, seconds)(middles(horizon.times)), horizon.times,
                        robot.in_tool)
    return horizon, poses, inflated_ellipsoids(
        Scene.of(obstacles), [c.radius for c in robot.capsules])


def test_kinematics_of_many_postures_are_those_of_each(robot):
    postures = random_postures(robot, 5)
    together = robot.kinematics_along(postures)
    for i, q in enumerate(postures):
        for field, value in robot.kinematics(q)._asdict().items():
            np.testing.assert_allclose(getattr(together, field)[i], value, atol=1e-12)


@pytest.mark.parametrize('in_tool', [False, True])
def test_poses_ahead_are_those_of_the_twist_integrated(in_tool):
    random = np.random.default_rng(0)
    start = Pose(random.normal(size=3), np.eye(3))
    twist = random.normal(size=6)
    times = node_times(2.0, 5)
    poses = poses_ahead(start, np.tile(twist, (5, 1)), times, in_tool)
    for i, time in enumerate(times[1:]):
        expected = se3.integrate(start, twist, time, in_tool)
        np.testing.assert_allclose(poses.position[i], expected.position, atol=1e-12)
        np.testing.assert_allclose(poses.rotation[i], expected.rotation, atol=1e-12)


@pytest.mark.parametrize('make', [make_panda, lambda: make_panda(axes=AXES[:3]),
                                  lambda: make_panda(command_frame='tool'), make_paper_arm])
def test_the_linearisation_is_exact_to_first_order(make):
    """Along w the poses stay, the cost has the QP's derivatives, ρ moves as the rows say."""
    robot = make()
    random = np.random.default_rng(1)
    weights = random.uniform(0.5, 4.0, robot.n)
    for seed, q in enumerate(random_postures(robot, 20)):
        twist = robot.full_twist(robot.task_rows(0.1 * random.normal(size=6)))
        horizon, poses, maps = problem(
            robot, q, twist, random_scene(robot, seed, 2), nodes=3, weights=weights)
        nodes = q + 0.1 * random.normal(size=(3, robot.n))
        plan, local = horizon._look(q, nodes, poses, maps)
        count, free, n = local.directions.shape
        assert (count, free, n) == (3, robot.n - robot.m, robot.n)

        def along(w, local=local):
            return local.base + (w.reshape(3, 1, -1) @ local.directions)[:, 0]

        def cost(w, q=q, horizon=horizon):
            steps = np.diff(np.vstack((q, along(w))), axis=0) * np.sqrt(weights)
            return 0.5 * np.sum(np.square(steps) / np.diff(horizon.times)[:, None])

        zero = np.zeros(count * free)
        np.testing.assert_allclose(local.linear, central_difference(cost, zero), atol=1e-6)
        step = random.normal(size=zero.shape)
        np.testing.assert_allclose(
            cost(step) - cost(zero), local.linear @ step + 0.5 * step @ local.hessian @ step,
            rtol=1e-9, atol=1e-9)
        assert plan.cost == pytest.approx(2.0 * cost(zero))

        # About the guess itself: no pose changes along the null space, and ρ as predicted.
        def moved(w, nodes=nodes, local=local):
            return robot.kinematics_along(nodes + (w.reshape(3, 1, -1) @ local.directions)[:, 0])

        def off(w, poses=poses, moved=moved):
            arms = moved(w)
            return np.array([se3.pose_error(Pose(*due), Pose(*tip), robot.in_tool)[robot.rows]
                             for *due, tip in zip(*poses, zip(arms.tip_position,
                                                              arms.tip_rotation))])

        errors = central_difference(off, zero)
        np.testing.assert_allclose(errors, 0.0, atol=1e-6)
        arms = robot.kinematics_along(nodes)
        pairs = link_clearance(maps, arms.segment_start, arms.segment_end, horizon.times[1:])
        near = (pairs.distance < 0.15).nonzero()
        slopes = central_difference(lambda p, maps=maps, t=horizon.times[1:]: link_clearance(
            maps, *robot.kinematics_along(p.reshape(3, -1))[-2:], t).clearance, nodes.ravel())
        for row, (at, link, obstacle) in enumerate(zip(*near)):
            if pairs.clearance[at, link, obstacle] > -0.9:
                expected = slopes[at, link, obstacle].reshape(3, -1)
                np.testing.assert_allclose(local.gradients[row], expected[at], atol=2e-5)
                assert local.at[row] == at


def test_a_plan_beyond_a_joint_limit_is_not_admissible(robot):
    limited = np.isfinite(robot.position_max)
    low, high = (np.where(limited, x, 0.0) for x in (robot.position_min, robot.position_max))
    inside = 0.5 * (low + high)
    horizon, _, maps = problem(robot, inside, np.zeros(6), nodes=1)
    for joint in limited.nonzero()[0]:
        for reach, admissible in ((0.49, True), (0.51, False)):
            q = inside.copy()
            q[joint] += reach * (high - low)[joint]
            arm = robot.kinematics(q)
            there = Poses(arm.tip_position[None], arm.tip_rotation[None])
            plan, _ = horizon._look(inside, q[None], there, maps)
            assert plan.error < 1e-9 and plan.admissible == admissible


def test_the_step_to_a_pose_is_the_damped_least_norm_one(robot):
    random = np.random.default_rng(0)
    for q in random_postures(robot, 10):
        jacobian, error = robot.kinematics(q).jacobian, random.normal(size=robot.m)
        expected = jacobian.T @ np.linalg.solve(
            jacobian @ jacobian.T + _DAMPING * np.eye(robot.m), error)
        step = _step_to_pose(*orthogonal_factors(jacobian), error)
        np.testing.assert_allclose(step, expected, atol=1e-9)


def test_a_preview_is_linear_between_its_points_steps_at_equal_times_and_ends():
    one = np.ones(6)
    preview = Preview(np.array([0.0, 1.0, 1.0, 2.0, 3.0]), np.outer([0, 1, 3, 3, 0], one))
    values = preview.at(np.array([-0.1, 0.0, 0.25, 1.0, 1.5, 2.5, 3.0, 9.0]))[:, 0]
    np.testing.assert_allclose(values, [0.0, 0.0, 0.25, 3.0, 3.0, 1.5, 0.0, 0.0])
    assert not Preview(np.zeros(1), one[None]).at(np.array([-1.0, 0.0, 1.0])).any()


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_the_mean_twists_between_times_are_those_of_the_preview_integrated(seed, points):
    random = np.random.default_rng(seed)
    gaps = random.uniform(size=points - 1) * random.integers(0, 2, points - 1)
    preview = Preview(0.3 + np.append(0.0, gaps.cumsum()), random.normal(size=(points, 6)))
    times = np.sort(random.uniform(-0.5, preview.times[-1] + 0.5, 4))
    for i, mean in enumerate(preview.between(times)):
        # Piece by piece, as the twist may make steps.
        knots = np.unique(np.clip(np.append(preview.times, times), times[i], times[i + 1]))
        total = sum((b - a) * preview.at(np.array([0.5 * (a + b)]))[0]
                    for a, b in itertools.pairwise(knots))
        np.testing.assert_allclose(
            mean, total / (times[i + 1] - times[i]), atol=1e-9)


@pytest.mark.parametrize(('times', 'twists', 'message'), [
    ([], np.empty((0, 6)), 'has 0 times'),
    ([0.0, 1.0], np.zeros((1, 6)), 'one or more points with six numbers each'),
    ([0.0, np.nan], np.zeros((2, 6)), 'not finite'),
    ([0.0, 2.0, 1.0], np.zeros((3, 6)), 'go backwards, from 2.0 to 1.0 s'),
])
def test_a_bad_preview_is_refused(times, twists, message):
    with pytest.raises(StateError, match=message):
        Preview(np.array(times), twists)


def test_a_held_command_goes_on_as_it_did():
    command = np.array([0.1, 0.0, -0.2, 0.0, 0.3, 0.0])
    times = np.array([0.0, 0.5, 1.0, 4.0])
    for growth, shares in ((0.0, [1, 1, 1, 1]), (1.0, [1, 1.5, 2, 2]), (-1.0, [1, 0.5, 0, 0])):
        np.testing.assert_allclose(
            continued(command, growth, times), np.outer(shares, command))


def test_obstacles_have_moved_by_the_time_a_node_is_reached(planar):
    ball = Obstacle('ball', np.array([0.3, 0.4, 0.0]), np.full(3, 0.1),
                    velocity=np.array([0.1, -0.2, 0.0]))
    postures, times = random_postures(planar, 3), np.array([0.0, 0.5, 2.0])
    arms = planar.kinematics_along(postures)
    radii = [c.radius for c in planar.capsules]
    ahead = link_clearance(
        inflated_ellipsoids(Scene.of([ball]), radii), arms.segment_start, arms.segment_end, times)
    for i, time in enumerate(times):
        there = Obstacle('ball', ball.center + time * ball.velocity, ball.semi_axes)
        expected = link_clearance(inflated_ellipsoids(Scene.of([there]), radii),
                                  arms.segment_start[i], arms.segment_end[i])
        np.testing.assert_allclose(ahead.clearance[i], expected.clearance, atol=1e-12)


@pytest.mark.parametrize('name', ['panda', 'panda_position', 'panda_tool', 'paper'])
def test_repeated_steps_arrive_at_a_stationary_path(name):
    """Without an obstacle Eq. 16 asks for no gradient in any node's null space."""
    robot = MAKERS[name]()
    q = np.clip(PANDA_READY, robot.position_min + 0.2, robot.position_max - 0.2)
    twist = robot.full_twist(robot.task_rows(np.array([0.1, 0.15, -0.1, 0.2, 0.1, -0.2])))
    horizon, poses, maps = problem(robot, q, twist, seconds=2.0)
    for _ in range(60):
        assert horizon.advance(q, poses, maps, 1e-12) is not None
    plan, local = horizon._look(q, horizon.nodes, poses, maps)
    first, _ = horizon._look(q, horizon._least_norm_path(q, poses), poses, maps)
    assert plan.error < 1e-6
    assert np.abs(local.linear).max() < 1e-4 * np.abs(first.cost)
    assert plan.cost < first.cost * (1.0 + 1e-9)


def test_where_every_joint_moves_the_tip_alike_the_least_norm_path_is_the_shortest(planar):
    """A straight chain turned about its base: by symmetry nothing can be gained by bending."""
    horizon, poses, maps = problem(planar, np.array([0.2, 0.5, 0.3]), np.zeros(6))
    velocity = horizon.advance(np.array([0.2, 0.5, 0.3]), poses, maps, DT)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-9)


def run(planner, q, twist_at, scene, seconds, known):
    """The closed loop; return postures and results."""
    postures, results = [np.array(q, dtype=float)], []
    for i in range(round(seconds / DT)):
        now = i * DT
        ahead = (lambda times, now=now: twist_at(now + middles(times))) if known else None
        results.append(planner.step(postures[-1], twist_at(now), scene, DT, ahead))
        postures.append(postures[-1] + DT * results[-1].dq)
    return np.array(postures), results


@pytest.mark.parametrize('make', [make_panda, lambda: make_panda(axes=AXES[:3]),
                                  make_paper_arm])
def test_the_joint_path_is_shorter_and_the_tip_on_its_line(make):
    robot = make()
    twist_at = smooth(robot.full_twist(robot.task_rows(
        np.array([0.05, -0.1, 0.05, 0.1, 0.0, -0.1]))))
    q = np.clip(PANDA_READY, robot.position_min + 0.2, robot.position_max - 0.2)
    line = robot.kinematics(q).tip_position + 1.5 * twist_at(1.5)[:3]
    effort = {}
    for known in (True, False):
        postures, results = run(
            Planner(robot, VARIATIONAL), q, twist_at, Scene.of(), 3.0, known)
        effort[known] = sum(r.dq @ r.dq for r in results)
        assert np.linalg.norm(robot.kinematics(postures[-1]).tip_position - line) < 1e-3
        assert all(np.abs(robot.kinematics(p).jacobian @ r.homogeneous).max() < 1e-9
                   for p, r in list(zip(postures, results))[::50])
    _, results = run(Planner(robot, PlannerParameters()), q, twist_at, Scene.of(), 3.0, False)
    usual = sum(r.dq @ r.dq for r in results)
    assert effort[True] <= effort[False] * 1.02
    assert effort[True] < usual


def test_an_arm_rests_when_its_profile_has_ended_next_to_an_obstacle():
    """A profile that ends with a step; the twist is there for one more tick than the preview."""
    scenario = load_scenario(share_directory() / 'config' / 'scenarios' / 'paper.yaml')
    robot, preview, scene = make_paper_arm(), scenario.preview(), Scene.of(scenario.obstacles)
    planner, q, moved = Planner(robot, VARIATIONAL), scenario.start_posture(make_paper_arm()), []
    for time in DT * np.arange(-250, 1000):
        ahead = (lambda times, now=time: preview.between(now + times)) if time <= 3.0 else None
        late = time - DT
        twist = scenario.twist_at(late) if 0.0 <= late < 3.0 else np.zeros(6)
        result = planner.step(q, twist, scene, DT, ahead)
        q = q + DT * result.dq
        moved.append(DT * np.abs(result.dq).sum())
    assert sum(moved) < 0.6
    assert sum(moved[252 + 750:]) < 0.005


def test_the_same_inputs_give_the_same_motion(panda):
    twist_at = smooth(np.array([0.1, 0.1, -0.1, 0.2, 0.0, 0.0]))
    scene = Scene.of(random_scene(panda, 3))
    first, second = (run(Planner(panda, VARIATIONAL), PANDA_READY, twist_at, scene, 0.6, True)[0]
                     for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_without_a_plan_dynamic_factor_steps_in_and_says_so(panda, monkeypatch):
    planner, usual = Planner(panda, VARIATIONAL), Planner(panda, PlannerParameters())
    monkeypatch.setattr(Horizon, 'advance', lambda *_: None)
    twist = np.array([0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
    result = planner.step(PANDA_READY, twist, Scene.of(), DT)
    assert 'dynamic_factor steps in' in result.reason
    np.testing.assert_array_equal(
        result.dq, usual.step(PANDA_READY, twist, Scene.of(), DT).dq)


def test_an_arm_without_a_spare_joint_has_no_choice(planar):
    from conftest import make_planar
    robot = make_planar(axes=('vx', 'vy', 'wz'))
    twist = np.array([0.05, 0.02, 0, 0, 0, 0.1])
    q = np.array([0.3, 0.8, 0.4])
    results = [Planner(robot, parameters).step(q, twist, Scene.of(), DT)
               for parameters in (VARIATIONAL, PlannerParameters())]
    np.testing.assert_allclose(results[0].dq, results[1].dq, atol=1e-12)
    assert results[0].reason == results[1].reason


def test_a_resting_arm_stays_where_it_is(panda):
    postures, results = run(Planner(panda, VARIATIONAL), PANDA_READY, smooth(np.zeros(6)),
                            Scene.of(random_scene(panda, 1)[:1]), 1.0, False)
    if all(r.stage.name == 'DESIRED' for r in results):
        assert np.abs(postures - PANDA_READY).max() < 1e-6


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_limits_hold_whatever_is_commanded_and_whatever_appears(seed, known):
    """Reversals, jumps of the command, obstacles that come, go and move, poses out of reach."""
    robot = _PANDA
    random = np.random.default_rng(seed)
    planner = Planner(robot, VARIATIONAL)
    q, previous = random_postures(robot, 1, seed)[0], np.zeros(7)
    for _ in range(4):
        twist = random.normal(size=6) * random.choice([0.0, 0.1, 1.0, 100.0])
        scene = Scene.of(random_scene(robot, int(random.integers(1000)),
                                      int(random.integers(0, 4))))
        for _ in range(12):
            ahead = (lambda times, t=twist: np.tile(t, (len(times) - 1, 1))) if known else None
            result = planner.step(q, twist, scene, DT, ahead)
            assert np.isfinite(result.dq).all()
            assert (np.abs(result.dq) <= robot.velocity_max + 1e-9).all()
            assert (np.abs(result.dq - previous) <= robot.acceleration_max * DT + 1e-9).all()
            previous, q = result.dq, q + DT * result.dq
            assert (q >= robot.position_min - 1e-9).all()
            assert (q <= robot.position_max + 1e-9).all()


_PANDA = make_panda()
