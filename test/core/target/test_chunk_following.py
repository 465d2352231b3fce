"""Closed loops along chunks: on time, from anywhere, one after another, and past what is there."""

from __future__ import annotations

from conftest import make_panda, make_paper_arm, PANDA_READY
import numpy as np
import pytest
from target_run import DT, moved, PANDA, Run, STILL, tip

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.judge import accelerations, reversals
from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot import se3
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.chunk_follower import ChunkFollower
from redundant_planner.core.target.progress import REACHED, TargetState

EMPTY = Scene.of(())
THERE = PANDA_READY + np.array([0.4, -0.2, 0.3, 0.2, -0.3, 0.2, 0.5])
DISPLACED = np.array([0.1, 0.2, -0.1, 0.0, 0.3, 0.4])


def minimum_jerk(x):
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def joints_at(t, seconds=2.0):
    """Postures (k, n) of a motion from rest to rest."""
    return PANDA_READY + np.outer(minimum_jerk(np.atleast_1d(t) / seconds), THERE - PANDA_READY)


def poses_at(t, seconds=2.0):
    begin = tip(PANDA, PANDA_READY)
    return [moved(begin, x * DISPLACED) for x in minimum_jerk(np.atleast_1d(t) / seconds)]


def times_of(run):
    return DT * np.arange(len(run.positions))


def off_poses(run, poses):
    """How far the tip was from where it should have been, (k, 6) [m, rad]."""
    return np.array([se3.pose_error(pose, tip(run.planner.robot, q), False)
                     for pose, q in zip(poses, run.positions)])


def reversals_of(run):
    velocities = np.diff(run.positions, axis=0) / DT
    return reversals(accelerations(velocities, DT), run.planner.robot.acceleration_max)


def test_joints_follow_a_chunk_in_its_time():
    t = np.linspace(0.0, 2.0, 21)
    run = Run()
    progress = run.to(Chunk(t, joints_at(t)), 3.0)
    assert progress.state is TargetState.REACHED and progress.joint < REACHED
    assert run.seconds < 2.0 + 5 * DT and progress.behind < 5 * DT
    assert np.abs(np.array(run.positions) - joints_at(times_of(run))).max() < 2e-3
    run.assert_within_limits()
    # And stays there.
    before = run.q
    chunk = Chunk(t, joints_at(t), late=2.0)
    run.to(lambda _: chunk, 0.5)
    np.testing.assert_allclose(run.q, before, atol=REACHED)
    assert not run.results[-1].dq.any()


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_the_tip_follows_a_chunk_in_its_time(method):
    t = np.linspace(0.0, 2.0, 21)
    run = Run(method=method)
    progress = run.to(Chunk(t, poses_at(t)), 3.0)
    assert progress.state is TargetState.REACHED
    assert max(progress.distance, progress.angle) < REACHED
    assert run.seconds < 2.0 + 15 * DT and progress.behind < 15 * DT
    assert np.abs(off_poses(run, poses_at(times_of(run)))).max() < 2e-3
    run.assert_within_limits()


def test_given_velocities_count():
    """With rests at every point the joints come to rest there."""
    t = np.arange(4.0)
    points = PANDA_READY + 0.1 * t[:, None]
    run = Run()
    run.to(Chunk(t, points, np.zeros((4, 7))), 4.0)
    velocities = np.abs(np.diff(run.positions, axis=0) / DT).max(axis=1)
    assert velocities[[250, 500]].max() < 0.02 < 0.1 < velocities[[125, 375]].min()


def test_a_chunk_faster_than_the_limits_is_followed_as_fast_as_they_allow():
    t = np.linspace(0.0, 0.2, 11)
    run, chunk = Run(), Chunk(t, joints_at(t, 0.2))
    progress = run.to(chunk, 3.0)
    assert progress.state is TargetState.REACHED
    run.assert_within_limits()
    # On its path, if not on time.
    along = joints_at(np.linspace(0.0, 0.2, 2001), 0.2)
    assert max(np.abs(along - q).max(axis=1).min() for q in run.positions) < 3e-3
    assert 0.05 < progress.behind < 0.6


@pytest.mark.first_alone
@pytest.mark.parametrize('of_poses', [False, True])
def test_chunks_that_disagree_take_over_without_a_jump(of_poses):
    random, now = np.random.default_rng(3), 0.0
    run = Run()
    home = tip(PANDA, PANDA_READY)
    while now < 8.0:
        t = np.arange(12) / 15.0
        way = 0.15 * (1.0 - np.cos(2.0 * np.pi * 0.1 * (t + now)))[:, None]
        if of_poses:
            off = random.normal(0.0, 0.01, 6)
            chunk = Chunk(t, [moved(home, w * DISPLACED / 0.4 + off) for w in way])
        else:
            chunk = Chunk(t, PANDA_READY + way * np.ones(7) + random.normal(0.0, 0.01, 7))
        run.to(lambda _, chunk=chunk: chunk, 0.4)
        now += 0.4
    run.assert_within_limits()
    assert reversals_of(run) <= 20
    assert max(result.progress.behind for result in run.results) < 0.1


def test_from_a_twist_and_from_elsewhere_it_gets_onto_the_chunk():
    t = np.arange(60) / 20.0
    points = PANDA_READY + 0.3 + 0.1 * np.sin(2.0 * t)[:, None]
    run = Run()
    for _ in range(150):
        result = run.planner.step(run.q, np.array([0.2, 0.0, 0.1, 0.0, 0.0, 0.0]), EMPTY, DT)
        run.q = run.q + DT * result.dq
        run.positions.append(run.q)
    begun = len(run.positions)
    chunk = Chunk(t, points)
    run.to(lambda _: chunk, 2.0)
    run.assert_within_limits()
    then = DT * (len(run.positions) - begun) - run.results[-1].progress.behind
    np.testing.assert_allclose(
        run.q, PANDA_READY + 0.3 + 0.1 * np.sin(2.0 * then), atol=5e-3)
    # A twist takes over, and nothing of the chunk is left.
    run.let_go()
    assert np.abs(np.diff(run.positions[-2:], axis=0)).max() < 1e-6


def test_a_single_point_is_reached_when_it_is_due():
    run = Run()
    assert run.to(Chunk([2.0], [THERE]), 4.0).state is TargetState.REACHED
    assert run.seconds == pytest.approx(2.0, abs=0.05)
    run.assert_within_limits()


def test_a_later_chunk_waits_for_its_time_while_the_present_one_goes_on():
    t = np.linspace(0.0, 2.0, 21)
    run, first = Run(), Chunk(t, joints_at(t))
    run.to(lambda _: first, 0.5)
    second = Chunk(t, joints_at(1.0 + t, 4.0), late=-0.5)
    run.to(lambda _: second, 0.48)
    np.testing.assert_allclose(run.q, joints_at(0.98)[0], atol=2e-3)
    run.to(lambda _: second, 2.0)
    np.testing.assert_allclose(run.q, joints_at(1.0 + 1.98, 4.0)[0], atol=5e-3)
    run.assert_within_limits()


def test_a_chunk_that_began_earlier_is_joined_where_it_is_by_now():
    t = np.linspace(0.0, 2.0, 21)
    run, chunk = Run(), Chunk(t, joints_at(t), late=0.4)
    run.to(lambda _: chunk, 1.4)
    np.testing.assert_allclose(run.q, joints_at(1.8)[0], atol=5e-3)
    run.assert_within_limits()


@pytest.mark.first_alone
@pytest.mark.parametrize('of_poses', [False, True])
def test_in_front_of_an_obstacle_it_waits_and_goes_on_when_that_is_gone(of_poses):
    t = np.linspace(0.0, 2.0, 21)
    way = Motion.through(capsules_of(PANDA), joints_at(np.linspace(0.0, 2.0, 200)))
    if of_poses:
        chunk, middle = Chunk(t, poses_at(t)), poses_at(1.2)[0].position
    else:
        chunk, middle = Chunk(t, joints_at(t)), tip(PANDA, THERE).position
    ball = Obstacle('ball', middle, np.full(3, 0.04))
    assert of_poses or way.to_obstacles((ball,), DT).distance < 0.0
    run, scene = Run(), Scene.of([ball])
    progress = run.to(lambda _: chunk, 4.0, scene)
    assert progress.state is TargetState.BLOCKED
    assert 'ball' in run.results[-1].reason
    assert progress.behind > 1.0 and progress.distance > 0.02
    motion = Motion.through(capsules_of(PANDA), np.array(run.positions))
    assert motion.to_obstacles((ball,), DT).distance > 0.005
    assert run.to(chunk, 4.0).state is TargetState.REACHED
    run.assert_within_limits()


def test_a_policy_that_leads_into_something_is_told_so():
    """New chunks every 0.2 s begin nothing anew."""
    t = np.linspace(0.0, 2.0, 21)
    run, scene = Run(), Scene.of([Obstacle('ball', tip(PANDA, THERE).position, np.full(3, 0.04))])
    for k in range(20):
        chunk = Chunk(t, joints_at(t + 0.2 * k))
        progress = run.to(lambda _, chunk=chunk: chunk, 0.2, scene)
    assert progress.state is TargetState.BLOCKED and progress.beside > 0.02
    assert 'ball' in run.results[-1].reason
    motion = Motion.through(capsules_of(PANDA), np.array(run.positions))
    assert motion.to_obstacles(scene.obstacles(), DT).distance > 0.005
    run.assert_within_limits()


@pytest.mark.parametrize('of_poses', [False, True])
def test_waiting_at_the_end_of_a_chunk_is_not_being_blocked(of_poses):
    """The next chunk, long after, begins as the first did."""
    t, run = np.linspace(0.0, 1.0, 11), Run()
    at = poses_at if of_poses else joints_at
    for share in (t, t[::-1]):
        chunk = Chunk(t, at(2.0 * share))
        run.to(lambda _, chunk=chunk: chunk, 3.0)
        assert run.results[-1].progress.state is TargetState.REACHED
    assert TargetState.BLOCKED not in [result.progress.state for result in run.results]


@pytest.mark.parametrize('frame', ['base', 'tool'])
def test_the_twists_that_a_chunk_announces_are_those_that_come(frame, monkeypatch):
    """In the command frame, which turns with the tip; between nodes they are interpolated."""
    said, twist_of = [], ChunkFollower.twist
    monkeypatch.setattr(ChunkFollower, 'twist', lambda self, start: (
        said.append(twist_of(self, start)) or said[-1]))
    start = PANDA_READY + np.array([0.3, 0.0, 0.2, 0.0, -0.4, 0.3, 0.6])
    t, begin = np.linspace(0.0, 2.0, 21), tip(PANDA, start)
    chunk = Chunk(t, [moved(begin, x * DISPLACED) for x in minimum_jerk(t / 2.0)])
    Run(make_panda(command_frame=frame), start).to(lambda _: chunk, 1.6)
    _, ahead = said[150]
    came = np.array([twist for twist, _ in said[150:350]])
    announced = ahead(DT * np.arange(len(came) + 1))
    assert np.abs(came).max() > 0.1
    np.testing.assert_allclose(announced, came, atol=0.05 * np.abs(came).max())


@pytest.mark.parametrize('speed', [0.3, 1.5])
def test_an_arm_in_full_motion_swings_out_no_further_than_it_must(speed):
    """A chunk that stands takes over: v²/2a of the slowest to stop, and little more."""
    run = Run()
    t = np.linspace(0.0, 2.0, 41)
    way = PANDA_READY + speed * (t[:, None] - 1.0) * np.array([1.0, 0, 0, 0, 0, 0, 0])
    chunk = Chunk(t, way)
    run.to(lambda _: chunk, 1.0)
    begin, stands = run.q[0], Chunk([0.0, 2.0], np.tile(run.q, (2, 1)))
    run.to(lambda _: stands, 2.0)
    swing = max(q[0] for q in run.positions) - begin
    assert swing < speed**2 / (2.0 * PANDA.acceleration_max[0]) * 2.5 + 0.06
    np.testing.assert_allclose(run.q, stands.end, atol=1e-3)
    run.assert_within_limits()


@pytest.mark.parametrize('of_poses', [False, True])
def test_parameters_that_change_on_the_way_do_not_begin_it_anew(of_poses):
    t = np.linspace(0.0, 2.0, 21)
    run, chunk = Run(), Chunk(t, poses_at(t) if of_poses else joints_at(t))
    run.to(lambda _: chunk, 0.8)
    run.planner.parameters = PlannerParameters(limits_linear_speed=0.5)
    run.planner.hold([Obstacle('cup', np.array([0.0, 0.0, 0.15]), np.full(3, 0.03))])
    assert run.to(chunk, 3.0).state is TargetState.REACHED
    assert run.seconds < 2.2
    run.assert_within_limits()


def test_a_reset_forgets_the_chunk():
    t = np.linspace(0.0, 2.0, 21)
    run, chunk = Run(), Chunk(t, joints_at(t))
    run.to(lambda _: chunk, 0.5)
    run.planner.reset()
    run.q = PANDA_READY.copy()
    fresh = Run()
    for _ in range(50):
        one = run.planner.step(run.q, STILL, EMPTY, DT, target=chunk)
        other = fresh.planner.step(run.q, STILL, EMPTY, DT, target=chunk)
        np.testing.assert_array_equal(one.dq, other.dq)
        run.q = run.q + DT * one.dq


def test_an_arm_on_rails_follows_with_three_axes():
    robot = make_paper_arm()
    start = np.array([0.1, 0.1, 0.0, 0.52, -0.52, 1.05, 0.0])
    begin = tip(robot, start)
    t = np.linspace(0.0, 3.0, 31)
    x = minimum_jerk(t / 3.0)
    run = Run(robot, start)
    poses = [moved(begin, (*(0.1 * one * np.array([1.0, -1.0, 0.5])), 0, 0, 0)) for one in x]
    progress = run.to(Chunk(t, poses), 4.0)
    assert progress.state is TargetState.REACHED
    run.assert_within_limits()


def test_chunks_that_do_not_fit_the_arm_are_refused_by_name():
    planner = Planner(PANDA, PlannerParameters())
    beyond = np.tile(PANDA_READY, (2, 1))
    beyond[1, 3] = 0.5
    for points, reason in (
            (beyond, "takes joint 'panda_joint4' from -?[0-9.]+ to 0.5; it must stay within"),
            (beyond[:, :6], 'the chunk has 6 joints')):
        with pytest.raises(StateError, match=reason):
            planner.step(PANDA_READY, STILL, EMPTY, DT, target=Chunk([0.0, 1.0], points))
