"""Bodies with several tips, and an arm on a base: of example-robot-data, or of its Panda."""

from __future__ import annotations

import copy
import itertools
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from benchmark.example_arms import ROBOTS
from benchmark.robots import make_robot
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.model import Robot as Arm
from redundant_planner.io.robot_files import Robot

Array = npt.NDArray[np.float64]

BODIES = ('tiago_dual', 'baxter', 'lift', 'base')

# The lift: its stroke [m], how far from its middle the arms stand, and how fast it is
# [m/s, m/s²].
_STROKE, _APART, _LIFT_SPEED, _LIFT_ACCELERATION = 0.5, 0.3, 0.2, 0.5
# The base: how far it may go from where it starts [m], its limits [m/s, m/s²; rad/s, rad/s²], and
# how high the arm stands on it, and its radius [m].
_ROOM, _BASE_LIMITS, _HEIGHT, _RADIUS = 3.0, (0.5, 0.5, 1.0, 1.0), 0.35, 0.3
# How unwilling it is to move.
_WEIGHT = 30.0
# Acceleration limits that the URDFs of TIAGo and Baxter do not have [rad/s², m/s²].
_ACCELERATION = 5.0


def make_body(name: str) -> Robot:
    """Return one of `BODIES`, with six controlled axes for each tip."""
    if name == 'tiago_dual':
        return Robot.from_urdf(
            ROBOTS / 'tiago_description' / 'robots' / 'tiago_dual.urdf',
            tips=('arm_left_tool_link', 'arm_right_tool_link'), base_frame='base_link',
            acceleration_max=_ACCELERATION)
    if name == 'baxter':
        return Robot.from_urdf(
            ROBOTS / 'baxter_description' / 'urdf' / 'baxter.urdf',
            tips=('left_gripper', 'right_gripper'), base_frame='base',
            acceleration_max=_ACCELERATION)
    return _on_a_lift() if name == 'lift' else _on_a_base()


def arms_of(robot: Arm, start: Array) -> tuple[tuple[Arm, Array], tuple[Arm, Array]]:
    """Return both arms of a body with two tips by themselves, and which joints (n,) each has.

    What they share stays where it is at the start (n,).
    """
    moving = np.asarray(robot.chain.tip_supports > 0.0)
    shared = moving.all(axis=0)
    locked = {robot.joint_names[j]: float(start[j]) for j in np.flatnonzero(shared)}

    def arm(tip: int) -> tuple[Arm, Array]:
        own, others = moving[tip] & ~shared, moving[1 - tip] & ~shared
        without_other = (robot.supports[:, others] == 0.0).all(axis=1)
        return Arm(
            robot.urdf, robot.tips[tip], base_frame=robot.base_frame, locked_positions=locked,
            velocity_max=robot.velocity_max[own], acceleration_max=robot.acceleration_max[own],
            jerk_max=robot.jerk_max[own],
            capsules=list(itertools.compress(robot.capsules, without_other.tolist()))), own

    return arm(0), arm(1)


def _on_a_lift() -> Robot:
    """Return two Pandas side by side on one lift."""
    panda = make_robot('panda', 6)
    robot = ElementTree.Element('robot', name='pandas_on_a_lift')
    for link in ('world', 'lift'):
        ElementTree.SubElement(robot, 'link', name=link)
    _joint(robot, 'lift_joint', 'prismatic', 'world', 'lift', '0 0 1',
           (0.0, _STROKE, _LIFT_SPEED))
    for side, y in (('left', _APART), ('right', -_APART)):
        _add(robot, panda, f'{side}_', 'lift', (0.0, y, 0.0))
    capsules = [
        Capsule(f'{side}_{c.name}', f'{side}_{c.frame}', c.start, c.end, c.radius)
        for side in ('left', 'right') for c in panda.capsules]
    accelerations = [_LIFT_ACCELERATION, *2 * panda.acceleration_max.tolist()]
    return Robot(
        ElementTree.tostring(robot, encoding='unicode'),
        tips=[f'{side}_{panda.tip_frame}' for side in ('left', 'right')], capsules=capsules,
        acceleration_max=accelerations)


def _on_a_base() -> Robot:
    """Return a Panda on a holonomic base: two prismatic joints and one that turns."""
    panda = make_robot('panda', 6)
    robot = ElementTree.Element('robot', name='panda_on_a_base')
    for link in ('world', 'base_x_link', 'base_y_link', 'base'):
        ElementTree.SubElement(robot, 'link', name=link)
    linear, linear_acceleration, angular, angular_acceleration = _BASE_LIMITS
    room = -_ROOM, _ROOM, linear
    _joint(robot, 'base_x', 'prismatic', 'world', 'base_x_link', '1 0 0', room)
    _joint(robot, 'base_y', 'prismatic', 'base_x_link', 'base_y_link', '0 1 0', room)
    _joint(robot, 'base_yaw', 'revolute', 'base_y_link', 'base', '0 0 1',
           (-np.pi, np.pi, angular))
    _add(robot, panda, '', 'base', (0.0, 0.0, _HEIGHT))
    # Its body, as high as the arm's foot.
    middle = 0.5 * _HEIGHT
    capsules = [Capsule('base', 'base', (0.0, 0.0, middle), (0.0, 0.0, middle), _RADIUS),
                *panda.capsules]
    return Robot(
        ElementTree.tostring(robot, encoding='unicode'), panda.tip_frame, capsules=capsules,
        weights=[_WEIGHT] * 3 + [1.0] * panda.n,
        acceleration_max=[linear_acceleration, linear_acceleration, angular_acceleration,
                          *panda.acceleration_max.tolist()])


def _joint(
    robot: ElementTree.Element, name: str, kind: str, parent: str, child: str, axis: str,
    limits: tuple[float, float, float],
) -> None:
    """Add a joint with limits of position and velocity."""
    joint = ElementTree.SubElement(robot, 'joint', name=name, type=kind)
    ElementTree.SubElement(joint, 'parent', link=parent)
    ElementTree.SubElement(joint, 'child', link=child)
    ElementTree.SubElement(joint, 'axis', xyz=axis)
    low, high, velocity = map(str, limits)
    ElementTree.SubElement(
        joint, 'limit', lower=low, upper=high, velocity=velocity, effort='1000')


def _add(
    robot: ElementTree.Element, arm: Arm, prefix: str, parent: str,
    place: tuple[float, float, float],
) -> None:
    """Add an arm's links and joints, with a prefix to their names, on a link of the robot's."""
    for element in ElementTree.fromstring(arm.urdf):
        if element.tag not in ('link', 'joint'):
            continue
        element = copy.deepcopy(element)
        element.set('name', prefix + str(element.get('name')))
        for tag, key in (('parent', 'link'), ('child', 'link'), ('mimic', 'joint')):
            for end in element.findall(tag):
                end.set(key, prefix + str(end.get(key)))
        robot.append(element)
    foot = ElementTree.SubElement(robot, 'joint', name=f'{prefix}foot', type='fixed')
    ElementTree.SubElement(foot, 'parent', link=parent)
    ElementTree.SubElement(foot, 'child', link=prefix + arm.base_frame)
    ElementTree.SubElement(foot, 'origin', xyz=' '.join(map(str, place)))
