"""The robot model against closed forms and finite differences."""

from __future__ import annotations

from conftest import (
    central_difference,
    LENGTHS,
    make_panda,
    make_planar,
    PANDA_READY,
    PANDA_URDF,
    planar_urdf,
    random_postures,
)
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.errors import ObstacleError, RobotError, StateError
from redundant_planner.core.obstacles.clearance import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Capsule, Robot


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
        linear = central_difference(lambda p: robot.kinematics(p).tip_position, q)
        turning = central_difference(
            lambda p, at=arm: pin.log3(robot.kinematics(p).tip_rotation @ at.tip_rotation.T), q)
        expected = np.vstack((linear, turning))
        np.testing.assert_allclose(arm.tip_jacobian, expected, atol=1e-7)
        if robot.command_frame == 'tool':
            expected = np.vstack((arm.tip_rotation.T @ linear, arm.tip_rotation.T @ turning))
        rows = robot.task_rows(np.arange(6)).astype(int)
        np.testing.assert_allclose(arm.jacobian, expected[rows], atol=1e-7)


def test_screw_columns_move_every_capsule_end(robot):
    for q in random_postures(robot, 5):
        arm = robot.kinematics(q)
        for i in range(len(robot.capsules)):
            for end in ('segment_start', 'segment_end'):
                point = getattr(arm, end)[i]
                expected = central_difference(
                    lambda p, e=end, i=i: getattr(robot.kinematics(p), e)[i], q)
                moves = arm.columns[:3] + np.cross(arm.columns[3:].T, point).T
                np.testing.assert_allclose(moves * robot.moves[i], expected, atol=1e-7)


def test_levers_bound_the_speed_of_every_capsule_end(robot):
    random = np.random.default_rng(3)
    for q in random_postures(robot, 50):
        arm = robot.kinematics(q)
        dq = random.normal(size=robot.n)
        for i in range(len(robot.capsules)):
            for point in (arm.segment_start[i], arm.segment_end[i]):
                moves = arm.columns[:3] + np.cross(arm.columns[3:].T, point).T
                speed = np.linalg.norm(moves @ (dq * robot.moves[i]))
                assert speed <= np.abs(dq) @ robot.levers[i] + 1e-12


def test_continuous_joint_has_no_limits_and_one_coordinate(planar):
    assert planar.n == 3
    assert np.isinf(planar.position_max[2]) and np.isinf(planar.position_min[2])
    turned = planar.kinematics([0.1, 0.2, 0.3 + 8 * np.pi])
    np.testing.assert_allclose(turned.tip_position,
                               planar.kinematics([0.1, 0.2, 0.3]).tip_position, atol=1e-9)


def test_locked_joint_leaves_the_chain_at_its_position():
    whole, locked = make_planar(), make_planar(locked_positions={'joint2': 0.7})
    assert locked.joint_names == ('joint1', 'joint3')
    np.testing.assert_allclose(locked.kinematics([0.2, -0.4]).tip_position,
                               whole.kinematics([0.2, 0.7, -0.4]).tip_position, atol=1e-12)


def test_base_frame_may_be_any_link_of_the_chain(panda):
    upper = make_panda(base_frame='panda_link2', acceleration_max=(5.0,))
    assert upper.joint_names == panda.joint_names[2:]
    q = np.array([0.3, -0.5, 0.2, -2.0, 0.4, 1.5, 0.8])
    model = pin.buildModelFromUrdf(str(PANDA_URDF))
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.append(q, [0.0, 0.0]))
    base, tip = (data.oMf[model.getFrameId(f)] for f in ('panda_link2', 'panda_hand'))
    np.testing.assert_allclose(upper.kinematics(q[2:]).tip_position,
                               (base.inverse() * tip).translation, atol=1e-12)


def test_joints_outside_the_chain_are_held(panda):
    assert panda.joint_names == tuple(f'panda_joint{i}' for i in range(1, 8))


def with_joint1(kind):
    return planar_urdf().replace('name="joint1" type="revolute"', f'name="joint1" type="{kind}"')


@pytest.mark.parametrize('kind', ['floating', 'planar'])
def test_floating_and_planar_joints_stand_still_outside_the_chain(kind):
    inside, outside = {'tip_frame': 'tip'}, {'tip_frame': 'tip', 'base_frame': 'link1'}
    with pytest.raises(RobotError, match=f"joint 'joint1' between .* is {kind}; a chain takes"):
        Robot(with_joint1(kind), axes=('vx', 'vy'), **inside)
    robot = Robot(with_joint1(kind), axes=('vx', 'vy'), capsules=[], **outside)
    expected = make_planar(base_frame='link1')
    for q in random_postures(robot, 3):
        np.testing.assert_array_equal(robot.kinematics(q).tip_position,
                                      expected.kinematics(q).tip_position)


@pytest.mark.parametrize(('limits', 'message'), [
    ('lower="-1e308" upper="1e308"', r'a joint that turns without end is continuous'),
    ('lower="0" upper="0"', r"joint 'joint1' cannot move"),
    ('', r"joint 'joint1' cannot move"),
])
def test_limits_that_a_chain_cannot_have_are_harmless_outside_it(limits, message):
    text = planar_urdf().replace('lower="-2.5" upper="2.5"', limits, 1)
    with pytest.raises(RobotError, match=message):
        Robot(text, 'tip', axes=('vx', 'vy'))
    assert Robot(text, 'tip', base_frame='link1', axes=('vx', 'vy'), capsules=[]).n == 2


def test_a_chain_of_one_joint_plans():
    robot = Robot(planar_urdf(('revolute',), (0.5,)), 'tip', axes=('vx',), link_radius=0.05)
    for q in (0.4, -0.9):
        arm = robot.kinematics([q])
        np.testing.assert_allclose(arm.tip_position, [0.5 * np.cos(q), 0.5 * np.sin(q), 0.0])
        np.testing.assert_allclose(arm.jacobian, [[-0.5 * np.sin(q)]])
    planner = Planner(robot, PlannerParameters(singularity_margin=0.0))
    result = planner.step(np.array([0.4]), np.array([0.01, 0, 0, 0, 0, 0]), Scene.of([]), 0.004)
    assert result.dq.shape == (1,) and -1.0 < result.dq[0] < 0.0


def test_more_joints_than_any_arm_has_are_refused():
    with pytest.raises(RobotError, match=r'51 movable joints .* takes 50 at most'):
        Robot(planar_urdf(('revolute',) * 51, (0.1,) * 51), 'tip')


def test_results_are_the_callers_to_keep(panda):
    first = panda.kinematics(PANDA_READY)
    kept = {name: np.array(value) for name, value in first._asdict().items()}
    q = PANDA_READY + 0.3
    panda.kinematics(q)
    for name, value in kept.items():
        np.testing.assert_array_equal(getattr(first, name), value)
    np.testing.assert_array_equal(q, PANDA_READY + 0.3)


@pytest.mark.parametrize(('change', 'message'), [
    ({'tip_frame': 'nose'}, r"tip_frame 'nose' is not in the URDF; it has 'base'"),
    ({'base_frame': 'nose'}, r"base_frame 'nose' is not in the URDF"),
    ({'tip_frame': 'base'}, r'no movable joint lies between'),
    ({'base_frame': 'link2', 'tip_frame': 'link1'}, r"does not hang from base_frame 'link2'"),
    ({'urdf': '<robot'}, r'not well-formed XML'),
    ({'urdf': '<model/>'}, r'outermost element is <model>'),
    ({'urdf': '<robot name="x"/>'}, r'does not describe a robot'),
    ({'axes': ('vx', 'up')}, r"axes are \['vx', 'up'\]; they must be"),
    ({'axes': ()}, r'non-empty choice'),
    ({'command_frame': 'world'}, r"command_frame is 'world'; it must be one of 'base', 'tool'"),
    ({'locked_positions': {'joint9': 0.0}}, r"locked joint 'joint9' is not a movable joint"),
    ({'locked_positions': {'joint1': np.nan}}, r"locked joint 'joint1' is held at nan"),
    ({'velocity_max': [1.0, 2.0]}, r'velocity_max has 2 values; it takes 1 or 3'),
    ({'acceleration_max': -1.0}, r"acceleration_max of joint 'joint1' is -1.0"),
    ({'acceleration_max': 1e308}, r"acceleration_max of joint 'joint1' is 1e\+308; it must"),
    ({'velocity_max': 'fast'}, r"velocity_max of joint 'joint1' is nan; it must lie in"),
    ({'locked_positions': {'joint1': 1e300}}, r"joint 'joint1' is held at 1e\+300; it must be a"),
    ({'capsules': [Capsule('arm', 'nose', np.zeros(3), np.ones(3), 0.1)]},
     r"capsule 'arm': the robot has no frame 'nose'"),
])
def test_bad_descriptions_are_refused_by_name(change, message):
    arguments = {'urdf': planar_urdf(), 'tip_frame': 'tip', 'axes': ('vx', 'vy'), **change}
    with pytest.raises(RobotError, match=message):
        Robot(arguments.pop('urdf'), arguments.pop('tip_frame'), **arguments)


@pytest.mark.parametrize(('start', 'radius'), [
    ([0.0, 0.0], 0.1), ([0.0, 0.0, np.nan], 0.1), ([0.0, 0.0, 0.0], -0.1),
    ([0.0, 0.0, 1e300], 0.1), ('abc', 0.1), (None, 0.1), ([[0.0] * 9] * 9, 0.1), ({}, 0.1),
    ([0.0, 0.0, 0.0], 'thick'), ([0.0, 0.0, 0.0], [0.1]), ([0.0, 0.0, 0.0], 1e300)])
def test_bad_capsules_are_refused(start, radius):
    with pytest.raises(ObstacleError, match="capsule 'arm'"):
        Capsule('arm', 'link1', start, np.ones(3), radius)


def test_bad_postures_are_refused(planar):
    with pytest.raises(StateError, match='has 3 joints'):
        planar.kinematics([0.0, 0.0])
    with pytest.raises(StateError, match="joint 'joint2' is not a finite number"):
        planar.kinematics([0.0, np.nan, 0.0])
