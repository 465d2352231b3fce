"""Which axes of a twist arms can follow that have few joints, or joints of one direction."""

from __future__ import annotations

from conftest import planar_urdf
import pytest

from redundant_planner.core.parameters import AXES
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.possible_axes import is_overdetermined, possible_axes

UP, ACROSS, ALONG = '0 0 1', '0 1 0', '1 0 0'
LIMIT = '<limit lower="-2.5" upper="2.5" velocity="2" effort="1"/>'


def chain(axes, kinds=None, mount='0 0 0'):
    """Links of 0.3 m along x, the first joint mounted with a roll, pitch and yaw."""
    parts = ['<robot name="arm"><link name="base"/>']
    parent = 'base'
    for i, axis in enumerate(axes):
        xyz, rpy = ('0.3 0.02 0.05', '0 0 0') if i else ('0 0 0', mount)
        kind = 'revolute' if kinds is None else kinds[i]
        parts.append(
            f'<link name="link{i}"/><joint name="joint{i}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="link{i}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{LIMIT}'
            '</joint>')
        parent = f'link{i}'
    parts.append(f'<link name="tip"/><joint name="end" type="fixed"><parent link="{parent}"/>'
                 '<child link="tip"/><origin xyz="0.2 0 0"/></joint></robot>')
    return Robot(''.join(parts), 'tip', capsules=[])


SIX = [UP, ACROSS, ACROSS, ALONG, ACROSS, ALONG]


@pytest.mark.parametrize('robot, axes', [
    (chain(SIX), AXES),
    (chain([UP, *SIX]), AXES),
    # A waist, three joints in a plane, and a wrist that rolls: rotations depend on the posture.
    (chain([UP, ACROSS, ACROSS, ACROSS, ALONG]), ('vx', 'vy', 'vz')),
    (chain([UP, ACROSS, ACROSS]), ('vx', 'vy', 'vz')),
    (chain([UP] * 5), ('vx', 'vy', 'wz')),
    (chain([ACROSS] * 5), ('vx', 'vz', 'wy')),
    # An angle as URDFs round it does not make another axis.
    (chain([UP] * 5, mount='1.5707 0 0'), ('vx', 'vz', 'wy')),
    # A SCARA turns about one axis at every posture.
    (chain([UP, UP, UP, UP], ['revolute', 'revolute', 'revolute', 'prismatic']),
     ('vx', 'vy', 'vz', 'wz')),
    (chain([ALONG, ACROSS], ['prismatic'] * 2), ('vx', 'vy')),
    (chain([ALONG]), ('wx',)),
    # A plane that leans: two axes say where in it, and one how it turns.
    (chain([UP] * 5, mount='0.8 0 0'), ('vx', 'vy', 'wy'))],
    ids=['six', 'seven', 'five', 'three', 'planar', 'upright plane', 'rounded', 'SCARA', 'gantry',
         'in place', 'leaning plane'])
def test_an_arm_can_follow_the_axes_that_are_proposed(robot, axes):
    assert possible_axes(robot) == axes
    assert is_overdetermined(robot) == (axes != AXES)
    assert not is_overdetermined(Robot(robot.urdf, 'tip', axes=axes, capsules=[]))


def test_axes_that_an_arm_has_not_are_too_many():
    """Three joints in a plane: they do not move along z, though these axes are only two."""
    planar = Robot(planar_urdf(), 'tip', axes=('vx', 'vz'), link_radius=0.0)
    assert is_overdetermined(planar)
