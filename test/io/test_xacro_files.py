"""URDFs made of macros: expanded with arguments, or the line to type is said."""

from __future__ import annotations

import sys

from conftest import planar_urdf
import pytest

from redundant_planner import PlannerError, Robot
from redundant_planner.io.xacro_files import expanded, urdf_in
from redundant_planner.tools import show_robot

pytest.importorskip('xacro')


@pytest.fixture
def arm(tmp_path):
    """The planar arm as macros: an argument is in front of each link's name."""
    text = planar_urdf().replace('"link1"', '"$(arg prefix)link1"')
    begin = text.index('>', text.index('<robot')) + 1
    text = (text[:begin].replace('<robot', '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"')
            + '<xacro:arg name="prefix" default=""/>' + text[begin:])
    file = tmp_path / 'arm.urdf.xacro'
    file.write_text(text)
    return file


def test_macros_are_expanded_with_their_arguments(arm):
    assert '"link1"' in urdf_in(arm) and 'xacro:arg' not in urdf_in(arm)
    assert '"my_link1"' in urdf_in(arm, ['prefix:=my_'])


def test_a_robot_comes_from_macros(arm):
    tip = Robot.from_urdf(arm, 'link1', link_radius=0.02)
    assert tip.n == 1


@pytest.mark.parametrize(('arguments', 'message'), [
    (['prefix=my_'], r"'prefix=my_' is not of the form name:=value"),
    ([':=1'], 'name:=value')])
def test_malformed_arguments_are_named(arm, arguments, message):
    with pytest.raises(PlannerError, match=message):
        urdf_in(arm, arguments)


def test_what_xacro_refuses_is_said(arm):
    arm.write_text(arm.read_text().replace('$(arg prefix)', '$(arg nothing)'))
    with pytest.raises(PlannerError, match=r'xacro cannot expand .*nothing') as error:
        urdf_in(arm)
    assert str(error.value).endswith("; arguments that it takes besides: 'prefix'")
    with pytest.raises(PlannerError) as error:
        urdf_in(arm, ['prefix:=my_'])
    assert 'besides' not in str(error.value)


@pytest.mark.parametrize(('sourced', 'file', 'message'), [
    ('', '$(find nowhere)/arm.xacro',
     'it asks for a package, and no workspace is sourced (AMENT_PREFIX_PATH is not set)'),
    ('/opt/none', '$(find nowhere)/arm.xacro',
     "package 'nowhere' is not installed; source the workspace that has it"),
    ('', '/nowhere/arm.xacro', 'No such file or directory: /nowhere/arm.xacro')])
def test_what_is_not_there_is_said_once_and_plainly(tmp_path, monkeypatch, sourced, file, message):
    monkeypatch.setenv('AMENT_PREFIX_PATH', sourced)
    pytest.importorskip('ament_index_python')
    arm = tmp_path / 'arm.urdf.xacro'
    arm.write_text('<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
                   f'<xacro:include filename="{file}"/></robot>')
    with pytest.raises(PlannerError) as error:
        urdf_in(arm)
    assert str(error.value) == f"xacro cannot expand '{arm}': {message}"


def test_a_plain_urdf_stays_where_it_is_and_takes_no_arguments(tmp_path):
    plain = tmp_path / 'arm.urdf'
    plain.write_text(planar_urdf())
    assert expanded(str(plain), [], tmp_path / 'out') == str(plain)
    with pytest.raises(PlannerError, match='no xacro file'):
        expanded(str(plain), ['a:=b'], tmp_path)


def test_without_xacro_the_line_to_type_is_said(arm, monkeypatch):
    monkeypatch.setitem(sys.modules, 'xacro', None)
    with pytest.raises(PlannerError, match=r'install ros-jazzy-xacro.*`xacro .* a:=b > arm.urdf`'):
        urdf_in(arm, ['a:=b'])


def test_show_robot_expands_into_a_file_beside_its_picture(arm, tmp_path, capsys):
    out = tmp_path / 'out'
    out.mkdir()
    status = show_robot.main([
        '--urdf', str(arm), '--tip', 'my_link1', '--out', str(out / 'arm.png'), '--xacro-args',
        'prefix:=my_'])
    said = capsys.readouterr()
    assert '"my_link1"' in (out / 'arm.urdf').read_text(), said
    assert status == 0 or 'collision geometry' in said.err
