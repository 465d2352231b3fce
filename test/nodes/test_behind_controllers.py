"""The planner's loop in front of simulated controllers: what came of it with real ones, or not.

Each row of what was measured behind the real ros2_control is a test here, by simulated time.
"""

from __future__ import annotations

from itertools import cycle

import numpy as np
import pytest

from benchmark.controlled_loop import ControlledLoop
from benchmark.following import clear, COMMANDS, GUILTY, guilty, INNOCENT, innocent
from benchmark.robots import make_robot
from benchmark.ros2_control import OUTPUTS, POSITION, Settings, TRAJECTORY, VELOCITY
from redundant_planner.core.parameters import PlannerParameters

PANDA = make_robot('panda', 6)
READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
FORWARD = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
STARTS = 1.5  # the planner listens before it moves the arm [s]


def behind(controller, **options):
    """Return a loop that is about to move a Panda."""
    run = ControlledLoop(PANDA, READY, controller, **options)
    run.run(STARTS)
    return run


def after_a_motion(output, **options):
    """Return a loop whose stick has just been let go of."""
    run = behind(output, **options)
    run.drive(FORWARD)
    run.run(0.5)
    run.drive(None)
    return run


@pytest.mark.first_alone
@pytest.mark.parametrize('command, output', [
    *(('cmd_vel', output) for output in OUTPUTS),
    *((command, POSITION) for command in COMMANDS if command != 'cmd_vel')])
@pytest.mark.parametrize('case', ['inactive', 'frozen'])
def test_nothing_waits_for_a_controller_that_wakes_up(case, command, output):
    outcome = guilty(case, output, command)
    # A stream that begins slowly has told the arm little by then.
    assert outcome.error_s <= (0.6 if command == 'stream' else 0.5) and outcome.rest_s <= 1.0
    assert outcome.awake_speed <= 0.05 and outcome.awake_way <= 2e-3
    assert outcome.follows
    assert outcome.step <= 1.05 and outcome.acceleration <= 1.0 + 1e-6


@pytest.mark.first_alone
@pytest.mark.parametrize('output', [POSITION, TRAJECTORY])
@pytest.mark.parametrize('case', [case for case in GUILTY if case not in ('inactive', 'frozen')])
def test_positions_keep_velocity_and_acceleration_whatever_the_arm_does(case, output):
    outcome = guilty(case, output, 'cmd_vel')
    assert outcome.step <= 1.05 and outcome.acceleration <= 1.0 + 1e-6


@pytest.mark.parametrize('active', [True, False])
def test_an_arm_that_is_not_seen_to_move_is_no_faster_than_it_can_soon_stop_from(active):
    """And one that is seen to move is as fast as its target asks for, the next time too."""
    run, soon = behind(POSITION, settings=Settings(active=active)), 0.08 * PANDA.acceleration_max
    for target in (READY + 0.5, READY):
        run.go_to(target)
        begin = run.now
        run.run(2.0)
        told = np.abs(run.commands(begin).velocities)
        assert (told <= soon * (1.0 + 1e-6)).all() != active
        assert active or run.error
        run.run(1.0)


@pytest.mark.parametrize('command, pair', [
    *((command, (1, 3)) for command in COMMANDS), ('go_to', (0, 5)), ('stream', (0, 5))], ids=str)
def test_swapped_joints_are_named_before_they_are_far_off(command, pair):
    joints, (i, j) = list(PANDA.joint_names), pair
    joints[i], joints[j] = joints[j], joints[i]
    run = behind(VELOCITY, joints=joints)
    COMMANDS[command](run)
    begin = run.now
    assert run.run(1.0, until=lambda: bool(run.loop.state.astray))
    for one, other in (joints[i], joints[j]), (joints[j], joints[i]):
        assert f"joint '{one}' moves as '{other}' was told" in run.error
    assert 'another order' in run.error
    run.run(5.0)
    moved, told = run.motion(begin), run.commands(begin)
    way = told.velocities.sum(axis=0) / 250
    assert np.abs(moved.positions[-1] - moved.positions[0] - way).max() < 0.1
    assert moved.times[np.abs(moved.velocities).max(axis=1) > 1e-9][-1] - begin <= 1.0


def test_swapped_joints_that_take_positions_leap_once():
    joints = list(PANDA.joint_names)
    joints[1], joints[3] = joints[3], joints[1]
    run = ControlledLoop(PANDA, READY, POSITION, joints=joints)
    run.run(5.0)
    leaps = np.abs(run.motion().velocities).max(axis=1) > 5.0
    assert leaps.sum() == 1
    assert 'as soon as the arm was commanded' in run.error and "'panda_joint4'" in run.error
    assert run.loop.at_rest
    begin = run.now
    run.drive(FORWARD)
    run.run(3.0)
    assert (np.abs(run.motion(begin).velocities).max(axis=1) > 5.0).sum() == 1


def test_a_process_that_is_stopped_as_it_begins_raises_no_alarm():
    run = ControlledLoop(PANDA, READY, VELOCITY)
    run.run(0.5)
    run.drive(2.0 * FORWARD)
    assert run.run(3.0, until=lambda: not run.loop.at_rest)
    run.run(0.2)
    run.sleeps_until = run.now + 0.3
    run.run(2.0)
    assert not run.error and np.abs(run.manager.q - READY).max() > 0.05


def test_names_in_trajectories_swap_nothing():
    run = behind(TRAJECTORY, joints=PANDA.joint_names[::-1])
    run.drive(FORWARD)
    run.run(1.0)
    assert not run.error and np.abs(run.manager.q - READY).max() > 0.05


@pytest.mark.first_alone
@pytest.mark.parametrize('output', OUTPUTS)
def test_where_others_have_moved_the_arm_it_stays(output):
    """MoveIt's usual switch of controllers, without a pause."""
    run = after_a_motion(output)
    run.run(1.0)
    run.manager.settings = Settings(active=False, moved=dict.fromkeys(PANDA.joint_names, 0.12))
    run.run(2.0)
    run.manager.settings = Settings(active=False)
    run.run(0.2)
    at, begin = run.manager.q.copy(), run.now
    run.manager.settings = Settings()
    run.run(2.0)
    # The last velocity before the switch is what the hardware keeps.
    assert np.abs(run.motion(begin).positions - at).max() < 1e-3
    run.drive(FORWARD)
    run.run(1.0)
    assert not run.error and np.abs(run.manager.q - at).max() > 0.05


@pytest.mark.first_alone
@pytest.mark.parametrize('output', [POSITION, TRAJECTORY, VELOCITY])
@pytest.mark.parametrize('tolerance', [0.02, 0.0])
def test_a_paused_arm_that_others_move_a_little_does_not_leap_back(tolerance, output):
    run = after_a_motion(output, follow_tolerance=tolerance)
    run.loop.supervisor.pause(True)
    run.run(2.0)
    run.manager.settings = Settings(active=False, moved=dict.fromkeys(PANDA.joint_names, 0.015))
    run.run(1.0)
    run.manager.settings = Settings()
    at, begin = run.manager.q.copy(), run.now
    run.loop.supervisor.pause(False)
    run.run(2.0)
    assert np.abs(run.motion(begin).positions - at).max() < 1e-3


@pytest.mark.first_alone
@pytest.mark.parametrize('output', [POSITION, TRAJECTORY, VELOCITY])
@pytest.mark.parametrize('tolerance', [0.0, 0.02])
@pytest.mark.parametrize('speed, seconds', [(0.002, 2.0), (0.001, 1.0), (0.02, 0.2), (0.12, 2.0)])
def test_a_resting_arm_that_others_move_a_little_stays_there(speed, seconds, tolerance, output):
    """Nobody has paused it: it corrects where it stands, and nobody hears that."""
    run = after_a_motion(output, follow_tolerance=tolerance)
    run.run(2.0)
    run.manager.settings = Settings(active=False, moved=dict.fromkeys(PANDA.joint_names, speed))
    run.run(seconds)
    run.manager.settings = Settings(active=False)
    run.run(1.5)
    at, begin = run.manager.q.copy(), run.now
    run.manager.settings = Settings()
    run.run(2.0)
    # The last velocity before the switch is what the hardware keeps.
    assert np.abs(run.motion(begin).positions - at).max() < 1e-3
    assert np.abs(run.motion(begin).velocities).max() < 0.05
    run.drive(FORWARD)
    run.run(1.0)
    assert not run.error and np.abs(run.manager.q - at).max() > 0.05


@pytest.mark.first_alone
@pytest.mark.parametrize('output', OUTPUTS)
@pytest.mark.parametrize('settings', [
    {'backlash': 0.01}, {'noise': 5e-4}, {'lag': 0.08, 'dead_time': 0.04}, {'states_rate': 20.0}])
def test_an_arm_that_rests_unmoved_goes_on_being_held(settings, output):
    run = behind(output, settings=Settings(**settings))
    for sign in (1.0, -1.0):
        run.drive(sign * FORWARD)
        run.run(0.7)
        run.drive(None)
        run.run(5.0)
    assert not any('something else' in sentence for _, sentence in run.warnings)
    assert not run.loop.at_rest


@pytest.mark.first_alone
@pytest.mark.parametrize('output', OUTPUTS)
def test_at_equal_rates_the_arm_moves_as_smoothly_as_its_commands(output):
    run = behind(output)
    begin = run.now
    for axis in np.eye(6)[:3]:
        for sign in (1.0, -1.0):
            run.drive(0.1 * sign * axis)
            run.run(0.8)
    moved, told = run.motion(begin).velocities, run.commands(begin).velocities
    assert run.manager.refused == 0
    assert np.diff(moved, axis=0).std() <= 1.01 * np.diff(told, axis=0).std()
    assert (np.abs(moved[50:]).max(axis=1) > 0.0).all()


@pytest.mark.first_alone
@pytest.mark.parametrize('case, output', list(zip(reversed(INNOCENT), cycle(OUTPUTS))))
def test_an_arm_that_is_late_or_loose_or_pushed_follows(case, output):
    outcome = innocent(case, output, 10.0, 3)
    assert outcome.alarms == 0 and outcome.restarts == 0


@pytest.mark.first_alone
@pytest.mark.parametrize('output, lag', [(VELOCITY, 0.2), (POSITION, 0.2), (TRAJECTORY, 0.1)])
def test_a_slow_drive_that_coasts_to_rest_is_moved_by_nobody(output, lag):
    """Behind a trajectory from where the arm is, the drive lags twice."""
    run = behind(output, settings=Settings(lag=lag), parameters=PlannerParameters(drive_lag=0.2))
    for sign in (1.0, -1.0, 1.0):
        run.drive(sign * FORWARD)
        run.run(2.0)
    run.drive(None)
    run.run(3.0)
    assert not any('does not follow' in sentence or 'something else' in sentence
                   for _, sentence in run.warnings)
    assert np.abs(run.manager.q - run.commands().positions[-1]).max() < 1e-3


def test_without_a_tolerance_nobody_says_anything():
    run = behind(VELOCITY, follow_tolerance=0.0, settings=Settings(active=False))
    run.drive(FORWARD)
    run.run(3.0)
    assert not run.error


@pytest.mark.parametrize('output', OUTPUTS)
def test_a_planner_that_ends_while_the_arm_does_not_follow_says_its_last_words(output):
    run = behind(output, settings=Settings(active=False))
    run.drive(FORWARD)
    assert run.run(2.0, until=lambda: bool(run.loop.state.astray))
    run.loop.finish()
    assert not run.commands().velocities[-1].any()
    assert np.abs(run.commands().positions[-1] - READY).max() < 1e-6


@pytest.mark.first_alone
@pytest.mark.parametrize('seed', [1, 6, 8, 9])
def test_positions_are_clear_where_the_plan_is(seed):
    outcome = clear(seed)
    assert not outcome.touches
    assert outcome.step <= 1.05
