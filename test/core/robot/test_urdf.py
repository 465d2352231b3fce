"""What a URDF may hold, and what is refused by name."""

from __future__ import annotations

from conftest import EXAMPLE_ROBOTS, planar_urdf
from hypothesis import given, strategies as st
import numpy as np
import pinocchio as pin
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.simulated_arm import joint_ranges
from redundant_planner.core.robot.urdf import read_urdf
from redundant_planner.io.likely_tips import likely_tip

JOINT1 = '<joint name="joint1" type="revolute">'
LIMIT1 = '<limit lower="-2.5" upper="2.5" velocity="2" effort="1"/>'


@pytest.mark.parametrize('file', [
    'panda_description/urdf/panda.urdf', 'tiago_description/robots/tiago_dual.urdf',
    'icub_description/robots/icub.urdf', 'pr2_description/urdf/pr2.urdf'])
def test_pinocchio_reads_the_same_kinematics_from_the_urdf_as_from_ours(file):
    path = EXAMPLE_ROBOTS / file
    urdf = read_urdf(path.read_text())
    theirs = pin.buildModelFromUrdf(str(path))
    ours = pin.buildModelFromXML(urdf.for_pinocchio())
    assert list(ours.names) == list(theirs.names)
    # A continuous joint has two coordinates there, cos and sin.
    q = np.random.default_rng(0).uniform(-1.0, 1.0, ours.nq)
    q_theirs = np.concatenate([
        [np.cos(q[i]), np.sin(q[i])] if joint.nq == 2 else [q[i]]
        for i, joint in enumerate(list(theirs.joints)[1:])])
    data, data_theirs = ours.createData(), theirs.createData()
    pin.framesForwardKinematics(ours, data, q)
    pin.framesForwardKinematics(theirs, data_theirs, q_theirs)
    for link in urdf.links:
        there, here = (d.oMf[m.getFrameId(link, pin.FrameType.BODY)] for d, m in (
            (data_theirs, theirs), (data, ours)))
        np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-12)


@pytest.mark.parametrize(('old', 'new', 'message'), [
    ('<robot name="planar">', '<robot>', 'a <robot> of the URDF is called'),
    ('<link name="link1"/>', '<link name="link1"/><link name="link1"/>', "two links called 'li"),
    ('<link name="link1"/>', '<link name="link1"/><link/>', 'a <link> of the URDF is called'),
    ('<link name="link1"/>', '<link name="link1"/><link name="alone"/>', "holds 'base', 'alone'"),
    ('"joint2"', '"joint1"', "two joints called 'joint1'"),
    ('"joint2"', f'"{"j" * 5000}"', 'a name of 1 to 200 printable characters'),
    (JOINT1, '<joint name="joint1" type="hinge">', "'joint1' of the URDF has the type 'hinge'"),
    (JOINT1, '<joint name="joint1">', "has the type ''"),
    ('<parent link="base"/>', '', "'joint1' of the URDF has the parent '', which is not a link"),
    ('<child link="link1"/>', '<child link="nose"/>', "has the child 'nose', which is not a link"),
    ('<parent link="base"/>', '<parent link="link1"/>', r"joints of 'link1'.* form a circle"),
    ('<parent link="base"/>', '<parent link="link3"/>', r"joints of 'link1'.* form a circle"),
    ('<child link="link2"/>', '<child link="link1"/>', "'link1' of the URDF hangs from two"),
    ('xyz="0.5 0 0"', 'xyz="0.5 0"', "origin of joint 'joint2' .* has xyz='0.5 0'; it takes 3"),
    ('xyz="0.5 0 0"', 'xyz=""', "has xyz=''"),
    ('xyz="0.5 0 0"', 'xyz="0.5 nan 0"', "has xyz='0.5 nan 0'; it takes 3 numbers within"),
    ('xyz="0.5 0 0"', 'xyz="0.5 0 1e300"', "has xyz='0.5 0 1e300'"),
    ('xyz="0.5 0 0"', 'rpy="-90° 0 0"', "has rpy='-90° 0 0'"),
    ('xyz="0 0 1"', 'xyz="0 0 0"', "'joint1' of the URDF has the axis 0.0 0.0 0.0"),
    (LIMIT1, '', "'joint1' of the URDF has no <limit>"),
    ('lower="-2.5"', 'lower="abc"', "limit of joint 'joint1' of the URDF has lower='abc'"),
    ('lower="-2.5"', 'lower="-90°"', "has lower='-90°'; it takes a number"),
    ('lower="-2.5"', 'lower=""', "has lower=''"),
    ('lower="-2.5"', 'lower="nan"', "has lower='nan'"),
    ('lower="-2.5"', 'lower="-inf"', 'both must be finite'),
    ('lower="-2.5"', 'lower="2.6"', 'lower must not exceed upper'),
    ('velocity="2"', 'velocity="-2"', 'velocity=-2.0; it takes a positive number'),
    ('velocity="2"', 'velocity="fast"', "has velocity='fast'"),
    (LIMIT1, LIMIT1 + '<mimic joint="joint2" multiplier="two"/>', "mimic of joint 'joint1' .*two"),
])
def test_a_bad_urdf_is_refused_by_name_wherever_it_is_read(old, new, message):
    text = planar_urdf().replace(old, new)
    assert text != planar_urdf()
    for read in (read_urdf, joint_ranges, likely_tip,
                 lambda text: Robot(text, 'tip', axes=('vx', 'vy'))):
        with pytest.raises(RobotError, match=message):
            read(text)


@pytest.mark.parametrize('key', ['acceleration', 'deceleration', 'jerk'])
@pytest.mark.parametrize(('value', 'wanted'), [
    ('0', '=0.0; it takes a positive number'), ('-3', '=-3.0; it takes a positive number'),
    ('nan', "='nan'; it takes a number"), ('fast', "='fast'; it takes a number"),
    ('', "=''; it takes a number"), ('${limit}', r"='\$\{limit\}'; it takes a number")])
def test_a_bad_limit_of_version_1_2_is_refused_by_joint_and_attribute(key, value, wanted):
    text = planar_urdf().replace('velocity="2"', f'velocity="2" {key}="{value}"', 1)
    with pytest.raises(RobotError, match=f"^the limit of joint 'joint1' of the URDF has {key}"
                                         f'{wanted}$'):
        read_urdf(text)


def test_an_unexpanded_macro_is_refused_by_joint():
    text = planar_urdf().replace('velocity="2"', 'velocity="${speed * 2}"', 1)
    with pytest.raises(RobotError, match=r"'joint1' of the URDF has velocity='\$\{speed \* 2"):
        read_urdf(text)
    text = planar_urdf().replace('xyz="0.5 0 0"', 'xyz="${length} 0 0"', 1)
    with pytest.raises(RobotError, match=r"origin of joint 'joint2' .* has xyz='\$\{length\} 0"):
        read_urdf(text)


@pytest.mark.parametrize('text', [
    '', '<robot', '\ud800', '<?xml version="1.0" encoding="nonsense"?><robot name="x"/>',
    '<robot name="x"/>', '<a>' * 100_000 + '</a>' * 100_000])
def test_what_is_no_urdf_is_refused(text):
    for read in (joint_ranges, likely_tip, lambda text: Robot(text, 'tip')):
        with pytest.raises(RobotError, match='the URDF'):
            read(text)


@given(st.text('<>/"= robtjlinkame0.', max_size=60), st.integers(0, 900))
def test_text_put_anywhere_into_a_urdf_is_read_or_refused(extra, place):
    text = planar_urdf()[:place] + extra + planar_urdf()[place:]
    try:
        joint_ranges(text)
        likely_tip(text)
    except RobotError:
        pass


def test_a_chain_of_a_thousand_links_is_read_at_once():
    joints = ''.join(
        f'<link name="link{i}"/><joint name="fixed{i}" type="fixed"><parent link="link{i - 1}"/>'
        f'<child link="link{i}"/></joint>' for i in range(4, 900))
    text = planar_urdf().replace('</robot>', f'{joints}</robot>')
    assert likely_tip(text) == 'link899'
    assert Robot(text, 'link899', axes=('vx', 'vy'), capsules=[]).n == 3
    with pytest.raises(RobotError, match='has 1505 links; it may have 1000'):
        read_urdf(text.replace('</robot>', ''.join(
            f'<link name="more{i}"/>' for i in range(604)) + '</robot>'))
