"""All limits hold at any sequence of ticks, and whatever parameters change in motion."""

from __future__ import annotations

from dataclasses import replace

from conftest import EXAMPLE_ROBOTS, examples, make_panda, make_paper_arm, make_planar, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.joint_observer import JointObserver
from redundant_planner.core.safety.jerk import FadingMean, MeanVelocity, Smoothing
from redundant_planner.io.robot_files import Robot

ARMS = {
    'panda': make_panda(), 'paper': make_paper_arm(), 'planar': make_planar(jerk_max=150.0),
    'ur5': Robot.from_urdf(EXAMPLE_ROBOTS / 'ur_description' / 'urdf' / 'ur5_robot.urdf', 'tool0')}
ROUND_OFF = 1e-6
DT = 0.004
N = 3
# Lengths of ticks [s]: of any length, jittered by a fifth, two in turn, and an odd one at times.
ANY = st.floats(0.0005, 0.02)
PACES = st.one_of(
    st.lists(ANY, min_size=5, max_size=40), st.lists(st.floats(0.0032, 0.0048), min_size=5),
    st.lists(ANY, min_size=2, max_size=2), st.tuples(ANY, st.integers(3, 30)).map(
        lambda odd: [DT] * odd[1] + [odd[0]]))


class Judge:
    """Holds commands to the limits, from the commands alone.

    A velocity that holds for dt may differ from the one before by a·dt, and the accelerations of
    two ticks by j times the time between their middles.
    """

    def __init__(self, robot, q):
        self.robot, self.q = robot, np.array(q)
        self._dq = self._acceleration = np.zeros(robot.n)
        self._dt = None

    def take(self, result, dt):
        robot, dq = self.robot, result.dq
        acceleration = (dq - self._dq) / dt
        apart = dt if self._dt is None else 0.5 * (dt + self._dt)
        jerk = np.abs(acceleration - self._acceleration) / apart
        self.q = self.q + dt * dq
        assert (np.abs(dq) <= robot.velocity_max * (1.0 + ROUND_OFF)).all()
        assert (np.abs(acceleration) <= robot.acceleration_max * (1.0 + ROUND_OFF)).all()
        assert not result.jerk_kept or (jerk <= robot.jerk_max * (1.0 + ROUND_OFF)).all()
        assert (self.q <= robot.position_max + 1e-9).all()
        assert (self.q >= robot.position_min - 1e-9).all()
        self._dq, self._acceleration, self._dt = dq, acceleration, dt


def start(robot, random):
    low = np.where(np.isfinite(robot.position_min), robot.position_min, -3.0)
    high = np.where(np.isfinite(robot.position_max), robot.position_max, 3.0)
    return random.uniform(low + 0.05, high - 0.05)


def obstacles(random, count):
    return Scene.of([Obstacle(f'o{i}', random.uniform(-0.8, 0.8, 3) + [0.0, 0.0, 0.5],
                              random.uniform(0.02, 0.06, 3)) for i in range(count)])


@pytest.mark.parametrize('arm', ['panda', 'paper', 'planar'])
@settings(max_examples=examples(12), deadline=None, derandomize=True)
@given(pace=PACES, seed=st.integers(0, 10**6))
def test_all_limits_hold_whatever_the_sequence_of_ticks(arm, pace, seed):
    robot, random = ARMS[arm], np.random.default_rng(seed)
    judge, kept = Judge(robot, start(robot, random)), 0
    planner = Planner(robot, PlannerParameters(
        limits_position_margin=float(random.choice([0.0, 0.01]))))
    scene, twist = obstacles(random, int(random.choice([0, 3]))), np.zeros(6)
    for i in range(200):
        if i % 50 == 0:
            twist = random.normal(size=6) * random.choice([0.0, 0.3, 1.0, 3.0])
        result = planner.step(judge.q, twist, scene, pace[i % len(pace)])
        judge.take(result, pace[i % len(pace)])
        kept += result.jerk_kept
    assert kept > 150


@settings(max_examples=examples(100), deadline=None)
@given(seed=st.integers(0, 10**6), delay=st.floats(0.0, 0.1))
def test_a_fading_mean_is_exact_at_any_sequence_of_ticks(seed, delay):
    random = np.random.default_rng(seed)
    acceleration_max = random.uniform(1.0, 20.0, N)
    mean = FadingMean(delay, np.zeros(N), np.zeros(N))
    q = planned = sent = acceleration = np.zeros(N)
    plan = posture = random.uniform(-1.0, 1.0, N)
    lowest = highest = posture
    for _ in range(100):
        dt = random.uniform(0.0005, 0.02)
        planned = planned + random.choice([-1.0, 0.0, 1.0]) * acceleration_max * dt
        plan = plan + dt * planned
        lowest, highest = np.minimum(lowest, plan), np.maximum(highest, plan)
        before, rate, sent = sent, acceleration, mean.take(planned, dt)
        acceleration = (sent - before) / dt
        q = q + dt * sent
        # u = v + τ v̇, and the joints come to rest where the plan is.
        np.testing.assert_allclose(sent + delay * acceleration, planned, atol=1e-9)
        np.testing.assert_allclose(mean.stops_at(posture + q, dt), plan, atol=1e-9)
        assert (np.abs(acceleration) <= acceleration_max * (1.0 + ROUND_OFF)).all()
        assert (np.abs(acceleration - rate) <= 2.0 * acceleration_max * dt / (dt + delay)
                * (1.0 + ROUND_OFF)).all()
        # Each posture lies among the planned ones, so that a limit of positions holds as well.
        assert (posture + q >= lowest - 1e-9).all() and (posture + q <= highest + 1e-9).all()


def test_a_window_takes_over_again_once_ticks_are_alike():
    robot = ARMS['panda']
    limits = Planner(robot, PlannerParameters())._limits
    smoothing, q = Smoothing(robot.n, 0.02), np.array(PANDA_READY)
    kinds = []
    for i, dt in enumerate([DT] * 20 + [0.003] + [DT] * 20):
        smoothing.begin(q, limits, dt, at_once=False)
        dq = smoothing.latest + 0.2 * dt * (i < 30)
        q = q + dt * smoothing.take(dq)
        kinds.append(type(smoothing._mean))
        assert smoothing.keeps_jerk
    assert kinds == [MeanVelocity] * 20 + [FadingMean] * 6 + [MeanVelocity] * 15


@settings(max_examples=examples(30), deadline=None)
@given(seed=st.integers(0, 10**6), dead_time=st.floats(0.0, 0.05))
def test_commands_under_way_are_known_at_any_sequence_of_ticks(seed, dead_time):
    """A drive of pure dead time is where the commands of then have led."""
    random = np.random.default_rng(seed)
    observer = JointObserver(1, 0.0, dead_time)
    times, ways = [-1.0, 0.0], [0.0, 0.0]
    for _ in range(60):
        dt = random.uniform(0.001, 0.02)
        measured = np.array([np.interp(times[-1] - dead_time, times, ways)])
        posture = observer.sense(measured, dt)
        # A tick's command is taken to hold for the tick in which it began to act.
        assert abs(posture[0] - ways[-1]) < 0.02
        dq = np.array([np.sin(3.0 * times[-1])])
        observer.commanded(dq, dt)
        times.append(times[-1] + dt)
        ways.append(ways[-1] + dt * float(dq[0]))


CHANGES = {
    'limits_position_margin': (0.05, 0.1, 0.3, 0.5), 'clearance_margin': (0.05, 0.1, 0.3),
    'clearance_self_margin': (0.05, 0.2), 'clearance_gain': (0.1, 100.0),
    'clearance_lead': (0.5, 2.0), 'singularity_margin': (0.1, 0.3), 'cone_angle': (0.1, 0.5),
    'limits_linear_speed': (0.0, 0.05), 'limits_angular_speed': (0.0, 0.1),
    'path_priority': ('strict', 'slide'), 'method': ('variational',),
    'slow_down': (('o=0.3:1.0',),)}


@pytest.mark.first_alone
@pytest.mark.parametrize('name', list(CHANGES))
@settings(max_examples=examples(8), deadline=None, derandomize=True)
@given(arm=st.sampled_from(['panda', 'ur5', 'paper']), seed=st.integers(0, 10**6),
       ticks=st.integers(5, 150))
def test_all_limits_hold_when_a_bound_tightens_in_motion(name, arm, seed, ticks):
    robot, random = ARMS[arm], np.random.default_rng(seed)
    judge = Judge(robot, start(robot, random))
    parameters = PlannerParameters(limits_position_margin=float(random.choice([0.0, 0.01])))
    planner, scene = Planner(robot, parameters), obstacles(random, int(random.choice([0, 3])))
    twist = random.normal(size=6) * random.choice([0.3, 1.0, 3.0])
    value = CHANGES[name][random.integers(len(CHANGES[name]))]
    for i in range(ticks + 100):
        if i == ticks:
            try:
                planner.parameters = replace(parameters, **{name: value})
            except ParameterError:  # no range left
                return
        judge.take(planner.step(judge.q, twist, scene, DT), DT)
