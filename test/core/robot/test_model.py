"""The chain that a robot is made of, and what is refused."""

from __future__ import annotations

from conftest import make_panda, make_planar, PANDA_URDF, planar_urdf, random_postures
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.errors import RobotError, StateError
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot


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
    upper = make_panda(base_frame='panda_link2', acceleration_max=(5.0,), jerk_max=())
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


def test_bad_postures_are_refused(planar):
    with pytest.raises(StateError, match='has 3 joints'):
        planar.kinematics([0.0, 0.0])
    with pytest.raises(StateError, match="joint 'joint2' is not a finite number"):
        planar.kinematics([0.0, np.nan, 0.0])
