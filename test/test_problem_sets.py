"""Problem sets: files are read or refused by name, made problems are free, and runs are judged."""

from __future__ import annotations

from itertools import pairwise
import json
from pathlib import Path
import sys

from conftest import make_panda, PANDA_READY
import numpy as np
import pinocchio as pin
import pytest
import yaml

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.obstacles.self_collision import link_distances
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.se3 import pose_error

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark.bodies import capsules_of
from benchmark.free_way import FreeWay
from benchmark.problem_sets.__main__ import main, run
from benchmark.problem_sets.explanation import line_blocked
from benchmark.problem_sets.families import FAMILIES
from benchmark.problem_sets.generated import generate, posture_at
from benchmark.problem_sets.moveit_files import find_files, ProblemFileError, read_problem
from benchmark.problem_sets.problem import fault_of, Problem, settled, tip_pose
from benchmark.problem_sets.servo import planner_step, servo, servo_twist, there_and_back
from benchmark.problem_sets.workers import Task
from benchmark.robots import make_robot

MARGINS = PlannerParameters()
JOINTS = [f'panda_joint{i}' for i in range(1, 8)]
GOAL = [0.4, -0.5, 0.1, -2.2, 0.1, 1.8, 0.9]

# Numbers like 5e-1 are text to YAML, poses lists or mappings, and quaternions of any length.
SCENE = """
name: kitchen
robot_model_name: panda
fixed_frame_transforms:
  - child_frame_id: world
    transform: {translation: [0, 0, 0], rotation: [0, 0, 0, 1]}
world:
  collision_objects:
    - id: table
      primitives: [{type: box, dimensions: [0.6, 1.0, 0.04]}]
      primitive_poses:
        - {position: [0.7, 0.0, 5e-2], orientation: [0, 0, 0, 1]}
    - id: jar
      pose: {position: {x: 0.1, y: 0.2, z: 0.3}, orientation: {x: 0, y: 0, z: 1, w: 1}}
      primitives:
        - {type: cylinder, dimensions: [0.2, 0.04]}
        - {type: sphere, dimensions: [0.05]}
      primitive_poses:
        - {position: [0.5, 0, 0], orientation: [0, 0, 0, 2]}
        - {position: [0.5, 0, 0.12], orientation: [0, 0, 0, 1]}
"""


def request_of(goal):
    return yaml.safe_dump({
        'group_name': 'panda_arm',
        'start_state': {'joint_state': {
            'name': ['panda_finger_joint1', *reversed(JOINTS)],
            'position': [0.04, *reversed(PANDA_READY.tolist())]}},
        'goal_constraints': [{'joint_constraints': [
            {'joint_name': name, 'position': value} for name, value in zip(JOINTS, goal)]}]})


@pytest.fixture
def folder(tmp_path):
    """One problem of a family, in the layout of MotionBenchMaker."""
    family = tmp_path / 'problems' / 'kitchen_panda'
    family.mkdir(parents=True)
    (family / 'scene0001.yaml').write_text(SCENE)
    (family / 'request0001.yaml').write_text(request_of(GOAL))
    return tmp_path


def test_a_scene_and_a_request_are_read_as_they_are_written(folder):
    (found,) = find_files(folder)
    problem = read_problem(*found, JOINTS)
    assert problem.name == 'kitchen/0001' and problem.family == 'kitchen'
    np.testing.assert_array_equal(problem.start, PANDA_READY)
    np.testing.assert_array_equal(problem.goal, GOAL)
    table, jar, ball = problem.obstacles
    assert (table.name, jar.name, ball.name) == ('table', 'jar', 'jar/1')
    assert (table.shape, jar.shape, ball.shape) == ('box', 'cylinder', 'ellipsoid')
    np.testing.assert_allclose(table.center, [0.7, 0.0, 0.05])
    np.testing.assert_allclose(table.half_extents, [0.3, 0.5, 0.02])
    # The jar's own pose turns x into y.
    np.testing.assert_allclose(jar.center, [0.1, 0.7, 0.3], atol=1e-12)
    np.testing.assert_allclose(jar.half_extents, [0.04, 0.04, 0.1])
    np.testing.assert_allclose(jar.rotation[:, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(ball.center, [0.1, 0.7, 0.42], atol=1e-12)
    np.testing.assert_allclose(ball.half_extents, 0.05)


@pytest.mark.parametrize(('old', 'new', 'says'), [
    ('type: box', 'type: cone', "primitives[0].type is 'cone'; it takes 'box', 'sphere'"),
    ('[0.6, 1.0, 0.04]', '[0.6, 1.0]', 'length, width and height, of a box [m]'),
    ('[0.6, 1.0, 0.04]', '[0.6, -1.0, 0.04]', 'positive'),
    ('[0.2, 0.04]', '[.nan, 0.04]', 'height and radius'),
    ('[0.7, 0.0, 5e-2]', '[0.7, 0.0]', 'primitive_poses[0].position is [0.7, 0.0]'),
    ('[0, 0, 0, 2]', '[0, 0, 0, 0]', 'orientation [x, y, z, w] that is not zero'),
    ('translation: [0, 0, 0]', 'translation: [0, 0, 1]', 'moves or turns the frame'),
    ('        - {type: sphere, dimensions: [0.05]}\n', '', '1 primitives and 2 primitive_poses'),
    ('      primitives: [{type', '      meshes: [{}]\n      primitives: [{type', 'has meshes'),
    ('    - id: table', '    - name: table', 'id is missing'),
    ('  collision_objects', '  objects', 'world.collision_objects is missing'),
    ('world:', 'world: [', 'cannot be read as YAML'),
])
def test_a_scene_that_is_wrong_is_refused_by_name(folder, old, new, says):
    (found,) = find_files(folder)
    assert old in SCENE
    found[1].write_text(SCENE.replace(old, new, 1))
    with pytest.raises(ProblemFileError) as error:
        read_problem(*found, JOINTS)
    assert str(found[1]) in str(error.value) and says in str(error.value)
    assert '; it takes ' in str(error.value)


@pytest.mark.parametrize(('change', 'says'), [
    (lambda r: r.pop('start_state'), 'start_state is missing'),
    (lambda r: r['start_state']['joint_state']['position'].pop(), '8 names and 7 positions'),
    (lambda r: r['goal_constraints'].clear(), 'joint_constraints is missing'),
    (lambda r: r['goal_constraints'][0]['joint_constraints'].pop(), "lacks 'panda_joint7'"),
    (lambda r: r['goal_constraints'][0]['joint_constraints'][2].update(position='far'),
     'a finite position for every joint [rad]'),
])
def test_a_request_that_is_wrong_is_refused_by_name(folder, change, says):
    (found,) = find_files(folder)
    request = yaml.safe_load(request_of(GOAL))
    change(request)
    found[2].write_text(yaml.safe_dump(request))
    with pytest.raises(ProblemFileError) as error:
        read_problem(*found, JOINTS)
    assert str(found[2]) in str(error.value) and says in str(error.value)


def test_folders_that_hold_no_such_problem_are_refused(folder, capsys):
    (folder / 'none').mkdir()
    with pytest.raises(ProblemFileError, match='there are no problems'):
        find_files(folder / 'none')
    with pytest.raises(ProblemFileError, match='there is no such folder'):
        find_files(folder / 'nowhere')
    with pytest.raises(ProblemFileError, match="no family 'bath'; there are 'kitchen'"):
        find_files(folder, ['bath'])
    assert len(find_files(folder, ['kitchen_panda'])) == 1
    assert main([str(folder), '--family', 'bath']) == 2
    assert "no family 'bath'" in capsys.readouterr().out
    (folder / 'problems' / 'kitchen_panda' / 'request0001.yaml').unlink()
    with pytest.raises(ProblemFileError, match=r'scene0001\.yaml: its request is missing'):
        find_files(folder)


def test_what_the_fingers_hold_at_the_goal_is_no_obstacle():
    robot = make_panda()
    capsules, tip = capsules_of(robot), tip_pose(robot, GOAL)
    can = Obstacle.cylinder('can', tip.position + 0.1 * tip.rotation[:, 2], 0.02, 0.1)
    wall = Obstacle.box('wall', tip.position + [0.0, 0.0, 0.5], (0.1, 0.1, 0.1))
    problem = Problem('p', 'p', (wall, can), PANDA_READY, np.array(GOAL))
    assert fault_of(robot, capsules, problem) == 'goal too near to an obstacle'
    problem = settled(robot, capsules, problem)
    assert [o.name for o in problem.obstacles] == ['wall']
    assert fault_of(robot, capsules, problem) == ''
    # A goal at a limit moves off it; one beyond stays, and is left out.
    for beyond, fault in ((0.0, ''), (0.1, 'goal beyond a limit')):
        goal = np.array(GOAL)
        goal[3] = robot.position_max[3] + beyond
        found = settled(robot, capsules, Problem('p', 'p', (), PANDA_READY, goal))
        assert fault_of(robot, capsules, found) == fault
        assert np.abs(found.goal - goal).max() <= 0.01 + 1e-9


@pytest.mark.first_alone
@pytest.mark.parametrize('family', FAMILIES)
def test_made_problems_are_free_at_both_ends_and_the_same_every_time(family):
    robot = make_panda()
    radii = np.array([c.radius for c in robot.capsules])
    for number in range(3):
        problem, again = (generate(robot, 5, family, number) for _ in range(2))
        np.testing.assert_array_equal(problem.start, again.start)
        np.testing.assert_array_equal(problem.goal, again.goal)
        for one, other in zip(problem.obstacles, again.obstacles, strict=True):
            assert one.name == other.name and one.shape == other.shape
            np.testing.assert_array_equal(one.center, other.center)
            np.testing.assert_array_equal(one.half_extents, other.half_extents)
        assert len({o.name for o in problem.obstacles}) == len(problem.obstacles) >= 3
        maps = inflated_obstacles(Scene.of(problem.obstacles), radii)
        for q in (problem.start, problem.goal):
            # By the planner's own distances; the generator asked coal.
            arm = robot.kinematics(q)
            pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
            assert pairs.distance.min() > MARGINS.clearance_margin - 1e-3
            assert link_distances(arm.segment_start, arm.segment_end, radii,
                                  robot.self_pairs).distance.min() >= 0.005
            assert (q >= robot.position_min + 0.01).all()
            assert (q <= robot.position_max - 0.01).all()
        ways = [tip_pose(robot, q).position for q in (problem.start, problem.goal)]
        assert np.linalg.norm(ways[1] - ways[0]) > 0.15
    assert not np.array_equal(problem.start, generate(robot, 6, family, number).start)


def test_a_posture_is_found_for_a_pose():
    robot = make_panda()
    pose = tip_pose(robot, GOAL)
    q = posture_at(robot, pose, PANDA_READY)
    found = tip_pose(robot, q)
    np.testing.assert_allclose(found.position, pose.position, atol=1e-4)
    np.testing.assert_allclose(found.rotation, pose.rotation, atol=1e-4)
    far = pose._replace(position=pose.position + [2.0, 0.0, 0.0])
    assert posture_at(robot, far, PANDA_READY) is None


def test_the_servo_goes_straight_and_ends_at_the_goal_or_where_nothing_moves():
    robot = make_panda()
    problem = Problem('p', 'p', (), PANDA_READY, np.array(GOAL))
    start, goal = tip_pose(robot, PANDA_READY), tip_pose(robot, GOAL)

    def exact(q, twist):
        return np.linalg.pinv(robot.kinematics(q).jacobian) @ twist, ''

    run = servo(robot, problem, exact)
    tips = np.array([robot.kinematics(q).tip_position for q in run.postures])
    line = (goal.position - start.position) / np.linalg.norm(goal.position - start.position)
    off = tips - start.position - np.outer((tips - start.position) @ line, line)
    assert run.reached and np.linalg.norm(off, axis=1).max() < 1e-3
    assert np.linalg.norm(tips[-1] - goal.position) < 0.005
    assert np.abs(pin.log3(goal.rotation.T @ robot.kinematics(
        run.postures[-1]).tip_rotation)).max() < 0.02
    twist = servo_twist(robot, start, goal)
    assert np.linalg.norm(twist[:3]) <= 0.25 + 1e-9 and np.linalg.norm(twist[3:]) <= 1.0 + 1e-9
    stuck = servo(robot, problem, lambda q, twist: (np.zeros(7), 'stuck'))
    assert not stuck.reached and stuck.reason == 'stuck'
    assert len(stuck.velocities) == round(3.0 / 0.004)


def test_a_way_is_found_around_what_blocks_the_line():
    robot = make_panda()
    capsules = capsules_of(robot)
    start, goal = PANDA_READY.copy(), PANDA_READY.copy()
    start[0], goal[0] = -0.8, 0.8
    middle = tip_pose(robot, PANDA_READY).position
    wall = Obstacle.box('wall', [middle[0] + 0.05, 0.0, 0.35], (0.2, 0.04, 0.7))
    free = Problem('free', 'p', (), start, goal)
    blocked = Problem('blocked', 'p', (wall,), start, goal)
    assert fault_of(robot, capsules, blocked) == ''
    assert not line_blocked(robot, capsules, free, 0.01)
    assert line_blocked(robot, capsules, blocked, 0.01)
    way = FreeWay(robot, capsules, (wall,), 0.01).find(start, goal)
    np.testing.assert_array_equal(way[[0, -1]], [start, goal])
    radii = [c.radius for c in robot.capsules]
    maps = inflated_obstacles(Scene.of([wall]), radii)
    for one, other in pairwise(way):
        for q in np.linspace(one, other, 50):
            arm = robot.kinematics(q)
            assert link_clearance(maps, arm.segment_start, arm.segment_end).distance.min() > 0.0


def test_a_short_run_of_a_made_family_hits_nothing(tmp_path, capsys):
    file = tmp_path / 'result.json'
    assert main(['--generated', '--seed', '3', '--family', 'box', '--count', '2', '--explain',
                 '--method', 'dynamic_factor', '--json', str(file)]) == 0
    entry = json.loads(file.read_text())['dynamic_factor']
    assert {'count', 'reached', 'collisions', 'limit_violations', 'path_median', 'time_median',
            'tick_us_median', 'left_out', 'line_fault', 'line_blocked'} <= set(entry)
    assert entry['count'] == 2 and entry['collisions'] == entry['self_collisions'] == 0
    assert entry['limit_violations'] == 0
    assert len(entry['stopped']) == round(2 * (1 - entry['reached']))
    assert set(entry['by_family']) == {'box'}
    assert 'dynamic_factor' in capsys.readouterr().out


@pytest.mark.parametrize(('family', 'number'), [('walls', 16), ('cage', 36)])
def test_ways_out_of_corners_are_found(family, number):
    """From these starts nearly all motions of half a radian are blocked."""
    robot = make_robot('panda', 6)
    problem = generate(robot, 0, family, number)
    planner = Planner(robot, PlannerParameters(clearance_margin=0.01))
    step = planner_step(planner, problem, to_target=True)
    assert servo(robot, problem, step, to_target=True).reached


def test_there_and_back_again_it_sets_off_earlier():
    robot = make_robot('panda', 6)
    problem = generate(robot, 0, 'cage', 36)
    first, again = (run([(0, 'cage', 36)], Task(
        ('dynamic_factor',), 0.01, to_target=True, again=again), 1)['dynamic_factor']
        for again in (False, True))
    assert first['reached'] == again['reached'] == 1.0
    assert again['limit_violations'] == 0
    assert again['thought_median'] < first['thought_median']
    planner = Planner(robot, PlannerParameters(clearance_margin=0.01))
    begun = there_and_back(planner, problem)
    off = pose_error(tip_pose(robot, problem.start), tip_pose(robot, begun.start), False)
    assert np.linalg.norm(off[:3]) < 0.005 and np.linalg.norm(off[3:]) < 0.02


def test_the_fastest_motion_along_a_line_is_bang_bang():
    pytest.importorskip('toppra')
    from benchmark.problem_sets.fastest import fastest_time
    from benchmark.robots import make_robot
    robot = make_robot('panda', 6)
    start = np.array([0.0, 0.0, 0.0, -2.0, 0.0, 1.7, 0.7])
    short, far = np.zeros(7), np.zeros(7)
    short[1], far[1] = 0.2, 1.0
    ways = [start + np.linspace(0.0, 1.0, 60)[:, None] * step for step in (short, far)]
    a, v = robot.acceleration_max[1], robot.velocity_max[1]
    assert fastest_time(robot, ways[0]) == pytest.approx(2.0 * np.sqrt(0.2 / a), rel=0.02)
    assert fastest_time(robot, ways[1]) == pytest.approx(1.0 / v + v / a, rel=0.02)
    # Standing still on the way counts for nothing.
    rested = np.vstack((ways[0][:30], np.repeat(ways[0][29:30], 50, axis=0), ways[0][30:]))
    assert fastest_time(robot, rested) == pytest.approx(fastest_time(robot, ways[0]), rel=0.02)


def test_roboplans_planner_goes_around_what_is_in_the_way():
    pytest.importorskip('roboplan')
    from benchmark.problem_sets.roboplan_rrt import planned
    from benchmark.robots import make_robot
    robot = make_robot('panda', 6)
    goal = PANDA_READY + np.array([1.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    between = robot.kinematics(0.5 * (PANDA_READY + goal)).tip_position
    near = [
        Obstacle.box('post', between, (0.05, 0.05, 0.3)),
        Obstacle.cylinder('can', between, 0.05, 0.3),
        Obstacle.capsule('ball', between, 0.08, 0.0), Obstacle('egg', between, np.full(3, 0.08))]
    lengths = []
    for obstacles in ((), *((obstacle,) for obstacle in near)):
        run = planned(robot, Problem('p', 'f', obstacles, PANDA_READY, goal), 0.01)
        assert run.reached, run.reason
        np.testing.assert_allclose(run.postures[[0, -1]], (PANDA_READY, goal), atol=1e-6)
        assert (np.abs(run.velocities) < 1.01 * robot.velocity_max).all()
        lengths.append(np.linalg.norm(np.diff(run.postures, axis=0), axis=1).sum())
        maps = inflated_obstacles(Scene.of(obstacles), [c.radius for c in robot.capsules])
        for q in run.postures if obstacles else ():
            arm = robot.kinematics(q)
            assert link_clearance(
                maps, arm.segment_start, arm.segment_end).distance.min() > 0.005
    assert lengths[0] == pytest.approx(1.6, abs=0.01) and min(lengths[1:]) > 1.61
    ellipsoid = Obstacle('egg', between, np.array([0.05, 0.05, 0.06]))
    with pytest.raises(ValueError, match="no shape like that of 'egg'"):
        planned(robot, Problem('p', 'f', (ellipsoid,), PANDA_READY, goal), 0.01)
