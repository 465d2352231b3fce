"""An arm on a holonomic base: its URDF with three more joints, and twists of the base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math
import xml.etree.ElementTree as ET

import numpy as np
import numpy.typing as npt

from redundant_planner.core.errors import ParameterError
from redundant_planner.io.parameter_files import RobotParameters

Array = npt.NDArray[np.float64]

# The joints of a base, from where odometry counts to what it carries, and that frame.
BASE_JOINTS = ('base_x', 'base_y', 'base_yaw')
ODOM = 'odom'
# The output with the base's twist, and the topic that says where it is.
BASE_CMD_VEL = 'base_cmd_vel'
_LINKS = ('base_x_link', 'base_y_link')
# Jerk limits of a base, as a multiple of its acceleration limits [1/s].
_JERK = 20.0


def on_base(urdf: str, parameters: RobotParameters) -> str:
    """Return a URDF whose root link stands on a base that moves in the plane, if there is one.

    Raises:
        ParameterError: the URDF has such links or joints already.
    """
    if not parameters.base:
        return urdf
    try:
        tree = ET.fromstring(urdf)
    except ET.ParseError:
        return urdf  # which whoever reads it refuses, and says why
    joints = {joint.get('name', '') for joint in tree.findall('joint')}
    if joints.issuperset(BASE_JOINTS):
        return urdf
    links = [link.get('name', '') for link in tree.findall('link')]
    taken = sorted({*links, *joints} & {ODOM, *_LINKS, *BASE_JOINTS})
    if taken:
        raise ParameterError(f"parameter 'base' is '{parameters.base}', which adds links and "
                             f'joints of the names {taken} to the URDF; it has them already')
    children = {child.get('link') for child in tree.findall('joint/child')}
    roots = [link for link in links if link not in children]
    for link in (ODOM, *_LINKS):
        ET.SubElement(tree, 'link', name=link)
    speed, turning = parameters.base_speed
    acceleration, turning_acceleration = parameters.base_acceleration
    room = parameters.base_room
    linear = {'lower': -room, 'upper': room, 'velocity': speed, 'acceleration': acceleration}
    angular = {'velocity': turning, 'acceleration': turning_acceleration}
    for name, kind, parent, child, axis, limit in (
            ('base_x', 'prismatic', ODOM, _LINKS[0], '1 0 0', linear),
            ('base_y', 'prismatic', *_LINKS, '0 1 0', linear),
            *(('base_yaw', 'continuous', _LINKS[1], root, '0 0 1', angular) for root in roots)):
        joint = ET.SubElement(tree, 'joint', name=name, type=kind)
        ET.SubElement(joint, 'parent', link=parent)
        ET.SubElement(joint, 'child', link=child)
        ET.SubElement(joint, 'axis', xyz=axis)
        ET.SubElement(joint, 'limit', {
            'effort': '0', **{key: repr(float(value)) for key, value in limit.items()}})
    return ET.tostring(tree, encoding='unicode')


def limits_with_base(
    of_arm: Mapping[str, tuple[float, ...]], parameters: RobotParameters, count: int,
) -> dict[str, tuple[float, ...]]:
    """Return the limits of all joints by name, and their weights.

    Args:
        of_arm: name → limits of the arm's joints, see `with_base`: 'velocity_max',
            'acceleration_max' and 'jerk_max'.
        parameters: of the base.
        count: joints, the base's three included.
    """
    speed, turning = parameters.base_speed
    acceleration, turning_acceleration = parameters.base_acceleration
    accelerations = (acceleration, acceleration, turning_acceleration)
    of_base = {'velocity_max': (speed, speed, turning), 'acceleration_max': accelerations,
               'jerk_max': tuple(_JERK * value for value in accelerations)}
    limits = {name: with_base(values, of_base[name], count) if values else ()
              for name, values in of_arm.items()}
    return {**limits, 'weights': with_base((1.0,), (parameters.base_weight,) * 3, count)}


def with_base(values: Sequence[float], of_base: Sequence[float], count: int) -> tuple[float, ...]:
    """Return a limit of each of `count` joints, of which the base's come first.

    Args:
        values: of the arm's joints, one for all, or of all joints; none for the URDF's.
        of_base: of the base's.
        count: joints.
    """
    arm = count - len(of_base)
    if len(values) == 1:
        values = tuple(values) * arm
    return (*of_base, *values) if len(values) == arm else tuple(values)


def world_rates(twist: Array, yaw: float) -> Array:
    """Return the rates (3,) of the base's joints for a twist (vx, vy, ωz) in its own axes.

    Args:
        twist: (3,) [m/s, rad/s].
        yaw: of the base [rad].
    """
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array((c * twist[0] - s * twist[1], s * twist[0] + c * twist[1], twist[2]))


def own_twist(rates: Array, yaw: float) -> Array:
    """Return the base's twist (vx, vy, ωz) in its own axes for rates (3,) of its joints."""
    return world_rates(rates, -yaw)
