"""The arm that mink and pink get is the same arm (runs where they are installed)."""

from __future__ import annotations

from pathlib import Path
import sys

from conftest import MAKERS, random_postures
import numpy as np
import pytest

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.robot.se3 import integrate, Pose

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
pytest.importorskip('mink')
pytest.importorskip('pink')
mujoco = pytest.importorskip('mujoco')
from benchmark.peers import Mink, mjcf, Pink  # noqa: E402


@pytest.mark.parametrize('name', ['panda', 'paper'])
def test_tip_and_capsules_are_where_ours_are(name):
    robot = MAKERS[name]()
    model = mujoco.MjModel.from_xml_string(mjcf(robot, []))
    data = mujoco.MjData(model)
    for q in random_postures(robot, 10):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        arm = robot.kinematics(q)
        np.testing.assert_allclose(data.site('tip').xpos, arm.tip_position, atol=1e-9)
        np.testing.assert_allclose(
            data.site('tip').xmat.reshape(3, 3), arm.tip_rotation, atol=1e-9)
        for i in range(len(robot.capsules)):
            np.testing.assert_allclose(
                data.geom(f'link{i}').xpos, 0.5 * (arm.segment_start[i] + arm.segment_end[i]),
                atol=1e-9)


@pytest.mark.parametrize('library', [Mink, Pink])
def test_they_follow_the_path_and_stop_at_the_obstacle(library):
    robot = MAKERS['panda_position']()
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    arm = robot.kinematics(q)
    ball = Obstacle('ball', arm.tip_position + [0.3, 0.0, -0.1], np.full(3, 0.05))
    for obstacles in ((), (ball,)):
        peer = library(robot, obstacles, 0.01, 0.005)
        pose, posture, closest = Pose(arm.tip_position, arm.tip_rotation), q, np.inf
        for _ in range(500):
            pose = integrate(pose, np.array([0.1, 0, 0, 0, 0, 0]), 0.004, False)
            posture = posture + 0.004 * peer.step(posture, pose, 0.004)
            now = robot.kinematics(posture)
            maps = inflated_obstacles(Scene.of([ball]), [c.radius for c in robot.capsules])
            closest = min(closest, link_clearance(
                maps, now.segment_start, now.segment_end).normalized_distance.min())
        reached = np.linalg.norm(robot.kinematics(posture).tip_position - pose.position)
        if obstacles:
            assert closest > 0.0
        else:
            assert reached < 1e-4 and closest < 0.0


@pytest.mark.parametrize('library', [Mink, Pink])
def test_they_keep_the_same_pairs_of_links_apart(library):
    robot = MAKERS['panda_position']()
    pairs, radii = robot.self_pairs, np.array([c.radius for c in robot.capsules])
    arm = robot.kinematics([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    for minded in (pairs, pairs[:0]):
        robot.self_pairs = minded
        peer = library(robot, (), 0.01, 0.005)
        pose, posture, closest = Pose(arm.tip_position, arm.tip_rotation), arm.q, np.inf
        for _ in range(1000):  # towards its own foot
            pose = integrate(pose, np.array([-0.15, 0, -0.05, 0, 0, 0]), 0.004, False)
            posture = posture + 0.004 * peer.step(posture, pose, 0.004)
            now = robot.kinematics(posture)
            closest = min(closest, link_distances(
                now.segment_start, now.segment_end, radii, pairs).distance.min())
        assert closest > 0.0 if len(minded) else closest < -0.05


@pytest.mark.parametrize('library', [Mink, Pink])
def test_they_stop_at_every_shape(library):
    robot = MAKERS['panda_position']()
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    arm = robot.kinematics(q)
    place, turn = arm.tip_position + [0.3, 0.0, -0.1], (0.0, 0.3826834, 0.0, 0.9238795)
    for obstacle in (
            Obstacle.box('box', place, (0.1, 0.2, 0.1), orientation=turn),
            Obstacle.cylinder('cylinder', place, 0.05, 0.2, orientation=turn),
            Obstacle.capsule('capsule', place, 0.05, 0.1, orientation=turn),
            Obstacle.capsule('ball', place, 0.05, 0.0)):
        peer = library(robot, (obstacle,), 0.01, 0.005)
        pose, posture, distances = Pose(arm.tip_position, arm.tip_rotation), q, []
        maps = inflated_obstacles(Scene.of([obstacle]), [c.radius for c in robot.capsules])
        for _ in range(500):
            pose = integrate(pose, np.array([0.1, 0, 0, 0, 0, 0]), 0.004, False)
            posture = posture + 0.004 * peer.step(posture, pose, 0.004)
            now = robot.kinematics(posture)
            distances.append(
                link_clearance(maps, now.segment_start, now.segment_end).distance.min())
        # It came near, and kept off: the library knows where the surface is.
        assert 0.0 < min(distances) < 0.03
