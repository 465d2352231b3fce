"""An arm that a singularity holds says which way leads out, and that way does."""

from __future__ import annotations

import re

from conftest import EXAMPLE_ROBOTS, make_panda, make_planar, planar_urdf
import numpy as np
import pytest

from redundant_planner.core.constants import limits_of, robot_constants
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety import way_out as module
from redundant_planner.core.safety.way_out import LastWayOut, way_out
from redundant_planner.core.target.progress import TargetState
from redundant_planner.simulation import simulate
from redundant_planner.tools.asked_goal import target_of

DEFAULTS = PlannerParameters()
MARGIN = DEFAULTS.singularity_margin
UR = EXAMPLE_ROBOTS / 'ur_description' / 'urdf'


def make_ur(name):
    return Robot((UR / f'{name}_robot.urdf').read_text(), 'tool0', link_radius=0.02)


def at_zero(robot):
    """As near to it as the planner lets joints go."""
    high, low = limits_of(robot, DEFAULTS).positions
    return np.clip(np.zeros(robot.n), low, high)


def found_at(robot, q):
    return way_out(robot, q, robot_constants(robot, DEFAULTS), limits_of(robot, DEFAULTS), MARGIN)


def smallest(robot, q):
    return np.linalg.svd(robot.kinematics(q).jacobian, compute_uv=False)[-1]


def test_a_stretched_planar_arm_bends_its_elbow():
    """Two joints turn the same point either way: either direction is fine."""
    robot = make_planar()
    found = found_at(robot, np.zeros(robot.n))
    assert {name for name, _ in found.joints} <= {'joint2', 'joint3'}
    assert found.position[0] < 0.0, 'the tip comes nearer'
    assert re.fullmatch(
        r"(in|de)crease joint 'joint\d'( and (in|de)crease joint 'joint\d')? to get out: "
        r'go_to --relative --position -\d\.\d\d -?\d\.\d\d 0\.00 --rpy 0\.00 0\.00 -?\d\.\d\d',
        str(found))


def test_an_arm_of_one_joint_has_no_second_one_to_move():
    robot = Robot(planar_urdf(('revolute',), (0.05,)), 'tip', axes=('vx',), link_radius=0.0)
    found = found_at(robot, np.zeros(1))
    assert [name for name, _ in found.joints] == ['joint1']


def test_a_regular_posture_needs_no_way_out():
    assert found_at(make_panda(), np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])) is None


@pytest.mark.first_alone
@pytest.mark.parametrize('make', [
    make_panda, lambda: make_ur('ur3'), lambda: make_ur('ur5'), lambda: make_ur('ur10')],
    ids=['panda', 'ur3', 'ur5', 'ur10'])
def test_the_command_that_it_names_leads_out(make):
    robot, twist = make(), np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    planner, q = Planner(robot, DEFAULTS), at_zero(make())
    stuck = simulate(planner, q, twist, Scene.of([]), 0.2, 0.004).results[-1]
    assert stuck.scale < 0.1
    words = re.search(r'(?:near a singularity|singular posture) \((.*?): go_to --relative '
                      r'--position (.*?) --rpy (.*?)\)', stuck.reason)
    assert words is not None, stuck.reason
    names = re.findall(r"crease joint '(.*?)'", words.group(1))
    assert names and set(names) <= set(robot.joint_names)

    arm = robot.kinematics(q)
    position, rpy = ([float(n) for n in words.group(i).split()] for i in (2, 3))
    target = target_of(Pose(arm.tip_position, arm.tip_rotation), position, rpy, True)
    motion = simulate(planner, q, np.zeros(6), Scene.of([]), 5.0, 0.004, target=target)
    assert motion.results[-1].progress.state is TargetState.REACHED
    end = motion.positions[-1]
    assert smallest(robot, end) > max(1.2 * smallest(robot, q), 0.02)


def test_it_is_looked_for_once_where_the_arm_stands(monkeypatch):
    robot, calls = make_panda(), []
    monkeypatch.setattr(module, 'way_out', lambda robot, q, *rest: calls.append(q))
    last = LastWayOut(robot, robot_constants(robot, DEFAULTS), limits_of(robot, DEFAULTS), MARGIN)
    q = at_zero(robot)
    for _ in range(100):
        last.words(q)
    last.words(q + 0.01)
    assert len(calls) == 1
    last.words(q + 0.5)
    assert len(calls) == 2, 'elsewhere'
    last.forget()
    last.words(q + 0.5)
    assert len(calls) == 3
