"""Where an arm's base stands: its URDF below a frame that other things are given in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.robot.urdf import read_urdf
from redundant_planner.io.poses import pose_of

# What the joint between both is called, so that nothing is mounted twice.
_JOINT = 'mount_of_{}'


def mounted(urdf: str, frame: str, pose: Sequence[float]) -> str:
    """Return a URDF whose root link is fixed to a new one.

    Args:
        urdf: its text.
        frame: name of the new root; empty for none.
        pose: of the old root in it: x y z, and nothing, roll pitch yaw, or a quaternion x y z w
            [m, rad].

    Raises:
        ParameterError: the URDF has such a link, or the pose is none.
    """
    if not frame:
        return urdf
    place, turned = pose_of("parameter 'mount_pose'", pose if len(pose) else np.zeros(3))
    if not abs(np.linalg.norm(turned) - 1.0) < 0.01:
        raise ParameterError(f"parameter 'mount_pose' has the quaternion {turned.tolist()}; its "
                             'length must be 1')
    rpy = pin.rpy.matrixToRpy(pin.Quaternion(turned).normalized().toRotationMatrix())
    try:
        tree = ET.fromstring(urdf)
    except ET.ParseError:
        return urdf  # which whoever reads it refuses, and says why
    joint = _JOINT.format(frame)
    if tree.find(f"joint[@name='{joint}']") is not None:
        return urdf
    links = [link.get('name', '') for link in tree.findall('link')]
    children = {child.get('link') for child in tree.findall('joint/child')}
    if frame in links:
        raise ParameterError(f"parameter 'mount_frame' is '{frame}', a link of the URDF; use it "
                             'as base_frame, or name another one')
    ET.SubElement(tree, 'link', name=frame)
    for root in [link for link in links if link not in children]:
        added = ET.SubElement(tree, 'joint', name=joint, type='fixed')
        ET.SubElement(added, 'parent', link=frame)
        ET.SubElement(added, 'child', link=root)
        ET.SubElement(added, 'origin', xyz=_text(place), rpy=_text(rpy))
    return ET.tostring(tree, encoding='unicode')


def base_of(urdf: str, mount_frame: str, base_frame: str) -> str:
    """Return the link that commands, obstacles and poses refer to; empty for the root.

    Args:
        urdf: a text that went through `mounted`.
        mount_frame: where the arm stands; empty for nowhere.
        base_frame: the link asked for; empty for none.

    Raises:
        ParameterError: the link asked for is another one than the mounted one, which both
            parameters make the base then.
        RobotError: the URDF is none.
    """
    if not mount_frame:
        return base_frame
    described = read_urdf(urdf)
    before = described.joints_above(base_frame)
    stands_at = [joint.child for joint in before if joint.name == _JOINT.format(mount_frame)]
    # A parameter file of quick_start's names the root itself; others what lies at the same place.
    same = bool(stands_at) and all(
        joint.kind == 'fixed' and not any(joint.xyz + joint.rpy) for joint in before[1:])
    if base_frame not in ('', mount_frame) and not same:
        root = next((joint.child for joint in described.joints
                     if joint.parent == described.root), '')
        raise ParameterError(
            f"parameter 'base_frame' is '{base_frame}', and 'mount_frame' is '{mount_frame}', "
            f"where '{root}' stands at mount_pose: one of them can be the base. Leave base_frame "
            f"empty and give the pose of '{root}', or leave mount_frame empty")
    return mount_frame


def _text(numbers: Iterable[float]) -> str:
    return ' '.join(repr(float(number)) for number in numbers)
