"""The joint path ahead: its optimality conditions, and the closed loop."""

from __future__ import annotations

from closed_loop import random_scene
from conftest import examples, make_panda, make_paper_arm, MAKERS, PANDA_READY, random_postures
from hypothesis import given, settings, strategies as st
import numpy as np
from path_problem import problem, smooth
import pytest

from redundant_planner.core.horizon.horizon import Horizon
from redundant_planner.core.horizon.least_norm_path import least_norm_path
from redundant_planner.core.horizon.path_qp import PathQP
from redundant_planner.core.horizon.poses_ahead import middles
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.io.resources import share_directory
from redundant_planner.io.scenario import load_scenario

DT = 0.004
VARIATIONAL = PlannerParameters(method='variational')


@pytest.mark.parametrize('name', ['panda', 'panda_position', 'panda_tool', 'paper'])
def test_repeated_steps_arrive_at_a_stationary_path(name):
    """Without an obstacle Eq. 16 asks for no gradient in any node's null space."""
    robot = MAKERS[name]()
    q = np.clip(PANDA_READY, robot.position_min + 0.2, robot.position_max - 0.2)
    twist = robot.full_twist(robot.task_rows(np.array([0.1, 0.15, -0.1, 0.2, 0.1, -0.2])))
    qp, poses, maps = problem(robot, q, twist, seconds=2.0)
    horizon = Horizon(robot, qp.times, qp.joints)
    for _ in range(60):
        assert horizon.advance(q, poses, maps, 1e-12) is not None
    plan, local = qp.look(q, horizon.nodes, poses, maps)
    first, _ = qp.look(q, least_norm_path(robot, q, poses, qp.joints), poses, maps)
    assert plan.measures.error < 1e-6
    assert np.abs(local.linear).max() < 1e-4 * np.abs(first.measures.cost)
    assert plan.measures.cost < first.measures.cost * (1.0 + 1e-9)


def test_where_every_joint_moves_the_tip_alike_the_least_norm_path_is_the_shortest(planar):
    """A straight chain turned about its base: by symmetry nothing can be gained by bending."""
    qp, poses, maps = problem(planar, np.array([0.2, 0.5, 0.3]), np.zeros(6))
    horizon = Horizon(planar, qp.times, qp.joints)
    velocity = horizon.advance(np.array([0.2, 0.5, 0.3]), poses, maps, DT)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-9)


def run(planner, q, twist_at, scene, seconds, known):
    """The closed loop; return postures and results."""
    postures, results = [np.array(q, dtype=float)], []
    for i in range(round(seconds / DT)):
        now = i * DT
        ahead = (lambda times, now=now: twist_at(now + middles(times))) if known else None
        results.append(planner.step(postures[-1], twist_at(now), scene, DT, ahead))
        postures.append(postures[-1] + DT * results[-1].dq)
    return np.array(postures), results


@pytest.mark.first_alone
@pytest.mark.parametrize('make', [make_panda, lambda: make_panda(axes=AXES[:3]),
                                  make_paper_arm])
def test_the_joint_path_is_shorter_and_the_tip_on_its_line(make):
    robot = make()
    twist_at = smooth(robot.full_twist(robot.task_rows(
        np.array([0.05, -0.1, 0.05, 0.1, 0.0, -0.1]))))
    q = np.clip(PANDA_READY, robot.position_min + 0.2, robot.position_max - 0.2)
    line = robot.kinematics(q).tip_position + 1.5 * twist_at(1.5)[:3]
    effort = {}
    for known in (True, False):
        postures, results = run(
            Planner(robot, VARIATIONAL), q, twist_at, Scene.of(), 3.0, known)
        effort[known] = sum(r.dq @ r.dq for r in results)
        assert np.linalg.norm(robot.kinematics(postures[-1]).tip_position - line) < 1e-3
        assert all(np.abs(robot.kinematics(p).jacobian @ r.homogeneous).max() < 1e-9
                   for p, r in list(zip(postures, results))[::50])
    _, results = run(Planner(robot, PlannerParameters()), q, twist_at, Scene.of(), 3.0, False)
    usual = sum(r.dq @ r.dq for r in results)
    assert effort[True] <= effort[False] * 1.02
    assert effort[True] < usual


def test_an_arm_rests_when_its_profile_has_ended_next_to_an_obstacle():
    """A profile that ends with a step; the twist is there for one more tick than the preview."""
    scenario = load_scenario(share_directory() / 'config' / 'scenarios' / 'paper.yaml')
    robot, preview, scene = make_paper_arm(), scenario.preview(), Scene.of(scenario.obstacles)
    planner, q, moved = Planner(robot, VARIATIONAL), scenario.start_posture(make_paper_arm()), []
    for time in DT * np.arange(-250, 1000):
        ahead = (lambda times, now=time: preview.between(now + times)) if time <= 3.0 else None
        late = time - DT
        twist = scenario.twist_at(late) if 0.0 <= late < 3.0 else np.zeros(6)
        result = planner.step(q, twist, scene, DT, ahead)
        q = q + DT * result.dq
        moved.append(DT * np.abs(result.dq).sum())
    assert sum(moved) < 0.6
    assert sum(moved[252 + 750:]) < 0.005


def test_the_same_inputs_give_the_same_motion(panda):
    twist_at = smooth(np.array([0.1, 0.1, -0.1, 0.2, 0.0, 0.0]))
    scene = Scene.of(random_scene(panda, 3))
    first, second = (run(Planner(panda, VARIATIONAL), PANDA_READY, twist_at, scene, 0.6, True)[0]
                     for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_without_a_plan_dynamic_factor_steps_in_and_says_so(panda, monkeypatch):
    planner, usual = Planner(panda, VARIATIONAL), Planner(panda, PlannerParameters())
    monkeypatch.setattr(Horizon, 'advance', lambda *_: None)
    twist = np.array([0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
    result = planner.step(PANDA_READY, twist, Scene.of(), DT)
    assert 'dynamic_factor steps in' in result.reason
    np.testing.assert_array_equal(
        result.dq, usual.step(PANDA_READY, twist, Scene.of(), DT).dq)


def test_a_command_that_turns_about_is_planned_anew_one_look_at_a_time(panda, monkeypatch):
    """The plan is looked at, then a new one: two looks in a tick would be its longest part."""
    looks, anew, look = [], [], PathQP.look

    def counted_look(*arguments):
        looks[-1] += 1
        return look(*arguments)

    def counted_path(*arguments):
        anew[-1] += 1
        return least_norm_path(*arguments)

    monkeypatch.setattr(PathQP, 'look', counted_look)
    monkeypatch.setattr('redundant_planner.core.horizon.horizon.least_norm_path', counted_path)
    planner, q = Planner(panda, VARIATIONAL), PANDA_READY
    scene, twist = Scene.of(random_scene(panda, 3)), np.array([0.2, 0.1, -0.1, 0.2, 0.0, 0.0])
    for i in range(200):
        looks.append(0)
        anew.append(0)
        q = q + DT * planner.step(q, twist if i % 50 < 25 else -twist, scene, DT).dq
    assert max(looks) == 1 and sum(looks) > 50
    # Within a few ticks of every turn.
    assert all(sum(anew[turn:turn + 6]) > 0 for turn in range(25, 200, 25))


def test_an_arm_without_a_spare_joint_has_no_choice(planar):
    from conftest import make_planar
    robot = make_planar(axes=('vx', 'vy', 'wz'))
    twist = np.array([0.05, 0.02, 0, 0, 0, 0.1])
    q = np.array([0.3, 0.8, 0.4])
    results = [Planner(robot, parameters).step(q, twist, Scene.of(), DT)
               for parameters in (VARIATIONAL, PlannerParameters())]
    np.testing.assert_allclose(results[0].dq, results[1].dq, atol=1e-12)
    assert results[0].reason == results[1].reason


def test_a_resting_arm_stays_where_it_is(panda):
    postures, results = run(Planner(panda, VARIATIONAL), PANDA_READY, smooth(np.zeros(6)),
                            Scene.of(random_scene(panda, 1)[:1]), 1.0, False)
    if all(r.stage.name == 'DESIRED' for r in results):
        assert np.abs(postures - PANDA_READY).max() < 1e-6


@settings(max_examples=examples(15), deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_limits_hold_whatever_is_commanded_and_whatever_appears(seed, known):
    """Reversals, jumps of the command, obstacles that come, go and move, poses out of reach."""
    robot = _PANDA
    random = np.random.default_rng(seed)
    planner = Planner(robot, VARIATIONAL)
    q, previous = random_postures(robot, 1, seed)[0], np.zeros(7)
    for _ in range(4):
        twist = random.normal(size=6) * random.choice([0.0, 0.1, 1.0, 100.0])
        scene = Scene.of(random_scene(robot, int(random.integers(1000)),
                                      int(random.integers(0, 4))))
        for _ in range(12):
            ahead = (lambda times, t=twist: np.tile(t, (len(times) - 1, 1))) if known else None
            result = planner.step(q, twist, scene, DT, ahead)
            assert np.isfinite(result.dq).all()
            assert (np.abs(result.dq) <= robot.velocity_max + 1e-9).all()
            assert (np.abs(result.dq - previous) <= robot.acceleration_max * DT + 1e-9).all()
            previous, q = result.dq, q + DT * result.dq
            assert (q >= robot.position_min - 1e-9).all()
            assert (q <= robot.position_max + 1e-9).all()


_PANDA = make_panda()
