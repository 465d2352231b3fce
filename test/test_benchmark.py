"""The scenario benchmark: its tasks are what they claim to be, and its judge measures right."""

from __future__ import annotations

from pathlib import Path
import sys

from conftest import make_panda, make_planar, PANDA_READY, random_postures
import numpy as np
import pytest

from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.io.obstacle_tracker import ObstacleTracker
from redundant_planner.io.perception_parameters import CloudParameters

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from benchmark import cloud, loop, smoothness, speed, worst_case
from benchmark.crowds import ALL_SHAPES, Crowd, KINDS, Layout
from benchmark.evasion import unavoidable
from benchmark.generator import DURATION, generate, Task
from benchmark.judge import Judge, reversals
from benchmark.robots import make_robot
from benchmark.scenarios import METHODS, run_planner, summarise, UNFILTERED
from benchmark.voxels import voxel_messages, voxel_ticks


@pytest.mark.parametrize('moving', [False, True])
def test_a_seed_gives_the_same_task_and_its_start_is_clear(panda, moving):
    for seed in range(4):
        task, again = (generate(panda, seed, moving=moving) for _ in range(2))
        np.testing.assert_array_equal(task.start, again.start)
        np.testing.assert_array_equal(task.twist, again.twist)
        assert 1 <= len(task.obstacles) <= 3
        arm = panda.kinematics(task.start)
        maps = inflated_obstacles(
            Scene.of(task.obstacles), [c.radius + 0.03 for c in panda.capsules],
            moved=panda.moved)
        pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
        assert pairs.normalized_distance.min() > 0.0
        assert any(o.velocity.any() for o in task.obstacles) == moving
        distance = 0.5 * DURATION * np.linalg.norm(task.twist[:3])
        assert distance == 0.0 if moving and not task.twist.any() else 0.1 <= distance <= 0.3


@pytest.mark.first_alone
@pytest.mark.parametrize('axes', [3, 6])
def test_a_task_has_a_way_that_the_judge_lets_pass(axes):
    robot = make_robot('panda', axes)
    judge, dt = Judge(robot), 0.004
    for seed in range(4):
        task = generate(robot, seed)
        rows = np.linspace(0.0, len(task.way) - 1.0, round(DURATION / dt) + 1)
        way = np.array([np.interp(rows, np.arange(len(task.way)), joint)
                        for joint in task.way.T]).T
        verdict = judge.judge(task, way, np.diff(way, axis=0) / dt, dt)
        assert verdict.completed and verdict.path_error < 1e-3 and verdict.min_distance > 0.01
        # Their straight pieces have corners; the way itself is smooth.
        speeds = np.diff(task.way, axis=0) * (len(task.way) - 1) / DURATION
        change = np.diff(np.vstack((np.zeros(robot.n), speeds)), axis=0)
        assert (np.abs(speeds) < robot.velocity_max).all()
        assert (np.abs(change) * (len(task.way) - 1) / DURATION < robot.acceleration_max).all()
        assert generate(robot, seed, impossible_too=True).way is None


def test_the_judge_measures_exact_distances():
    # A planar arm's capsules against a ball: distance between segment and centre less both radii.
    links = [Capsule(f'l{i}', f'link{i}', np.zeros(3), np.array([x, 0, 0]), 0.05)
             for i, x in ((1, 0.5), (2, 0.4), (3, 0.3))]
    robot = make_planar(capsules=links)
    judge = Judge(robot)
    ball = Obstacle('ball', np.array([0.4, 0.3, 0.2]), np.full(3, 0.1))
    for q in random_postures(robot, 20):
        arm = robot.kinematics(q)
        along = arm.segment_end - arm.segment_start
        t = np.clip(((ball.center - arm.segment_start) * along).sum(1) / (along**2).sum(1), 0, 1)
        nearest = arm.segment_start + t[:, None] * along
        expected = np.linalg.norm(nearest - ball.center, axis=1).min() - 0.15
        task = Task(0, q, np.zeros(6), (ball,))
        verdict = judge.judge(task, np.array([q, q]), np.zeros((1, 3)), 0.004)
        if expected < 0.2:
            assert verdict.min_distance == pytest.approx(expected, abs=1e-4)
        else:  # too far away to matter, and left out
            assert verdict.min_distance > 0.2
        assert verdict.limit_violation == 0.0 and verdict.completed


def test_the_judge_sees_every_kind_of_violation():
    judge = Judge(make_planar(jerk_max=np.inf))
    task = Task(0, np.zeros(3), np.zeros(6), ())
    start = np.zeros((2, 3))
    fast = np.array([[2.0 * 1.5, 0.0, 0.0]])
    assert judge.judge(task, start, fast, 10.0).limit_violation == pytest.approx(0.5)
    jump = np.array([[0.04, 0.0, 0.0]])
    assert judge.judge(task, start, jump, 0.004).limit_violation == pytest.approx(1.0)
    gentle = Judge(make_planar(jerk_max=500.0))
    assert gentle.judge(task, start, 0.25 * jump, 0.004).limit_violation == pytest.approx(0.25)
    outside = np.array([[2.6, 0.0, 0.0], [2.6, 0.0, 0.0]])
    verdict = judge.judge(Task(0, outside[0], np.zeros(6), ()), outside, np.zeros((1, 3)), 0.004)
    assert verdict.limit_violation == pytest.approx(0.1)


@pytest.mark.long
def test_the_filter_hits_nothing_where_the_least_norm_hits():
    robot = make_panda()
    judge = Judge(robot)
    tasks = [generate(robot, seed) for seed in range(3)]
    plain, safe = ([run_planner(robot, METHODS[name], judge, task, filtered=name not in UNFILTERED)
                    for task in tasks]
                   for name in ('least_norm', 'dynamic_factor'))
    assert summarise(plain)['collisions'] >= 2
    result = summarise(safe)
    assert result['collisions'] == 0 and result['limit_violations'] == 0
    assert result['max_path_error_mm'] < 1.0
    assert {'tracked', 'min_distance_mm', 'cost_median', 'path_median', 'tick_us_median',
            'tick_us_p99'} <= set(result)


@pytest.mark.long
def test_what_sweeps_over_the_shoulder_is_unavoidable_and_what_passes_by_is_not():
    robot = make_panda()
    shoulder = Obstacle('o', np.array([-0.6, 0.0, 0.33]), np.full(3, 0.08),
                        velocity=np.array([0.3, 0.0, 0.0]))
    above = Obstacle('o', np.array([-0.6, 0.0, 0.9]), np.full(3, 0.08),
                     velocity=np.array([0.3, 0.0, 0.0]))
    for obstacle, expected in ((shoulder, True), (above, False)):
        task = Task(0, PANDA_READY, np.zeros(6), (obstacle,))
        assert unavoidable(robot, task) == expected


@pytest.mark.long
def test_what_takes_too_long_to_evade_is_unavoidable():
    across = Obstacle('o', np.array([-0.05, -0.6, 0.48]), np.full(3, 0.08),
                      velocity=np.array([0.0, 0.3, 0.0]))
    task = Task(0, PANDA_READY, np.zeros(6), (across,))
    for acceleration, expected in ((0.02, True), (5.0, False)):
        assert unavoidable(make_panda(acceleration_max=[acceleration] * 7), task) == expected


@pytest.mark.long
def test_the_upper_arm_turns_away_from_where_an_obstacle_is_going():
    """Which a barrier against where it is does not achieve."""
    robot = make_panda()
    judge, task = Judge(robot), generate(robot, 21427, moving=True)
    instant = PlannerParameters(clearance_evasion_horizon=0.0, horizon_look_ahead=0.0)
    hit = run_planner(robot, instant, judge, task).verdict
    evades = run_planner(robot, PlannerParameters(), judge, task).verdict
    assert hit.min_distance < -0.02 and 'link2' in hit.nearest
    assert evades.min_distance > 0.0
    assert hit.limit_violation == evades.limit_violation == 0.0


@pytest.mark.long
@pytest.mark.parametrize(('axes', 'seed', 'around'), [
    (6, 30710, METHODS['variational_known']), (3, 30874, PlannerParameters())])
def test_looking_ahead_finds_the_way_that_the_instant_misses(axes, seed, around):
    robot = make_robot('panda', axes)
    judge, task = Judge(robot), generate(robot, seed)
    stuck = run_planner(robot, PlannerParameters(horizon_look_ahead=0.0), judge, task)
    free = run_planner(robot, around, judge, task, known=around.method == 'variational')
    assert not stuck.tracked and free.tracked
    for verdict in (stuck.verdict, free.verdict):
        assert verdict.path_error < 1e-3
        assert verdict.min_distance > 0.009 and verdict.limit_violation == 0.0


def test_speed_measures_every_count_by_name():
    result = speed.measure('paper', [0, 3, 30], 20, peers=False)
    for key in ('tick_us', 'tick_p99_us', 'tick_own_p99_us', 'hall_tick_us', 'variational_us'):
        assert set(result[key]) == {'0', '3', '30'}
        assert all(value > 1.0 for value in result[key].values())
    assert result['mink_us'] == result['ratio_variational_to_mink'] == {}
    assert result['sections_us']['kinematics'] > 1.0


@pytest.mark.parametrize('clear_way', [False, True])
def test_obstacles_of_every_shape_keep_off_the_start(clear_way):
    robot, start = make_robot('panda', 6), speed.STARTS['panda']
    found = speed.obstacles_around(robot, start, 40, 'reach', Layout(ALL_SHAPES, clear_way))
    assert {o.shape for o in found} == set(ALL_SHAPES)
    assert len({o.name for o in found}) == len(found) == 40
    for obstacle in found:
        assert obstacle.half_extents.min() >= 0.02 and obstacle.half_extents[:2].max() <= 0.05
    maps = inflated_obstacles(Scene.of(found), [c.radius for c in robot.capsules])
    # Where it would come to in 1.5 s at full speed, and half a turn.
    q = start
    for _ in range(10 if clear_way else 1):
        arm = robot.kinematics(q)
        assert link_clearance(maps, arm.segment_start, arm.segment_end).distance.min() > 0.04
        q = q + 0.17 * np.linalg.pinv(arm.jacobian) @ speed._TWIST


@pytest.mark.long
@pytest.mark.parametrize('kind', KINDS)
def test_crowds_are_made_of_obstacles_that_can_be(kind):
    robot, start = make_robot('panda', 6), speed.STARTS['panda']
    crowd = Crowd(kind, 24, ALL_SHAPES, np.random.default_rng(2))
    for _ in range(20):
        scene = crowd.scene(robot, start, 0.03)
        # One by one they pass the checks of `Obstacle`, and come back as they were.
        again = Scene.of(scene.obstacles())
        np.testing.assert_array_equal(again.shapes, scene.shapes)
        np.testing.assert_allclose(again.half_extents, scene.half_extents)
        np.testing.assert_allclose(again.rotations, scene.rotations, atol=1e-9)


def test_an_act_among_all_shapes_is_the_same_every_time():
    robot = make_robot('panda', 6)
    act = worst_case.Act('panda', 'dynamic_factor', 10, 0, 0, ALL_SHAPES)
    plays = [worst_case.play(robot, act) for _ in range(2)]
    assert len(plays[0][0]) == 250 and plays[0][0].min() > 1.0
    assert plays[0][1] == plays[1][1]


def test_voxels_come_as_boxes_that_keep_off_the_arm():
    robot, start = make_robot('panda', 6), speed.STARTS['panda']
    tracker, arm = ObstacleTracker((), [robot.base_frame]), robot.kinematics(start)
    seen = []
    for raw in voxel_messages(robot, start, 300)[:3]:
        assert tracker.update(raw, 0.0) == []
        scene = tracker.scene
        assert len(scene.names) == 300 and {o.shape for o in scene.obstacles()} == {'box'}
        np.testing.assert_allclose(scene.half_extents, 0.01)
        maps = inflated_obstacles(scene, [c.radius for c in robot.capsules])
        assert link_clearance(maps, arm.segment_start, arm.segment_end).distance.min() > 0.05
        seen.append({tuple(center) for center in np.round(scene.centers, 6).tolist()})
    assert 250 < len(seen[0] & seen[1]) < 300
    times = voxel_ticks(robot, start, 300, speed._twist_at, 17)
    assert times['voxels'] == 300 and times['voxel_longest_us'] > times['voxel_step_us'] > 1.0
    with pytest.raises(ValueError, match='do not fit'):
        voxel_messages(robot, start, 1_000_000)


def test_the_loops_obstacles_leave_the_start_free():
    robot = make_panda()
    frames = loop.obstacle_messages(robot, loop._STARTS['panda'], 5)
    assert len(frames) == 60
    book = ObstacleTracker((), ['panda_link0'])
    for frame in frames:
        assert book.update(frame, 0.0) == []
        arm = robot.kinematics(loop._STARTS['panda'])
        maps = inflated_obstacles(book.scene, [c.radius for c in robot.capsules])
        pairs = link_clearance(maps, arm.segment_start, arm.segment_end)
        assert pairs.normalized_distance.min() > 0.0


@pytest.mark.long
def test_an_arm_does_not_whip_off_its_path():
    """One that did: next to a singularity, around an obstacle, and 10.6 mm away."""
    robot = make_robot('panda', 6)
    start = np.array([1.303, 0.3184, -1.3704, -2.0799, -0.9385, 2.2462, 0.6141])
    twist = np.array([-0.0043, -0.1493, -0.0004, -0.0757, 0.1046, 0.1262])
    obstacles = tuple(
        Obstacle(f'o{i}', np.array(center), np.array(semi_axes), np.array(orientation)
                 / np.linalg.norm(orientation))
        for i, (center, semi_axes, orientation) in enumerate((
            ((0.3447, -0.1029, 0.3428), (0.0783, 0.0884, 0.0997),
             (-0.5306, -0.1771, -0.3124, 0.7678)),
            ((0.3519, 0.0037, 0.7651), (0.0464, 0.0405, 0.0788),
             (-0.0486, -0.1577, 0.5127, 0.8426)),
            ((0.2581, -0.0784, 0.4235), (0.0662, 0.0874, 0.056),
             (-0.3537, 0.3342, 0.8644, 0.1267)))))
    outcome = run_planner(robot, METHODS['variational_held'], Judge(robot),
                          Task(0, start, twist, obstacles))
    assert outcome.verdict.path_error < 1e-3


def test_the_cloud_benchmark_times_the_same_points_in_every_layout():
    parameters = CloudParameters(min_points=1)
    found = [cloud.measure(1200, 12, parameters, layout) for layout in cloud.LAYOUTS]
    assert found[0]['voxels'] == found[1]['voxels'] == found[2]['voxels'] > 100
    assert found[1]['bytes'] > 2 * found[0]['bytes'] > 2 * 1200 * 16
    for result in found:
        assert 0.0 < result['median_ms'] <= result['p99_ms'] <= result['longest_ms']
        assert min(result['steps_us'].values()) > 0.0


def test_reversals_are_counted_beyond_a_share_of_the_limit():
    most = np.array([10.0, 10.0])
    assert reversals(np.array([[1.0, 0.4], [-1.0, -0.4], [0.0, 0.4], [-1.0, 0.4]]), most) == 1
    assert reversals(np.zeros((0, 2)), most) == 0


@pytest.mark.long
def test_a_slow_noisy_arm_is_commanded_as_smoothly_as_an_ideal_one():
    """What the encoders say is late and noisy; the commands are not."""
    robot = make_robot('panda', 6)
    judge, task = Judge(robot), generate(robot, 52001)
    found = {name: smoothness.run_planner(
        robot, 'dynamic_factor', judge, task, drive, 0.004)
        for name, drive in smoothness.DRIVES.items()}
    for smooth in found.values():
        assert smooth.limit_violation == 0.0 and smooth.min_distance > 0.009
        assert smooth.reversals <= 2 * found['ideal'].reversals + 2
        assert smooth.rms_acceleration <= 1.2 * found['ideal'].rms_acceleration
        assert smooth.path_error < 1e-3
    entry = smoothness.summarise(list(found.values()))
    assert {'reversals_median', 'reversals_max', 'rms_acceleration', 'peak_acceleration_share',
            'peak_jerk_share', 'violations'} <= set(entry)
