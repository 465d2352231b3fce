"""The tip's axis stays in its cone: the barrier, twists among obstacles, and free targets."""

from __future__ import annotations

from conftest import central_difference, examples, make_panda, PANDA_READY
from hypothesis import assume, given, settings, strategies as st
import numpy as np
import pytest
from target_run import DT, EMPTY, moved, Run, tip

from redundant_planner.core.errors import ParameterError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.cone import Cone, cone_room, leaning
from redundant_planner.core.target.progress import TargetState

PANDA, FREE_TURN = make_panda(), make_panda(axes=('vx', 'vy', 'vz'))
DOWN = np.array((0.0, 0.0, -1.0))
ANGLE = np.radians(5.0)
UPRIGHT = {'cone_angle': ANGLE, 'cone_direction': (0.0, 0.0, -1.0)}
POSTURES = st.lists(st.floats(-2.5, 2.5), min_size=7, max_size=7).map(
    lambda q: np.clip(q, PANDA.position_min, PANDA.position_max))


def lean(robot, q):
    """Angle of the hand's z axis from straight down [rad]."""
    cosine = robot.kinematics(np.asarray(q)).tip_rotation[:, 2] @ DOWN
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


@given(POSTURES, st.floats(0.02, 3.0))
def test_the_room_in_the_cone_and_its_gradient(q, angle):
    cone = Cone(np.array((0.0, 0.0, 1.0)), DOWN, angle)

    def room(q):
        arm = PANDA.kinematics(q)
        return cone_room(cone, arm.tip_rotation, arm.joint_screws)

    value, gradient = room(q)
    theta = lean(PANDA, q)
    assert value == pytest.approx((np.cos(theta) - np.cos(angle)) / np.sin(angle), abs=1e-6)
    assert (value > 0.0) == (theta < angle) or abs(theta - angle) < 1e-6
    np.testing.assert_allclose(
        gradient, central_difference(lambda q: room(q)[0], q), rtol=1e-4, atol=1e-5)


@given(POSTURES, st.integers(0, 2**32 - 1))
def test_how_it_leans_is_what_differences_say(q, seed):
    """The room α − θ, its gradient and its second derivative along a motion."""
    cone = Cone(np.array((0.0, 0.6, 0.8)), DOWN, 0.5)
    dq = np.random.default_rng(seed).normal(size=7)

    def at(q):
        arm = PANDA.kinematics(q)
        return leaning(cone, arm.tip_rotation, arm.joint_screws, dq)

    def room(t):
        return at(q + t * dq).room[0]

    found, step = at(q), 1e-4
    assume(0.05 < 0.5 - found.room[0] < 3.0)
    np.testing.assert_allclose(
        found.gradient[0], central_difference(lambda q: at(q).room[0], q), rtol=1e-4, atol=1e-5)
    expected = (room(step) - 2.0 * room(0.0) + room(-step)) / step**2
    assert found.change[0] == pytest.approx(expected, rel=1e-3, abs=1e-3)
    # As it moves it comes no nearer to the edge than straight away from the direction.
    assert found.room[1] >= found.room[0] - 1e-9
    assert found.gradient[1] @ dq == pytest.approx(-np.linalg.norm(
        (PANDA.kinematics(q + step * dq).tip_rotation - PANDA.kinematics(
            q - step * dq).tip_rotation) @ cone.axis) / (2.0 * step), rel=1e-4, abs=1e-6)


@pytest.mark.first_alone
@pytest.mark.parametrize(('robot', 'most'), [(PANDA, 1.0), (FREE_TURN, 1.3)],
                         ids=['six axes', 'three axes'])
@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
@settings(max_examples=examples(6), derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_no_twist_leads_beyond_the_cone(robot, most, method, seed):
    """Whatever is commanded, among obstacles, it leans 5° at most.

    Where the orientation is free besides, an arm that turns fast in its null space and folds into
    itself may lean a little further: no contact comes before the cone.
    """
    random = np.random.default_rng(seed)
    planner = Planner(robot, PlannerParameters(method=method, **UPRIGHT))
    q, leans = np.array(PANDA_READY), []
    scene = Scene.of([Obstacle('ball', random.uniform(-0.6, 0.6, 3) + (0.0, 0.0, 0.5),
                               random.uniform(0.03, 0.08, 3)) for _ in range(2)])
    for tick in range(400):
        if tick % 100 == 0:
            twist = random.normal(size=6) * (0.15, 0.15, 0.15, 0.4, 0.4, 0.4)
        q = q + DT * planner.step(q, twist, scene, DT).dq
        leans.append(lean(robot, q))
    assert max(leans) < most * ANGLE
    assert np.abs(q - PANDA_READY).max() > 0.01


def test_where_the_cone_holds_the_arm_back_the_reason_says_so():
    planner, q = Planner(PANDA, PlannerParameters(**UPRIGHT)), np.array(PANDA_READY)
    for _ in range(250):
        result = planner.step(q, np.array((0.0, 0.0, 0.0, 0.5, 0.0, 0.0)), EMPTY, DT)
        q = q + DT * result.dq
    assert 'cone.angle' in result.reason and result.scale < 0.1
    assert 0.8 * ANGLE < lean(PANDA, q) < ANGLE


@pytest.mark.parametrize('path', ['free', 'straight'])
def test_to_a_target_without_leaning(path):
    """By a long way about the base, where a straight motion of the joints would spill."""
    run = Run(target_path=path, **UPRIGHT)
    target = moved(tip(PANDA, PANDA_READY), (-0.1, 0.4, -0.2, 0.0, 0.0, 0.5))
    assert run.to(target, 15.0).state is TargetState.REACHED
    assert max(lean(PANDA, q) for q in run.positions) < ANGLE
    run.assert_within_limits()


def test_a_tip_found_outside_its_cone_may_come_back_and_not_lean_further():
    start = np.array(PANDA_READY)
    start[5] += 0.3
    planner, q = Planner(PANDA, PlannerParameters(**UPRIGHT)), start
    begin, leans = lean(PANDA, q), []
    assert begin > ANGLE
    for twist in ((0.0, 0.2), (0.0, -0.2)):
        for _ in range(100):
            q = q + DT * planner.step(q, np.array((0.0, 0.0, 0.0, *twist, 0.0)), EMPTY, DT).dq
            leans.append(lean(PANDA, q))
    assert max(leans) < begin + 1e-3 and min(leans) < begin - 0.05


@pytest.mark.parametrize(('changes', 'what'), [
    ({'cone_tip_axis': (0.0, 0.0, 0.0)}, 'cone.tip_axis.*zeros'),
    ({'cone_direction': (0.0, 1.0)}, 'cone.direction.*2 entries'),
    ({'cone_angle': 0.0}, 'cone.angle'),
    ({'posture_preferred': ('panda_joint3',)}, 'posture.preferred.*joint=position'),
    ({'posture_preferred': ('panda_joint3=up',)}, 'posture.preferred.*joint=position')])
def test_what_makes_no_sense_is_refused(changes, what):
    with pytest.raises(ParameterError, match=what):
        PlannerParameters(**changes)


@pytest.mark.parametrize(('entry', 'what'), [
    ('elbow=0.0', "names joint 'elbow'.*panda_joint1"), ('panda_joint4=1.0', 'goes from')])
def test_a_posture_that_the_arm_does_not_have_is_refused(entry, what):
    with pytest.raises(ParameterError, match=what):
        Planner(PANDA, PlannerParameters(posture_preferred=(entry,)))
