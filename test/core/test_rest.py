"""An arm that something stops comes to rest, and stays there while the command goes on."""

from __future__ import annotations

from dataclasses import replace
import functools

from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

from benchmark.edges import Arm, driven, Rest, rest_of, start_of, summarise, VARIANTS
from benchmark.example_arms import arms, load_arm
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner

URDFS = {path.stem: path for path, _ in arms()}
DT = 0.004


@functools.cache
def arm_named(name: str) -> Arm:
    return Arm(load_arm(URDFS[name]))


@functools.cache
def end_of(name, number, way, variant):
    """Return how the arm ended that was commanded `way` ('+vx') from a posture of seed 1."""
    arm, twist = arm_named(name), np.zeros(6)
    axis = AXES.index(way[1:])
    twist[axis] = float(way[0] + '1') * (0.25 if axis < 3 else 1.0)
    motion = driven(
        arm.robot, VARIANTS[variant], start_of(arm, 1, number), twist, DT)
    return rest_of(arm, motion, DT)


# Each shook or crept on before: the null space swung about the posture of the largest singular
# value, followed paths that led nowhere, or the tip swung about the place where its slide ends.
@pytest.mark.first_alone
@pytest.mark.parametrize('name, number, way, variant', [
    ('xarm7', 0, '-wx', 'dynamic_factor'), ('xarm7', 0, '-wx', 'variational'),
    ('panda', 0, '-vz', 'variational'), ('panda', 0, '+wz', 'variational'),
    ('xarm7', 0, '+vz', 'dynamic_factor'), ('so101', 0, '-vz', 'slide')])
def test_an_arm_that_cannot_go_on_is_at_rest(name, number, way, variant):
    end = end_of(name, number, way, variant)
    assert end.stopped and not end.restless
    assert end.reversals <= 4
    assert end.violation == 0.0
    assert end.clearance > -1e-6


# With all of the braking there is, joints would end their ways one after the other.
@pytest.mark.parametrize('name, way, angle', [
    ('ur5_robot', '+wy', 3.0), ('baxter', '+wy', 2.9), ('baxter', '-wz', 2.1)])
def test_a_slide_that_goes_on_is_smooth(name, way, angle):
    end = end_of(name, 0, way, 'slide')
    assert not end.stopped and end.tip_angle > angle
    assert end.reversals <= 7
    assert end.violation == 0.0


def test_what_counts_of_arms_that_were_stopped_and_of_others():
    rest = Rest(True, 3, 1e-4, 1e-4, 0.01, 0.0, 0.02, '')
    creeping = replace(rest, travel=0.1, clearance=0.01)
    turning = replace(rest, stopped=False, reversals=50, tip_angle=2.0, travel=2.0)
    assert creeping.restless and not rest.restless and not turning.restless
    found = summarise([rest, creeping, turning])
    assert (found['runs'], found['restless'], found['stopped']) == (3, 1, 2)
    assert (found['reversals_max'], found['reversals_max_stopped']) == (50, 3)
    assert found['closest_mm'] == 10.0


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_an_arm_at_rest_moves_as_soon_as_it_can(method):
    """A ball stops it for 4 s; without the ball it has its speed back in half a second."""
    robot, twist = make_panda(), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    planner, q = Planner(robot, PlannerParameters(method=method)), np.array(PANDA_READY)
    tip = robot.kinematics(q).tip_position
    blocked = Scene.of([Obstacle('ball', tip + [0.25, 0.0, 0.0], [0.08] * 3)])
    scales = []
    for i in range(1125):
        result = planner.step(q, twist, blocked if i < 1000 else Scene.of([]), DT)
        q = q + DT * result.dq
        scales.append(result.scale)
    assert scales[999] < 0.01 and np.abs(result.dq).max() > 0.01
    assert scales[-1] > 0.99
