"""Machine code writes and reads within its arrays: it has no bounds checks of its own."""

from __future__ import annotations

from closed_loop import drive, DT, NOTHING
from conftest import EXAMPLE_ROBOTS, make_panda, make_planar, PANDA_READY, planar_urdf
import numpy as np
import pytest

from redundant_planner.core import planner as planner_module
from redundant_planner.core.errors import ObstacleError, StateError
from redundant_planner.core.horizon.least_norm_path import step_to_pose
from redundant_planner.core.obstacles.near_pairs import MOST_ACTING
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import MOST_VIEWS
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.null_space import orthogonal_factors
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety.barriers import room_for_rows
from redundant_planner.io.robot_files import Robot


def arm_of(joints, **options):
    kinds = ('revolute',) * joints
    return Robot(planar_urdf(kinds, (0.3,) * joints), 'tip', **{'link_radius': 0.02, **options})


def test_a_tick_has_room_for_every_row_that_it_may_write(monkeypatch):
    """Crowds, with links near each other and the arm fast: two rows for each pair of links."""
    robot = make_panda()
    things = [Obstacle(f'ball{i}', (0.1 * np.cos(i), 0.1 * np.sin(i), 0.05 + 0.02 * i), [0.03] * 3)
              for i in range(40)]
    random, used = np.random.default_rng(1), []
    wish = planner_module.wish

    def counted(*arguments):
        found = wish(*arguments)
        used.append(found.rows_used)
        return found

    monkeypatch.setattr(planner_module, 'wish', counted)
    planner = Planner(robot, PlannerParameters(clearance_self_margin=1.0))
    planner.hold(things)
    pairs = len(planner.robot.self_pairs)
    for _ in range(10):
        planner.reset()
        start = random.uniform(0.8 * robot.position_min, 0.8 * robot.position_max)
        drive(planner, start, random.uniform(-1.0, 1.0, 6), seconds=0.2, dt=0.01)
    room = len(room_for_rows(planner._constants).gradient)
    assert pairs < max(used) <= room
    assert room >= MOST_ACTING + MOST_VIEWS * pairs


def test_a_tick_that_has_too_many_rows_says_so_before_it_writes_one():
    robot = make_panda()
    planner = Planner(robot, PlannerParameters(clearance_self_margin=1.0))
    setup = planner._setup.value
    assert setup.rows.gradient.base is not None  # a view of what crosses over
    small = planner._constants._replace(self_pairs=planner._constants.self_pairs[:0])
    planner._setup = planner_module.Packed.of(setup._replace(rows=room_for_rows(small)._replace(
        gradient=np.empty((3, robot.n)), terms=np.empty((3, 3)),
        about=np.empty((3, 3), np.intp))))
    with pytest.raises(IndexError, match='more barriers than room_for_rows has room for'):
        planner.step(PANDA_READY, np.zeros(6), NOTHING, DT)


@pytest.mark.parametrize('n', range(1, 9))
@pytest.mark.parametrize('m', range(1, 7))
def test_factors_and_steps_fit_arms_of_any_number_of_joints(m, n):
    jacobian = np.random.default_rng(10 * m + n).normal(size=(m, n))
    error, damping = np.arange(1.0, m + 1.0), 1e-3
    orthogonal, upper = orthogonal_factors(jacobian)
    np.testing.assert_allclose(orthogonal @ orthogonal.T, np.eye(n), atol=1e-12)
    rows = min(m, n)
    np.testing.assert_allclose(orthogonal[:, :rows] @ upper[:rows], jacobian.T, atol=1e-12)
    assert not upper[rows:].any()
    np.testing.assert_allclose(
        step_to_pose(orthogonal, upper, error, damping),
        jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(m), error),
        atol=1e-9)


@pytest.mark.parametrize('joints', [1, 2, 3, 5])
@pytest.mark.parametrize('path', ['free', 'straight'])
def test_arms_with_fewer_joints_than_axes_do_not_leave_a_pose_that_they_reach(joints, path):
    robot = arm_of(joints)
    start, goal = np.full(joints, 0.2), np.full(joints, 0.5)
    there = robot.kinematics(goal)
    target = Pose(there.tip_position, there.tip_rotation)
    planner, q, off = Planner(robot, PlannerParameters(target_path=path)), start, []
    for _ in range(300):
        q = q + DT * planner.step(q, np.zeros(6), NOTHING, DT, target=target).dq
        off.append(np.linalg.norm(robot.kinematics(q).tip_position - there.tip_position))
    assert off[-1] <= off[0] + 1e-9


def test_an_arm_without_capsules_moves_among_obstacles_that_move():
    robot = make_planar(capsules=[])
    assert not robot.capsules
    ball = Obstacle('ball', (0.5, 0.5, 0.0), [0.1] * 3, velocity=(0.1, 0.0, 0.0))
    postures, _ = drive(Planner(robot, PlannerParameters()), (0.3, 0.6, 0.4),
                        np.array([0.0, 0.1, 0, 0, 0, 0]), Scene.of([ball]), 0.4)
    assert np.abs(postures[-1] - postures[0]).max() > 0.01


@pytest.mark.parametrize('shape', [(40, 6), (3, 6), (0, 6), (12, 3)])
def test_twists_ahead_of_another_number_are_refused(shape):
    planner = Planner(make_panda(), PlannerParameters(method='variational'))
    with pytest.raises(StateError, match='ahead returned twists of shape'):
        planner.step(PANDA_READY, np.zeros(6), NOTHING, DT, lambda times: np.zeros(shape))


@pytest.mark.parametrize('columns', [4, 10])
def test_postures_of_another_number_of_joints_are_refused(columns):
    with pytest.raises(StateError, match=rf'shape \(5, {columns}\); the chain takes \(N, 7\)'):
        make_panda().kinematics_along(np.zeros((5, columns)))


def test_scenes_of_unequal_arrays_are_refused():
    scene = Scene.of([Obstacle('a', (1, 0, 0), [0.1] * 3), Obstacle('b', (2, 0, 0), [0.1] * 3)])
    parts = {name: getattr(scene, name) for name in scene.__dataclass_fields__}
    for name in list(parts)[1:]:
        with pytest.raises(ObstacleError, match='a scene of 2 names has'):
            Scene(**{**parts, name: parts[name][:1]})


@pytest.mark.parametrize('size', [1e6 * 1.01, 1e9, 1e154, 1e308])
@pytest.mark.parametrize('target', [False, True])
def test_numbers_without_end_are_refused_and_leave_the_planner_as_it_was(size, target):
    planner = Planner(make_panda(), PlannerParameters())
    before = planner.step(PANDA_READY, np.full(6, 0.1), NOTHING, DT)
    far = np.array(PANDA_READY)
    far[1] = -size
    with pytest.raises(StateError, match=r"joint 'panda_joint2' is -.* no joint is further"):
        planner.step(far, np.zeros(6), NOTHING, DT, target=PANDA_READY if target else None)
    with pytest.raises(StateError, match='position of the pose'):
        planner.step(PANDA_READY, np.zeros(6), NOTHING, DT,
                     target=Pose(np.full(3, size), np.eye(3)))
    for dt in (size, 1e-5, np.nan):
        with pytest.raises(StateError, match='dt is'):
            planner.step(PANDA_READY, np.zeros(6), NOTHING, dt)
        with pytest.raises(StateError, match='dt is'):
            planner.braked(np.zeros(7), dt)
    for dq in (np.full(7, np.nan), np.zeros(1), np.zeros(8)):
        with pytest.raises(StateError, match=r'dq is .* it takes 7 finite numbers'):
            planner.braked(dq, DT)
    after = planner.step(PANDA_READY + DT * before.dq, np.full(6, 0.1), NOTHING, DT)
    assert np.isfinite(after.dq).all() and after.dq.any()


def test_an_arm_that_is_found_far_away_plans_its_way_as_fast_as_any():
    robot = Robot.from_urdf(EXAMPLE_ROBOTS / 'kinova_description' / 'robots' / 'kinova.urdf',
                            'j2s6s200_end_effector')
    planner = Planner(robot, PlannerParameters())
    q = np.array([900.0, 2.0, 2.0, 0.5, 0.5, 9e5])
    result = planner.step(q, np.zeros(6), NOTHING, DT, target=q + 0.1)
    assert np.isfinite(result.dq).all()
