"""Where limits are from, as tools and the files that they write say; limits in parameters."""

from __future__ import annotations

import argparse

from conftest import planar_urdf
import numpy as np
import pytest
import yaml

from redundant_planner.core.errors import ParameterError, RobotError
from redundant_planner.io.limit_report import limit_lines
from redundant_planner.io.parameter_files import RobotParameters
from redundant_planner.io.parameter_writer import parameter_file_text
from redundant_planner.io.robot_files import build_robot, load_robot, Robot, robot_of_values
from redundant_planner.tools.quick_start import prepared
from redundant_planner.tools.show_robot import main as show_robot

BALLS = ''.join(f'<link name="link{i}"><collision><geometry><sphere radius="0.05"/></geometry>'
                '</collision></link>' for i in (1, 2, 3))
# Joint 1 as a URDF of version 1.2 has it; joint 2 without a limit of velocity.
TEXT = planar_urdf(('revolute', 'revolute', 'revolute')).replace(
    'velocity="2"', 'velocity="1.5" acceleration="3" jerk="77"', 1).replace(
    'velocity="2"', '', 1)
for i in (1, 2, 3):
    TEXT = TEXT.replace(f'<link name="link{i}"/>', '')
TEXT = TEXT.replace('<link name="base"/>', f'<link name="base"/>{BALLS}')
TABLE = [
    'joint   position [rad, m]  velocity [per s]  acceleration [per s²]  jerk [per s³]',
    'joint1  -2.5..2.5 URDF     1.5 URDF          3 URDF                 77 URDF',
    'joint2  -2.5..2.5 URDF     1 default         5 default              500 default',
    'joint3  -2.5..2.5 URDF     2 URDF            5 default              500 default']


def test_a_joint_without_limits_is_said_to_be_endless():
    robot = Robot(planar_urdf(('continuous', 'revolute', 'revolute')), 'tip', link_radius=0.02)
    lines = limit_lines(robot, robot.limit_sources)
    assert [line.split()[1] for line in lines[1:3]] == ['endless', '-2.5..2.5']


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / 'arm.urdf'
    path.write_text(TEXT)
    return path


def lines_of(text):
    return [line.removeprefix('#').strip() for line in text.splitlines()]


def test_show_robot_says_where_each_limit_is_from_and_so_does_its_file(urdf, tmp_path, capsys):
    arguments = ['--out', str(tmp_path / 'arm.png')]
    assert show_robot(['--urdf', str(urdf), *arguments]) == 0
    printed = capsys.readouterr()
    assert "no velocity limit for 'joint2'; 1.0 is taken" in printed.err
    for said in (printed.err, printed.out):
        assert [line for line in lines_of(said) if line in TABLE] == TABLE
    file = tmp_path / 'arm.yaml'
    file.write_text(printed.out)
    # What the URDF lacks is in the file, to be replaced; jerk follows from the URDF's again.
    robot = load_robot(file)
    np.testing.assert_array_equal(robot.velocity_max, [1.5, 1.0, 2.0])
    np.testing.assert_array_equal(robot.acceleration_max, [3.0, 5.0, 5.0])
    np.testing.assert_array_equal(robot.jerk_max, [77.0, 500.0, 500.0])
    file.write_text(printed.out.replace('acceleration_max: [3.0, 5.0, 5.0]', (
        "acceleration_max: [4.0]\n    position_limits: ['joint3=-1.25..2']")))
    assert show_robot(['--params', str(file), *arguments]) == 0
    said = lines_of(capsys.readouterr().err)
    assert ('joint3  -1.25..2 parameter  2 parameter       4 parameter            400 default'
            in said)


def test_a_urdf_with_all_limits_is_left_to_say_them(urdf, tmp_path, capsys):
    urdf.write_text(planar_urdf(('revolute', 'revolute', 'revolute')).replace(
        'velocity="2"', 'velocity="2" acceleration="3" jerk="77"').replace(
        '<link name="link1"/>', '').replace('<link name="link2"/>', '').replace(
        '<link name="link3"/>', '').replace('<link name="base"/>', f'<link name="base"/>{BALLS}'))
    assert show_robot(['--urdf', str(urdf), '--out', str(tmp_path / 'arm.png')]) == 0
    printed = capsys.readouterr().out
    assert 'acceleration_max' not in printed and 'jerk_max' not in printed
    file = tmp_path / 'arm.yaml'
    file.write_text(printed)
    np.testing.assert_array_equal(load_robot(file).acceleration_max, 3.0)
    # A corrected URDF counts.
    urdf.write_text(urdf.read_text().replace('acceleration="3"', 'acceleration="2"'))
    np.testing.assert_array_equal(load_robot(file).acceleration_max, 2.0)


def test_quick_start_says_the_same(urdf, tmp_path):
    said = []
    options = argparse.Namespace(
        urdf=str(urdf), xacro_args=(), tips=[], out=tmp_path, tip='', base='', overwrite=False)
    _, file, _ = prepared(options, said.append, said.append)
    text = '\n'.join(said)
    assert [line for line in lines_of(text) if line in TABLE] == TABLE
    assert [line for line in lines_of(file.read_text()) if line in TABLE] == TABLE


def test_narrower_soft_limits_are_named_with_what_to_write(urdf, tmp_path, capsys):
    soft = ('<safety_controller k_velocity="10" soft_lower_limit="-2" soft_upper_limit="3"/>',
            '<safety_controller k_velocity="10" soft_lower_limit="-9" soft_upper_limit="9"/>',
            '<safety_controller k_velocity="10" soft_lower_limit="low" soft_upper_limit="1"/>')
    text = TEXT
    for i, element in enumerate(soft, start=1):
        text = text.replace(f'<parent link="{["base", "link1", "link2"][i - 1]}"/>',
                            f'<parent link="{["base", "link1", "link2"][i - 1]}"/>{element}')
    urdf.write_text(text)
    assert show_robot(['--urdf', str(urdf), '--out', str(tmp_path / 'arm.png')]) == 0
    assert "position_limits: ['joint1=-2..2.5']" in ' '.join(capsys.readouterr().err.split())


@pytest.mark.parametrize('entry', [
    'joint1', 'joint1=', 'joint1=1', '=0..1', 'joint1=0..', 'joint1=..1', 'joint1=a..b',
    'joint1=0..inf', 'joint1=nan..1', 'joint1=0...1', 'joint1=0..1..2'])
def test_an_entry_that_is_no_range_is_refused(entry):
    with pytest.raises(ParameterError, match=(
            r"^parameter 'position_limits' has .*; it takes 'joint=low\.\.high', a joint's name "
            'and two numbers')):
        RobotParameters(position_limits=(entry,))


def test_ranges_are_read_as_they_are_written():
    parameters = RobotParameters(position_limits=('a=-1..2.5', 'b=-1e-1..0', 'c=.5..1.'))
    assert parameters.position_ranges == {'a': (-1.0, 2.5), 'b': (-0.1, 0.0), 'c': (0.5, 1.0)}
    with pytest.raises(ParameterError, match="'position_limits' names 'a' twice"):
        RobotParameters(position_limits=('a=-1..2.5', 'a=0..1'))


def test_a_recorded_configuration_has_the_same_limits(urdf):
    parameters = RobotParameters(
        urdf=str(urdf), tip_frame='tip', axes=('vx', 'vy'), velocity_max=(1.0,),
        position_limits=('joint2=-1..0.5',))
    robot = build_robot(parameters, TEXT, {}, folder=urdf.parent)
    again = robot_of_values(yaml.safe_load(
        parameter_file_text(parameters, robot, {}))['/**']['ros__parameters'])
    assert again.limit_sources == robot.limit_sources
    for name in ('position_min', 'position_max', 'velocity_max', 'acceleration_max', 'jerk_max'):
        np.testing.assert_array_equal(getattr(again, name), getattr(robot, name))


@pytest.mark.parametrize(('entry', 'message'), [
    ('joint9=0..1', "position_limits name joint 'joint9'"),
    ('joint1=1..-1', 'the first must be less than the second'),
    ('joint1=-2.6..1', "they must lie within the URDF's, -2.5..2.5")])
def test_a_range_that_the_robot_cannot_have_is_refused_at_the_start(
        urdf, tmp_path, entry, message):
    file = tmp_path / 'arm.yaml'
    file.write_text(f'/**: {{ros__parameters: {{urdf: {urdf}, tip_frame: tip, axes: [vx, vy], '
                    f"velocity_max: [1.0], position_limits: ['{entry}']}}}}")
    with pytest.raises(RobotError, match=message):
        Robot.from_file(file)
