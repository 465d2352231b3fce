"""Links against links: closed form against sampling, gradients, and the closed loop."""

from __future__ import annotations

from closed_loop import drive, DT, NOTHING
from conftest import central_difference, make_planar, PANDA_READY, random_postures
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest

from benchmark.robots import make_robot
from benchmark.target_problems import problem_of
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import distance_gradients, link_distances
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.se3 import Pose

points = arrays(float, (4, 3), elements=st.floats(-1.0, 1.0))
PAIR = np.array([[0, 1]])


@given(points, st.sampled_from(['free', 'parallel', 'point', 'points', 'crossing']))
def test_distance_of_two_segments_is_the_smallest(ends, kind):
    start, end = ends[:2].copy(), ends[2:].copy()
    if kind == 'parallel':
        end[1] = start[1] + 0.7 * (end[0] - start[0])
    if kind in ('point', 'points'):
        end[1] = start[1]
    if kind == 'points':
        end[0] = start[0]
    if kind == 'crossing':
        start[1], end[1] = 0.5 * (start[0] + end[0]) - ends[3], 0.5 * (start[0] + end[0]) + ends[3]
    radii = np.array([0.03, 0.05])
    pairs = link_distances(start, end, radii, PAIR)
    t = np.linspace(0.0, 1.0, 60)
    first = start[0] + t[:, None] * (end[0] - start[0])
    second = start[1] + t[:, None] * (end[1] - start[1])
    sampled = np.linalg.norm(first[:, None] - second[None], axis=-1).min() - radii.sum()
    # Never above what sampling finds; below it by no more than the samples are apart.
    spacing = (np.linalg.norm(end - start, axis=1) / 59).sum()
    assert sampled - spacing - 1e-9 <= pairs.distance[0] <= sampled + 1e-9


def test_gradients_match_finite_differences(robot):
    links = np.transpose(np.triu_indices(len(robot.capsules), 1))
    supports = robot.supports[links[:, 0]] - robot.supports[links[:, 1]]
    radii = np.array([c.radius for c in robot.capsules])

    def at(q):
        arm = robot.kinematics(q)
        return link_distances(arm.segment_start, arm.segment_end, radii, links)

    for q in random_postures(robot, 20):
        pairs = at(q)
        # At a joint that two links share they have no distance to differentiate.
        chosen = np.flatnonzero(
            np.linalg.norm(pairs.points[:, 0] - pairs.points[:, 1], axis=1) > 1e-3)
        gradient = distance_gradients(
            pairs.points, chosen, robot.kinematics(q).joint_screws, supports)
        expected = central_difference(lambda p: at(p).distance, q)[chosen]
        np.testing.assert_allclose(gradient, expected, atol=1e-5)


def test_a_planar_arm_does_not_fold_onto_itself():
    links = [Capsule(f'l{i}', f'link{i}', np.array([0.1, 0, 0]), np.array([x, 0, 0]), 0.04)
             for i, x in ((1, 0.5), (2, 0.3), (3, 0.3))]
    robot = make_planar(capsules=links)
    start = np.array([0.0, 2.0, 1.4])
    radii = np.full(3, 0.04)

    def smallest(postures):
        return min(link_distances(arm.segment_start, arm.segment_end, radii, np.array([[0, 2]]))
                   .distance[0] for arm in map(robot.kinematics, postures))

    twist = np.array([0.1, -0.3, 0, 0, 0, 0])
    margins = {}
    for margin in (0.01, -1.0):
        planner = Planner(robot, PlannerParameters(clearance_self_margin=margin))
        postures, _ = drive(planner, start, twist, NOTHING, 2.0)
        margins[margin] = smallest(postures)
    assert margins[0.01] > 0.0095
    assert margins[-1.0] < 0.0


def test_a_panda_keeps_its_hand_off_its_shoulder(panda):
    planner = Planner(panda, PlannerParameters())
    twist = np.array([-0.2, 0.0, -0.05, 0.0, 0.0, 0.0])
    postures, results = drive(planner, PANDA_READY, twist, NOTHING, 4.0)
    radii = np.array([c.radius for c in panda.capsules])
    distances = np.array([
        link_distances(arm.segment_start, arm.segment_end, radii, panda.self_pairs).distance.min()
        for arm in map(panda.kinematics, postures[::5])])
    begun_free = distances[0] > 0.005
    assert begun_free and distances.min() > 0.0045
    changes = np.abs(np.diff([r.dq for r in results], axis=0, prepend=np.zeros((1, 7))))
    assert (changes <= panda.acceleration_max * 0.004 + 1e-9).all()
    assert pytest.approx(results[-1].scale, abs=0.05) == 0.0


def test_links_whose_distance_turns_while_the_arm_brakes_keep_clear():
    """Another part of link5 becomes the nearest to link2: from then on braking comes too late."""
    robot = make_robot('panda', 6)
    problem = problem_of(robot, 72052)
    target = robot.kinematics(problem.goal)
    planner = Planner(robot, PlannerParameters(target_path='straight'))
    scene, q = Scene.of(problem.obstacles), problem.start
    radii = np.array([c.radius for c in robot.capsules])
    nearest = np.inf
    for _ in range(450):
        q = q + DT * planner.step(q, np.zeros(6), scene, DT, target=Pose(
            target.tip_position, target.tip_rotation)).dq
        arm = robot.kinematics(q)
        nearest = min(nearest, link_distances(
            arm.segment_start, arm.segment_end, radii, robot.self_pairs).distance.min())
    assert 0.0045 < nearest < 0.01


def test_not_measuring_every_tick_changes_nothing(panda):
    """The bound by which pairs are skipped never hides one that would have acted."""
    twist = np.array([-0.15, 0.05, -0.1, 0.2, 0.3, 0.0])
    lazy, eager = (Planner(panda, PlannerParameters()) for _ in range(2))
    q = PANDA_READY.copy()
    for _ in range(600):
        eager._self_known = None
        expected = eager.step(q, twist, NOTHING, 0.004).dq
        dq = lazy.step(q, twist, NOTHING, 0.004).dq
        np.testing.assert_array_equal(dq, expected)
        q = q + 0.004 * dq
