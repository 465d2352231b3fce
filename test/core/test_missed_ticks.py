"""Ticks that do not take place: an arm that takes velocities goes on by its latest one."""

from __future__ import annotations

from conftest import examples, make_panda, make_two_handed, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.se3 import integrate, Pose, pose_error, poses_error
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.moving_target import MovingTarget
from redundant_planner.core.target.progress import TargetState
from redundant_planner.paper.method import PAPER_METHODS, PaperPlanner

PANDA, BODY, DT = make_panda(), make_two_handed(), 0.004
BODY_START = np.array([0.2, 0.0, 0.4, 0.3, 0.2, 0.9, 0.1, 0.4, 0.4, -0.3, -0.2, 0.9, -0.1, 0.4])
SEEDS = st.integers(0, 2**32 - 1)


def missed_ticks(seed, count, share=0.2, most=5):
    """How many ticks are missed before each of some."""
    random = np.random.default_rng(seed)
    return (random.random(count) < share) * random.integers(1, most + 1, count)


def run(planner, q, missed, ask, *, told=True, until=lambda result: False):
    """Yield posture and result of each tick of an ideal arm."""
    velocity = np.zeros(len(q))
    for gap in missed.tolist():
        q = q + gap * DT * velocity
        if told:
            planner.missed(gap)
        result = planner.step(q, dt=DT, scene=(), **ask)
        yield q, result
        if until(result):
            return
        velocity = result.dq
        q = q + DT * velocity


@settings(max_examples=examples(10), deadline=None)
@given(seed=SEEDS)
def test_the_tip_stays_where_its_twist_has_led_it_by_now(seed):
    twist, missed = np.array([0.0, 0.1, 0.1, 0.2, 0.0, 0.0]), missed_ticks(seed, 200)
    planner = Planner(PANDA)
    start = PANDA.kinematics(PANDA_READY).tips.first
    elapsed = DT * np.concatenate(([0.0], np.cumsum(missed[1:] + 1)))
    path = [(q, result) for q, result in run(planner, PANDA_READY, missed, {'twist': twist})]
    assert all(result.scale == 1.0 for _, result in path[50:])
    # Setting off takes some time; from then on the tip keeps up with it.
    late = [np.linalg.norm(pose_error(integrate(start, twist, seconds, False),
                                      PANDA.kinematics(q).tips.first, False)[:3])
            for seconds, (q, _) in zip(elapsed, path)]
    assert np.ptp(late[60:]) < 1.5e-3
    assert max(np.linalg.norm(result.path_error[:3]) for _, result in path) < 1e-3


def joint_way(seed, *, told):
    """How long a free way takes while ticks are missed [s], and how far beyond it leads."""
    goal = PANDA_READY + np.array([0.8, 0.4, -0.5, 0.6, 0.3, 0.4, 0.5])
    missed = missed_ticks(seed, 1500)
    way = [(q, result) for q, result in run(
        Planner(PANDA), PANDA_READY, missed, {'twist': np.zeros(6), 'target': goal}, told=told,
        until=lambda result: result.progress.state is TargetState.REACHED)]
    q, result = way[-1]
    assert result.progress.state is TargetState.REACHED
    assert np.abs(q - goal).max() < 2e-3
    line = (goal - PANDA_READY) / np.linalg.norm(goal - PANDA_READY)
    return DT * (len(way) + missed[:len(way)].sum()), max((q - goal) @ line for q, _ in way)


@pytest.mark.parametrize('seed', range(3))
def test_a_free_way_goes_on(seed):
    # An arm that brakes as hard as it may and misses a tick goes too far in any case.
    (seconds, beyond), (longer, _) = (joint_way(seed, told=told) for told in (True, False))
    assert seconds < 0.8 * longer and beyond < 0.2


def in_two_seconds(kind):
    """A chunk of poses, joints or one tip's poses, and what commands it."""
    if kind == 'joints':
        return PANDA, PANDA_READY, Chunk([0.0, 1.0, 2.0], [
            PANDA_READY + share * np.array([0.3, 0.1, 0.0, 0.2, 0.0, 0.1, 0.2])
            for share in (0.0, 0.5, 1.0)]), np.zeros(6)
    robot, q = (PANDA, PANDA_READY) if kind == 'poses' else (BODY, BODY_START)
    start = robot.kinematics(q).tips.first
    chunk = Chunk([0.0, 1.0, 2.0], [
        Pose(start.position + np.array([0.0, 0.05 * share, 0.05 * share]), start.rotation)
        for share in (0.0, 0.5, 1.0)])
    if kind == 'poses':
        return robot, q, chunk, np.zeros(6)
    return robot, q, {robot.tips[0]: chunk}, np.zeros((2, 6))


@pytest.mark.parametrize('kind', ['joints', 'poses', 'tip'])
def test_a_chunk_does_not_fall_behind(kind):
    robot, q, target, twist = in_two_seconds(kind)
    missed = missed_ticks(7, 700)
    way = list(run(Planner(robot), q, missed, {'twist': twist, 'target': target},
                   until=lambda result: result.progress.state is TargetState.REACHED))
    assert way[-1][1].progress.state is TargetState.REACHED
    elapsed = DT * (len(way) + missed[:len(way)].sum())
    assert 1.9 < elapsed < 2.3
    assert way[-1][1].progress.behind < 0.05


@pytest.mark.parametrize('kind', ['joints', 'poses', 'tip'])
@pytest.mark.parametrize('change', ['parameters', 'hold'])
def test_ticks_may_be_missed_after_a_change_along_a_chunk(kind, change):
    robot, q, target, twist = in_two_seconds(kind)
    planner = Planner(robot)
    for i in range(60):
        result = planner.step(q, twist, [], DT, target=target)
        if i % 20 == 10:
            if change == 'hold':
                planner.hold([])
            else:
                planner.parameters = planner.parameters
        planner.missed(2)
        q = q + 3 * DT * result.dq


def test_a_chunk_that_waits_for_its_time_begins_then():
    start = PANDA.kinematics(PANDA_READY).tips.first

    def chunk(late, up):
        return Chunk([0.0, 2.0], [start, Pose(start.position + np.array([0.0, 0.0, up]),
                                              start.rotation)], late=late)

    first, second = chunk(0.0, 1e-6), chunk(-0.5, 0.1)
    planner, q, elapsed, missed = Planner(PANDA), PANDA_READY, 0.0, missed_ticks(3, 400)
    result = planner.step(q, np.zeros(6), [], DT, target=first)
    for gap in missed.tolist():
        planner.missed(gap)
        q = q + (gap + 1) * DT * result.dq
        elapsed += (gap + 1) * DT
        result = planner.step(q, np.zeros(6), [], DT, target=second)
        if q is not PANDA_READY and PANDA.kinematics(q).tip_position[2] > start.position[2] + 2e-3:
            break
    assert 0.5 < elapsed < 0.9


def lost(seed, *, told):
    """How far coupled hands get from each other while ticks are missed [m, rad]."""
    planner, still = Planner(BODY), np.zeros(6)
    planner.step(BODY_START, np.zeros((2, 6)), [], DT)
    planner.couple()
    coupling = planner.coupling
    held = coupling.object_pose(planner.reference)
    target = integrate(held, np.array([0.0, 0.0, -0.03, 0.0, -0.15, 0.1]), 1.0, False)
    worst = 0.0
    for q, _ in run(planner, BODY_START, missed_ticks(seed, 300, 0.1, 4),
                    {'twist': still, 'target': target}, told=told,
                    until=lambda result: result.progress.state is TargetState.REACHED):
        tips = BODY.kinematics(q).tips
        worst = max(worst, np.abs(poses_error(coupling.tips(tips.first), tips, False)).max())
    return worst


@pytest.mark.parametrize('seed', range(4))
def test_what_two_hands_hold_stays_between_them(seed):
    told, untold = (lost(seed, told=told) for told in (True, False))
    assert told < 1e-3 and told < untold / 5.0


def test_time_of_a_stream_goes_on():
    target = MovingTarget(0.1, np.full(1, 0.05))
    random, now = np.random.default_rng(0), 0.0
    errors = []
    for i in range(400):
        gap = int(random.random() < 0.2) * int(random.integers(1, 6))
        target.wait(gap * DT)
        now += (gap + 1) * DT
        target.sense([(np.array([0.2 * now]), 0.0)], DT, lambda numbers: True)
        if target.estimate is not None and i > 200:
            errors.append(abs(float(target.estimate.velocity[0]) - 0.2))
    assert max(errors) < 0.01


@pytest.mark.parametrize('method', PAPER_METHODS)
def test_the_papers_reference_goes_on_as_well(method):
    planner = PaperPlanner(PANDA, PlannerParameters(method=method))
    planner.missed(3)
    assert planner.reference is None
    q, twist = PANDA_READY, np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    result = planner.step(q, twist, Scene.of(), DT)
    before = planner.reference
    planner.missed(4)
    step = planner.reference.position - before.position
    np.testing.assert_allclose(step, 4 * DT * twist[:3], atol=1e-9)
    q = q + 5 * DT * result.dq
    assert np.abs(planner.step(q, twist, Scene.of(), DT).path_error).max() < 1e-4


def test_none_missed_changes_nothing():
    first, second = Planner(PANDA), Planner(PANDA)
    q = PANDA_READY
    for _ in range(30):
        second.missed(0)
        one, other = (planner.step(q, np.array([0.1, 0.0, 0.1, 0, 0, 0]), [], DT)
                      for planner in (first, second))
        assert np.array_equal(one.dq, other.dq)
        q = q + DT * one.dq
    for planner in (first, second):
        planner.reset()
        planner.missed(5)
        assert planner.reference is None


@pytest.mark.parametrize('bad', [-1, 1.0, np.nan, None])
def test_what_is_no_number_of_ticks_is_refused(bad):
    with pytest.raises(StateError, match=r'ticks is .*; it takes a whole number, 0 or more'):
        Planner(PANDA).missed(bad)
