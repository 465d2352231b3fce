"""The model of an arm: what is taken from the URDF, and what is assumed."""

from __future__ import annotations

from conftest import make_panda, make_paper_arm
import mujoco
import numpy as np
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot
from redundant_planner.io.physics_parameters import PhysicsParameters
from redundant_planner.physics.inertia import BALL_MASS, DENSITY, rotation_of
from redundant_planner.physics.model import arm_model, PLACES

# A link of 2 kg with its mass 0.3 m beyond the joint, and a joint that mimics the first.
URDF = """
<robot name="two"><link name="world"/>
  <link name="one"><inertial><origin xyz="0.3 0 0" rpy="0 0 1.5708"/><mass value="2"/>
    <inertia ixx="0.03" iyy="0.02" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="two"/>
  <joint name="a" type="continuous"><parent link="world"/><child link="one"/>
    <axis xyz="0 1 0"/><limit effort="{effort}" velocity="3"/></joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/>
    <origin xyz="0.6 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="3"/>{mimic}</joint>
</robot>"""


def two(effort='9', mimic='', **options):
    return Robot(URDF.format(effort=effort, mimic=mimic), 'one' if mimic else 'two', axes=('vx',),
                 **{'capsules': [], **options})


def test_masses_inertias_and_limits_are_the_urdfs():
    model = arm_model(make_panda(), PhysicsParameters())
    body = model.nominal.body('link panda_link3')
    assert body.mass[0] == pytest.approx(3.228604)
    assert sorted(body.inertia) == pytest.approx(np.linalg.eigvalsh(
        [[0.037242, -0.004761, -0.011396], [-0.004761, 0.036155, -0.012805],
         [-0.011396, -0.012805, 0.01083]]), rel=1e-6)
    np.testing.assert_array_equal(model.effort_max, [87.0] * 4 + [12.0] * 3 + [100.0])
    assert model.remarks == ()


def test_an_inertia_turned_in_its_link_is_turned():
    """By 90 degrees about z: x and y change places; about the joint comes m r²."""
    model = arm_model(two(), PhysicsParameters(armature=0.0)).nominal
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    matrix = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, matrix)
    second = 0.4 * BALL_MASS * 0.05**2
    assert matrix[0, 0] == pytest.approx(
        0.03 + 2.0 * 0.3**2 + second + BALL_MASS * 0.6**2, rel=1e-4)


def test_rotations_are_pinocchios():
    import pinocchio as pin
    for rpy in np.random.default_rng(0).uniform(-3, 3, (20, 3)):
        np.testing.assert_allclose(rotation_of(tuple(rpy)), pin.rpy.rpyToMatrix(*rpy), atol=1e-12)


def test_links_without_inertia_are_named_and_get_that_of_their_capsules():
    bare = arm_model(two(), PhysicsParameters())
    assert len(bare.remarks) == 1 and "no inertia of 'two'" in bare.remarks[0]
    assert bare.nominal.body('link two').mass[0] == pytest.approx(BALL_MASS)
    clad = arm_model(two(capsules=[Capsule('c', 'two', (0, 0, 0), (0.5, 0, 0), 0.05)]),
                     PhysicsParameters())
    volume = np.pi * 0.05**2 * 0.5 + 4.0 / 3.0 * np.pi * 0.05**3
    assert clad.nominal.body('link two').mass[0] == pytest.approx(DENSITY * volume)


def test_a_tool_of_which_only_the_mass_is_known_keeps_it():
    tool = """<link name="tool"><inertial><origin xyz="0 0 0.1"/><mass value="1.5"/>
        <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="flange" type="fixed"><parent link="two"/><child link="tool"/></joint></robot>"""
    urdf = URDF.format(effort='9', mimic='').replace('</robot>', tool)
    model = arm_model(Robot(urdf, 'tool', axes=('vx',), capsules=[]), PhysicsParameters())
    assert model.nominal.body('link tool').mass[0] == 1.5
    # Link two moves with the tool: it needs no mass of its own.
    assert len(model.remarks) == 1 and "matrix of 'tool'" in model.remarks[0]
    assert model.nominal.body_mass.sum() == 3.5


def test_a_paper_arm_of_bare_lines_can_be_simulated():
    model = arm_model(make_paper_arm(), PhysicsParameters())
    assert "'carriage'" in model.remarks[0]
    assert model.model.nmocap == PLACES


def test_joints_without_effort_limit_are_named():
    model = arm_model(two(effort='0'), PhysicsParameters())
    assert "no effort limit of 'a'" in model.remarks[-1]
    assert model.effort_max[0] == np.inf and not model.model.actuator_forcelimited[0]


@pytest.mark.parametrize('effort', ['-1', 'inf', 'nan', 'x'])
def test_effort_limits_that_are_none_are_refused(effort):
    with pytest.raises(RobotError, match="joint 'a' of the URDF has effort="):
        arm_model(two(effort=effort), PhysicsParameters())


def test_joints_that_mimic_follow():
    model = arm_model(two(mimic='<mimic joint="a" multiplier="0.5" offset="0.1"/>'),
                      PhysicsParameters())
    assert model.ranges.names == ('a',) and model.followers == ((1, 0, 0.5, 0.1),)
    with pytest.raises(RobotError, match="joint 'b' of the URDF mimics 'z'"):
        arm_model(two(mimic='<mimic joint="z"/>'), PhysicsParameters())


def test_a_mass_error_is_the_simulated_arms_alone():
    right = arm_model(make_panda(), PhysicsParameters())
    wrong = arm_model(make_panda(), PhysicsParameters(mass_error=0.2))
    assert wrong.model.nbody == right.model.nbody
    np.testing.assert_allclose(wrong.model.body_mass, 1.2 * right.model.body_mass)
    np.testing.assert_allclose(wrong.model.body_inertia, 1.2 * right.model.body_inertia)
    np.testing.assert_array_equal(wrong.nominal.body_mass, right.nominal.body_mass)
    np.testing.assert_array_equal(wrong.stiffness, right.stiffness)
