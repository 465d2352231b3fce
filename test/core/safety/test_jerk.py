"""Commands keep the jerk limits, and everything that the planned motion keeps."""

from __future__ import annotations

from dataclasses import replace

from closed_loop import drive, DT, random_scene
from conftest import examples, make_panda, make_planar, PANDA_READY, random_postures
from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import RobotError
from redundant_planner.core.obstacles.clearance import link_clearance
from redundant_planner.core.obstacles.inflation import inflated_obstacles
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.jerk import MeanVelocity, reversal_time, SmoothStop, window_of
from redundant_planner.core.safety.stage import Stage

N = 3
ROUND_OFF = 1.0 + 1e-9


def differences(velocities, dt):
    """Return accelerations and jerks of commands (k, n) that begin at rest."""
    acceleration = np.diff(velocities, axis=0, prepend=0.0) / dt
    return acceleration, np.diff(acceleration, axis=0, prepend=0.0) / dt


@settings(max_examples=examples(150), deadline=None)
@given(seed=st.integers(0, 10**6), dt=st.sampled_from([0.001, 0.004, 0.02]),
       ratio=st.floats(1.5, 3.0))
def test_means_keep_what_the_planned_motion_keeps_and_the_jerk_besides(seed, dt, ratio):
    random = np.random.default_rng(seed)
    acceleration_max = random.uniform(1.0, 20.0, N)
    jerk_max = acceleration_max * 10.0**ratio * random.uniform(0.5, 2.0, N)
    ticks = window_of(reversal_time(acceleration_max, jerk_max), dt)
    mean = MeanVelocity(ticks, np.zeros(N))
    planned = np.cumsum(
        random.choice([-1.0, 0.0, 1.0], (300, 1)) * acceleration_max * dt
        * random.uniform(0.0, 1.0, (300, N)), axis=0)
    velocities = np.array([mean.take(u, dt) for u in planned])
    acceleration, jerk = differences(velocities, dt)
    assert (np.abs(velocities) <= np.abs(planned).max(axis=0) * ROUND_OFF).all()
    assert (np.abs(acceleration) <= acceleration_max * ROUND_OFF).all()
    assert (np.abs(jerk) <= jerk_max * ROUND_OFF + 1e-9).all()
    # Each posture is the mean of planned ones, so that a limit of positions holds as well.
    way, planned_way = np.cumsum(velocities, axis=0) * dt, np.cumsum(planned, axis=0) * dt
    before = np.vstack((np.zeros((ticks - 1, N)), planned_way))
    for i in (0, 50, 299):
        np.testing.assert_allclose(way[i], before[i:i + ticks].mean(axis=0), atol=1e-12)
    # What is on its way is known: planning nothing more, the arm still goes there.
    posture = random.uniform(-1.0, 1.0, N)
    stop = mean.stops_at(posture, dt)
    rest = np.array([mean.take(np.zeros(N), dt) for _ in range(ticks)])
    np.testing.assert_allclose(posture + rest.sum(axis=0) * dt, stop, atol=1e-12)
    np.testing.assert_array_equal(rest[-1], 0.0)


@settings(max_examples=examples(150), deadline=None)
@example(seed=0, dt=0.001, ratio=10.0)
@given(seed=st.integers(0, 10**6), dt=st.sampled_from([0.001, 0.004, 0.02]),
       ratio=st.floats(10.0, 1000.0))
def test_a_stop_from_any_command_is_an_s_curve(seed, dt, ratio):
    random = np.random.default_rng(seed)
    acceleration_max = random.uniform(1.0, 20.0, N)
    jerk_max = ratio * acceleration_max
    before = random.uniform(-2.0, 2.0, N)
    last = before + random.uniform(-1.0, 1.0, N) * acceleration_max * dt
    stop = SmoothStop(acceleration_max, jerk_max, dt)
    stop.moving(before)
    stop.moving(last)
    sent = [before, last]
    while sent[-1].any():
        sent.append(stop.next())
        assert len(sent) * dt < 4.0
    np.testing.assert_array_equal(stop.next(), 0.0)
    acceleration = np.diff(sent, axis=0) / dt
    assert (np.abs(acceleration) <= acceleration_max * (1.0 + 1e-6)).all()
    assert (np.abs(np.diff(acceleration, axis=0)) / dt <= jerk_max * (1.0 + 1e-6)).all()


def arms():
    """Return arms whose jerk limits act: a Panda at 1 kHz, one made gentle, and a small one."""
    return {
        'panda, 1 kHz': (make_panda(), 0.001),
        'gentle panda': (make_panda(jerk_max=(100.0,)), DT),
        'planar': (make_planar(jerk_max=150.0), DT)}


@pytest.mark.parametrize('name', list(arms()))
def test_all_limits_hold_in_every_tick_among_obstacles_at_rest(name):
    robot, dt = arms()[name]
    random = np.random.default_rng(5)
    limited = 0
    for seed in range(3):
        scene = replace(
            moving := Scene.of(random_scene(robot, seed)),
            velocities=np.zeros_like(moving.velocities))
        planner = Planner(robot, PlannerParameters())
        start = next(q for q in random_postures(robot, 50, seed) if not planner.contacts(q, scene))
        twists = [robot.full_twist(0.3 * random.normal(size=robot.m)) for _ in range(4)]
        twists += [np.zeros(6)] * 3
        postures, results = drive(
            planner, start, lambda t, twists=twists: twists[min(int(t / 0.2), 6)], scene, 1.4, dt)
        velocities = np.array([r.dq for r in results])
        acceleration, jerk = differences(velocities, dt)
        assert (np.abs(velocities) <= robot.velocity_max * ROUND_OFF).all()
        assert (np.abs(acceleration) <= robot.acceleration_max * (1.0 + 1e-6)).all()
        assert (np.abs(jerk) <= robot.jerk_max * (1.0 + 1e-6)).all()
        assert (postures <= robot.position_max).all() and (postures >= robot.position_min).all()
        assert all(r.jerk_kept for r in results)
        limited += (np.abs(jerk) > 0.3 * robot.jerk_max).any()
    assert limited


def test_the_tip_stays_on_its_path_although_commands_are_means():
    robot = make_panda(jerk_max=(300.0,))
    planner, twist = Planner(robot, PlannerParameters()), np.array([0.0, 0.2, -0.1, 0.0, 0.0, 0.0])
    postures, _ = drive(planner, PANDA_READY, lambda t: twist * (t < 1.0), seconds=1.8)
    tips = np.array([robot.kinematics(q).tip_position for q in postures]) - (
        robot.kinematics(PANDA_READY).tip_position)
    way = twist[:3] / np.linalg.norm(twist[:3])
    aside = tips - np.outer(tips @ way, way)
    assert np.abs(aside).max() < 1.5e-4
    np.testing.assert_allclose(tips[-1], twist[:3], atol=2e-3)


def clearance(robot, q, scene):
    arm = robot.kinematics(q)
    maps = inflated_obstacles(scene, [capsule.radius for capsule in robot.capsules])
    return link_clearance(maps, arm.segment_start, arm.segment_end).distance.min()


def test_jerk_gives_way_to_what_moves_in_and_comes_back():
    """A ball comes at the forearm faster than the arm can be out of its way in peace."""
    nearest = {}
    for jerk in (500.0, np.inf):
        robot = make_panda(jerk_max=(jerk,))
        planner, q = Planner(robot, PlannerParameters()), np.array(PANDA_READY)
        arm = robot.kinematics(q)
        forearm = [capsule.name for capsule in robot.capsules].index('link5')
        middle = 0.5 * (arm.segment_start[forearm] + arm.segment_end[forearm])
        ball = Obstacle('ball', middle + [0.0, 0.45, 0.0], [0.08] * 3, velocity=[0.0, -1.2, 0.0])
        sent, kept, stages, nearest[jerk] = [], [], [], np.inf
        for i in range(750):
            scene = Scene.of([ball.after(i * DT)])
            result = planner.step(q, np.zeros(6), scene, DT)
            q = q + DT * result.dq
            sent.append(result.dq)
            kept.append(result.jerk_kept)
            stages.append(result.stage)
            nearest[jerk] = min(nearest[jerk], clearance(robot, q, scene))
        acceleration, jerks = differences(np.array(sent), DT)
        assert (np.abs(acceleration) <= robot.acceleration_max * (1.0 + 1e-6)).all()
        assert Stage.FORCED in stages
        broken = (np.abs(jerks) > robot.jerk_max * (1.0 + 1e-6)).any(axis=1)
        given_up = ~np.array(kept)
        if jerk == 500.0:
            assert broken.any() and kept[0] and kept[-1]
            # Every tick that breaks the limit is one that says so, or the one after it.
            assert (given_up | np.roll(given_up, 1))[broken].all()
            # And it is given up where clearance cannot be kept, and for 0.1 s after.
            forced = np.flatnonzero([stage is Stage.FORCED for stage in stages])
            since = np.array([min(i - forced[forced < i], default=np.inf) for i in range(750)])
            assert (since[given_up] * DT <= 0.1 + 2 * DT).all()
        else:
            assert not given_up.any()
    assert nearest[500.0] > min(nearest[np.inf] - 0.01, PlannerParameters().clearance_margin)


def test_a_planner_goes_on_from_what_was_commanded_instead():
    robot = make_panda(jerk_max=(500.0,))
    planner = Planner(robot, PlannerParameters())
    twist = np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0])
    postures, results = drive(planner, PANDA_READY, twist, seconds=0.5)
    stop = SmoothStop(robot.acceleration_max, robot.jerk_max, DT)
    sent = [r.dq for r in results]
    stop.moving(sent[-2])
    stop.moving(sent[-1])
    q = postures[-1]
    for _ in range(6):
        sent.append(stop.next())
        planner.braked(sent[-1], DT)
        q = q + DT * sent[-1]
    assert sent[-1].any()
    for _ in range(100):
        sent.append(planner.step(q, twist, Scene.of(), DT).dq)
        q = q + DT * sent[-1]
    acceleration, jerk = differences(np.array(sent), DT)
    assert (np.abs(acceleration) <= robot.acceleration_max * (1.0 + 1e-6)).all()
    assert (np.abs(jerk) <= robot.jerk_max * (1.0 + 1e-6)).all()
    assert np.linalg.norm(robot.kinematics(q).jacobian @ sent[-1] - twist) < 1e-3


def test_the_default_follows_from_the_acceleration_and_impossible_limits_are_named():
    robot = make_planar(acceleration_max=[4.0, 5.0, 6.0])
    np.testing.assert_array_equal(robot.jerk_max, [400.0, 500.0, 600.0])
    assert np.isinf(make_planar(jerk_max=np.inf).jerk_max).all()
    with pytest.raises(RobotError, match=r"jerk_max of joint '.*' is 3.0; .* 10 or more"):
        make_planar(jerk_max=3.0)
    with pytest.raises(RobotError, match='jerk_max has 2 values'):
        make_planar(jerk_max=[100.0, 200.0])
    with pytest.raises(RobotError, match='jerk_max'):
        make_planar(jerk_max=np.nan)
