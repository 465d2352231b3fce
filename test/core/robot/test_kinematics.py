"""Forward kinematics and Jacobians against closed forms and finite differences."""

from __future__ import annotations

from conftest import central_difference, LENGTHS, PANDA_READY, random_postures
import numpy as np
import pinocchio as pin

from redundant_planner.core.robot.model import Robot

# Axes along none of the coordinates, both kinds of joints, every joint turned against the last.
SLANTED = '<robot name="slanted"><link name="base"/>' + ''.join(
    f'<link name="{child}"/><joint name="j{i}" type="{kind}"><parent link="{parent}"/>'
    f'<child link="{child}"/><origin xyz="0.1 -0.2 0.3" rpy="{0.3 * i} -0.7 {1.1 - i}"/>'
    f'<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>'
    for i, (parent, child, kind, axis) in enumerate([
        ('base', 'a', 'revolute', '1 2 -2'), ('a', 'b', 'prismatic', '-1 0.5 0.2'),
        ('b', 'c', 'continuous', '0 1 1'), ('c', 'tip', 'revolute', '0 0 -1')])) + '</robot>'


def test_planar_arm_has_the_closed_form_kinematics(planar):
    # x = Σ l_i cos(q_1 + … + q_i), y = Σ l_i sin(…), angle = Σ q_i
    for q in random_postures(planar, 25):
        angles = np.cumsum(q)
        arm = planar.kinematics(q)
        expected = [LENGTHS @ np.cos(angles), LENGTHS @ np.sin(angles), 0.0]
        np.testing.assert_allclose(arm.tip_position, expected, atol=1e-12)
        np.testing.assert_allclose(arm.tip_rotation[:2, 0],
                                   [np.cos(angles[-1]), np.sin(angles[-1])], atol=1e-12)
        joints = np.array([[np.cos(a), np.sin(a)] for a in angles]) * np.array(LENGTHS)[:, None]
        np.testing.assert_allclose(planar.joint_points(q)[1:, :2], np.cumsum(joints, axis=0),
                                   atol=1e-12)


def test_paper_arm_is_where_the_paper_prints_it(paper_arm):
    # DESIGN §2.1: the start and both columns of Table 1 reach the printed positions.
    start = [0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0]
    columns = ([0.1950, 0.1416, -0.1154, 0.3755, -0.6731, 0.9528, 0.0],
               [0.1586, 0.09307, -0.1110, 0.3871, -0.598, 0.9956, 0.0])
    assert np.linalg.norm(paper_arm.kinematics(start).tip_position - [0, 0.455, 0.930]) < 6e-4
    for column in columns:
        error = paper_arm.kinematics(column).tip_position - [-0.087, 0.305, 0.941]
        assert np.abs(error).max() < 6e-4


def test_paper_arm_has_the_reconstructed_kinematics(paper_arm):
    for q in random_postures(paper_arm, 25):
        d1, d2, t3, t4, t5, t6, _ = q
        u = (0.390 + 0.275 * np.sin(t4) + 0.183 * np.sin(t4 + t5)
             - 0.345 * np.cos(t4 + t5 + t6))
        r = (0.110 + 0.275 * np.cos(t4) + 0.183 * np.cos(t4 + t5)
             + 0.345 * np.sin(t4 + t5 + t6))
        np.testing.assert_allclose(paper_arm.kinematics(q).tip_position,
                                   [r * np.sin(t3), d2 + u, d1 + r * np.cos(t3)], atol=1e-12)


def test_jacobians_match_finite_differences(robot):
    for q in random_postures(robot, 20):
        arm = robot.kinematics(q)
        expected, in_command_axes = [], []
        for t, tip in enumerate(arm.tips.each):
            linear = central_difference(
                lambda p, t=t: robot.kinematics(p).tip_positions[t], q)
            turning = central_difference(lambda p, t=t, at=tip: pin.log3(
                robot.kinematics(p).tip_rotations[t] @ at.rotation.T), q)
            expected += [linear, turning]
            axes = tip.rotation.T if robot.command_frame == 'tool' else np.eye(3)
            in_command_axes += [axes @ linear, axes @ turning]
        np.testing.assert_allclose(arm.tip_jacobian, np.vstack(expected), atol=1e-7)
        rows = robot.task_rows(np.arange(6 * len(robot.tips))).astype(int)
        np.testing.assert_allclose(arm.jacobian, np.vstack(in_command_axes)[rows], atol=1e-7)


def test_joint_screws_move_every_capsule_end(robot):
    for q in random_postures(robot, 5):
        arm = robot.kinematics(q)
        for i in range(len(robot.capsules)):
            for end in ('segment_start', 'segment_end'):
                point = getattr(arm, end)[i]
                expected = central_difference(
                    lambda p, e=end, i=i: getattr(robot.kinematics(p), e)[i], q)
                moves = arm.joint_screws[:3] + np.cross(arm.joint_screws[3:].T, point).T
                np.testing.assert_allclose(moves * robot.supports[i], expected, atol=1e-7)


def test_results_are_the_callers_to_keep(panda):
    first = panda.kinematics(PANDA_READY)
    kept = {name: np.array(value) for name, value in first._asdict().items()}
    q = PANDA_READY + 0.3
    panda.kinematics(q)
    for name, value in kept.items():
        np.testing.assert_array_equal(getattr(first, name), value)
    np.testing.assert_array_equal(q, PANDA_READY + 0.3)


def test_kinematics_of_many_postures_are_those_of_each(robot):
    postures = random_postures(robot, 5)
    together = robot.kinematics_along(postures)
    for i, q in enumerate(postures):
        for field, value in robot.kinematics(q)._asdict().items():
            found = getattr(together, field)
            np.testing.assert_allclose(
                found.reshape(len(postures), *value.shape)[i], value, atol=1e-12)


def test_joints_are_where_pinocchio_has_them(robot):
    data = robot.model.createData()
    tips = [robot.model.getFrameId(tip) for tip in robot.tips]
    for q in random_postures(robot, 20):
        arm = robot.kinematics(q)
        pin.computeJointJacobians(robot.model, data, q)
        np.testing.assert_allclose(arm.joint_screws, data.J, atol=1e-13)
        for found, tip in zip(arm.tips.each, tips):
            placed = pin.updateFramePlacement(robot.model, data, tip)
            np.testing.assert_allclose(found.position, placed.translation, atol=1e-13)
            np.testing.assert_allclose(found.rotation, placed.rotation, atol=1e-13)


def test_slanted_axes_and_joints_that_slide_are_where_pinocchio_has_them():
    robot = Robot(SLANTED, 'tip', link_radius=0.0, velocity_max=1.0, axes=['vx', 'vy', 'vz'])
    data = robot.model.createData()
    for q in random_postures(robot, 20):
        pin.computeJointJacobians(robot.model, data, q)
        np.testing.assert_allclose(robot.kinematics(q).joint_screws, data.J, atol=1e-13)
