"""Barriers and criteria of the user's own: checked when given, kept and followed from then on."""

from __future__ import annotations

from closed_loop import drive, DT, NOTHING, random_scene
from conftest import (
    central_difference,
    examples,
    HANDS,
    make_panda,
    make_paper_arm,
    make_planar,
    make_two_handed,
    PANDA_READY,
    random_postures,
)
from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest

from redundant_planner.core.errors import ParameterError, RobotError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.own_rules import Barrier, Criterion
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.redundancy.null_space import decompose, project
from redundant_planner.core.safety.stage import Stage
from redundant_planner.core.target.chunk import Chunk
from redundant_planner.core.target.progress import TargetState

SEEDS = st.integers(0, 2**32 - 1)
SMOOTH, ABRUPT = make_panda(), make_panda(jerk_max=(np.inf,))
POSITION = make_panda(axes=('vx', 'vy', 'vz'), jerk_max=(np.inf,))
BODY = make_two_handed()
TARGET = np.array([0.6, 0.0, 0.0])


def beside_column(robot, link, center=(0.3, 0.3), radius=0.25, unit=1.0):
    """Keep a link's origin out of an upright cylinder [m / unit]."""
    def function(arm):
        position, jacobian = robot.point(arm, link)
        off = position[:2] - center
        away = np.linalg.norm(off)
        return (away - radius) / unit, off / away @ jacobian[:2] / unit
    return function


def within_ball(robot, link, center=(0.0, 0.0, 0.5), radius=0.4):
    """Keep a link's origin in a ball: curved the other way [m²]."""
    def function(arm):
        position, jacobian = robot.point(arm, link)
        off = position - center
        return radius**2 - off @ off, -2.0 * off @ jacobian
    return function


def in_view(robot, link, cosine=0.8, target=TARGET):
    """Keep a point in the cone that a camera on a link sees."""
    def function(arm):
        eye, motion = robot.point(arm, link)
        axis, turning = robot.direction(arm, link, (0.0, 0.0, 1.0))
        to = target - eye
        distance = np.linalg.norm(to)
        sight = to / distance
        return axis @ sight - cosine, sight @ turning - (
            axis - axis @ sight * sight) @ motion / distance
    return function


def barriers_of(robot):
    if robot is BODY:
        return [Barrier('the hand stays near', within_ball(
                    robot, HANDS[0], (0.3, 0.3, 0.8), 0.5)),
                Barrier('the elbow is beside', beside_column(
                    robot, 'right_link4', (0.3, -0.3), 0.2))]
    return [Barrier('elbow beside', beside_column(robot, 'panda_link4')),
            Barrier('elbow in', within_ball(robot, 'panda_link4')),
            Barrier('in view', in_view(robot, 'panda_hand'))]


def least(barriers, robot, q):
    return min(barrier.function(robot.kinematics(q))[0] for barrier in barriers)


def start_within(barriers, robot, seed):
    for q in random_postures(robot, 400, seed % 1000):
        if least(barriers, robot, q) >= 0.0:
            return q
    return None


def at_rest(thing, larger_by=0.0):
    return Obstacle(thing.name, thing.center, thing.half_extents + larger_by)


def restless(robot, random, speed):
    """Twists that jump, and are 0 now and then."""
    shape = (6, len(robot.tips), 6) if len(robot.tips) > 1 else (6, 6)
    twists = speed * random.uniform(-1.0, 1.0, shape)
    twists[random.random(6) < 0.2] = 0.0
    return lambda t: twists[int(t / 0.25)]


@pytest.mark.parametrize('link', ['base', 'left_link2', 'right_link5', *HANDS])
def test_points_and_directions_move_as_their_jacobians_say(link):
    offset, axis = np.array([0.1, -0.2, 0.05]), np.array([1.0, 2.0, -2.0])
    for q in random_postures(BODY, 5):
        arm = BODY.kinematics(q)
        position, jacobian = BODY.point(arm, link, offset)
        along, turning = BODY.direction(arm, link, axis)
        np.testing.assert_allclose(np.linalg.norm(along), 1.0)
        np.testing.assert_allclose(jacobian, np.array([central_difference(
            lambda p, i=i: BODY.point(BODY.kinematics(p), link, offset)[0][i], q)
            for i in range(3)]), atol=1e-8)
        np.testing.assert_allclose(turning, np.array([central_difference(
            lambda p, i=i: BODY.direction(BODY.kinematics(p), link, axis)[0][i], q)
            for i in range(3)]), atol=1e-8)
        if link in HANDS:
            tip = HANDS.index(link)
            position, jacobian = BODY.point(arm, link)
            np.testing.assert_allclose(position, arm.tip_positions[tip], atol=1e-12)
            np.testing.assert_allclose(
                jacobian, arm.tip_jacobian[6 * tip:6 * tip + 3], atol=1e-12)


def test_an_unknown_link_is_named_with_those_that_there_are():
    with pytest.raises(RobotError, match=r"has no link 'elbow'; it has .*'right_link1'"):
        BODY.point(BODY.kinematics(np.zeros(BODY.n)), 'elbow')


RIGHT = beside_column(SMOOTH, 'panda_link4')


@pytest.mark.parametrize(('function', 'message'), [
    (lambda arm: (RIGHT(arm)[0], -RIGHT(arm)[1]),
     r"barrier 'b': its gradient has -?[\d.]+ for joint 'panda_joint\d', but its value changes by "
     r'-?[\d.]+ for each rad or m of it, at the posture \[.*; it takes the derivative'),
    (lambda arm: (RIGHT(arm)[0], RIGHT(arm)[1][:6]),
     r"barrier 'b' returned a gradient of the shape \(6,\) at .*7 numbers, one for each joint"),
    (lambda arm: (np.nan, RIGHT(arm)[1]), "barrier 'b' is nan at the posture"),
    (lambda arm: (RIGHT(arm)[0], np.array([0.0, np.inf, *np.zeros(5)])),
     "its gradient has inf for joint 'panda_joint2'"),
    (lambda arm: RIGHT(arm)[0], "barrier 'b' returned .*it returns a number and its gradient"),
    (lambda arm: 1 / 0, "barrier 'b' raised ZeroDivisionError at .*: division by zero"),
])
def test_what_is_no_barrier_is_refused_by_name(function, message):
    with pytest.raises(ParameterError, match=message):
        Planner(SMOOTH, barriers=[Barrier('b', function)])


@pytest.mark.parametrize(('options', 'message'), [
    ({'barriers': [Barrier('', RIGHT)]}, "a barrier is named ''"),
    ({'barriers': [Barrier('b', RIGHT)], 'criteria': [Criterion('b', RIGHT)]},
     "a criterion is named 'b'; it takes a name of its own"),
    ({'barriers': [RIGHT]}, 'it takes a Barrier'),
    ({'criteria': [Criterion('c', RIGHT, -1.0)]}, "criterion 'c' has the weight -1.0"),
])
def test_names_are_unique_and_weights_positive(options, message):
    with pytest.raises(ParameterError, match=message):
        Planner(SMOOTH, **options)


@pytest.mark.parametrize('robot', [SMOOTH, ABRUPT, POSITION, BODY],
                         ids=['smooth', 'abrupt', 'position', 'body'])
@given(seed=SEEDS, slow=st.booleans(), crowded=st.booleans())
# An arm that speeds up within the room that is kept: it would come to rest ever further out.
@example(seed=23465, slow=False, crowded=False)
@example(seed=7, slow=False, crowded=False)
@settings(max_examples=examples(24), deadline=None)
def test_barriers_are_kept_under_any_twists(robot, seed, slow, crowded):
    """Among obstacles at rest, at joint limits, and while the arm brakes."""
    random, barriers = np.random.default_rng(seed), barriers_of(robot)
    if robot is not BODY:
        barriers = barriers[:1 + seed % 3] if seed % 2 else barriers[seed % 3:]
    q = start_within(barriers, robot, seed)
    if q is None:
        return
    planner = Planner(robot, barriers=barriers)
    # Of an arm that begins too near to something the clearance comes first.
    scene = [
        at_rest(thing) for thing in (random_scene(robot, seed) if crowded else ())
        if not planner.contacts(q, [at_rest(thing, larger_by=0.05)])]
    dt = 0.004 if slow else 0.01
    postures, results = drive(
        planner, q, restless(robot, random, 0.4 if slow else 1.0), scene, 1.2, dt)
    assert min(least(barriers, robot, p) for p in postures) >= -1e-6
    velocities = np.array([np.zeros(robot.n), *(result.dq for result in results)])
    assert (np.abs(np.diff(velocities, axis=0)) <= robot.acceleration_max * dt + 1e-9).all()


def test_braking_is_never_asked_for_faster_than_in_proportion():
    """Also where the arm moves away from the barrier, at the place where it would come to rest."""
    seed, barriers = 7, barriers_of(ABRUPT)[:2]
    q, random = start_within(barriers, ABRUPT, seed), np.random.default_rng(seed)
    _, results = drive(Planner(ABRUPT, barriers=barriers), q, restless(ABRUPT, random, 1.0), [],
                       1.2, 0.01)
    assert Stage.FORCED not in [result.stage for result in results]


@given(seed=SEEDS)
@settings(max_examples=examples(16), deadline=None)
def test_an_arm_found_outside_may_stay_or_come_in_and_gets_no_worse(seed):
    random = np.random.default_rng(seed)
    barriers = [Barrier('elbow beside', beside_column(SMOOTH, 'panda_link4', radius=0.6))]
    q = next(q for q in random_postures(SMOOTH, 400, seed % 1000)
             if least(barriers, SMOOTH, q) < -0.05)
    planner = Planner(SMOOTH, barriers=barriers)
    postures, results = drive(planner, q, restless(SMOOTH, random, 0.5), seconds=1.2)
    values = np.array([least(barriers, SMOOTH, p) for p in postures])
    # Where clearances of the arm's own links ask for the opposite, neither is kept in full.
    conflicts = any(result.stage is Stage.FORCED for result in results)
    assert values.min() >= values[0] - (0.05 if conflicts else 1e-4)


def test_a_reason_names_the_barrier_and_the_result_its_value():
    barrier = Barrier('elbow outside the column', beside_column(
        SMOOTH, 'panda_link4', (0.0, 0.45), 0.4))
    planner = Planner(SMOOTH, barriers=[barrier],
                      criteria=[Criterion('looks', in_view(SMOOTH, 'panda_hand'))])
    postures, results = drive(planner, PANDA_READY, np.array([0, 0.3, 0, 0, 0, 0]), seconds=3.0)
    last = results[-1]
    assert last.reason.startswith("the speed gave way: 'elbow outside the column'")
    assert [own.name for own in last.own] == ['elbow outside the column', 'looks']
    assert 0.0 <= last.own[0].value < 1e-3
    # It may go back at once.
    q = postures[-1]
    for _ in range(50):
        result = planner.step(q, np.array([0, -0.3, 0, 0, 0, 0]), NOTHING, DT)
        q = q + DT * result.dq
    assert result.scale > 0.5
    assert Planner(SMOOTH).step(PANDA_READY, np.zeros(6), NOTHING, DT).own == ()


def test_the_unit_of_a_barrier_does_not_matter():
    twist = np.array([0.1, 0.3, 0, 0, 0, 0.2])
    ends = [drive(Planner(SMOOTH, barriers=[Barrier('b', beside_column(
        SMOOTH, 'panda_link4', (0.0, 0.45), 0.4, unit))]), PANDA_READY, twist, seconds=1.5)[0][-1]
        for unit in (1.0, 1e-3, 1e4)]
    np.testing.assert_allclose(ends[1:], [ends[0]] * 2, atol=1e-6)


def test_a_chunk_of_the_joints_is_followed_as_far_as_barriers_let_it():
    times = np.linspace(0.0, 2.0, 41)
    chunk = Chunk(times, PANDA_READY + np.outer(times, np.array([-0.6, 0, 0, 0, 0, 0, 0])))
    barriers = [Barrier('elbow beside', beside_column(SMOOTH, 'panda_link4', (0.0, 0.45), 0.4))]
    planner, q = Planner(SMOOTH, barriers=barriers), PANDA_READY
    values = []
    for _ in range(500):
        result = planner.step(q, np.zeros(6), NOTHING, DT, target=chunk)
        q = q + DT * result.dq
        values.append(least(barriers, SMOOTH, q))
    assert min(values) >= -1e-6 and values[-1] < 1e-2


def test_an_arm_brakes_within_its_limits_where_a_barrier_is_no_number():
    def function(arm):
        position, jacobian = SMOOTH.point(arm, 'panda_hand')
        return (1.0 + position[1] if position[1] < 0.1 or not broken else np.nan), jacobian[1]

    broken = False
    planner = Planner(SMOOTH, barriers=[Barrier('hand', function)])
    broken = True
    _, results = drive(planner, PANDA_READY, np.array([0, 0.3, 0, 0, 0, 0]), seconds=1.5)
    assert results[-1].reason == "the arm brakes: 'hand' is not a finite number"
    assert np.isnan(results[-1].own[0].value)
    assert not results[-1].dq.any()
    changes = np.diff([result.dq for result in results], axis=0)
    assert (np.abs(changes) <= SMOOTH.acceleration_max * DT + 1e-9).all()


@pytest.mark.parametrize('robot', [make_panda(), make_paper_arm(), make_planar(), BODY],
                         ids=['panda', 'paper', 'planar', 'body'])
def test_criteria_join_the_gradient_of_equation_18(robot):
    """With k = 1 and nothing else in ∇H, the homogeneous part is P times the user's gradient."""
    link = robot.tips[0]

    def function(arm):
        position, jacobian = robot.point(arm, link)
        return arm.q[1] + position[0] * arm.q[0], (
            np.eye(robot.n)[1] + position[0] * np.eye(robot.n)[0] + arm.q[0] * jacobian[0])

    off = {'criteria_k_w': 0.0, 'criteria_k_s': 0.0, 'criteria_k_f': 0.0, 'criteria_k_m': 0.0,
           'method': 'gradient_projection', 'criteria_k_fixed': 1.0}
    shape = (len(robot.tips), 6) if len(robot.tips) > 1 else 6
    for q in random_postures(robot, 5):
        planner = Planner(robot, PlannerParameters(**off), filtered=False,
                          criteria=[Criterion('c', function, 2.0)])
        result = planner.step(q, np.full(shape, 0.1), NOTHING, DT)
        arm = robot.kinematics(q)
        expected = project(decompose(arm.jacobian), 2.0 * function(arm)[1])
        np.testing.assert_allclose(result.homogeneous, expected, atol=1e-9)


def test_a_criterion_grows_while_the_tip_keeps_its_path():
    function, ends, tips = in_view(POSITION, 'panda_hand'), [], []
    for criteria in ([], [Criterion('looks', function)]):
        planner = Planner(POSITION, criteria=criteria)
        postures, _ = drive(planner, PANDA_READY, np.array([0, 0.15, 0, 0, 0, 0]), seconds=2.0)
        ends.append(function(POSITION.kinematics(postures[-1]))[0])
        tips.append(POSITION.kinematics(postures[-1]).tip_position)
    assert ends[1] > ends[0] + 0.05
    np.testing.assert_allclose(tips[0], tips[1], atol=1e-3)


def test_a_criterion_that_is_no_number_counts_nothing_and_is_named():
    broken = False
    planner = Planner(SMOOTH, criteria=[Criterion(
        'c', lambda arm: (np.nan if broken else arm.q[0], np.eye(SMOOTH.n)[0]))])
    broken = True
    result = planner.step(PANDA_READY, np.full(6, 0.1), NOTHING, DT)
    assert "without 'c', which is not a finite number" in result.reason
    assert np.isfinite(result.dq).all()


@pytest.mark.parametrize(('pose', 'seed'), [(False, 1), (True, 2), (True, 15)])
def test_ways_to_targets_lead_around_a_barrier(pose, seed):
    """The elbow would swing through the column on the straight way of the joints."""
    barriers = [Barrier('elbow beside', beside_column(SMOOTH, 'panda_link4', (0.15, 0.0), 0.12)),
                Barrier('elbow in', within_ball(SMOOTH, 'panda_link4', radius=0.5))]
    start, end = [q for q in random_postures(SMOOTH, 200, seed)
                  if least(barriers, SMOOTH, q) > 0.03][:2]
    assert min(least(barriers, SMOOTH, start + share * (end - start))
               for share in np.linspace(0.0, 1.0, 60)) < -0.01
    target = SMOOTH.kinematics(end).tips.first if pose else end
    planner, q, values = Planner(SMOOTH, barriers=barriers), start, []
    for _ in range(3000):
        result = planner.step(q, np.zeros(6), NOTHING, DT, target=target)
        q = q + DT * result.dq
        values.append(least(barriers, SMOOTH, q))
        if result.progress.state is TargetState.REACHED:
            break
    assert result.progress.state is TargetState.REACHED, result
    assert min(values) >= -1e-6


def test_a_target_that_a_barrier_forbids_is_not_gone_to_and_the_barrier_named():
    barriers = [Barrier('elbow beside', beside_column(SMOOTH, 'panda_link4', (0.15, 0.0), 0.12))]
    start, end = PANDA_READY.copy(), PANDA_READY.copy()
    start[:2], end[:2] = (-1.0, 0.2), (0.0, 0.2)
    planner, q = Planner(SMOOTH, barriers=barriers), start
    for _ in range(400):
        result = planner.step(q, np.zeros(6), NOTHING, DT, target=end)
        q = q + DT * result.dq
    assert "'elbow beside' would not be kept" in result.reason
    np.testing.assert_allclose(q, start, atol=1e-3)
