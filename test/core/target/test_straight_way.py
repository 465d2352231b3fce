"""To a pose along a straight line: arrival, limits, new targets, streams."""

from __future__ import annotations

from conftest import examples, make_panda, make_paper_arm, PANDA_READY
from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest
from target_run import AT_REST, DT, EMPTY, moved, PANDA, Run, STILL, tip

from benchmark.targets import fastest_time
from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot import se3
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.target.progress import TargetState


class StraightRun(Run):
    """In a line."""

    def __init__(self, *robot, **parameters):
        super().__init__(*robot, target_path='straight', **parameters)


postures = st.lists(st.floats(-0.5, 0.5), min_size=7, max_size=7).map(
    lambda offset: PANDA_READY + np.array(offset))


@settings(max_examples=examples(10), derandomize=True)
@given(postures)
@example(PANDA_READY + np.array([0.255859375, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
@example(PANDA_READY - np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
def test_it_arrives_within_all_limits_and_does_not_overshoot(goal):
    """Wherever a nearby posture has its tip: once nearer, never half a millimetre farther."""
    run, target = StraightRun(), tip(PANDA, goal)
    progress = run.to(target, 6.0)
    assert progress.state is not TargetState.REACHED or progress.distance < 2e-4
    run.assert_within_limits()
    distances = np.linalg.norm(run.tips - target.position, axis=1)
    assert (distances - np.minimum.accumulate(distances)).max() < 5e-4
    if progress.state is not TargetState.REACHED:  # links or limits that the line leads into
        assert progress.state in (TargetState.BLOCKED, TargetState.OUT_OF_REACH)
        assert run.results[-1].reason


@pytest.mark.parametrize('options', [
    {}, {'command_frame': 'tool'}, {'axes': ('vx', 'vy', 'vz')},
    {'axes': ('vx', 'vy', 'vz', 'wx', 'wy')}])
def test_the_tip_keeps_to_its_line_and_turns_about_one_axis(options):
    robot = make_panda(**options)
    run = StraightRun(robot)
    begin = tip(robot, PANDA_READY)
    target = moved(begin, (0.12, 0.15, -0.1, 0.3, 0.2, -0.4))
    assert run.to(target, 4.0).state is TargetState.REACHED
    end = tip(robot, run.q)
    np.testing.assert_allclose(end.position, target.position, atol=1e-4)
    way = target.position - begin.position
    way = way / np.linalg.norm(way)
    aside = (run.tips - begin.position) - np.outer((run.tips - begin.position) @ way, way)
    assert np.linalg.norm(aside, axis=1).max() < 1e-3
    if robot.m == 6:
        half = tip(robot, run.positions[len(run.positions) // 3])
        turned = se3.pose_error(half, begin, False)[3:]
        share = np.linalg.norm(half.position - begin.position) / np.linalg.norm(
            target.position - begin.position)
        np.testing.assert_allclose(turned, share * np.array((0.3, 0.2, -0.4)), atol=2e-3)


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_it_is_as_fast_as_the_joints_allow(method):
    """Of a rest-to-rest motion along a known path: within 10 % of the fastest, and of its guess.

    The fastest is that of the arm's own joint path with all of the limits: some joint is at its
    limit of velocity or acceleration at every moment (Bobrow et al. 1985). Jerk limits make every
    motion longer by 2 a / j.
    """
    run, begin = StraightRun(method=method), tip(PANDA, PANDA_READY)
    run.to(moved(begin, (0.25, 0.2, -0.15, 0.0, 0.0, 0.0)), 4.0)
    guess = run.results[0].progress.seconds
    moving = np.flatnonzero([r.progress.state is not TargetState.REACHED for r in run.results])
    took = DT * len(moving)
    fastest = fastest_time(PANDA, np.array(run.positions), run.planner.parameters)
    assert took == pytest.approx(fastest, rel=0.1)
    assert guess == pytest.approx(took, rel=0.15)


def test_a_new_target_on_the_way_is_taken_up_without_a_stop():
    run, begin = StraightRun(), tip(PANDA, PANDA_READY)
    run.to(lambda t: moved(begin, (0.15, 0.0, 0.0, 0.0, 0.0, 0.0)), 0.25)
    before = len(run.results)
    second = moved(begin, (0.1, 0.15, 0.05, 0.0, 0.0, 0.3))
    assert run.to(second, 3.0).state is TargetState.REACHED
    speeds = np.linalg.norm(np.diff(run.tips, axis=0), axis=1) / DT
    # Until it brakes for the second one, it never gets slower than half of what it was.
    assert speeds[before:before + 50].min() > 0.5 * speeds[before]
    run.assert_within_limits()


@pytest.mark.first_alone
@pytest.mark.parametrize('lag', [0.0, 0.08])
@pytest.mark.parametrize('rate', [30, 100, 250, 500])
def test_a_stream_is_followed_smoothly_one_lag_behind(rate, lag):
    """With jitter of up to a tick, a tenth of its messages lost, and a turn on the way."""
    random, begin, speed = np.random.default_rng(rate), tip(PANDA, PANDA_READY), 0.08

    def pose(t):
        return moved(begin, (0.0, speed * (t - 1.5), 0.03 * np.sin(min(t, 2.0) * np.pi),
                             0.0, 0.0, 0.1 * t))

    sent = np.arange(0.0, 3.5, 1.0 / rate)
    delays = random.uniform(0.0, min(0.5 / rate, DT), len(sent))
    arrived = np.maximum.accumulate(sent + delays)
    kept = random.random(len(sent)) > 0.1
    kept[0] = True
    sent, arrived = sent[kept], arrived[kept]
    poses = [pose(t) for t in sent]
    run = StraightRun(target_lag=lag)
    run.to(lambda t: poses[max(int(np.searchsorted(arrived, t, side='right')) - 1, 0)], 3.5)
    run.assert_within_limits()
    assert {r.progress.state for r in run.results} <= {TargetState.MOVING, TargetState.REACHED}
    behind = [(pose(DT * i).position - p)[1] for i, p in enumerate(run.tips)]
    # So many lost ones count for the gap that is usual.
    longest = max(lag, 1.4 * 2.0 / rate) if lag else 0.0
    assert lag - DT < np.mean(behind[-200:]) / speed < longest + 2.0 * DT + delays.mean()
    # Stairs of 30 Hz have 5 rad/s² in the mean.
    acceleration = np.diff(run.positions, 2, axis=0)[200:] / DT**2
    assert np.sqrt((acceleration**2).mean()) < (1.2 if lag else 2.5)


def test_a_stream_that_ends_leaves_the_arm_at_its_last_pose():
    run, begin = StraightRun(), tip(PANDA, PANDA_READY)
    run.to(lambda t: moved(begin, (0.0, 0.1 * min(t, 1.0), 0.0, 0.0, 0.0, 0.0)), 2.5)
    np.testing.assert_allclose(
        run.tips[-1], begin.position + (0.0, 0.1, 0.0), atol=2e-4)
    assert np.abs(run.results[-1].dq).max() < AT_REST


def test_a_wall_in_the_way_blocks_it_and_it_goes_on_when_that_is_gone():
    run, begin = StraightRun(), tip(PANDA, PANDA_READY)
    target = moved(begin, (0.25, 0.0, 0.0, 0.0, 0.0, 0.0))
    wall = Scene.of([Obstacle.box('wall', begin.position + (0.2, 0.0, 0.0), (0.02, 1.0, 1.0))])
    progress = run.to(target, 3.0, wall)
    assert progress.state is TargetState.BLOCKED and "'wall'" in run.results[-1].reason
    assert 0.05 < progress.distance < 0.2 and progress.miss == 0.0
    assert np.abs(run.results[-1].dq).max() < AT_REST
    assert run.to(target, 3.0).state is TargetState.REACHED
    run.assert_within_limits()


def test_out_of_reach_is_said_with_how_far():
    run, begin = StraightRun(), tip(PANDA, PANDA_READY)
    progress = run.to(moved(begin, (0.8, 0.0, 0.0, 0.0, 0.0, 0.0)), 5.0)
    assert progress.state is TargetState.OUT_OF_REACH
    assert 0.1 < progress.miss < 0.8 and 0.1 < progress.distance < 0.8
    run.assert_within_limits()


def test_an_arm_without_spare_joints_goes_to_targets_too():
    robot = make_paper_arm()
    start = np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])
    run = StraightRun(robot, start)
    assert run.to(moved(tip(robot, start), (-0.05, -0.05, 0.01, 0.0, 0.0, 0.0)), 5.0).state is (
        TargetState.REACHED)


def test_the_same_targets_give_the_same_motion():
    begin = tip(PANDA, PANDA_READY)
    runs = [StraightRun(), StraightRun()]
    for run in runs:
        run.to(lambda t: moved(begin, (0.1 * t, 0.0, 0.05, 0.0, 0.0, 0.0)), 1.0)
    np.testing.assert_array_equal(runs[0].positions, runs[1].positions)


def test_after_a_target_a_twist_commands_again():
    run, begin = StraightRun(), tip(PANDA, PANDA_READY)
    run.to(lambda t: moved(begin, (0.15, 0.0, 0.0, 0.0, 0.0, 0.0)), 0.2)
    result = run.let_go()
    assert result.progress is None and np.abs(result.dq).max() < AT_REST
    run.assert_within_limits()


@pytest.mark.parametrize(('position', 'rotation', 'what'), [
    ((0.0, np.nan, 0.0), np.eye(3), 'three finite'),
    ((0.0, 0.0), np.eye(3), 'three finite'),
    (('a', 0.0, 0.0), np.eye(3), 'numbers'),
    ((0.0, 0.0, 0.0), 2.0 * np.eye(3), 'rotation matrix'),
    ((0.0, 0.0, 0.0), -np.eye(3), 'rotation matrix')])
def test_a_pose_that_is_none_is_refused_and_the_planner_goes_on(position, rotation, what):
    run = StraightRun()
    with pytest.raises(StateError, match=what):
        run.planner.step(run.q, STILL, EMPTY, DT, target=Pose(position, rotation))
    run.planner.step(run.q, STILL, EMPTY, DT)
