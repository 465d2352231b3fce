"""An arm that stands somewhere in a cell: the same arm, seen from there."""

from __future__ import annotations

from conftest import PANDA_READY, PANDA_URDF, ROBOTS
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.errors import ParameterError, RobotError
from redundant_planner.io.mount import mounted
from redundant_planner.io.robot_files import Robot, robot_of_values

POSE = (0.4, -0.2, 0.9, 0.3, -0.5, 2.0)


def panda(**changes):
    return Robot.from_file(ROBOTS / 'panda.yaml', urdf=str(PANDA_URDF), **changes)


@pytest.mark.parametrize('pose', [POSE, (*POSE[:3], *pin.Quaternion(
    pin.rpy.rpyToMatrix(*POSE[3:])).coeffs())])
def test_everything_is_seen_from_the_mount(pose):
    alone, there = panda(), panda(mount_frame='cell', mount_pose=pose)
    assert there.base_frame == 'cell' and there.joint_names == alone.joint_names
    one, other = alone.kinematics(PANDA_READY), there.kinematics(PANDA_READY)
    turn = pin.rpy.rpyToMatrix(*POSE[3:])
    for name in ('tip_position', 'segment_start', 'segment_end'):
        np.testing.assert_allclose(
            getattr(other, name), getattr(one, name) @ turn.T + POSE[:3], atol=1e-9)
    np.testing.assert_allclose(other.tip_rotation, turn @ one.tip_rotation, atol=1e-9)


def test_three_numbers_are_a_place():
    there = panda(mount_frame='cell', mount_pose=(1.0, 2.0, 3.0))
    np.testing.assert_allclose(
        there.kinematics(PANDA_READY).tip_position,
        panda().kinematics(PANDA_READY).tip_position + [1.0, 2.0, 3.0], atol=1e-9)


@pytest.mark.parametrize('base_frame', ['cell', 'panda_link0'])
def test_the_root_named_as_base_does_not_undo_the_mount(base_frame):
    """Parameter files of quick_start name it."""
    there = panda(mount_frame='cell', mount_pose=POSE, base_frame=base_frame)
    expected = panda(mount_frame='cell', mount_pose=POSE)
    assert there.base_frame == 'cell'
    np.testing.assert_array_equal(there.kinematics(PANDA_READY).tip_position,
                                  expected.kinematics(PANDA_READY).tip_position)


@pytest.mark.parametrize(('origin', 'taken'), [('0 0 0', True), ('0 0 0.1', False)])
def test_a_base_away_from_the_mounted_root_is_refused(tmp_path, origin, taken):
    """Is mount_pose that of the root, or of the base? Where both are one place, no matter."""
    urdf = tmp_path / 'arm.urdf'
    urdf.write_text(PANDA_URDF.read_text().replace('</robot>', (
        '<link name="world"/><joint name="stand" type="fixed"><parent link="world"/>'
        f'<child link="panda_link0"/><origin xyz="{origin}"/></joint></robot>')))
    mount = {'mount_frame': 'cell', 'mount_pose': POSE, 'base_frame': 'panda_link0'}

    def build():
        return Robot.from_file(ROBOTS / 'panda.yaml', urdf=str(urdf), **mount)

    if taken:
        np.testing.assert_allclose(build().kinematics(PANDA_READY).tip_position,
                                   panda(**mount).kinematics(PANDA_READY).tip_position)
        return
    with pytest.raises(ParameterError, match=(
            r"'base_frame' is 'panda_link0', and 'mount_frame' is 'cell', where 'world' stands at "
            r"mount_pose: one of them can be the base\. Leave base_frame empty")):
        build()


def test_a_base_behind_a_joint_is_refused_beside_a_mount():
    with pytest.raises(ParameterError, match="'base_frame' is 'panda_link1', and 'mount_frame'"):
        panda(mount_frame='cell', mount_pose=POSE, base_frame='panda_link1')


def test_what_is_mounted_stays_as_it_is():
    urdf = mounted(PANDA_URDF.read_text(), 'cell', POSE)
    assert mounted(urdf, 'cell', POSE) == urdf
    with pytest.raises(ParameterError, match="'mount_frame' is 'panda_link0', a link of the URDF"):
        mounted(urdf, 'panda_link0', POSE)
    for pose, what in (((1.0, 2.0), r'is \[1\.0, 2\.0\]'), (
            (0, 0, 0, 0, 0, 0, 2), 'length must be 1')):
        with pytest.raises(ParameterError, match=what):
            mounted(PANDA_URDF.read_text(), 'cell', pose)
    with pytest.raises(RobotError):
        Robot(mounted('<robot', 'cell', POSE), 'tip', capsules=[])


def test_a_recorded_configuration_mounts_nothing_twice():
    there = panda(mount_frame='cell', mount_pose=POSE)
    values = {'robot_description': there.urdf, 'mount_frame': 'cell', 'mount_pose': list(POSE),
              'base_frame': 'cell', 'tip_frame': 'panda_hand', 'link_shapes': 'straight'}
    for base in ('cell', 'panda_link0', ''):
        again = robot_of_values({**values, 'base_frame': base})
        np.testing.assert_allclose(again.kinematics(PANDA_READY).tip_position,
                                   there.kinematics(PANDA_READY).tip_position, atol=1e-12)
