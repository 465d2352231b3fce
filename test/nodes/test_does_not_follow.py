"""An arm that does not do what it is told: the planner stops, says so, and goes on gently."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from controlled_arm import PANDA, started
from diagnostic_msgs.msg import DiagnosticStatus
from live_helpers import LIVE, station
import numpy as np
import pytest

pytestmark = LIVE

FORWARD = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
OUTPUTS = ('velocity_commands', 'position_commands')


def both(*steps):
    def call():
        for step in steps:
            step()
    return call


def says(ros, text, level=DiagnosticStatus.ERROR):
    return any(text in status.message and status.level == level for status in ros.statuses)


def spin(ros, arm, seconds, drive=lambda: None):
    end = time.monotonic() + seconds
    ros.wait_for(lambda: time.monotonic() > end, 'the end', meanwhile=both(arm.cycle, drive))


def silent(ros, arm, drive=lambda: None):
    """Go on until no command has come for a while."""
    def quiet():
        ros.commands.clear()
        spin(ros, arm, 0.2, drive)
        return not ros.commands
    ros.wait_for(quiet, 'silence', meanwhile=both(arm.cycle, drive))


@pytest.mark.parametrize('output', OUTPUTS)
def test_an_inactive_controller_is_noticed_and_nothing_waits_for_it(output):
    with station() as (ros, processes):
        arm = started(ros, processes, output)
        arm.activate(False)
        drive = ros.driver(FORWARD)
        ros.wait_for(lambda: says(ros, 'does not follow'), 'an error',
                     meanwhile=both(arm.cycle, drive))
        assert any('is its controller active' in s.message for s in ros.statuses)
        silent(ros, arm, drive)
        spin(ros, arm, 1.0, drive)  # a stick that is held all the time is no fresh command
        assert not ros.commands
        arm.activate(True)
        begin = time.monotonic()
        spin(ros, arm, 0.5, drive)
        spin(ros, arm, 0.5)
        assert arm.moved(begin) < 2e-3
        # A fresh command: gently at first, then as ever.
        ros.statuses.clear()
        begin = time.monotonic()
        ros.wait_for(lambda: arm.moved(begin) > 0.1, 'motion', meanwhile=both(arm.cycle, drive))
        steps = np.abs(np.diff([q for at, q in arm.history if at >= begin], axis=0)).max(axis=1)
        assert steps.max() < 2.0 * PANDA.velocity_max.max() * 0.004
        ros.wait_for(lambda: ros.statuses and ros.statuses[-1].level == DiagnosticStatus.OK,
                     'no error any more', meanwhile=both(arm.cycle, drive))


def test_joints_in_another_order_are_stopped_and_named():
    with station() as (ros, processes):
        arm = started(ros, processes, 'velocity_commands', (1, 0, 2, 3, 4, 5, 6))
        begin, drive = time.monotonic(), ros.driver(FORWARD)
        ros.wait_for(lambda: says(ros, 'another order'), 'an error',
                     meanwhile=both(arm.cycle, drive))
        silent(ros, arm, drive)
        assert arm.moved(begin) < 0.1
        message = next(s.message for s in ros.statuses if 'another order' in s.message)
        assert "'panda_joint1'" in message and "'panda_joint2'" in message


def test_positions_that_go_to_other_joints_leap_once():
    with station() as (ros, processes):
        arm = started(ros, processes, 'position_commands', order=(1, 0, 2, 3, 4, 5, 6))
        ros.wait_for(lambda: says(ros, 'jump each time'), 'an error',
                     meanwhile=both(arm.cycle, ros.driver(FORWARD)))
        silent(ros, arm, ros.driver(FORWARD))


@pytest.mark.parametrize('output', OUTPUTS)
def test_frozen_hardware_with_fresh_stamps_does_not_leap_when_it_wakes_up(output):
    with station() as (ros, processes):
        arm = started(ros, processes, output)
        drive = ros.driver(FORWARD)
        ros.wait_for(lambda: arm.moved() > 0.05, 'motion', meanwhile=both(arm.cycle, drive))
        arm.frozen = True
        ros.wait_for(lambda: says(ros, 'does not follow'), 'an error',
                     meanwhile=both(arm.cycle, drive))
        silent(ros, arm, drive)
        arm.frozen = False
        begin = time.monotonic()
        spin(ros, arm, 0.5)
        assert arm.moved(begin) < 2e-3


def test_an_arm_that_others_have_moved_at_rest_stays_there():
    with station() as (ros, processes):
        arm = started(ros, processes, 'velocity_commands')
        drive = ros.driver(FORWARD)
        ros.wait_for(lambda: arm.moved() > 0.02, 'motion', meanwhile=both(arm.cycle, drive))
        spin(ros, arm, 1.0)
        arm.activate(False)  # another controller takes over
        for _ in range(50):
            arm.q = arm.q + 0.005 * np.array([1.0, -1.0, 0.5, 0.0, 0.0, 0.0, 0.0])
            spin(ros, arm, 0.02)
        spin(ros, arm, 0.5)
        arm.activate(True)
        begin = time.monotonic()
        spin(ros, arm, 1.0)
        assert arm.moved(begin) < 6e-3
        begin = time.monotonic()
        ros.wait_for(lambda: arm.moved(begin) > 0.02, 'motion', meanwhile=both(arm.cycle, drive))


def test_an_output_that_nobody_hears_is_named():
    with station() as (ros, processes):
        arm = started(ros, processes, 'velocity_commands', listens=False)
        ros.wait_for(lambda: says(ros, 'nobody listens to velocity_commands on /velocity_c'),
                     'an error', meanwhile=both(arm.cycle, ros.driver(FORWARD)))


def test_go_to_ends_with_the_reason():
    with station() as (ros, processes):
        arm = started(ros, processes, 'velocity_commands')
        arm.activate(False)
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.node.context.get_domain_id())}
        child = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.go_to', '--position', '0.4', '0.2',
             '0.4', '--wait'], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True)
        try:
            ros.wait_for(lambda: child.poll() is not None, 'the end', meanwhile=arm.cycle)
        finally:
            child.kill()
        assert child.returncode == 1
        assert 'does not follow: joint' in child.stderr.read()
