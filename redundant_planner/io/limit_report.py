"""What is said of an arm's limits: each number with where it is from."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

from redundant_planner.core.parameters import is_number
from redundant_planner.core.robot.joint_limits import Sources
from redundant_planner.core.robot.model import Robot

_HEADS = ('position [rad, m]', 'velocity [per s]', 'acceleration [per s²]', 'jerk [per s³]')
# Numbers of a URDF are written with a few digits [rad, m].
_ROUND_OFF = 1e-6


def limit_lines(robot: Robot, sources: Sources) -> list[str]:
    """Return a table of an arm's limits in lines of text: a head, and one for each joint.

    Args:
        robot: the arm.
        sources: where its limits are from.
    """
    ranges = [f'{low:g}..{high:g}' if low > -math.inf or high < math.inf else 'endless'
              for low, high in zip(robot.position_min, robot.position_max)]
    numbers = (ranges, *([f'{limit:g}' for limit in limits] for limits in (
        robot.velocity_max, robot.acceleration_max, robot.jerk_max)))
    columns = [('joint', *robot.joint_names), *(
        (head, *(f'{number} {source}' for number, source in zip(column, where)))
        for head, column, where in zip(_HEADS, numbers, sources))]
    widths = [max(map(len, column)) for column in columns]
    return ['  '.join(word.ljust(width) for word, width in zip(row, widths)).rstrip()
            for row in zip(*columns)]


def narrower_soft_limits(robot: Robot) -> str:
    """Return a sentence about what the URDF's safety_controller narrows; empty where it does not.

    ros2_control's joint limiters heed it where they are switched on. Nothing in a URDF tells
    whether they are, so the planner does not.
    """
    soft = _soft_limits(robot.urdf)
    entries = []
    for name, low, high in zip(robot.joint_names, robot.position_min, robot.position_max):
        lower, upper = soft.get(name, (-math.inf, math.inf))
        if lower > low + _ROUND_OFF or upper < high - _ROUND_OFF:
            entries.append(f'{name}={max(lower, low):g}..{min(upper, high):g}')
    if not entries:
        return ''
    return ('the soft limits of the safety_controller in the URDF are narrower, and the planner '
            f'does not heed them; if the drives do: position_limits: {entries}')


def _soft_limits(urdf: str) -> dict[str, tuple[float, float]]:
    """Return joint name → lower and upper soft limit of a URDF, of the joints that have both."""
    found = {}
    for joint in ElementTree.fromstring(urdf).findall('joint'):
        controller = joint.find('safety_controller')
        if controller is None:
            continue
        ends = [controller.get(f'soft_{end}_limit', '') for end in ('lower', 'upper')]
        if all(map(is_number, ends)) and float(ends[0]) < float(ends[1]):
            found[joint.get('name', '')] = float(ends[0]), float(ends[1])
    return found
