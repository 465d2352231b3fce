"""go_to, drive and record_bag with a planner that has several tips."""

from __future__ import annotations

from contextlib import ExitStack
import os
import pty
import re
import signal
import subprocess
import sys

from conftest import HANDS, make_two_handed, two_handed_urdf
from live_helpers import every, LIVE, PATIENCE, station
import numpy as np
import pytest
from std_srvs.srv import SetBool

from redundant_planner.core.errors import StateError
from redundant_planner.io.tip_topics import topic_of
from redundant_planner.nodes.target_text import text_of_tip
from redundant_planner.tools.go_to import main as go_to

BODY = make_two_handed()
NAMES = list(BODY.joint_names)
START = [0.2, 0.0, 0.4, 0.3, 0.2, 0.9, 0.1, 0.4, 0.4, -0.3, -0.2, 0.9, -0.1, 0.4]
VALUES = {'robot_description': two_handed_urdf(), 'tips': list(HANDS), 'link_shapes': 'straight',
          'link_radius': 0.03, 'drive.dead_time': 0.006}


def test_a_tip_has_topics_of_its_own_where_there_are_several():
    assert topic_of('', 'cmd_vel', ['hand']) == topic_of('hand', 'cmd_vel', ['hand']) == 'cmd_vel'
    assert topic_of('left_hand', 'cmd_vel', HANDS) == 'left_hand/cmd_vel'
    assert topic_of('object', 'target_pose', HANDS) == 'object/target_pose'
    for tip, tips, message in (
            ('', HANDS, "say which with --tip; the tips are 'left_hand', 'right_hand', and "
                        "'object' is what they hold"),
            ('claw', HANDS, "--tip is 'claw'; the tips are 'left_hand'"),
            ('claw', ['hand'], "--tip is 'claw'; the planner has one tip, 'hand'"),
            ('object', ['hand'], 'has one tip')):
        with pytest.raises(StateError, match=message):
            topic_of(tip, 'cmd_vel', tips)


def test_what_is_said_of_one_tip_is_found_among_those_of_others():
    text = 'left_hand: 1 2 3 0 0 0 1; right_hand: 4 5 6 0 0 0 1'
    assert text_of_tip(text, 'right_hand') == '4 5 6 0 0 0 1'
    assert text_of_tip(text, 'hand') == text_of_tip('', 'hand') == ''


def test_a_tip_and_joints_exclude_each_other(capsys):
    with pytest.raises(SystemExit):
        go_to(['--joints', 'lift=0.1', '--tip', 'left_hand'])
    assert '--joints are of the whole body' in capsys.readouterr().err


def run(ros, tool, *arguments):
    """Run a tool as a process in the station's domain; return exit status and output."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.node.context.get_domain_id())}
    process = subprocess.Popen(
        [sys.executable, '-m', f'redundant_planner.tools.{tool}', *arguments],
        env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    ros.wait_for(lambda: process.poll() is not None, f'the end of {tool}')
    out, err = process.communicate()
    return process.returncode, out, err


def tips(ros):
    return dict(zip(HANDS, BODY.kinematics(ros.state(NAMES)).tips.each))


def start(ros, processes):
    processes.start('fake_hardware_node', [], {
        'robot_description': VALUES['robot_description'], 'initial_joints': NAMES,
        'initial_positions': START})
    processes.start('planner_node', [], VALUES)
    ros.wait_for(lambda: ros.commands, 'start')


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_go_to_moves_each_tip_and_what_both_hold_and_a_bag_has_it_all(tmp_path):
    with station() as (ros, processes), ExitStack() as stack:
        start(ros, processes)
        recorder = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.record_bag', str(tmp_path / 'bag')],
            env=processes.environment, stdout=subprocess.PIPE, text=True)
        stack.callback(recorder.kill)
        # Streams it hears once somebody publishes them; what is sent once it awaits.
        topics = [*(f'{tip}/target_pose' for tip in (*HANDS, 'object')), 'object/pose']
        ros.wait_for(lambda: all('record_bag' in {
            end.node_name for end in ros.node.get_subscriptions_info_by_topic(topic)}
            for topic in topics), 'the recorder on each topic')
        before = tips(ros)
        status, _, err = run(ros, 'go_to', '--position', '0', '0', '0')
        assert status == 2 and "say which with --tip; the tips are 'left_hand'" in err
        status, _, err = run(ros, 'go_to', '--position', '0', '0', '0', '--tip', 'claw')
        assert status == 2 and "--tip is 'claw'; the tips are 'left_hand'" in err

        # Along the axes of the right hand; the other one stays.
        status, out, err = run(ros, 'go_to', '--tip', 'right_hand', '--relative', '--position',
                               '0.04', '0', '0.02', '--wait')
        assert status == 0 and 'reached' in out, err
        after, right = tips(ros), before['right_hand']
        np.testing.assert_allclose(
            after['right_hand'].position, right.position + right.rotation @ (0.04, 0.0, 0.02),
            atol=1e-3)
        np.testing.assert_allclose(
            after['left_hand'].position, before['left_hand'].position, atol=1e-3)
        left = after['left_hand'].position + (0.02, 0.03, 0.0)
        status, out, err = run(ros, 'go_to', '--tip', 'left_hand', '--wait', '--position',
                               *(f'{number:.5f}' for number in left))
        assert status == 0 and 'reached' in out, err
        np.testing.assert_allclose(tips(ros)['left_hand'].position, left, atol=1e-3)

        # What both hold, from where it is: its position is half way between them.
        ros.wait_for(ros.at_rest, 'rest')
        assert ros.call(SetBool, 'couple', SetBool.Request(data=True)).success
        status, _, err = run(ros, 'go_to', '--tip', 'left_hand', '--relative', '--position',
                             '0.02', '0', '0')
        assert status == 2 and 'move it with --tip object' in err
        before = tips(ros)
        status, out, err = run(ros, 'go_to', '--object', '--relative', '--position', '0', '0',
                               '0.03', '--rpy', '0', '0', '0.1', '--wait')
        assert status == 0 and 'reached' in out, err
        middle = [np.mean([pose.position for pose in there.values()], axis=0)
                  for there in (before, tips(ros))]
        np.testing.assert_allclose(middle[1] - middle[0], (0.0, 0.0, 0.03), atol=1e-3)
        turn = tips(ros)['left_hand'].rotation @ before['left_hand'].rotation.T
        np.testing.assert_allclose(np.arctan2(turn[1, 0], turn[0, 0]), 0.1, atol=5e-3)
        # Its orientation stays where none is given, although it is not the base's any more.
        status, out, err = run(ros, 'go_to', '--object', '--wait', '--position',
                               *(f'{number:.5f}' for number in middle[0]))
        assert status == 0, err
        again = tips(ros)['left_hand'].rotation @ before['left_hand'].rotation.T
        np.testing.assert_allclose(again, turn, atol=5e-3)

        ros.wait_for(ros.at_rest, 'rest')
        assert ros.call(SetBool, 'couple', SetBool.Request(data=False)).success
        recorder.send_signal(signal.SIGINT)
        said, _ = recorder.communicate(timeout=PATIENCE)
    counts = {topic: int(count) for count, topic in re.findall(r'^ *(\d+)  /(\S+)$', said, re.M)}
    assert counts['object/pose'] > 10


@pytest.mark.long
@pytest.mark.live
@LIVE
def test_go_to_object_without_a_coupling_says_what_it_takes():
    with station() as (ros, processes):
        start(ros, processes)
        status, _, err = run(ros, 'go_to', '--object', '--relative', '--position', '0', '0', '0.1')
        assert status == 2 and 'which takes ~/couple' in err and 'on /object/pose' in err


@pytest.mark.live
@LIVE
def test_drive_moves_the_tip_that_is_named_and_asks_for_a_name():
    with station() as (ros, processes):
        start(ros, processes)
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.node.context.get_domain_id())}

        def drive(*arguments):
            ours, theirs = pty.openpty()
            return ours, subprocess.Popen(
                [sys.executable, '-m', 'redundant_planner.tools.drive', *arguments],
                env=environment, stdin=theirs, stdout=theirs, stderr=theirs)

        ours, process = drive('--tip', 'left_hand')
        before = tips(ros)

        def risen():
            return (tips(ros)['left_hand'].position - before['left_hand'].position)[2] > 0.01

        ros.wait_for(risen, 'motion', meanwhile=every(0.1, lambda: os.write(ours, b'r')))
        os.write(ours, b'q')
        ros.wait_for(lambda: process.poll() is not None, 'the end of drive')
        assert process.returncode == 0
        ros.wait_for(ros.at_rest, 'rest')
        moved = tips(ros)['left_hand'].position - before['left_hand'].position
        assert np.abs(moved[:2]).max() < 1e-3
        ours, process = drive()
        ros.wait_for(lambda: process.poll() is not None, 'the end of drive')
        assert process.returncode == 2
        assert b"say which with --tip; the tips are 'left_hand'" in os.read(ours, 100_000)
