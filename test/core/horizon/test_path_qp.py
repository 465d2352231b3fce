"""The QP about a joint path: its linearisation and its limits."""

from __future__ import annotations

from closed_loop import random_scene
from conftest import central_difference, make_panda, make_paper_arm, random_postures
import numpy as np
from path_problem import problem
import pytest

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose


@pytest.mark.parametrize('make', [make_panda, lambda: make_panda(axes=AXES[:3]),
                                  lambda: make_panda(command_frame='tool'), make_paper_arm])
def test_the_linearisation_is_exact_to_first_order(make):
    """Along w the poses stay, the cost has the QP's derivatives, ρ moves as the rows say."""
    robot = make()
    random = np.random.default_rng(1)
    weights = random.uniform(0.5, 4.0, robot.n)
    for seed, q in enumerate(random_postures(robot, 20)):
        twist = robot.full_twist(robot.task_rows(0.1 * random.normal(size=6)))
        qp, poses, maps = problem(
            robot, q, twist, random_scene(robot, seed, 2), nodes=3, weights=weights)
        nodes = q + 0.1 * random.normal(size=(3, robot.n))
        plan, local = qp.look(q, nodes, poses, maps)
        count, free, n = local.directions.shape
        assert (count, free, n) == (3, robot.n - robot.m, robot.n)

        def along(w, local=local):
            return local.base + (w.reshape(3, 1, -1) @ local.directions)[:, 0]

        def cost(w, q=q, qp=qp):
            steps = np.diff(np.vstack((q, along(w))), axis=0) * np.sqrt(weights)
            return 0.5 * np.sum(np.square(steps) / np.diff(qp.times)[:, None])

        zero = np.zeros(count * free)
        np.testing.assert_allclose(local.linear, central_difference(cost, zero), atol=1e-6)
        step = random.normal(size=zero.shape)
        np.testing.assert_allclose(
            cost(step) - cost(zero), local.linear @ step + 0.5 * step @ local.hessian @ step,
            rtol=1e-9, atol=1e-9)
        assert plan.measures.cost == pytest.approx(2.0 * cost(zero))

        # About the guess itself: no pose changes along the null space, and ρ as predicted.
        def moved(w, nodes=nodes, local=local):
            return robot.kinematics_along(nodes + (w.reshape(3, 1, -1) @ local.directions)[:, 0])

        def off(w, poses=poses, moved=moved):
            arms = moved(w)
            return np.array([se3.pose_error(Pose(*due), Pose(*tip), robot.in_tool)[robot.rows]
                             for *due, tip in zip(*poses, zip(arms.tip_positions,
                                                              arms.tip_rotations))])

        errors = central_difference(off, zero)
        np.testing.assert_allclose(errors, 0.0, atol=1e-6)
        arms = robot.kinematics_along(nodes)
        pairs = link_clearance(maps, arms.segment_start, arms.segment_end, qp.times[1:])
        near = (pairs.distance < 0.15).nonzero()
        slopes = central_difference(lambda p, maps=maps, t=qp.times[1:]: link_clearance(
            maps, *robot.kinematics_along(p.reshape(3, -1))[-2:], t).normalized_distance,
            nodes.ravel())
        for row, (at, link, obstacle) in enumerate(zip(*near)):
            if pairs.normalized_distance[at, link, obstacle] > -0.9:
                expected = slopes[at, link, obstacle].reshape(3, -1)
                np.testing.assert_allclose(local.gradients[row], expected[at], atol=2e-5)
                assert local.at[row] == at


def test_a_plan_beyond_a_joint_limit_is_not_admissible(robot):
    limited = np.isfinite(robot.position_max)
    low, high = (np.where(limited, x, 0.0) for x in (robot.position_min, robot.position_max))
    inside = 0.5 * (low + high)
    qp, _, maps = problem(robot, inside, np.zeros(6 * len(robot.tips)), nodes=1)
    for joint in limited.nonzero()[0]:
        for reach, admissible in ((0.49, True), (0.51, False)):
            q = inside.copy()
            q[joint] += reach * (high - low)[joint]
            arm = robot.kinematics(q)
            there = arm.tips
            plan, _ = qp.look(inside, q[None], there, maps)
            assert plan.measures.error < 1e-9 and plan.admissible == admissible
