"""To a pose by a free joint path: arrival, limits, ways around things that stand or move."""

from __future__ import annotations

from dataclasses import replace
import math

from conftest import examples, make_panda, make_paper_arm, PANDA_READY, PANDA_URDF
from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest
from target_run import AT_REST, DT, EMPTY, moved, PANDA, Run, tip

from benchmark.bodies import capsules_of
from benchmark.closest_approach import Motion
from benchmark.target_problems import problem_of
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.obstacles.scene import Scene
from redundant_planner.core.robot.cone import Cone
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.target.curve_search import CurveSearch
from redundant_planner.core.target.progress import TargetState

CAPSULES = capsules_of(PANDA)
# A wall beside the arm that a line from one side of it to the other leads through.
WALL = Obstacle.box('wall', (0.5, 0.0, 0.25), (0.5, 0.04, 0.5))
LEFT = np.array([0.7, 0.6, 0.0, -1.9, 0.0, 2.4, 0.8])
RIGHT = LEFT * (-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def clearance(run, obstacles):
    """Smallest distance of any link from obstacles that stand still, and from other links [m]."""
    motion = Motion.through(CAPSULES, np.array(run.positions))
    return min(motion.to_obstacles(obstacles, DT).distance, motion.to_itself().distance)


def states(run):
    return [r.progress.state for r in run.results]


@settings(max_examples=examples(8), derandomize=True)
@given(st.lists(st.floats(0.1, 0.9), min_size=7, max_size=7))
def test_it_arrives_anywhere_within_all_limits(shares):
    goal = PANDA.position_min + np.array(shares) * (PANDA.position_max - PANDA.position_min)
    motion = Motion.through(CAPSULES, goal[None])
    run, target = Run(), tip(PANDA, goal)
    progress = run.to(target, 15.0)
    if motion.to_itself().distance > 0.02:
        assert progress.state is TargetState.REACHED
    assert clearance(run, ()) > 0.0
    run.assert_within_limits()


@pytest.mark.first_alone
@pytest.mark.parametrize('method', ['dynamic_factor', 'variational'])
def test_it_goes_around_a_wall(method):
    run, target = Run(start=LEFT, method=method), tip(PANDA, RIGHT)
    assert run.to(target, 15.0, Scene.of([WALL])).state is TargetState.REACHED
    assert clearance(run, (WALL,)) > 0.008
    run.assert_within_limits()
    assert states(run)[0] is TargetState.THINKING
    straight = Run(start=LEFT, method=method, target_path='straight')
    assert straight.to(target, 5.0, Scene.of([WALL])).state is TargetState.BLOCKED


@pytest.mark.parametrize('options', [
    {'command_frame': 'tool'}, {'axes': ('vx', 'vy', 'vz')}, {'axes': ('vx', 'vy', 'vz', 'wz')}])
def test_whatever_axes_are_controlled(options):
    robot = make_panda(**options)
    run, target = Run(robot, LEFT), tip(robot, RIGHT)
    assert run.to(target, 15.0, Scene.of([WALL])).state is TargetState.REACHED
    np.testing.assert_allclose(tip(robot, run.q).position, target.position, atol=3e-4)
    assert clearance(run, (WALL,)) > 0.008
    run.assert_within_limits()


def test_an_arm_without_spare_joints():
    robot = Robot(PANDA_URDF.read_text(), PANDA.tip_frame, link_radius=0.05,
                  locked_positions={'panda_joint3': 0.0})
    assert robot.n == robot.m == 6
    left, right = np.delete(LEFT, 2), np.delete(RIGHT, 2)
    run = Run(robot, left)
    assert run.to(tip(robot, right), 15.0, Scene.of([WALL])).state is TargetState.REACHED
    run.assert_within_limits()


def test_an_arm_with_four_spare_joints_and_rails():
    robot = make_paper_arm()
    start = np.array([0.1, 0.1, 0.0, 0.5233, -0.5233, 1.0467, 0.0])
    run = Run(robot, start)
    goal = start + (0.2, 0.1, 1.2, 0.3, -0.2, 0.1, 0.0)
    assert run.to(tip(robot, goal), 15.0).state is TargetState.REACHED
    run.assert_within_limits()


def test_a_new_target_on_the_way_is_taken_up():
    run = Run(start=LEFT)
    run.to(lambda t: tip(PANDA, RIGHT), 1.2, Scene.of([WALL]))
    assert np.abs(run.results[-1].dq).max() > 0.1
    back = moved(tip(PANDA, LEFT), (0.0, 0.05, 0.1, 0.0, 0.0, 0.0))
    assert run.to(back, 15.0, Scene.of([WALL])).state is TargetState.REACHED
    assert clearance(run, (WALL,)) > 0.005
    run.assert_within_limits()


def test_it_arrives_where_a_joint_is_at_its_limit_near_a_singularity():
    down = (0.0, 0.0, -1.0)
    cone = Cone(np.array((0.0, 0.0, 1.0)), np.array(down), math.radians(5.0))
    problem = problem_of(PANDA, 75052, cone)
    run = Run(start=problem.start, cone_angle=cone.angle, cone_direction=down)
    scene, target = Scene.of(problem.obstacles), tip(PANDA, problem.goal)
    assert run.to(target, 10.0, scene).state is TargetState.REACHED
    spare = np.minimum(run.q - PANDA.position_min, PANDA.position_max - run.q)
    assert spare.min() < 0.011, 'no joint is at its limit: test another problem'
    run.assert_within_limits()


def test_out_of_reach_it_goes_as_near_as_a_line_takes_it():
    run, begin = Run(), tip(PANDA, PANDA_READY)
    progress = run.to(moved(begin, (0.8, 0.0, 0.0, 0.0, 0.0, 0.0)), 8.0)
    assert progress.state is TargetState.OUT_OF_REACH
    assert 0.1 < progress.miss < 0.8 and 0.1 < progress.distance < 0.7
    assert np.abs(run.results[-1].dq).max() < AT_REST
    run.assert_within_limits()


def test_a_goal_in_a_closed_box_is_blocked_until_that_opens():
    target = tip(PANDA, RIGHT)
    x, y, z = target.position
    # Five sides of a box around the hand, and the sixth.
    sides = [Obstacle.box(f'{axis}{way}', np.array((x, y, z)) + 0.22 * way * np.eye(3)[axis],
                          np.where(np.eye(3)[axis], 0.02, 0.46))
             for axis in range(3) for way in (-1.0, 1.0)]
    run = Run(start=LEFT)
    assert run.to(target, 5.0, Scene.of(sides)).state is TargetState.BLOCKED
    assert np.abs(run.results[-1].dq).max() < AT_REST
    assert run.to(target, 15.0, EMPTY).state is TargetState.REACHED
    run.assert_within_limits()


def test_an_arm_that_stands_in_something_still_ends_its_ticks():
    """From inside an obstacle no way begins; it is said, and the arm goes once that is gone."""
    inside = Obstacle.box('inside', tip(PANDA, LEFT).position, (0.1, 0.1, 0.1))
    run, target = Run(start=LEFT, path_priority='strict'), tip(PANDA, RIGHT)
    progress = run.to(target, 3.0, Scene.of([inside]))
    assert progress.state in (TargetState.BLOCKED, TargetState.THINKING)
    assert run.to(target, 15.0).state is TargetState.REACHED
    run.assert_within_limits()


def test_a_thing_that_comes_to_stand_in_the_way_is_gone_around():
    free, target = Run(start=LEFT), tip(PANDA, RIGHT)
    assert free.to(target, 10.0).state is TargetState.REACHED
    middle = free.tips[len(free.tips) // 2]
    thing = Obstacle.box('thing', middle, (0.06, 0.06, 0.06))
    appears = Scene.of([thing])
    run = Run(start=LEFT)
    begin = next(i for i, r in enumerate(free.results)
                 if np.linalg.norm(free.tips[i] - middle) < 0.3)
    progress = run.to(target, 15.0, lambda t: appears if t > DT * begin else EMPTY)
    assert progress.state is TargetState.REACHED
    run.assert_within_limits()
    assert clearance(run, (thing,)) > 0.0


def test_what_crosses_the_way_is_let_pass_or_gone_around():
    target = tip(PANDA, RIGHT)

    def scene(t):
        return Scene.of([Obstacle(
            'ball', (0.5, 0.0, 1.2 - 0.25 * t), (0.07,) * 3, velocity=(0.0, 0.0, -0.25))])

    run = Run(start=LEFT)
    nearest = np.inf
    progress = None
    for i in range(round(12.0 / DT)):
        progress = run.to(target, DT, scene(i * DT))
        nearest = min(nearest, run.results[-1].nearest.beyond_margin)
        if progress.state is TargetState.REACHED and i * DT > 6.0:
            break
    assert progress.state is TargetState.REACHED
    assert nearest > 0.0
    run.assert_within_limits()


def test_a_twist_takes_over_in_the_middle_of_the_way():
    run = Run(start=LEFT)
    run.to(lambda t: tip(PANDA, RIGHT), 1.2, Scene.of([WALL]))
    result = run.let_go(Scene.of([WALL]))
    assert result.progress is None and np.abs(result.dq).max() < AT_REST
    run.assert_within_limits()


@pytest.mark.parametrize('moves', [False, True], ids=['a wall', 'and a ball'])
def test_the_same_inputs_give_the_same_motion_whether_it_thinks_ahead_of_ticks_or_in_them(moves):
    ball = Obstacle('ball', (0.4, 0.9, 0.5), (0.06, 0.06, 0.06), velocity=(0.0, -0.2, 0.0))
    first, last = tip(PANDA, PANDA_READY), tip(PANDA, RIGHT)
    runs = [Run(start=LEFT), Run(start=LEFT, ahead=True)]
    for run in runs:
        # It changes its mind while it thinks, and while it improves its way.
        run.to(lambda t: last if t < 0.02 or t > 0.3 else first, 4.0, lambda t: Scene.of(
            [WALL, ball.after(t)] if moves else [WALL]))
    assert TargetState.THINKING in states(runs[0]) and TargetState.MOVING in states(runs[0])
    np.testing.assert_array_equal(runs[0].positions, runs[1].positions)


HAPPENS = ('another target', 'missed', 'braked', 'held', 'let go', 'parameters', 'reset', 'twist')


@settings(max_examples=examples(25), deadline=None)
@given(st.lists(st.tuples(st.integers(1, 120), st.sampled_from(HAPPENS)), min_size=2, max_size=8))
@example([(400, 'another target'), (60, 'parameters'), (300, 'another target'), (5, 'missed')])
def test_whatever_happens_is_the_same_whether_it_thinks_ahead_of_ticks_or_in_them(events):
    scene, box = Scene.of([WALL]), Obstacle.box('box', (0.0, 0.0, 0.08), (0.04, 0.04, 0.04))
    targets = [tip(PANDA, RIGHT), tip(PANDA, LEFT)]
    runs = [Run(start=LEFT), Run(start=LEFT, ahead=True)]
    for run in runs:
        planner, which = run.planner, 0
        for ticks, what in events:
            run.to(lambda _: targets[which], ticks * DT, scene)  # noqa: B023
            if what == 'another target':
                which = 1 - which
            elif what == 'missed':
                planner.missed(3)
                run.q = run.q + 3 * DT * run.results[-1].dq
            elif what == 'braked':
                dq = 0.9 * run.results[-1].dq
                planner.braked(dq, DT)
                run.q = run.q + DT * dq
            elif what in ('held', 'let go'):
                planner.hold([box] if what == 'held' else [])
            elif what == 'parameters':
                planner.parameters = replace(planner.parameters, feedback_gain=1.5)
            elif what == 'reset':
                planner.reset()
            else:
                run.let_go(scene)
    np.testing.assert_array_equal(runs[0].positions, runs[1].positions)


def test_a_search_that_fails_ahead_of_a_tick_fails_the_tick(monkeypatch):
    run, scene = Run(start=LEFT), Scene.of([WALL])
    run.to(lambda _: tip(PANDA, RIGHT), 2 * DT, scene)

    def fails(*_args, **_kwargs):
        raise ArithmeticError('for a test')

    monkeypatch.setattr(CurveSearch, 'think', fails)
    for attempt in (lambda: run.planner.prepare(scene),
                    lambda: run.to(tip(PANDA, RIGHT), DT, scene)):
        with pytest.raises(ArithmeticError):
            attempt()
