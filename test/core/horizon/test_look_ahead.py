"""The joint path ahead makes no chatter: how it is moved on, switched to, and cut at the end."""

from __future__ import annotations

from closed_loop import DT
from conftest import examples, make_panda, make_paper_arm
from hypothesis import given, settings, strategies as st
import numpy as np
from path_problem import problem
import pytest

from benchmark.generator import generate
from benchmark.judge import reversals
from benchmark.robots import make_robot
from redundant_planner.core.horizon.horizon import Horizon
from redundant_planner.core.horizon.look_ahead import LookAhead
from redundant_planner.core.horizon.path_qp import Measures, moved_on, Plan
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.paper.experiment import paper_scenario


@settings(max_examples=examples(100), deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(2, 12), dt=st.floats(0.0, 2.0))
def test_a_plan_is_moved_on_by_interpolation(seed, count, dt):
    random = np.random.default_rng(seed)
    times = np.append(0.0, np.cumsum(random.uniform(0.01, 0.3, count)))
    later = np.append(0.0, np.cumsum(random.uniform(0.01, 0.3, count))) + dt
    start, nodes = random.normal(size=3), random.normal(size=(count, 3))
    postures = np.vstack((start, nodes))
    expected = np.column_stack([np.interp(later, times, joint) for joint in postures.T])
    np.testing.assert_allclose(moved_on(start, nodes, times, later), expected, atol=1e-12)


def test_an_arm_beside_its_plan_does_not_change_the_plans_velocity(planar):
    """Else each tick that does not improve the plan would pull the arm back to it."""
    q = np.array([0.2, 0.5, 0.3])
    qp, poses, maps = problem(planar, q, np.array([0.05, 0.02, 0.0, 0.0, 0.0, 0.0]))
    horizon = Horizon(planar, qp.times, qp.joints)
    for _ in range(10):
        planned = horizon.advance(q, poses, maps, 1e-9)
    aside = np.array([0.01, -0.02, 0.01])
    plan = horizon._moved_on(horizon._plan, q + DT * planned + aside, DT)
    velocity = (plan.nodes[0] - plan.start) / qp.times[1]
    # What is left comes of the path's own bends, and of the nodes' coming back to it.
    on_plan = horizon._moved_on(horizon._plan, q + DT * planned, DT)
    same = (on_plan.nodes[0] - on_plan.start) / qp.times[1]
    np.testing.assert_allclose(velocity, same - aside / qp.times[-1], atol=1e-9)


def look_ahead():
    planner = Planner(make_panda(), PlannerParameters())
    return planner._aiming._look_ahead


@pytest.mark.parametrize('free, expected', [(True, 0.4), (False, 0.02)])
def test_a_path_that_leads_nowhere_slows_down_with_the_tip(panda, free, expected):
    """In front of an obstacle the tip follows a twentieth of its command."""
    ahead = look_ahead()
    horizon = ahead._horizons[0]
    horizon._plan = Plan(
        np.zeros((len(horizon.times) - 1, panda.n)), np.zeros(panda.n), horizon.times,
        Measures(cost=0.0, error=0.0, intrusion=0.0 if free else 0.01, beyond=0.0))
    ahead._horizon, ahead._wanted = horizon, np.full(panda.n, 0.4)
    for _ in range(1000):
        ahead.note(0.05, DT)
        found = ahead._smoothed(DT)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_a_way_that_is_blocked_in_every_other_tick_switches_once():
    ahead = look_ahead()
    shares = []
    for tick in range(round(0.6 / DT)):
        ahead.switch(tick % 2 == 0, DT)
        shares.append(ahead.guided)
    assert (np.diff(shares) >= 0.0).all() and shares[-1] == 1.0
    for _ in range(round(1.5 / DT)):
        ahead.switch(False, DT)
        shares.append(ahead.guided)
    assert shares[-1] == 0.0
    # One way up and one way back.
    signs = np.sign(np.diff(shares))
    assert (np.diff(signs[signs != 0.0]) != 0.0).sum() == 1


def test_among_what_moves_it_turns_back_at_once():
    ahead = look_ahead()
    for _ in range(10):
        ahead.switch(True, DT, at_once=True)
    share = ahead.guided
    ahead.switch(False, DT, at_once=True)
    assert 0.0 < ahead.guided < share


def test_variational_follows_its_path_always():
    planner = Planner(make_panda(), PlannerParameters(method='variational'))
    assert isinstance(planner._aiming._look_ahead, LookAhead)
    planner._aiming._look_ahead.switch(False, DT)
    assert planner.guided == 1.0


def papers_scenario(method, announced):
    """Velocities (k, n) of the paper's scenario, announced so long before it begins [s]."""
    scenario, robot = paper_scenario(), make_paper_arm()
    planner, q = Planner(robot, PlannerParameters(method=method)), scenario.start_posture(robot)
    preview, scene, sent = scenario.preview(), Scene.of(scenario.obstacles), []
    for i in range(round((announced + scenario.duration) / DT)):
        now = i * DT - announced
        twist = scenario.twist_at(now) if now >= 0.0 else np.zeros(6)
        result = planner.step(q, twist, scene, DT, preview.ahead(now))
        q = q + DT * result.dq
        sent.append(result.dq)
    return np.array(sent)


def extrema(velocities):
    """How many extrema each joint's velocity has."""
    found = []
    for joint in velocities.T:
        changes = np.diff(joint)
        signs = np.sign(changes[np.abs(changes) > 1e-6])
        found.append((np.diff(signs) != 0.0).sum())
    return np.array(found)


@pytest.mark.parametrize('method', ['variational', 'dynamic_factor'])
def test_the_papers_scenario_has_one_smooth_curve_per_joint(method):
    """Announced as it begins, with an obstacle at the elbow: 83 extrema of the velocities once."""
    velocities = papers_scenario(method, 0.0)[round(0.1 / DT):round(2.7 / DT)]
    assert (extrema(velocities) <= 4).all()
    assert np.abs(np.diff(velocities, axis=0)).max() / DT < 1.5


def test_a_motion_announced_before_it_begins_starts_on_its_path():
    """One smooth curve per joint from the start on, and nothing moves before it."""
    sent, first = papers_scenario('dynamic_factor', 0.4), round(0.4 / DT)
    assert not sent[:first].any() and sent[first].any()
    # After the ticks that the acceleration limits take.
    velocities = sent[first + 5:first + round(2.7 / DT)]
    assert (extrema(velocities) <= 1).all()
    assert np.abs(np.diff(velocities, axis=0)).max() / DT < 0.2


def test_a_path_made_ready_in_vain_is_forgotten():
    """The operator announces a motion and then makes another one, away from the obstacle."""
    scenario, robot = paper_scenario(), make_paper_arm()
    fresh, ready = (Planner(robot, PlannerParameters()) for _ in range(2))
    q, scene, preview = scenario.start_posture(robot), Scene.of(), scenario.preview()
    for i in range(50):
        ready.step(q, np.zeros(6), scene, DT, preview.ahead(i * DT - 0.5))
    postures = {}
    for name, planner in (('fresh', fresh), ('ready', ready)):
        at = q
        for _ in range(100):
            at = at + DT * planner.step(at, scenario.twist_at(1.0), scene, DT).dq
        postures[name] = at
    np.testing.assert_allclose(postures['ready'], postures['fresh'], atol=1e-12)
    assert not ready._aiming._look_ahead._has_planned and ready.guided == 0.0


@pytest.mark.first_alone
@pytest.mark.parametrize('seed', [98005, 98012, 98016, 98021, 98026, 98028])
def test_the_path_takes_over_without_reversing_a_joint(seed):
    """Handed over within 0.1 s instead of 0.3 s, two or three joints of each motion do."""
    robot = make_robot('panda', 6)
    task, planner = generate(robot, seed), Planner(robot, PlannerParameters())
    scene, q, commands, guided = Scene.of(task.obstacles), task.start, [], 0.0
    for i in range(500):
        commands.append(planner.step(q, task.twist_at(i * DT), scene, DT).dq)
        q, guided = q + DT * commands[-1], max(guided, planner.guided)
    assert guided == 1.0
    assert reversals(np.diff(commands, axis=0) / DT, robot.acceleration_max) == 0
