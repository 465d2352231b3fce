"""The arm that other libraries get is the same arm (runs where they are installed)."""

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
mujoco = pytest.importorskip('mujoco')
from benchmark.peers import installed, library, missing, PEERS  # noqa: E402
from benchmark.peers.mjcf import mjcf  # noqa: E402

METHODS = [pytest.param(name, marks=pytest.mark.skipif(bool(missing(name)), reason=missing(name)))
           for name in PEERS]


@pytest.mark.parametrize('name', ['panda', 'paper', 'two_handed'])
def test_tips_and_capsules_are_where_ours_are(name):
    robot = MAKERS[name]()
    model = mujoco.MjModel.from_xml_string(mjcf(robot, []))
    data = mujoco.MjData(model)
    for q in random_postures(robot, 10):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        arm = robot.kinematics(q)
        for t, tip in enumerate(arm.tips.each):
            site = data.site(f'tip{t}')
            np.testing.assert_allclose(site.xpos, tip.position, atol=1e-9)
            np.testing.assert_allclose(site.xmat.reshape(3, 3), tip.rotation, atol=1e-9)
        for i in range(len(robot.capsules)):
            np.testing.assert_allclose(
                data.geom(f'link{i}').xpos, 0.5 * (arm.segment_start[i] + arm.segment_end[i]),
                atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize('name', METHODS)
def test_they_follow_the_path_and_stop_at_the_obstacle(name):
    robot = MAKERS['panda_position']()
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    arm = robot.kinematics(q)
    ball = Obstacle('ball', arm.tip_position + [0.3, 0.0, -0.1], np.full(3, 0.05))
    for obstacles in ((), (ball,)):
        peer = library(name)(robot, obstacles, 0.01, 0.005)
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


@pytest.mark.parametrize('name', [p for p in METHODS if p.values[0] != 'neo'])
def test_they_keep_the_same_pairs_of_links_apart(name):
    robot = MAKERS['panda_position']()
    pairs, radii = robot.self_pairs, np.array([c.radius for c in robot.capsules])
    arm = robot.kinematics([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    for minded in (pairs, pairs[:0]):
        robot.self_pairs = minded
        peer = library(name)(robot, (), 0.01, 0.005)
        pose, posture, closest = Pose(arm.tip_position, arm.tip_rotation), arm.q, np.inf
        for _ in range(1000):  # towards its own foot
            pose = integrate(pose, np.array([-0.15, 0, -0.05, 0, 0, 0]), 0.004, False)
            posture = posture + 0.004 * peer.step(posture, pose, 0.004)
            now = robot.kinematics(posture)
            closest = min(closest, link_distances(
                now.segment_start, now.segment_end, radii, pairs).distance.min())
        assert closest > 0.0 if len(minded) else closest < -0.05


@pytest.mark.long
@pytest.mark.parametrize('name', METHODS)
def test_they_stop_at_every_shape(name):
    robot = MAKERS['panda_position']()
    q = np.array([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    arm = robot.kinematics(q)
    place, turn = arm.tip_position + [0.3, 0.0, -0.1], (0.0, 0.3826834, 0.0, 0.9238795)
    for obstacle in (
            Obstacle.box('box', place, (0.1, 0.2, 0.1), orientation=turn),
            Obstacle.cylinder('cylinder', place, 0.05, 0.2, orientation=turn),
            Obstacle.capsule('capsule', place, 0.05, 0.1, orientation=turn),
            Obstacle.capsule('ball', place, 0.05, 0.0)):
        peer = library(name)(robot, (obstacle,), 0.01, 0.005)
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


@pytest.mark.parametrize('name', METHODS)
def test_no_joint_is_faster_than_it_can_be(name):
    robot = MAKERS['panda']()
    arm = robot.kinematics([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    peer = library(name)(robot, (), 0.01, 0.005)
    pose, posture, fastest = Pose(arm.tip_position, arm.tip_rotation), arm.q, 0.0
    for _ in range(60):  # 3 m/s: no joint can follow
        pose = integrate(pose, np.array([0.0, 3.0, 0.0, 0.0, 0.0, 0.0]), 0.004, False)
        velocity = peer.step(posture, pose, 0.004)
        posture = posture + 0.004 * velocity
        fastest = max(fastest, (np.abs(velocity) / robot.velocity_max).max())
    assert 0.3 < fastest < 1.001


@pytest.mark.long
@pytest.mark.parametrize('name', METHODS)
def test_they_know_where_obstacles_have_moved_to(name):
    robot = MAKERS['panda_position']()
    arm = robot.kinematics([0.0, -0.3, 0.0, -2.0, 0.0, 1.8, 0.7])
    near, far = (Obstacle('ball', arm.tip_position + [0.3, 0.0, z], np.full(3, 0.05))
                 for z in (-0.1, 2.0))
    maps = inflated_obstacles(Scene.of([near]), [c.radius for c in robot.capsules])
    closest = []
    for first, second in ((far, near), (near, far)):
        peer = library(name)(robot, (first,), 0.01, 0.005)
        peer.move((second,))
        pose, posture, distance = Pose(arm.tip_position, arm.tip_rotation), arm.q, np.inf
        for _ in range(500):
            pose = integrate(pose, np.array([0.1, 0, 0, 0, 0, 0]), 0.004, False)
            posture = posture + 0.004 * peer.step(posture, pose, 0.004)
            now = robot.kinematics(posture)
            distance = min(distance, link_clearance(
                maps, now.segment_start, now.segment_end).distance.min())
        closest.append(distance)
    assert closest[0] > 0.0 > closest[1]


def test_what_is_not_installed_is_named_with_the_command(monkeypatch):
    monkeypatch.setattr('benchmark.peers.find_spec', lambda name: None)
    assert installed() == []
    for name in PEERS:
        with pytest.raises(ImportError, match=rf'^{name}: .*pip install'):
            library(name)
