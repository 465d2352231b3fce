"""Targets in narrow places: less room on the way there, and out again without a push."""

from __future__ import annotations

from dataclasses import replace

from conftest import make_panda, PANDA_READY
import numpy as np
import pytest

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.target.progress import TargetState

PANDA, DT = make_panda(), 0.004
TIP = PANDA.kinematics(PANDA_READY).tips.first
TARGET = Pose(TIP.position + np.array([0.0, 0.0, -0.11]), TIP.rotation)
MARGIN = 0.01
NARROW = PlannerParameters(clearance_margin=MARGIN, target_margin=0.002)


def slot(gap):
    """Two walls that leave the hand, which is 102 mm thick, a gap [m]."""
    return Scene.of([
        Obstacle.box(name, TIP.position + np.array([side * (0.5 * gap + 0.05), 0.0, -0.19]),
                     (0.1, 0.3, 0.1)) for name, side in (('left', -1.0), ('right', 1.0))])


def distance(q, scene):
    """How far the links are from obstacles [m]."""
    arm = PANDA.kinematics(q)
    maps = inflated_obstacles(scene, [c.radius for c in PANDA.capsules], moved=PANDA.moved)
    return link_clearance(maps, arm.segment_start, arm.segment_end).distance.min()


def into(planner, scene, seconds=3.0):
    """Go to the target between the walls; return state, posture and smallest distance [m]."""
    q, nearest = PANDA_READY, np.inf
    for _ in range(round(seconds / DT)):
        result = planner.step(q, np.zeros(6), scene, DT, target=TARGET)
        planner.prepare(scene)
        q = q + DT * result.dq
        nearest = min(nearest, distance(q, scene))
        if result.progress.state is TargetState.REACHED:
            break
    return result.progress.state, q, nearest


@pytest.mark.parametrize('room', [0.003, 0.0065])
def test_a_target_may_have_less_room_than_other_motion(room):
    scene = slot(0.102 + 2.0 * room)
    state, _, nearest = into(Planner(PANDA, replace(NARROW, target_margin=-1.0)), scene)
    assert state is not TargetState.REACHED and nearest > MARGIN - 1e-4
    state, _, nearest = into(Planner(PANDA, NARROW), scene)
    assert state is TargetState.REACHED and 0.002 - 1e-4 < nearest < MARGIN


@pytest.mark.parametrize('resets', [False, True])
def test_the_arm_leaves_on_its_path_and_keeps_the_larger_margin_once_it_is_out(resets):
    planner, scene = Planner(PANDA, NARROW), slot(0.109)
    _, q, _ = into(planner, scene)
    if resets:  # as where an arm begins to move
        planner.reset()
    up, nearest = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]), distance(q, scene)
    for _ in range(400):
        result = planner.step(q, up, scene, DT)
        q = q + DT * result.dq
        now = distance(q, scene)
        assert np.abs(result.path_error[:3]).max() < 1e-4
        assert now > nearest - 1e-4
        # The margin grows once, where nothing is within it; where the arm begins it is its room.
        assert planner.margin < max(now, 0.003) + 1e-4
    assert planner.margin == MARGIN
    # Down again by a twist, the larger one holds.
    for _ in range(600):
        q = q + DT * planner.step(q, -up, scene, DT).dq
    assert planner.margin == MARGIN and distance(q, scene) > MARGIN - 1e-4


@pytest.mark.parametrize('room', [0.001, 0.01])
def test_an_arm_on_its_way_to_something_is_not_thrown_back(room):
    """Where a target ends as far away as the larger margin asks, at the smaller one's speed."""
    margin = 0.05
    planner = Planner(PANDA, PlannerParameters(clearance_margin=margin, target_margin=0.002,
                                               target_path='straight'))
    wall = Scene.of([Obstacle.box('wall', TIP.position + (0.45, 0.0, 0.0), (0.4, 2.0, 2.0))])
    target, q = Pose(TIP.position + np.array([0.22, 0.0, 0.0]), TIP.rotation), PANDA_READY
    while distance(q, wall) > margin + room:
        q = q + DT * planner.step(q, np.zeros(6), wall, DT, target=target).dq
    for _ in range(300):
        result = planner.step(q, np.zeros(6), wall, DT)
        q = q + DT * result.dq
        assert np.abs(result.path_error[:3]).max() < 1e-3
        assert result.stage not in (Stage.YIELDING, Stage.FORCED)
    assert distance(q, wall) > 0.002


def test_an_arm_that_had_no_target_comes_no_nearer_than_it_is():
    """It stands a hair within the larger margin, as noise may have it."""
    planner = Planner(PANDA, PlannerParameters(clearance_margin=0.05, target_margin=0.002))
    wall = Scene.of([Obstacle.box('wall', TIP.position + (0.45, 0.0, 0.0), (0.4, 2.0, 2.0))])
    q, towards = PANDA_READY, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    for i in range(1500):
        q = q + DT * planner.step(q, towards, wall, DT).dq
        if i == 900:
            q = q + 1e-5 * np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
            planner.reset()
        if i == 1200:
            planner.hold([])
    assert distance(q, wall) > 0.05 - 2e-4


def test_among_many_obstacles_the_larger_margin_comes_back_too():
    far = [Obstacle(f'{i}', np.array([2.5, 0.1 * i, 0.5]), np.full(3, 0.03)) for i in range(40)]
    planner = Planner(PANDA, PlannerParameters(clearance_margin=0.5, target_margin=0.1))
    planner.step(PANDA_READY, np.zeros(6), far, DT, target=TARGET)
    assert planner.margin == 0.1
    planner.step(PANDA_READY, np.zeros(6), far, DT)
    assert planner.margin == 0.5


@pytest.mark.parametrize('given, kept', [(-1.0, MARGIN), (0.005, 0.005), (0.05, MARGIN)])
def test_it_is_never_more_than_the_margin_of_other_motion(given, kept):
    planner = Planner(PANDA, replace(NARROW, target_margin=given))
    planner.step(PANDA_READY, np.zeros(6), [], DT, target=TARGET)
    assert planner.margin == kept
    planner.step(PANDA_READY, np.zeros(6), [], DT)
    assert planner.margin == MARGIN


def test_parameters_that_change_leave_an_arm_where_it_is_in_peace():
    planner, scene = Planner(PANDA, NARROW), slot(0.109)
    _, q, _ = into(planner, scene)
    planner.parameters = replace(NARROW, clearance_gain=4.0)
    result = planner.step(q, np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0]), scene, DT)
    assert planner.margin < MARGIN and not result.reason.startswith('the arm leaves')
