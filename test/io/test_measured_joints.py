"""Joints beside the chain: which of them are locked where they are measured."""

from __future__ import annotations

from conftest import planar_urdf

from redundant_planner.io.measured_joints import joints_to_measure, locked_at
from redundant_planner.io.parameter_files import RobotParameters

FINGERS = ''.join(
    f'<link name="{name}_link"/><joint name="{name}" type="prismatic"><parent link="link3"/>'
    f'<child link="{name}_link"/><axis xyz="1 0 0"/>'
    '<limit lower="0" upper="0.04" velocity="1" effort="1"/></joint>'
    for name in ('thumb', 'finger'))
URDF = planar_urdf().replace('</robot>', f'{FINGERS}</robot>')


def parameters(*locked):
    return RobotParameters(tip_frame='tip', axes=('vx', 'vy'), locked_joints=locked)


def test_joints_outside_the_chain_are_measured_but_for_those_that_are_locked_by_name():
    assert joints_to_measure(parameters(), URDF) == ()
    assert joints_to_measure(parameters('*=measured'), URDF) == ('thumb', 'finger')
    assert joints_to_measure(parameters('thumb=0.02', '*=measured'), URDF) == ('finger',)


def test_what_was_measured_is_locked_and_no_longer_measured():
    locked = locked_at(parameters('thumb=0.02', '*=measured'), {'finger': 0.031})
    assert locked.locked == {'thumb': 0.02, 'finger': 0.031}
    assert joints_to_measure(locked, URDF) == ()
