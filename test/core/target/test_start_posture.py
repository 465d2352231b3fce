"""Every arm of example-robot-data moves from the posture that is proposed, and others do too."""

from __future__ import annotations

import functools

from conftest import make_paper_arm, PANDA_URDF, planar_urdf, random_postures
import numpy as np
import pytest

from benchmark.example_arms import arms, load_arm, ROBOTS
from redundant_planner.core.constants import robot_constants
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.target.start_posture import start_posture
from redundant_planner.simulation import simulate

ARMS = {path.stem: path for path, _ in arms()}
DEFAULTS = PlannerParameters()
SPEED, DT = 0.05, 0.004


@functools.cache
def arm_named(name: str) -> Robot:
    return load_arm(ARMS[name])


def manipulability(robot, q):
    return np.linalg.svd(robot.kinematics(q).jacobian, compute_uv=False).prod()


def room(robot, q):
    """Between links that can collide, margin taken off [m]."""
    arm, constants = robot.kinematics(q), robot_constants(robot, DEFAULTS)
    return link_distances(arm.segment_start, arm.segment_end, constants.radii,
                          constants.self_pairs).distance.min(initial=np.inf)


def share_of_speed(robot, q, axis):
    """Of a commanded speed along an axis, once the arm has sped up."""
    twist = np.zeros(6)
    twist[axis] = SPEED
    motion = simulate(Planner(robot, DEFAULTS), q, twist, Scene.of([]), 0.4, DT)
    ahead = [robot.kinematics(motion.positions[i]).tip_position[axis] for i in (-26, -1)]
    return (ahead[1] - ahead[0]) / (25 * DT * SPEED)


def test_all_arms_with_six_or_seven_joints_are_tried():
    assert len(ARMS) >= 19 and {'panda', 'ur5_robot', 'xarm7', 'kinova', 'z1'} <= set(ARMS)


@pytest.mark.first_alone
@pytest.mark.parametrize('name', ARMS)
def test_the_arm_moves_from_its_start_in_every_direction(name):
    robot = arm_named(name)
    q = start_posture(robot)
    span = robot.position_max - robot.position_min
    limited = np.isfinite(span)
    to_limit = np.minimum(q - robot.position_min, robot.position_max - q)
    assert (to_limit[limited] >= 0.15 * span[limited]).all(), 'away from limits'
    assert (np.abs(q[~limited]) <= np.pi).all()
    assert room(robot, q) >= 0.004, 'links have room beyond their margin'
    best = max(manipulability(robot, other) for other in random_postures(robot, 300))
    assert manipulability(robot, q) >= 0.5 * best
    tip = robot.kinematics(q).tip_position
    assert tip[2] > 0.0, 'above the base plane'
    for axis in range(3):
        assert share_of_speed(robot, q, axis) >= 0.9, AXES[axis]


def test_an_arm_below_a_drone_hangs_and_moves_in_every_direction():
    """Above its base it would stand within the rotors. With five joints it controls positions."""
    robot = load_arm(next(ROBOTS.rglob('hextilt_flying_arm_5.urdf')))
    assert robot.axes == ('vx', 'vy', 'vz')
    q = start_posture(robot)
    assert room(robot, q) > 0.0 and robot.kinematics(q).tip_position[2] < -0.2
    for axis in range(3):
        assert share_of_speed(robot, q, axis) >= 0.9, AXES[axis]


def test_an_arm_on_a_slow_lift_moves_in_every_direction():
    """Its lift alone makes 0.035 m/s; the arm on it must not be singular."""
    robot = load_arm(next(ROBOTS.rglob('tiago_pro.urdf')))
    q = start_posture(robot)
    assert robot.velocity_max[0] < SPEED
    assert np.linalg.svd(robot.kinematics(q).jacobian[:, 1:], compute_uv=False)[-1] > 0.1
    for axis in range(3):
        assert share_of_speed(robot, q, axis) >= 0.9, AXES[axis]


def test_the_same_arm_gets_the_same_posture():
    one = Robot(PANDA_URDF.read_text(), 'panda_hand', link_radius=0.05)
    other = Robot(PANDA_URDF.read_text(), 'panda_hand', link_radius=0.05)
    np.testing.assert_array_equal(start_posture(one), start_posture(other))


def rail(joint='<limit lower="-2" upper="2" velocity="1" effort="1"/>', kind='prismatic'):
    """A Panda on a rail along y."""
    text = PANDA_URDF.read_text()
    return text.replace('<link name="panda_link0">', (
        '<link name="world"/><link name="carriage"/>'
        f'<joint name="rail" type="{kind}"><parent link="world"/><child link="carriage"/>'
        f'<axis xyz="0 1 0"/>{joint}</joint><joint name="mount" type="fixed">'
        '<parent link="carriage"/><child link="panda_link0"/></joint>'
        '<link name="panda_link0">'), 1)


@pytest.mark.parametrize('robot', [
    Robot(rail(), 'panda_hand', link_radius=0.05),
    make_paper_arm(),
    Robot(planar_urdf(('continuous',) * 3), 'tip', axes=('vx', 'vy'), link_radius=0.0)],
    ids=['a Panda on a rail', 'two prismatic joints', 'joints without limits'])
def test_other_kinds_of_arms_move_as_well(robot):
    q = start_posture(robot)
    assert (q >= robot.position_min).all() and (q <= robot.position_max).all()
    assert np.isfinite(q).all() and room(robot, q) > 0.0
    for axis in robot.rows[robot.rows < 3]:
        assert share_of_speed(robot, q, axis) >= 0.9, AXES[axis]


def test_a_wider_margin_between_links_leaves_more_room():
    robot = arm_named('panda')
    q = start_posture(robot, PlannerParameters(clearance_self_margin=0.05))
    assert room(robot, q) > 0.045, 'beyond 5 mm'
