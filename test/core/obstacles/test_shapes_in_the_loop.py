"""An arm among boxes, cylinders, capsules and walls: it keeps clear, and keeps still."""

from __future__ import annotations

from closed_loop import drive, DT, random_obstacle, smallest_level
from conftest import PANDA_READY
import numpy as np
import pytest

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.workspace import walls
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner

METHODS = ['dynamic_factor', 'variational']


def clear_scene(robot, random, count, margin):
    """Obstacles of all shapes that rest, none nearer to the arm at its start than the margin."""
    arm, found = robot.kinematics(PANDA_READY), []
    radii = [capsule.radius + margin for capsule in robot.capsules]
    while len(found) < count:
        one = Scene.of([random_obstacle(random, f'o{len(found)}', -0.8, 1.0)])
        resting = Scene(one.names, one.shapes, one.centers, one.rotations, one.half_extents,
                        np.zeros((1, 3)), np.zeros((1, 3)))
        pairs = link_clearance(
            inflated_obstacles(resting, radii), arm.segment_start, arm.segment_end)
        if pairs.distance.min() > 0.0:
            found += resting.obstacles()
    return Scene.of(found)


def assert_within_limits(robot, postures, results):
    velocities = np.array([result.dq for result in results])
    changes = np.diff(velocities, axis=0, prepend=np.zeros((1, robot.n))) / DT
    assert (np.abs(velocities) <= robot.velocity_max + 1e-9).all()
    assert (np.abs(changes) <= robot.acceleration_max + 1e-6).all()
    assert (postures >= robot.position_min).all() and (postures <= robot.position_max).all()


@pytest.mark.first_alone
@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('seed', range(4))
def test_an_arm_that_is_sent_anywhere_touches_nothing(panda, method, seed):
    random = np.random.default_rng(seed)
    scene = clear_scene(panda, random, 8, 0.015)
    twists = random.normal(size=(3, 6)) * [0.2, 0.2, 0.2, 0.5, 0.5, 0.5]
    postures, results = drive(
        Planner(panda, PlannerParameters(method=method)), PANDA_READY,
        lambda t: twists[int(t)], scene, 3.0)
    assert smallest_level(panda, postures, scene) > 0.0
    assert_within_limits(panda, postures, results)


def reversals(robot, results):
    """How often a joint's acceleration changes its sign beyond a twentieth of its limit."""
    changes = np.diff([result.dq for result in results], axis=0) / DT
    signs = np.where(np.abs(changes) > 0.05 * robot.acceleration_max, np.sign(changes), 0.0)
    return sum(int((np.diff(column[column != 0.0]) != 0.0).sum()) for column in signs.T)


@pytest.mark.first_alone
@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('gap', [0.012, 0.03])
@pytest.mark.parametrize('sinking', [-0.05, -0.01, 0.0])
def test_a_hand_slides_along_a_table_without_chatter(panda, method, gap, sinking):
    """Its fingers are parallel to the table: any of their points may be the nearest."""
    arm, radius = panda.kinematics(PANDA_READY), panda.capsules[-1].radius
    top = min(arm.segment_start[-1, 2], arm.segment_end[-1, 2]) - radius - gap
    table = Obstacle.box('table', (0.75, 0.0, top - 0.05), (1.0, 2.0, 0.1))
    _, results = drive(
        Planner(panda, PlannerParameters(method=method)), PANDA_READY,
        np.array([0.0, 0.15, sinking, 0.0, 0.0, 0.3]), Scene.of([table]), 3.0)
    assert min(result.nearest.beyond_margin for result in results) > -1e-3
    assert reversals(panda, results) <= 20


def lowest(robot, postures, axis):
    """The smallest coordinate of any point of the moving links at each posture, and the largest.

    Both (k,).
    """
    arms = robot.kinematics_along(np.array(postures))
    ends = np.stack((arms.segment_start, arms.segment_end))[..., robot.moved, axis]
    radii = np.array([capsule.radius for capsule in robot.capsules])[robot.moved]
    return (ends - radii).min(axis=(0, 2)), (ends + radii).max(axis=(0, 2))


@pytest.mark.first_alone
@pytest.mark.parametrize(('axis', 'twist', 'box'), [
    (1, (0.0, 0.2, 0.0), (-2.0, -2.0, -2.0, 2.0, 0.25, 2.0)),
    (1, (0.0, -0.2, 0.0), (-2.0, -0.25, -2.0, 2.0, 2.0, 2.0)),
    (2, (0.0, 0.0, -0.2), (-2.0, -2.0, 0.1, 2.0, 2.0, 2.0)),
    (2, (0.0, 0.0, 0.2), (-2.0, -2.0, -2.0, 2.0, 2.0, 0.95)),
    (0, (0.2, 0.0, 0.0), (-2.0, -2.0, -2.0, 0.5, 2.0, 2.0)),
    (0, (-0.2, 0.0, 0.0), (-0.35, -2.0, -2.0, 2.0, 2.0, 2.0))])
def test_no_link_crosses_a_wall(panda, axis, twist, box):
    planner = Planner(panda, PlannerParameters())
    postures, results = drive(
        planner, PANDA_READY, np.array([*twist, 0.0, 0.0, 0.0]), Scene.of(walls(box)), 4.0)
    low, high = lowest(panda, postures, axis)
    assert low.min() >= box[axis] and high.max() <= box[axis + 3]
    # It gets near the wall, and says what holds it there.
    assert min(low.min() - box[axis], box[axis + 3] - high.max()) < 0.02
    assert any('workspace' in result.reason for result in results)
    assert_within_limits(panda, postures, results)
    # A wall is no obstacle that one wants to know the nearest of.
    assert results[-1].nearest is None and results[-1].clearance_index == np.inf


def test_a_link_beyond_a_wall_may_come_in_but_not_go_further_out(panda):
    low, _ = lowest(panda, [PANDA_READY], 1)
    wall = low[0] + 0.05
    scene = Scene.of(walls((-2.0, wall, -2.0, 2.0, 2.0, 2.0)))
    planner = Planner(panda, PlannerParameters())
    postures, _ = drive(planner, PANDA_READY, np.zeros(6), scene, 0.5)
    np.testing.assert_allclose(postures[-1], PANDA_READY, atol=1e-6)
    outwards, _ = drive(planner, PANDA_READY, np.array([0, -0.2, 0, 0, 0, 0.0]), scene, 2.0)
    assert lowest(panda, outwards, 1)[0].min() > low[0] - 1e-3
    planner.reset()
    inwards, _ = drive(planner, PANDA_READY, np.array([0, 0.2, 0, 0, 0, 0.0]), scene, 1.0)
    tip = [panda.kinematics(q).tip_position[1] for q in inwards]
    assert tip[-1] - tip[0] > 0.15


@pytest.mark.parametrize(('box', 'message'), [
    ((0.0, 1.0), 'has 2 entries; it takes 6'),
    ((0.0, 0.0, 1.0, 1.0, 1.0, 1.0), 'z_min 1.0 and z_max 1.0; z_min must be less')])
def test_a_workspace_that_is_no_box_is_refused(box, message):
    with pytest.raises(ParameterError, match=message):
        walls(box)


def test_no_walls_without_a_workspace():
    assert walls(()) == ()
