"""`path_priority: slide`: along what is in the way, as near to the command as possible."""

from __future__ import annotations

from conftest import examples, make_panda, PANDA_READY
from hypothesis import given, settings, strategies as st
import numpy as np
import pinocchio as pin
import pytest

from benchmark.judge import accelerations, limit_violation, reversals
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.planner import Planner
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.core.safety.stage import Stage

DT = 0.004
PANDA = make_panda()
BEGIN = PANDA.kinematics(PANDA_READY)
# Its face lies 5 cm below the fingers, and reaches further than any motion here.
TABLE = Obstacle.box('table', BEGIN.tip_position + (0.2, 0.2, -0.26), (0.6, 1.6, 0.2))


class Run:
    """A closed loop with an arm that follows at once."""

    def __init__(self, obstacles, **parameters):
        self.planner = Planner(PANDA, PlannerParameters(**parameters))
        self.planner.reset()
        self.scene, self.q = Scene.of(obstacles), PANDA_READY
        self.positions, self.results = [self.q], []

    def go(self, twist, seconds):
        for _ in range(round(seconds / DT)):
            result = self.planner.step(self.q, np.array(twist, dtype=float), self.scene, DT)
            self.q = self.q + DT * result.dq
            self.positions.append(self.q)
            self.results.append(result)
        return self

    @property
    def moved(self):
        return PANDA.kinematics(self.q).tip_position - BEGIN.tip_position

    @property
    def turned(self):
        end = PANDA.kinematics(self.q).tip_rotation
        return np.linalg.norm(pin.log3(end @ BEGIN.tip_rotation.T))

    @property
    def stages(self):
        return [result.stage for result in self.results]

    def assert_safe(self):
        velocities = np.array([result.dq for result in self.results])
        assert limit_violation(PANDA, np.array(self.positions), velocities, DT) == 0.0
        assert min(r.nearest.beyond_margin for r in self.results if r.nearest) > -1e-4


def test_pressed_onto_a_table_the_tip_goes_on_along_it():
    """At the speed of the command along the face, without turning, in one smooth motion."""
    down_and_sideways = (0.0, 0.08, -0.06, 0.0, 0.0, 0.0)
    run = Run([TABLE], path_priority='slide').go(down_and_sideways, 4.0)
    run.assert_safe()
    assert run.stages[-1] is Stage.SLIDING
    assert "slides along what is in its way: link 'fingers' near obstacle 'table'" in (
        run.results[-1].reason)
    assert run.moved[1] > 0.95 * 0.08 * 4.0 and abs(run.moved[0]) < 0.03
    assert run.turned < np.radians(1.0)
    # Down at the table, and no deeper.
    heights = np.array([r.pose.position[2] for r in run.results])
    assert heights[0] - heights[-1] < 0.06 and np.ptp(heights[-300:]) < 5e-3
    acceleration = np.diff([r.dq for r in run.results], axis=0)
    turns = (acceleration[1:] * acceleration[:-1] < 0.0) & (np.abs(acceleration[1:]) > 1e-3)
    assert turns.sum() < 4
    # Where the tip may not turn aside, it stops.
    held = Run([TABLE], path_priority='yield').go(down_and_sideways, 4.0)
    assert held.moved[1] < 0.1


@pytest.mark.parametrize('twist', [(0.0, 0.0, 0.0, 0.0, 0.8, 0.0), (0.0, 0.0, 0.0, 0.8, 0.0, 0.0)])
def test_a_turn_that_cannot_go_on_leaves_the_tip_about_where_it_is(twist):
    """The wrist ends up at its own links and limits; half a metre aside it could turn on."""
    run = Run([], path_priority='slide').go(twist, 6.0)
    velocities = np.array([result.dq for result in run.results])
    assert limit_violation(PANDA, np.array(run.positions), velocities, DT) == 0.0
    assert run.stages.count(Stage.SLIDING) > 200
    shifted = np.linalg.norm([
        result.pose.position - BEGIN.tip_position for result in run.results], axis=1)
    assert shifted.max() < 0.15 and run.turned > 1.8
    assert reversals(accelerations(velocities, DT), PANDA.acceleration_max) < 40


def test_straight_onto_a_face_it_stops_and_away_from_it_it_goes_at_once():
    run = Run([TABLE], path_priority='slide').go((0.0, 0.0, -0.08, 0.0, 0.0, 0.0), 3.0)
    run.assert_safe()
    assert np.abs(run.results[-1].dq).max() < 0.03
    low = run.moved[2]
    run.go((0.0, 0.0, 0.08, 0.0, 0.0, 0.0), 1.0)
    assert run.moved[2] > low + 0.06 and run.stages[-1] is Stage.DESIRED
    run.assert_safe()


def test_it_passes_a_ball_and_stays_beside_its_first_line():
    """The path goes on from where the tip has slid to: nothing draws it back."""
    ball = Obstacle('ball', BEGIN.tip_position + (0.05, 0.2, -0.02), (0.07, 0.07, 0.07))
    run = Run([ball], path_priority='slide').go((0.0, 0.1, 0.0, 0.0, 0.0, 0.0), 4.0)
    run.assert_safe()
    assert run.moved[1] > 0.25 and np.linalg.norm(run.moved[[0, 2]]) > 0.02
    aside = run.moved[[0, 2]]
    run.go(np.zeros(6), 1.0)
    np.testing.assert_allclose(run.moved[[0, 2]], aside, atol=2e-3)
    assert max(np.abs(r.path_error[:3]).max() for r in run.results) < 1e-4


def test_a_command_along_what_drove_it_off_its_path_counts_more_than_the_way_back():
    def table(height, speed=0.0):
        return Scene.of([Obstacle.box('table', TABLE.center + (0.0, 0.0, height), (0.6, 1.6, 0.2),
                                      velocity=(0.0, 0.0, speed))])
    run = Run([], path_priority='slide')
    for i in range(round(2.0 / DT)):
        run.scene = table(0.05 * i * DT, 0.05)
        run.go(np.zeros(6), DT)
    assert Stage.YIELDING in run.stages and np.linalg.norm(run.moved) > 0.05
    run.scene, before = table(0.1), run.moved
    run.go((0.0, 0.08, -0.06, 0.0, 0.0, 0.0), 1.0)
    assert run.stages[-1] is Stage.SLIDING and (run.moved - before)[1] > 0.9 * 0.08
    run.assert_safe()


def test_far_from_everything_it_is_as_without():
    twist = (0.05, -0.08, 0.04, 0.0, 0.1, 0.0)
    runs = [Run([], path_priority=p).go(twist, 1.0) for p in ('yield', 'slide')]
    np.testing.assert_array_equal(runs[0].positions, runs[1].positions)


@settings(max_examples=examples(8))
@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).filter(
    lambda v: np.linalg.norm(v) > 0.1), st.integers(0, 1000))
def test_any_command_among_obstacles_is_safe(direction, seed):
    random = np.random.default_rng(seed)
    obstacles = [TABLE, *(
        Obstacle(str(i), BEGIN.tip_position + random.choice([-1.0, 1.0], 3)
                 * random.uniform(0.16, 0.3, 3), (0.05, 0.05, 0.05)) for i in range(3))]
    run = Run(obstacles, path_priority='slide')
    begin = min(run.planner.step(run.q, np.zeros(6), run.scene, DT).nearest.beyond_margin, 0.0)
    run.planner.reset()
    run.go(0.2 * np.array(direction) / np.linalg.norm(direction), 2.0)
    velocities = np.array([result.dq for result in run.results])
    assert limit_violation(PANDA, np.array(run.positions), velocities, DT) == 0.0
    assert min(r.nearest.beyond_margin for r in run.results) > begin - 1e-4


@pytest.mark.first_alone
@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_a_target_behind_a_ball_is_reached_by_sliding(method):
    ball = Obstacle('ball', BEGIN.tip_position + (0.05, 0.2, -0.02), (0.07, 0.07, 0.07))
    goal = Pose(BEGIN.tip_position + (0.0, 0.4, 0.0), BEGIN.tip_rotation)
    ends = {}
    for priority in ('yield', 'slide'):
        run = Run([ball], path_priority=priority, method=method, target_path='straight')
        for _ in range(1500):
            result = run.planner.step(run.q, np.zeros(6), run.scene, DT, target=goal)
            run.q = run.q + DT * result.dq
            run.positions.append(run.q)
            run.results.append(result)
        run.assert_safe()
        ends[priority] = result.progress
    assert ends['slide'].distance < 1e-3 < ends['yield'].distance
