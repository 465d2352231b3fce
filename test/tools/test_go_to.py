"""go_to: there and back with real nodes, and what it says when it cannot."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys

from bench import ARM, ARM_VALUES, FILE
from live_helpers import LIVE, station
import numpy as np
import pinocchio as pin
import pytest
from rcl_interfaces.msg import Log
from std_srvs.srv import SetBool

from redundant_planner.core.errors import StateError
from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.core.robot.se3 import Pose
from redundant_planner.nodes.messages import markers_of
from redundant_planner.nodes.supervisor import PAUSED_ALREADY
from redundant_planner.tools.asked_goal import joint_target_of, target_of
from redundant_planner.tools.go_to import main as go_to
from redundant_planner.tools.target_advice import explained

TIP = Pose(np.array([0.1, 0.2, 0.3]), np.asarray(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 2)))


def test_left_out_parts_stay_and_relative_is_in_the_tips_axes():
    there = target_of(TIP, [0.4, 0.5, 0.6], None, False)
    np.testing.assert_array_equal(there.position, [0.4, 0.5, 0.6])
    np.testing.assert_array_equal(there.rotation, TIP.rotation)
    turned = target_of(TIP, None, [0.0, 0.0, 0.0], False)
    np.testing.assert_array_equal(turned.position, TIP.position)
    np.testing.assert_allclose(turned.rotation, np.eye(3), atol=1e-12)
    forward = target_of(TIP, [0.1, 0.0, 0.0], [0.0, 0.0, np.pi / 2], True)
    np.testing.assert_allclose(forward.position, [0.1, 0.3, 0.3], atol=1e-12)
    np.testing.assert_allclose(forward.rotation, pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), atol=1e-12)


def test_what_it_cannot_use_is_refused(capsys):
    with pytest.raises(StateError, match=r'--position is .* three finite'):
        target_of(TIP, [0.0, np.nan, 0.0], None, False)
    with pytest.raises(SystemExit):
        go_to([])
    assert 'give --position, --rpy or both, or else --joints' in capsys.readouterr().err
    with pytest.raises(SystemExit):
        go_to(['--position', '0', '0', '0', '--joints', 'a=1'])


def test_joints_that_are_left_out_stay_and_bad_entries_are_named():
    q = 0.5 * (ARM.position_min + ARM.position_max)
    one, two = ARM.joint_names[:2]
    for relative, expected in ((False, (0.1, q[1])), (True, (q[0] + 0.1, q[1]))):
        found = joint_target_of(ARM, q, [f'{one}=0.1'], relative)
        np.testing.assert_array_equal(found[:2], expected)
        np.testing.assert_array_equal(found[2:], q[2:])
    for entries, what in (
            (['elbow=1'], f"'elbow=1'; the joints are '{one}'"),
            ([one], 'it takes joint=position'), ([f'{one}=a'], 'it takes joint=position'),
            ([f'{two}=nan'], 'not a finite number'),
            ([f'{one}=0', f'{one}=0'], f"names '{one}' twice"), ([f'{one}=99'], 'must be')):
        with pytest.raises(StateError, match=re.escape(what)):
            joint_target_of(ARM, q, entries, False)


@pytest.mark.parametrize(('reason', 'advice'), [
    ("at the target 'hand' would be 3.0 mm too near to an obstacle", 'target.margin'),
    ("at the target 'hand' would be 3.0 mm too near to 'link1'", 'show_robot'),
    ('no posture has the tip at the target; the speed gave way: singular posture', 'nearer place'),
    ("the speed gave way: link 'hand' near obstacle 'wall'", 'target.path: free'),
    ('no way to the target is found', 'a place in between')])
def test_a_reason_comes_with_what_may_help(reason, advice):
    found = explained(reason)
    assert found.startswith(f'{reason}; try ') and advice in found


def test_of_an_unknown_reason_it_says_no_more_than_that():
    assert explained('a comet') == 'a comet'
    assert explained('') == 'no way has been found yet'


def run(ros, *arguments):
    """go_to as a process, in the station's domain."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.node.context.get_domain_id())}
    return subprocess.Popen(
        [sys.executable, '-m', 'redundant_planner.tools.go_to', *arguments], env=environment,
        text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def end(ros, process):
    """Wait until it ends; return exit status and output."""
    ros.wait_for(lambda: process.poll() is not None, 'the end of go_to')
    out, err = process.communicate()
    return process.returncode, out, err


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_there_blocked_and_stopped_by_ctrl_c():
    with station() as (ros, processes):
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        processes.start('planner_node', FILE,
                        {'limits.linear_speed': 0.05, 'target.path': 'straight'})
        ros.wait_for(lambda: ros.commands and ros.obstacles.get_subscription_count(), 'start')

        def tip():
            return ARM.kinematics(ros.state(ARM.joint_names)).tip_position

        begin = tip()
        there = [f'{number:.5f}' for number in begin + (0.0, -0.05, 0.02)]
        status, out, err = end(ros, run(ros, '--position', *there, '--wait'))
        assert status == 0, err
        assert 'reached' in out and re.search(r'0\.\d mm', out)
        np.testing.assert_allclose(tip(), begin + (0.0, -0.05, 0.02), atol=1e-3)

        # The joints alike, and back.
        q = ros.state(ARM.joint_names)
        for turn in (0.1, -0.1):
            status, out, err = end(ros, run(
                ros, '--joints', f'{ARM.joint_names[-1]}={turn}', '--relative', '--wait'))
            assert status == 0 and 'farthest joint 0.000 rad' in out, (out, err)
        np.testing.assert_allclose(ros.state(ARM.joint_names), q, atol=1e-3)

        # Without --wait it is back at once, and the arm goes on its way.
        status, _, err = end(ros, run(ros, '--position', *there, '--rpy', '0', '0', '0.1'))
        assert status == 0, err

        wall = Obstacle.box('wall', begin + (0.0, -0.25, 0.0), (0.2, 0.05, 0.2))
        ros.obstacles.publish(markers_of([wall], ARM.base_frame))
        ros.wait_for(lambda: any(v.value == '1' for s in ros.statuses[-1:] for v in s.values
                                 if v.key == 'obstacles'), 'the wall')
        behind = [f'{number:.5f}' for number in begin + (0.0, -0.4, 0.0)]
        said = []
        ros.node.create_subscription(Log, '/rosout', lambda m: said.append(m.msg), 100)
        status, out, err = end(ros, run(ros, '--position', *behind, '--wait'))
        assert status == 1 and re.search(r"(blocked|out of reach): .*'wall", err), err
        assert 'try ' in err and 'go_to gives up' in err
        # It says so while it waits, and the pause by which it stops the arm is its own affair.
        assert 'waiting' in out and "'wall" in out
        assert not any('target forgotten' in line for line in said), said

        # The motion waited for is the next one's: Ctrl-C comes when it has said where to go.
        ros.wait_for(ros.at_rest, 'rest')
        before = tip()
        process = run(ros, '--position', *(f'{n:.5f}' for n in begin), '--wait')
        ros.wait_for(lambda: np.linalg.norm(tip() - before) > 0.01, 'motion')
        process.send_signal(signal.SIGINT)
        status, _, err = end(ros, process)
        assert status == 130 and 'stopped' in err
        ros.commands.clear()
        ros.wait_for(ros.at_rest, 'rest')
        assert np.linalg.norm(tip() - begin) > 0.01


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_without_a_planner_it_says_what_is_missing():
    with station() as (ros, _):
        status, _, err = end(ros, run(ros, '--position', '0', '0', '0'))
        assert status == 2 and 'no configuration of a planner within 10 s' in err


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_without_joint_states_it_names_the_topic_that_it_hears():
    with station() as (ros, processes):
        processes.start('fake_hardware_node', FILE, ARM_VALUES,
                        {'joint_states': '/cell/measured'})
        processes.start('planner_node', FILE, {}, {'joint_states': '/cell/measured'})
        place = ['--position', '0', '0.4', '0.9']
        status, _, err = end(ros, run(ros, *place))
        assert status == 2 and re.search(
            "no joint_states of 'd1', .* on /joint_states within 10 s", err), err
        remapped = '--ros-args -r joint_states:='
        assert remapped in err
        status, _, err = end(ros, run(ros, *place, *f'{remapped}/cell/measured'.split()))
        assert status == 0, err


def planner_and_arm(ros, processes):
    """Start a slow planner and its arm; return the planner."""
    processes.start('fake_hardware_node', FILE, ARM_VALUES)
    planner = processes.start('planner_node', FILE, {'limits.linear_speed': 0.05})
    ros.wait_for(lambda: ros.commands and ros.obstacles.get_subscription_count(), 'start')
    return planner


def far(ros):
    """The arguments for a motion that takes seconds."""
    place = ARM.kinematics(ros.state(ARM.joint_names)).tip_position + (0.0, -0.3, 0.0)
    return ['--position', *(f'{number:.5f}' for number in place), '--wait']


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_ctrl_c_twice_stops_the_arm_and_leaves_no_pause():
    with station() as (ros, processes):
        planner_and_arm(ros, processes)
        for _ in range(3):
            ros.commands.clear()
            process = run(ros, *far(ros))
            ros.wait_for(ros.moves, 'motion')
            for _ in range(2):
                process.send_signal(signal.SIGINT)
                ros.spin(0.005)
            status, _, err = end(ros, process)
            assert status == 130 and err.strip() == 'go_to: stopped', (status, err)
            ros.wait_for(ros.at_rest, 'rest')
        assert ros.call(SetBool, 'pause', SetBool.Request(data=True)).message != PAUSED_ALREADY


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_somebody_elses_pause_goes_on_and_a_planner_that_ends_is_missed():
    with station() as (ros, processes):
        planner = planner_and_arm(ros, processes)
        ros.call(SetBool, 'pause', SetBool.Request(data=True))
        status, _, err = end(ros, run(ros, *far(ros)))
        assert status == 2 and err.startswith('go_to: no word of the target')
        assert ros.call(
            SetBool, 'pause', SetBool.Request(data=True)).message == PAUSED_ALREADY
        ros.call(SetBool, 'pause', SetBool.Request(data=False))
        ros.commands.clear()
        process = run(ros, *far(ros))
        # Half a second of it, so that go_to has had word of the target.
        ros.wait_for(ros.moves, 'motion')
        ros.commands.clear()
        ros.wait_for(lambda: ros.moves() and len(ros.commands) > 125, 'half a second of motion')
        planner.terminate()
        status, _, err = end(ros, process)
        assert status == 2 and 'no word of the target for 5 s' in err
        assert 'the arm may still move: planner_node does not answer' in err
