"""The safety filter keeps every bound, whatever it is given."""

from __future__ import annotations

from conftest import examples, make_paper_arm
from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.safety.barriers import barriers_of
from redundant_planner.core.safety.limits import bounds_of_velocity, Limits, stopping_time
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.safety.stages import Request, safe_velocity

N, DT = 7, 0.004
LIMITS = Limits(np.outer([1.0, -1.0], np.ones(N)), np.full(N, 2.0),
                np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]), 0.0)
NO_BARRIERS = barriers_of(np.empty((0, N)), np.empty(0), np.empty(0))


def filtered(desired, jacobian, twist, q, previous, barriers=NO_BARRIERS, may_yield=False):
    still = np.zeros(len(twist))
    request = Request(desired, np.zeros_like(desired), jacobian, twist, still, still, q, previous)
    return safe_velocity(request, LIMITS, barriers, weights=np.ones(N), gain=10.0,
                         may_yield=may_yield, may_slide=False, dt=DT)


@settings(max_examples=examples(200), deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6), st.floats(-3.0, 6.0), st.integers(0, 12))
def test_bounds_hold_for_any_input(seed, m, magnitude, pairs):
    random = np.random.default_rng(seed)
    size = 10.0**magnitude
    barriers = barriers_of(random.normal(size=(pairs, N)), random.normal(size=pairs),
                        random.uniform(-1.0, 2.0, pairs))
    q = random.uniform(-1.2, 1.2, N)
    previous = random.uniform(-2.0, 2.0, N)
    result = filtered(size * random.normal(size=N), random.normal(size=(m, N)),
                      size * random.normal(size=m), q, previous, barriers)
    assert np.isfinite(result.dq).all()
    assert (np.abs(result.dq) <= LIMITS.velocity_max + 1e-9).all()
    assert 0.0 <= result.scale <= 1.0
    # Never further out than it is, and never past the limit within the tick.
    reached = q + DT * result.dq
    assert (reached <= np.maximum(LIMITS.positions[0], q) + 1e-9).all()
    assert (reached >= np.minimum(LIMITS.positions[1], q) - 1e-9).all()


@settings(max_examples=examples(100), deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 6))
def test_only_speed_gives_way_while_the_arm_speeds_up(seed, m):
    random = np.random.default_rng(seed)
    jacobian, twist = random.normal(size=(m, N)), random.normal(size=m)
    desired = np.linalg.pinv(jacobian) @ twist
    result = filtered(desired, jacobian, twist, random.uniform(-0.9, 0.9, N), np.zeros(N))
    assert result.stage in (Stage.DESIRED, Stage.SCALED)
    np.testing.assert_allclose(jacobian @ result.dq, result.scale * twist, atol=1e-6)
    assert (np.abs(result.dq) <= LIMITS.acceleration_max * DT + 1e-9).all()


@settings(max_examples=examples(60), deadline=None)
@example(seed=685)
@example(seed=824)
@example(seed=1241)
@given(seed=st.integers(0, 10**6))
def test_the_arm_always_stops_before_its_limits(seed):
    """From rest, driven anywhere at any speed for a second, then told to stop.

    The velocity bound is proved to be viable: braking is always possible, and position,
    velocity and acceleration limits hold in every tick.
    """
    random = np.random.default_rng(seed)
    q, dq = random.uniform(-1.0, 1.0, N), np.zeros(N)
    jacobian = random.normal(size=(3, N))
    twists = [*(random.normal(size=(4, 3)) * 3.0), np.zeros(3)]
    for tick in range(300):
        twist = twists[tick // 60]
        desired = np.linalg.pinv(jacobian) @ twist
        result = filtered(desired, jacobian, twist, q, dq)
        assert result.stage is not Stage.STOPPED and result.stage is not Stage.FORCED
        assert (np.abs(result.dq - dq) <= LIMITS.acceleration_max * DT + 1e-9).all()
        dq = result.dq
        q = q + DT * dq
        assert (np.abs(q) <= 1.0 + 1e-9).all()
    stop = 2.0 / LIMITS.acceleration_max.min()
    assert stop > 60 * DT or np.abs(dq).max() < 1e-9


def test_bounds_of_velocity_are_viable_one_joint_at_a_time():
    """Full speed at the limit until the bound says otherwise, then as hard as allowed."""
    limits = Limits(np.array([[1.0], [-1.0]]), np.array([2.0]), np.array([5.0]), 0.0)
    q, dq = np.array([-0.5]), np.array([0.0])
    for _ in range(1000):
        stop = stopping_time(dq, limits.acceleration_max) + DT
        _, upper, _ = bounds_of_velocity(q, dq, limits, stop, DT)
        assert abs(upper[0] - dq[0]) <= 5.0 * DT + 1e-12
        dq = upper
        q = q + DT * dq
        assert q[0] <= 1.0 + 1e-12
    assert q[0] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_a_joint_that_cannot_stop_in_time_says_so_and_brakes_as_hard_as_it_may(side):
    limits = Limits(np.array([[1.0, 1.0], [-1.0, -1.0]]), np.full(2, 2.0), np.full(2, 5.0), 0.0)
    for q, dq, stops in ((0.5, 0.5, True), (0.95, 1.5, False), (0.99, 0.05, True)):
        posture, previous = side * np.array([q, 0.0]), side * np.array([dq, 0.1])
        stop = stopping_time(previous, limits.acceleration_max) + DT
        lower, upper, kept = bounds_of_velocity(posture, previous, limits, stop, DT)
        assert kept is stops and (lower <= upper).all()
        # An acceleration limit gives way only where nothing else is left.
        hardest = side * (dq - 5.0 * DT)
        if not stops:
            assert lower[0] == upper[0] == pytest.approx(hardest)


def test_the_desired_velocity_passes_where_nothing_is_near():
    jacobian = np.random.default_rng(0).normal(size=(3, N))
    desired = np.full(N, 0.01)
    result = filtered(desired, jacobian, jacobian @ desired, np.zeros(N), desired)
    assert result.stage is Stage.SCALED and result.scale == pytest.approx(1.0)
    np.testing.assert_allclose(result.dq, desired, atol=1e-9)


def test_a_barrier_slows_the_twist_to_a_stop():
    # One joint, one axis: the only way not to approach is not to move.
    jacobian = np.eye(1, N)
    gradient = -np.eye(1, N)
    for clearance in (0.5, 0.05, 0.0):
        barriers = barriers_of(gradient, np.zeros(1), np.array([clearance]))
        at_speed = np.eye(1, N)[0] * 0.05 if clearance else np.zeros(N)
        result = filtered(np.eye(1, N)[0], jacobian, np.ones(1), np.zeros(N), at_speed, barriers)
        allowed = min(10.0 * clearance, 0.05 + 15.0 * DT)
        assert result.dq[0] == pytest.approx(allowed, abs=1e-6)
        assert result.scale == pytest.approx(allowed, abs=1e-6)
        if 10.0 * clearance < 0.05 + 15.0 * DT:
            assert list(result.pairs) == [0]


def test_the_null_space_goes_before_the_speed():
    # Joint 0 moves the tip, joint 1 moves nothing but the clearance.
    jacobian = np.eye(1, N)
    gradient = np.zeros((1, N))
    gradient[0, :2] = -1.0, 1.0
    barriers = barriers_of(gradient, np.zeros(1), np.zeros(1))
    result = filtered(np.eye(1, N)[0] * 0.02, jacobian, np.full(1, 0.02), np.zeros(N),
                      np.zeros(N), barriers)
    assert result.scale == pytest.approx(1.0, abs=1e-9)
    assert result.dq[1] >= result.dq[0] - 1e-9


def test_a_barrier_that_nothing_can_be_done_about_costs_the_others_nothing():
    gradient = np.zeros((2, N))
    gradient[1, 0] = 1.0
    barriers = barriers_of(gradient, np.array([-5.0, -0.03]), np.zeros(2))
    for may_yield in (False, True):
        result = filtered(np.zeros(N), np.eye(1, N), np.zeros(1), np.zeros(N), np.zeros(N),
                          barriers, may_yield=may_yield)
        assert result.stage is Stage.FORCED
        if may_yield:
            assert result.dq[0] == pytest.approx(0.03, abs=1e-3)


@pytest.mark.parametrize('spared', [0, 1])
def test_of_two_barriers_that_cannot_both_be_kept_what_is_in_hand_goes_first(spared):
    gradient = np.zeros((2, N))
    gradient[:, 0] = 1.0, -1.0
    spare = np.zeros(2)
    spare[spared] = 0.02
    barriers = barriers_of(gradient, np.full(2, -0.03), np.zeros(2), spare=spare)
    share = filtered(np.zeros(N), np.zeros((1, N)), np.zeros(1), np.zeros(N), np.zeros(N),
                     barriers._replace(spare=np.zeros(2)), may_yield=True).dq[0]
    assert abs(share) < 1e-3
    away = filtered(np.zeros(N), np.zeros((1, N)), np.zeros(1), np.zeros(N), np.zeros(N),
                    barriers, may_yield=True).dq[0]
    assert (-1.0 if spared == 0 else 1.0) * away > 0.02


def test_inside_the_margin_the_arm_moves_out():
    gradient = np.eye(1, N)
    barriers = barriers_of(gradient, np.zeros(1), np.array([-0.1]))
    dq = np.zeros(N)
    for _ in range(20):
        dq = filtered(np.zeros(N), np.zeros((1, N)), np.zeros(1), np.zeros(N), dq, barriers).dq
    assert dq[0] == pytest.approx(1.0, rel=0.05)  # gain 10 × 0.1


def test_same_inputs_give_the_same_output():
    random = np.random.default_rng(4)
    arguments = (random.normal(size=N), random.normal(size=(6, N)), random.normal(size=6),
                 random.uniform(-1, 1, N), random.normal(size=N))
    first, second = filtered(*arguments), filtered(*arguments)
    np.testing.assert_array_equal(first.dq, second.dq)
    assert first.stage is second.stage


@pytest.mark.first_alone
@pytest.mark.parametrize('delay', [1, 2])
@pytest.mark.parametrize('seed', range(3))
def test_old_measurements_cost_margin_but_no_acceleration_limit(delay, seed):
    """A drive's positions arrive some ticks late, as over topics: full speed into the limits."""
    robot = make_paper_arm()
    random = np.random.default_rng(seed)
    planner = Planner(robot, PlannerParameters(feedback_gain=0.0))
    dt, q = 0.004, np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])
    history, previous = [q] * (delay + 1), np.zeros(7)
    for i in range(1500):
        if i % 300 == 0:
            twist = np.append(random.normal(size=3), np.zeros(3)) * 0.3
        dq = planner.step(history[-1 - delay], twist, Scene.of(), dt).dq
        assert (np.abs(dq - previous) <= robot.acceleration_max * dt + 1e-9).all()
        q, previous = q + dt * dq, dq
        history.append(q)
        assert (q >= robot.position_min - 1e-9).all() and (q <= robot.position_max + 1e-9).all()
