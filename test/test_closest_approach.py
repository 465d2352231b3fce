"""The judge's distances, against closed forms."""

from __future__ import annotations

from pathlib import Path
import sys

from conftest import make_panda, make_planar, PANDA_URDF, random_postures
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.capsules import Capsule

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark.bodies import capsules_of, meshes_of
from benchmark.closest_approach import Motion

_TURN = np.array([0.3, -0.2, 0.5, 0.8]) / np.linalg.norm([0.3, -0.2, 0.5, 0.8])
_PLACE = np.array([0.35, 0.2, 0.5])
OBSTACLES = {
    'box': Obstacle.box('o', _PLACE, (0.2, 0.1, 0.3), orientation=_TURN),
    'cylinder': Obstacle.cylinder('o', _PLACE, 0.08, 0.3, orientation=_TURN),
    'capsule': Obstacle.capsule('o', _PLACE, 0.06, 0.3, orientation=_TURN),
    'ball': Obstacle('o', _PLACE, np.full(3, 0.1), _TURN),
    'half_space': Obstacle.half_space('o', (0.3, 0.3, 0.0), orientation=(0.1, 0.0, 0.0, 0.995)),
}


def outside(name, points):
    """Signed distance (k,) of points (k, 3) from an obstacle: closed forms, in its own axes."""
    obstacle = OBSTACLES[name]
    local = (points - obstacle.center) @ obstacle.rotation
    half = obstacle.half_extents
    if name == 'half_space':
        return local[:, 2]
    if name == 'ball':
        return np.linalg.norm(local, axis=1) - half[0]
    if name == 'capsule':
        along = np.clip(local[:, 2], half[0] - half[2], half[2] - half[0])
        return np.hypot(np.hypot(local[:, 0], local[:, 1]), local[:, 2] - along) - half[0]
    beyond = np.abs(local) - half
    if name == 'cylinder':
        beyond = np.column_stack((
            np.hypot(local[:, 0], local[:, 1]) - half[0], beyond[:, 2]))
    return (np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
            + np.minimum(beyond.max(axis=1), 0.0))


def nearest(robot, q, name):
    arm, t = robot.kinematics(q), np.linspace(0.0, 1.0, 4001)[:, None]
    return min(
        outside(name, start + t * (end - start)).min() - capsule.radius
        for start, end, capsule, moved in zip(
            arm.segment_start, arm.segment_end, robot.capsules, robot.moved) if moved)


@pytest.mark.parametrize('name', OBSTACLES)
def test_distances_to_every_shape_are_exact(name):
    robot = make_panda()
    bodies, free = capsules_of(robot), 0
    for q in random_postures(robot, 40):
        expected = nearest(robot, q, name)
        found = Motion.through(bodies, q[None]).to_obstacles([OBSTACLES[name]], 0.0)
        if expected > 0.0:
            free += 1
            assert found.distance == pytest.approx(expected, abs=1e-5)
        else:  # how deep is told in other ways by everybody
            assert found.distance < 1e-6
        assert found.second == 'o' and found.first in bodies.names
    assert 5 < free < 40


@pytest.mark.first_alone
@pytest.mark.parametrize('moves', [False, True])
def test_no_posture_of_a_motion_is_nearer_than_the_nearest(moves):
    robot, random = make_panda(), np.random.default_rng(1)
    bodies, dt = capsules_of(robot), 0.004
    obstacle = Obstacle.box(
        'o', (0.5, 0.3, 0.6), (0.2, 0.1, 0.3), orientation=_TURN,
        velocity=(-0.1, 0.0, 0.1) if moves else (0, 0, 0),
        angular_velocity=(0.5, 0.3, -0.4) if moves else (0, 0, 0))
    for _ in range(5):
        one, other = random_postures(robot, 2, seed=int(random.integers(1000)))
        postures = np.linspace(one, other, 300)
        found = Motion.through(bodies, postures).to_obstacles([obstacle], dt)
        every = []
        for i, q in enumerate(postures):
            turn = pin.exp3(i * dt * obstacle.angular_velocity)
            moved = Obstacle.box(
                'o', obstacle.center + i * dt * obstacle.velocity, 2 * obstacle.half_extents,
                orientation=pin.Quaternion(turn @ obstacle.rotation).coeffs())
            every.append(Motion.through(bodies, q[None]).to_obstacles([moved], dt).distance)
        assert found.distance == pytest.approx(min(every), abs=2e-5)
        assert every[found.index] == pytest.approx(found.distance, abs=1e-6)


def test_meshes_lie_in_the_capsules_and_reach_their_own_corners():
    robot = make_panda()
    capsules, meshes = capsules_of(robot), meshes_of(robot, PANDA_URDF)
    assert set(meshes.links) == {*(f'panda_link{i}' for i in range(8)), 'panda_hand',
                                 'panda_leftfinger', 'panda_rightfinger'}
    data = meshes.model.createData()
    for q in random_postures(robot, 10):
        ball = Obstacle('ball', (0.9, 0.1, 0.9), np.full(3, 0.01))
        near = Motion.through(meshes, q[None]).to_obstacles([ball], 0.0)
        assert near.distance > Motion.through(capsules, q[None]).to_obstacles(
            [ball], 0.0).distance
        pin.forwardKinematics(meshes.model, data, q)
        corners = np.vstack([
            np.array(shape.points()) @ (at := data.oMi[joint] * place).rotation.T + at.translation
            for shape, joint, place in zip(meshes.shapes, meshes.joints, meshes.placements)
            if hasattr(shape, 'points')])
        to_corner = np.linalg.norm(corners - ball.center, axis=1).min() - 0.01
        # No further than to the nearest corner, and by no more nearer than a facet bulges.
        assert to_corner - 0.03 < near.distance < to_corner + 1e-5


def test_links_that_meet_are_found():
    links = [Capsule(f'l{i}', f'link{i}', np.zeros(3), np.array([x, 0, 0]), 0.05)
             for i, x in ((1, 0.5), (2, 0.4), (3, 0.3))]
    robot = make_planar(capsules=links)
    bodies = capsules_of(robot)
    assert [tuple(pair) for pair in bodies.self_pairs] == [(0, 2)]
    # Elbows of 90° each: the third link runs back, 0.4 m off the first.
    square = Motion.through(bodies, np.array([[0.0, np.pi / 2, np.pi / 2]]))
    assert square.to_itself().distance == pytest.approx(0.3, abs=1e-5)
    # Folded: the third lies on the first.
    folded = Motion.through(bodies, np.linspace([0.0, 0.5, 0.5], [0.0, 2.4, 2.4], 50))
    assert folded.to_itself().distance < 0.0 and 0 < folded.to_itself().index < 50
