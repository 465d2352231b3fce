"""ros2_control's part of a URDF: which hardware drives the joints, by which interfaces."""

from __future__ import annotations

from xml.etree import ElementTree

from redundant_planner.core.errors import known, RobotError
from redundant_planner.core.robot.urdf import read_urdf


def with_hardware(urdf: str, block: str) -> str:
    """Return a URDF with a <ros2_control> block.

    Args:
        urdf: the URDF's text, without such a block.
        block: the block's text.

    Raises:
        RobotError: one of the two is malformed, the URDF has a block already, or the block names a
            joint that the URDF lacks.
    """
    joints = [joint.name for joint in read_urdf(urdf).joints]
    robot = ElementTree.fromstring(urdf)
    if robot.find('ros2_control') is not None:
        raise RobotError('the URDF has a <ros2_control> block already; start its own controller '
                         'manager instead (docs/ros2_control.md)')
    try:
        hardware = ElementTree.fromstring(block)
    except ElementTree.ParseError as error:
        raise RobotError(f'the <ros2_control> block is not well-formed XML: {error}') from None
    if hardware.tag != 'ros2_control':
        raise RobotError(f"the block's outermost element is <{hardware.tag}>; it must be "
                         '<ros2_control>')
    for element in hardware.findall('joint'):
        name = element.get('name', '')
        if name not in joints:
            raise RobotError(f"the <ros2_control> block names the joint '{name}', which the URDF "
                             f'lacks; it has {known(joints)}')
    robot.append(hardware)
    return ElementTree.tostring(robot, encoding='unicode')
