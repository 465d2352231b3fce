"""The whole tick in closed loop: trends, identities and the paper's own numbers."""

from __future__ import annotations

from closed_loop import drive, DT, NOTHING, smallest_level
from conftest import (
    examples,
    make_panda,
    make_paper_arm,
    make_planar,
    PANDA_READY,
    random_postures,
)
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.constants import limits_of, robot_constants
from redundant_planner.core.errors import ParameterError, StateError
from redundant_planner.core.horizon.evasive_plan import EvasivePlan
from redundant_planner.core.horizon.horizon import Horizon
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import AXES, PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.capsules import Capsule
from redundant_planner.core.robot.se3 import integrate
from redundant_planner.core.safety.limits import stopping_time
from redundant_planner.core.safety.self_motion import fastest_self_motion, STRAY, STRAY_ANGLE
from redundant_planner.core.safety.stage import Stage
from redundant_planner.paper.method import PaperPlanner

# Nothing but Eqs. 1, 2 and 18, where no filter acts.
BARE = {'clearance_smoothing': 0.0, 'clearance_influence_distance': np.inf,
        'singularity_damping': 0.0, 'singularity_damping_threshold': 0.0,
        'feedback_gain': 0.0, 'clearance_margin': 0.0, 'limits_position_margin': 0.0,
        'criteria_k_w': 1.0, 'criteria_k_m': 0.0}


def commanded(robot, twists):
    """Twists (6 t,) as `step` takes them."""
    return twists if len(robot.tips) == 1 else twists.reshape(-1, 6)


def test_equation_1_holds_term_by_term(robot):
    """J q̇ = ẋ and J (k P∇H) = 0 for any gradient, where nothing is damped or filtered."""
    obstacle = Scene.of([Obstacle('o', np.array([0.3, 0.2, 0.5]), np.full(3, 0.1))])
    random = np.random.default_rng(0)
    planner = Planner(robot, PlannerParameters(**BARE, criteria_k_s=0.5, criteria_k_f=0.3),
                      filtered=False)
    for q in random_postures(robot, 20):
        planner.reset()
        twist = 0.1 * random.normal(size=6 * len(robot.tips))
        result = planner.step(q, commanded(robot, twist), obstacle, DT)
        jacobian = robot.kinematics(q).jacobian
        np.testing.assert_allclose(jacobian @ result.dq, robot.task_rows(twist), atol=1e-9)
        np.testing.assert_allclose(jacobian @ result.homogeneous, 0.0, atol=1e-10)
        np.testing.assert_allclose(result.dq, result.least_norm + result.homogeneous)
        # Eq. 2 bounds the homogeneous part by kα times the least-norm part.
        assert (np.linalg.norm(result.homogeneous)
                <= planner.parameters.criteria_k_alpha * np.linalg.norm(result.least_norm)
                * (1 + 1e-9))


def test_the_reference_pose_is_the_command_integrated_and_the_callers_to_keep(robot):
    random = np.random.default_rng(1)
    planner = Planner(robot, PlannerParameters(**BARE), filtered=False)
    for q in random_postures(robot, 10):
        planner.reset()
        twist = robot.full_twist(robot.task_rows(0.1 * random.normal(size=6 * len(robot.tips))))
        expected = [integrate(pose, part, DT, robot.in_tool) for pose, part in zip(
            robot.kinematics(q).tips.each, twist.reshape(-1, 6))]
        planner.step(q, commanded(robot, twist), NOTHING, DT)
        references = planner.references
        planner.step(q, commanded(robot, -twist), NOTHING, DT)
        for reference, wanted in zip(references.each, expected):
            np.testing.assert_allclose(reference.position, wanted.position, atol=1e-9)
            np.testing.assert_allclose(reference.rotation, wanted.rotation, atol=1e-9)


@pytest.mark.parametrize(('gains', 'column', 'tolerance'), [
    ({'method': 'paper_gradient_projection', 'criteria_k_fixed': 6.2e-4, 'criteria_k_f': 0.0},
     [0.1950, 0.1416, -0.1154, 0.3755, -0.6731, 0.9528], 0.003),
    ({'method': 'paper', 'criteria_k_alpha': 0.80969, 'criteria_k_s': 95.38,
      'criteria_k_f': 7.924e4},
     [0.1586, 0.09307, -0.1110, 0.3871, -0.598, 0.9956], 0.002),
])
def test_table_1_of_the_paper(paper_arm, gains, column, tolerance):
    scene = Scene.of([Obstacle('o', np.array([0, 0.55, 0.45]), np.array([0.05, 0.03, 0.03]))])
    planner = PaperPlanner(paper_arm, PlannerParameters(criteria_k_w=1.0, **gains))
    twist = np.array([-0.029, -0.05, 0.011 / 3.0, 0.0, 0.0, 0.0])
    postures, _ = drive(planner, [0.1, 0.1, 0, 0.5233, -0.5233, 1.0467, 0], twist, scene, 3.0,
                        0.01)
    np.testing.assert_allclose(postures[-1][:6], column, atol=tolerance)


def test_whole_links_stay_clear_and_the_tip_on_its_line(paper_arm):
    obstacle = Obstacle('o', np.array([0, 0.55, 0.45]), np.array([0.05, 0.03, 0.03]))
    scene = Scene.of([obstacle])
    twist = np.array([-0.029, -0.05, 0.011 / 3.0, 0.0, 0.0, 0.0])
    start = np.array([0.1, 0.1, 0, 0.5233, -0.5233, 1.0467, 0])
    for method in ('dynamic_factor', 'gradient_projection'):
        planner = Planner(paper_arm, PlannerParameters(method=method))
        postures, results = drive(planner, start, twist, scene, 3.0)
        assert smallest_level(paper_arm, postures, scene) > 0.0
        first = paper_arm.kinematics(start).tip_position
        for q in postures[::10]:
            off = paper_arm.kinematics(q).tip_position - first
            along = twist[:3] / np.linalg.norm(twist[:3])
            assert np.linalg.norm(off - along * (off @ along)) < 1e-4
        assert {r.stage for r in results} <= {Stage.DESIRED, Stage.SCALED}


def test_without_the_filter_the_papers_links_pass_through(paper_arm):
    # DESIGN §2.5: S ≈ −0.5 on the links while every joint has S > 5.
    scene = Scene.of([Obstacle('o', np.array([0, 0.55, 0.45]), np.array([0.05, 0.03, 0.03]))])
    column = np.array([0.1586, 0.09307, -0.1110, 0.3871, -0.598, 0.9956, 0.0])
    level = smallest_level(paper_arm, [column], scene)
    assert (level + 1.0) ** 2 - 1.0 == pytest.approx(-0.5, abs=0.06)


@pytest.mark.parametrize('frame', ['base', 'tool'])
def test_a_pure_rotation_leaves_the_tip_point_where_it_is(frame):
    robot = make_panda(command_frame=frame)
    planner = Planner(robot, PlannerParameters())
    twist = np.array([0, 0, 0, 0, 0, 0.5])
    postures, results = drive(planner, PANDA_READY, twist, seconds=3.0)
    first = robot.kinematics(PANDA_READY)
    tips = np.array([robot.kinematics(q).tip_position for q in postures])
    assert np.linalg.norm(tips - first.tip_position, axis=1).max() < 5e-5
    turned = sum(r.scale for r in results) * DT * 0.5
    last = robot.kinematics(postures[-1]).tip_rotation
    angle = np.arccos((np.trace(last @ first.tip_rotation.T) - 1.0) / 2.0)
    assert angle == pytest.approx(turned, abs=1e-3)


def test_feedback_takes_drift_back_and_open_loop_keeps_it(panda):
    twist = np.array([0.05, 0.05, -0.03, 0.1, 0.0, 0.2])
    errors = {}
    for gain in (0.0, 5.0):
        planner = Planner(panda, PlannerParameters(feedback_gain=gain))
        _, results = drive(planner, PANDA_READY, twist, seconds=4.0, dt=0.01)
        errors[gain] = np.linalg.norm(results[-1].path_error[:3])
    assert errors[5.0] < 0.2 * errors[0.0]
    assert errors[5.0] < 1e-4


def test_a_pushed_arm_comes_back_smoothly(panda):
    planner = Planner(panda, PlannerParameters())
    postures, _ = drive(planner, PANDA_READY, np.zeros(6), seconds=0.1)
    moved = postures[-1] + 0.02
    postures, results = drive(planner, moved, np.zeros(6), seconds=3.0)
    errors = [np.linalg.norm(r.path_error) for r in results]
    assert errors[-1] < 0.01 * errors[0]
    speeds = np.diff([r.dq for r in results], axis=0, prepend=np.zeros((1, 7)))
    assert (np.abs(speeds) <= panda.acceleration_max * DT + 1e-9).all()


def test_the_null_space_is_handed_over_on_the_way_into_something_and_back_on_the_way_out(panda):
    # A ball where the forearm is about to be.
    up, link = np.array([0.0, 0.0, 0.08, 0.0, 0.0, 0.0]), 5
    assert panda.capsules[link].name == 'link5'
    plain, _ = drive(Planner(panda, PlannerParameters()), PANDA_READY, up, seconds=2.0)
    before, after = (0.5 * (arm.segment_start[link] + arm.segment_end[link])
                     for arm in (panda.kinematics(q) for q in (PANDA_READY, plain[-1])))
    way = (after - before) / np.linalg.norm(after - before)
    scene = Scene.of([Obstacle(
        'ball', after + (panda.capsules[link].radius + 0.02) * way, np.full(3, 0.03))])

    planner = Planner(panda, PlannerParameters())
    q, shares, previous = PANDA_READY, [], np.zeros(7)
    for i in range(1250):
        result = planner.step(q, up if i < 500 else -up, scene, DT)
        shares.append(planner.guided)
        np.testing.assert_allclose(
            panda.kinematics(q).jacobian @ result.homogeneous, 0.0, atol=1e-9)
        assert result.scale == pytest.approx(1.0) or i % 500 < 20  # takes up speed, turns
        assert (np.abs(result.dq - previous) <= panda.acceleration_max * DT + 1e-9).all()
        assert result.nearest.beyond_margin > 0.0
        q, previous = q + DT * result.dq, result.dq
    changes = np.diff(shares, prepend=0.0)
    assert shares[0] == 0.0 and max(shares) == 1.0 and shares[-1] == 0.0
    assert changes.max() <= DT / 0.1 + 1e-9 and changes.min() >= -DT / 1.0 - 1e-9


@pytest.mark.parametrize('obstacles', [0, 3])
def test_where_nothing_lies_ahead_equation_2_is_all_there_is(panda, obstacles):
    twist = np.array([0.02, 0.03, -0.02, 0.05, 0.0, 0.1])
    scene = Scene.of([Obstacle(f'o{i}', np.array([1.0, 0.3 * i, 1.0]), np.full(3, 0.05))
                      for i in range(obstacles)])
    plain, _ = drive(
        Planner(panda, PlannerParameters(horizon_look_ahead=0.0)), PANDA_READY, twist, scene)
    ahead, results = drive(Planner(panda, PlannerParameters()), PANDA_READY, twist, scene)
    np.testing.assert_array_equal(plain, ahead)
    for result in results[1:]:
        size = np.linalg.norm(result.least_norm)
        projected = np.linalg.norm(result.homogeneous) / result.factor
        assert result.factor == pytest.approx(
            PlannerParameters().criteria_k_alpha * size / (size + projected))


def test_in_a_crowd_nothing_is_planned(panda):
    arm = panda.kinematics(PANDA_READY)
    center = arm.segment_end[4] + [panda.capsules[4].radius + 0.08, 0.0, 0.0]
    one = Obstacle('ball', center, np.full(3, 0.03))
    crowd = [one, *(Obstacle(f'o{i}', center + [0.1, 0.0, 0.001 * i], np.full(3, 0.03))
                    for i in range(60))]
    twist = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    for obstacles, plans in (([one], True), (crowd, False)):
        planner = Planner(panda, PlannerParameters())
        drive(planner, PANDA_READY, twist, Scene.of(obstacles), seconds=0.3)
        assert (planner.guided > 0.0) == plans


def test_at_a_high_rate_not_every_tick_plans(panda, monkeypatch):
    planned, advance = [], Horizon.advance
    monkeypatch.setattr(Horizon, 'advance', lambda self, q, poses, maps, dt: (
        planned.append(dt) or advance(self, q, poses, maps, dt)))
    twist = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    postures = {}
    for dt, expected in ((0.004, 0.004), (0.001, 0.003)):
        planned.clear()
        planner = Planner(panda, PlannerParameters(method='variational'))
        postures[dt], _ = drive(planner, PANDA_READY, twist, seconds=0.6, dt=dt)
        np.testing.assert_allclose(planned[1:], expected)
    np.testing.assert_allclose(postures[0.001][-1], postures[0.004][-1], atol=2e-3)


@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_paths_are_improved_after_the_command_and_it_makes_no_difference_when(
        panda, method, monkeypatch):
    """Among a ball that passes and others that stand, with a reset on the way."""
    improved_in = []

    def note(kind, name):
        original = getattr(kind, name)

        def noted(*arguments):
            improved_in.append((where, name))
            return original(*arguments)

        monkeypatch.setattr(kind, name, noted)

    note(Horizon, 'advance')
    note(EvasivePlan, '_step')
    tip = panda.kinematics(PANDA_READY).tip_position
    ball = Obstacle('ball', tip + [0.1, 0.35, 0.0], [0.05] * 3, velocity=[0.0, -0.3, 0.0])
    post = Obstacle('post', tip + [0.15, 0.1, -0.1], [0.04] * 3)
    twist, q = np.array([0.1, 0.03, 0.0, 0.0, 0.0, 0.2]), PANDA_READY
    planners = [Planner(panda, PlannerParameters(method=method)) for _ in range(2)]
    for i in range(500):
        scene = Scene.of([ball.after(i * DT), post])
        where = 'step'
        prepared, plain = (planner.step(q, twist, scene, DT) for planner in planners)
        np.testing.assert_array_equal(prepared.dq, plain.dq)
        assert prepared.reason == plain.reason
        where = 'prepare'
        planners[0].prepare(scene)
        if i == 300:
            for planner in planners:
                planner.reset()
        q = q + DT * plain.dq
    for name in ('advance', '_step'):
        count, by_the_other = (improved_in.count((w, name)) for w in ('prepare', 'step'))
        # First paths are planned at once, and a reset drops what was due.
        assert count > 30 and abs(by_the_other - count) < 8


def test_where_the_joint_path_ahead_leads_nowhere_the_arm_rests_at_its_end(paper_arm):
    """Stretched out, with the command still on: it does not go on trying."""
    start = np.array([0.35, 0.1, 0, 0.5233, -0.5233, 1.0467, 0])
    twist = np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    planner = Planner(paper_arm, PlannerParameters())
    postures, _ = drive(planner, start, twist, seconds=6.0)
    assert np.abs(postures[-1] - postures[-250]).max() < 1e-3
    assert planner.guided < 0.1


def test_position_only_control_leaves_orientation_free():
    robot = make_panda(axes=AXES[:3])
    planner = Planner(robot, PlannerParameters())
    twist = np.array([0.05, 0.0, 0.0, 9.0, 9.0, 9.0])  # rotation is not controlled: no effect
    postures, results = drive(planner, PANDA_READY, twist, seconds=2.0)
    moved = (robot.kinematics(postures[-1]).tip_position
             - robot.kinematics(PANDA_READY).tip_position)
    travelled = 0.05 * DT * sum(r.scale for r in results)
    np.testing.assert_allclose(moved, [travelled, 0.0, 0.0], atol=1e-4)


def test_joint_weights_move_the_motion_to_the_cheap_joints(paper_arm):
    twist = np.array([0.0, 0.05, 0.05, 0.0, 0.0, 0.0])
    start = np.array([0.1, 0.1, 0, 0.5233, -0.5233, 1.0467, 0])
    paths = []
    for weight in (1.0, 100.0):
        planner = Planner(paper_arm, PlannerParameters(
            criteria_joint_weights=(weight, weight, *[1.0] * 5)))
        postures, _ = drive(planner, start, twist)
        paths.append(np.abs(np.diff(postures[:, :2], axis=0)).sum())
    assert paths[1] < 0.25 * paths[0]


def test_too_fast_a_command_is_slowed_in_its_own_direction(panda):
    slow, fast = (Planner(panda, PlannerParameters(limits_linear_speed=0.1)) for _ in range(2))
    direction = np.array([0.06, 0.08, 0.0, 0.0, 0.0, 0.0])
    a, _ = drive(slow, PANDA_READY, direction)
    b, _ = drive(fast, PANDA_READY, 1e200 * direction)
    np.testing.assert_allclose(a, b, atol=1e-9)


@settings(max_examples=examples(40), deadline=None)
@given(st.integers(0, 10**6), st.floats(-3.0, 300.0),
       st.sampled_from([0, 1, 2, 3, 5, 8, 30, 300]))
def test_limits_hold_whatever_comes(seed, magnitude, obstacles):
    """Random states, absurd commands, links of no length, obstacles anywhere by the hundred."""
    random = np.random.default_rng(seed)
    robot = ARM[seed % len(ARM)]
    scene = Scene.of([
        Obstacle(f'o{i}', random.uniform(-0.6, 0.6, 3), random.uniform(0.01, 0.3, 3),
                 velocity=random.normal(size=3)) for i in range(obstacles)])
    planner = Planner(robot, PlannerParameters())
    q = random_postures(robot, 1, seed)[0]
    previous = np.zeros(robot.n)
    for _ in range(15):
        twist = np.clip(random.normal(size=6) * 10.0**magnitude, -1e300, 1e300)
        result = planner.step(q, twist, scene, DT)
        assert np.isfinite(result.dq).all()
        assert (np.abs(result.dq) <= robot.velocity_max + 1e-9).all()
        assert (np.abs(result.dq - previous) <= robot.acceleration_max * DT + 1e-9).all()
        previous, q = result.dq, q + DT * result.dq
        assert (q <= robot.position_max + 1e-9).all() and (q >= robot.position_min - 1e-9).all()


POINTS = [Capsule(f'point{i}', f'link{i}', np.full(3, 0.05), np.full(3, 0.05), 0.04 * (i % 2))
          for i in (1, 2, 3)]
ARM = [make_paper_arm(), make_panda(), make_planar(capsules=POINTS),
       make_panda(command_frame='tool')]


def test_every_tick_can_be_replayed(panda):
    scene = Scene.of([Obstacle('o', np.array([0.4, 0.1, 0.5]), np.full(3, 0.08))])
    runs = [drive(Planner(panda, PlannerParameters()), PANDA_READY,
                  lambda t: np.array([0.1 * np.sin(t), 0.1, 0, 0, 0, 0.2]), scene)[0]
            for _ in range(2)]
    np.testing.assert_array_equal(*runs)


def test_arguments_are_not_changed(panda):
    q, twist = PANDA_READY.copy(), np.ones(6) * 50.0
    Planner(panda, PlannerParameters()).step(q, twist, NOTHING, DT)
    np.testing.assert_array_equal(q, PANDA_READY)
    np.testing.assert_array_equal(twist, 50.0)


def test_what_slows_the_arm_is_named(paper_arm):
    # Up against d1's upper limit with everything else costly.
    planner = Planner(paper_arm, PlannerParameters())
    start = np.array([0.35, 0.1, 0, 0.5233, -0.5233, 1.0467, 0])
    _, results = drive(planner, start, np.array([0.0, 0.0, 0.3, 0, 0, 0]), seconds=6.0)
    stopped = [r for r in results if r.scale < 0.5 and r.reason]
    assert stopped and "joint 'd1' at its limit" in stopped[-1].reason


@pytest.mark.parametrize(('twist', 'dt', 'message'), [
    (np.zeros(5), DT, 'six finite numbers'), (np.full(6, np.nan), DT, 'six finite numbers'),
    (np.zeros(6), 0.0, 'dt is 0.0'), (np.zeros(6), np.nan, 'dt is nan'),
    (np.zeros(6), 5e-324, 'it must be 0.0001 s or longer')])
def test_bad_input_is_refused_and_changes_nothing(panda, twist, dt, message):
    planner, twin = (Planner(panda, PlannerParameters()) for _ in range(2))
    with pytest.raises(StateError, match=message):
        planner.step(PANDA_READY, twist, NOTHING, dt)
    good = np.array([0.1, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(planner.step(PANDA_READY, good, NOTHING, DT).dq,
                                  twin.step(PANDA_READY, good, NOTHING, DT).dq)


def test_parameters_that_do_not_fit_the_robot_are_refused(panda):
    with pytest.raises(ParameterError, match=r"joint_weights' has 2 entries; it takes 7"):
        Planner(panda, PlannerParameters(criteria_joint_weights=(1.0, 2.0)))
    with pytest.raises(ParameterError, match=r"position_margin' is 0.5; joint 'd1' has no"):
        Planner(make_paper_arm(), PlannerParameters(limits_position_margin=0.5))


@pytest.mark.first_alone
@pytest.mark.parametrize(('make', 'start', 'direction'), [
    (make_panda, PANDA_READY, [0.3, 0.0, 0.1]),
    (lambda: make_panda(axes=AXES[:3]), PANDA_READY, [0.0, 0.0, 0.3]),
    (make_paper_arm, [0.1, 0.1, 0, 0.5, -0.5, 1.0, 0], [0.0, 0.3, 0.3]),
    (make_planar, [0.3, 0.4, 0.3], [0.3, 0.1, 0.0]),
])
def test_into_a_singularity_and_out_again(make, start, direction):
    """Outwards until nothing goes any more, then back: on the line, within limits, at once."""
    robot = make()
    planner = Planner(robot, PlannerParameters())
    out = np.array([*direction, 0.0, 0.0, 0.0])
    postures, results = drive(planner, start, lambda t: out if t < 5.0 else -out, seconds=7.0)
    tips = np.array([robot.kinematics(q).tip_position for q in postures]) - robot.kinematics(
        start).tip_position
    along = out[:3] / np.linalg.norm(out[:3])
    assert np.linalg.norm(tips - np.outer(tips @ along, along), axis=1).max() < 1e-3
    velocities = np.array([r.dq for r in results])
    changes = np.abs(np.diff(velocities, axis=0, prepend=np.zeros((1, robot.n))))
    assert (np.abs(velocities) <= robot.velocity_max + 1e-9).all()
    assert (changes <= robot.acceleration_max * DT + 1e-9).all()
    turn = round(5.0 / DT)
    assert results[turn - 1].scale < 0.05  # it had come to its end
    back = (tips[turn] - tips[turn + round(1.0 / DT)]) @ along
    assert back > 0.5 * np.linalg.norm(out[:3])  # and one second later it is well on its way


def sweep(robot, path_priority, axis, lead=0.1, speed=0.2):
    """A ball that crosses the resting arm's fifth link; distances, errors and results."""
    planner = Planner(robot, PlannerParameters(
        path_priority=path_priority, clearance_lead=lead))
    arm = robot.kinematics(PANDA_READY)
    link = [c.name for c in robot.capsules].index('link5')
    middle = 0.5 * (arm.segment_start[link] + arm.segment_end[link])
    velocity = speed * np.array(axis)
    q, distances, results = PANDA_READY, [], []
    for i in range(round(14.0 / DT)):
        center = middle + velocity * (i * DT - 2.0)
        scene = Scene.of([Obstacle('ball', center, np.full(3, 0.06), velocity=velocity)])
        results.append(planner.step(q, np.zeros(6), scene, DT))
        q = q + DT * results[-1].dq
        distances.append(results[-1].nearest.beyond_margin)
    errors = [np.linalg.norm(r.path_error[:3]) for r in results]
    return np.array(distances), np.array(errors), results


@pytest.mark.first_alone
@pytest.mark.parametrize(('axis', 'leaves'), [
    ([1.0, 0.0, 0.0], True), ([0.0, 1.0, 0.0], None), ([-0.6, 0.0, 0.8], True)])
@pytest.mark.parametrize('lead', [0.0, 0.1])
def test_a_resting_arm_evades_what_moves_into_it_and_comes_back(panda, axis, leaves, lead):
    distances, errors, results = sweep(panda, 'yield', axis, lead)
    assert distances.min() > -0.01  # the margin may be used, the arm is not hit
    assert errors[-1] < 1e-3
    left = [r for r in results if r.stage is Stage.YIELDING]
    if lead == 0.0 and leaves is not None:  # sideways, null-space motion alone may be enough
        assert left
    if leaves:
        assert "obstacle 'ball'" in left[0].reason and 'leaves its path' in left[0].reason


def test_a_strict_arm_does_not_leave_its_path(panda):
    distances, errors, results = sweep(panda, 'strict', [1.0, 0.0, 0.0])
    assert errors.max() < 1e-3
    assert distances.min() < -0.01  # and is hit
    assert not any(r.stage is Stage.YIELDING for r in results)


def test_an_arm_found_inside_an_obstacle_moves_out_and_never_deeper(panda):
    arm = panda.kinematics(PANDA_READY)
    link = [c.name for c in panda.capsules].index('link5')
    center = 0.5 * (arm.segment_start[link] + arm.segment_end[link]) + [0.05, 0.03, 0.0]
    scene = Scene.of([Obstacle('ball', center, np.full(3, 0.07))])
    _, results = drive(Planner(panda, PlannerParameters()), PANDA_READY, np.zeros(6), scene, 3.0)
    distances = np.array([r.nearest.beyond_margin for r in results])
    assert distances[0] < -0.03
    assert (np.diff(distances) > -1e-5).all()
    assert distances[-1] > -1e-3


@pytest.mark.parametrize('limit', ['limits_linear_speed', 'limits_angular_speed'])
def test_a_speed_limit_of_zero_stops_the_arm(panda, limit):
    planner = Planner(panda, PlannerParameters(**{limit: 0.0}))
    twist = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.3])
    for _ in range(20):
        result = planner.step(PANDA_READY, twist, Scene.of(), 0.004)
    assert np.abs(result.dq).max() < 1e-9


@pytest.mark.parametrize('margin', [0.005, 0.01, 0.02, 0.03])
def test_a_joint_that_brakes_with_the_others_uses_half_its_margin_at_most(paper_arm, margin):
    """Other joints take longer to stop than the rail, which is already near its end."""
    q = [0.35, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0]
    postures, _ = drive(
        Planner(paper_arm, PlannerParameters(limits_position_margin=margin)), q,
        np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0]), seconds=2.0)
    assert (paper_arm.position_max[0] - postures[:, 0]).min() >= 0.49 * margin


@pytest.mark.parametrize('margin', [0.15, 0.1999])
def test_a_margin_that_grows_over_a_moving_arm_brakes_it_within_the_acceleration_limits(margin):
    """Found deep inside the margin on its way out, it stops on what is left of it."""
    robot = make_paper_arm()
    planner, dt = Planner(robot, PlannerParameters()), 0.004
    q, dq = np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0]), np.zeros(robot.n)
    twist = np.array([-0.029, -0.05, 0.004, 0.0, 0.0, 0.0])
    # Where rails d1 and d2 have 0.1 m to their lower ends.
    for i in range(60):
        if i == 20:
            planner.parameters = PlannerParameters(limits_position_margin=margin)
            moving = dq
        result = planner.step(q, twist, Scene.of(), dt)
        assert (np.abs(result.dq - dq) <= robot.acceleration_max * dt + 1e-9).all()
        dq = result.dq
        q = q + dt * dq
        assert (q > robot.position_min).all() and (q < robot.position_max).all()
    assert moving[1] < -0.01 and dq[1] > -1e-9


@pytest.mark.parametrize('make', [make_panda, make_paper_arm])
def test_null_space_motion_at_its_bound_stops_next_to_the_path(make):
    """Proportional braking from the bound, integrated, leads 0.25 mm aside, or 2.5 mrad."""
    robot = make()
    parameters = PlannerParameters()
    limits, constants = limits_of(robot, parameters), robot_constants(robot, parameters)
    random, met = np.random.default_rng(0), 0
    for q in random_postures(robot, 40):
        arm = robot.kinematics(q)
        spare = np.linalg.svd(arm.jacobian)[2][robot.m:]
        self_motion = random.normal(size=len(spare)) @ spare
        self_motion *= 20.0 / np.linalg.norm(self_motion)
        bound = fastest_self_motion(arm, self_motion, limits, constants)
        assert bound < np.linalg.norm(self_motion)
        slow = self_motion * (bound / np.linalg.norm(self_motion))
        assert fastest_self_motion(arm, 0.5 * slow, limits, constants) == np.inf
        stop = stopping_time(slow, robot.acceleration_max)
        rest = robot.kinematics(q + 0.5 * stop * slow)
        aside = np.linalg.norm(rest.tip_position - arm.tip_position)
        turned = np.arccos(np.clip(
            0.5 * (np.trace(rest.tip_rotation @ arm.tip_rotation.T) - 1.0), -1.0, 1.0))
        # Of second order; where that is little the third shows.
        assert aside < 1.5 * STRAY and (robot.m < 6 or turned < 1.5 * STRAY_ANGLE)
        met += aside > 0.5 * STRAY or turned > 0.5 * STRAY_ANGLE
    assert met > 30
