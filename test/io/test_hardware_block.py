"""ros2_control's block in a URDF."""

from __future__ import annotations

from xml.etree import ElementTree

from conftest import planar_urdf
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.io.hardware_block import with_hardware

BLOCK = """<!-- A comment. -->
<ros2_control name="mock" type="system"><hardware><plugin>mock_components/GenericSystem</plugin>
</hardware><joint name="joint1"><command_interface name="velocity"/></joint></ros2_control>"""


def test_the_urdf_gets_the_block_and_stays_as_it_was():
    urdf = planar_urdf()
    robot = ElementTree.fromstring(with_hardware(urdf, BLOCK))
    (block,) = robot.findall('ros2_control')
    assert block.findtext('hardware/plugin') == 'mock_components/GenericSystem'
    assert block.find('joint/command_interface').get('name') == 'velocity'
    robot.remove(block)
    assert ElementTree.canonicalize(ElementTree.tostring(robot)) == ElementTree.canonicalize(urdf)


@pytest.mark.parametrize('urdf, block, message', [
    (planar_urdf(), BLOCK.replace('joint1', 'shoulder'),
     "names the joint 'shoulder', which the URDF lacks; it has 'joint1'"),
    (planar_urdf(), BLOCK.replace('</joint>', ''), 'block is not well-formed XML'),
    (planar_urdf(), '<robot/>', 'must be <ros2_control>'),
    (with_hardware(planar_urdf(), BLOCK), BLOCK, 'has a <ros2_control> block already'),
    ('<robot', BLOCK, 'the URDF is not well-formed XML'),
])
def test_what_does_not_fit_is_refused_by_name(urdf, block, message):
    with pytest.raises(RobotError, match=message):
        with_hardware(urdf, block)
