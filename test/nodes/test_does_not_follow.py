"""An arm that does not do what it is told, live; all cases are in test_behind_controllers.py."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticStatus
from live_helpers import LIVE, station
import numpy as np
import pytest
from ros2_control_stand_in import StandIn

from benchmark.ros2_control import OUTPUTS, POSITION, TRAJECTORY

pytestmark = LIVE

FORWARD = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
START = list(PANDA_READY)
PANDA = make_panda()


def started(ros, processes, folder, controller='velocity', heard=True, **options):
    """Start an arm behind a controller, and a planner for it."""
    arm = StandIn(ros, processes, folder, controller, start=START, **options)
    processes.start('planner_node', [ROBOTS / 'panda.yaml'], {
        'urdf': str(PANDA_URDF), 'outputs': [arm.output]}, remap=arm.remap if heard else {})
    if heard:
        arm.wait_until_heard()
    else:
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
    return arm


def says(ros, text):
    """Return when an error was said with these words, as `ros.statuses` are collected."""
    return any(text in status.message and status.level == DiagnosticStatus.ERROR
               for status in ros.statuses)


def silent(ros, drive):
    """Go on driving until no command has come for a while."""
    def quiet():
        ros.commands.clear()
        end = time.monotonic() + 0.2
        ros.wait_for(lambda: time.monotonic() > end, 'the end', meanwhile=drive)
        return not ros.commands
    ros.wait_for(quiet, 'silence', meanwhile=drive)


@pytest.mark.first_alone
@pytest.mark.parametrize('controller', OUTPUTS)
def test_a_controller_that_wakes_up_finds_no_command_waiting(controller, tmp_path):
    with station() as (ros, processes):
        arm = started(ros, processes, tmp_path, controller, active=False)
        drive = ros.driver(FORWARD)
        ros.wait_for(lambda: says(ros, 'does not follow'), 'an error', meanwhile=drive)
        assert says(ros, 'is its controller active')
        silent(ros, drive)
        begin = arm.now()
        arm.set(active=True)
        # A stick that is held all the time is no fresh command.
        ros.drive(FORWARD, 0.5)
        assert not ros.commands
        end = time.monotonic() + 0.5
        ros.wait_for(lambda: time.monotonic() > end, 'the end')
        awake = arm.cycles(since=begin)
        assert np.abs(awake.velocities).max() <= 0.05
        assert np.abs(awake.positions - awake.positions[0]).max() <= 2e-3
        # Then it follows, and nobody complains any more.
        ros.statuses.clear()
        ros.drive_until(FORWARD, lambda: np.abs(
            arm.cycles(since=begin).positions[-1] - START).max() > 0.1, 'motion')
        ros.drive_until(FORWARD, lambda: ros.statuses
                        and ros.statuses[-1].level == DiagnosticStatus.OK, 'no error any more')
        moved = arm.cycles(since=begin)
        assert moved.refused[-1] == 0
        assert (np.abs(moved.velocities) < 2.0 * PANDA.velocity_max).all()
        # In motion the hardware freezes.
        arm.set(frozen=True)
        ros.statuses.clear()
        ros.wait_for(lambda: says(ros, 'does not follow'), 'an error', meanwhile=drive)
        silent(ros, drive)
        begin = arm.now()
        arm.set(frozen=False)
        end = time.monotonic() + 0.5
        ros.wait_for(lambda: time.monotonic() > end, 'the end')
        assert np.abs(arm.cycles(since=begin).velocities).max() <= 0.05


@pytest.mark.parametrize('controller', [POSITION, TRAJECTORY])
def test_positions_come_once_in_each_cycle(controller, tmp_path):
    """Where commands came at a cycle's edge, every fourth cycle would stand still."""
    with station() as (ros, processes):
        arm = started(ros, processes, tmp_path, controller)
        shares = []
        # Some are late on a busy machine, but not in every second.
        while len(shares) < 6 and min(shares, default=1.0) >= 0.2:
            if shares:
                ros.drive(-FORWARD, 1.5)
            ros.drive(FORWARD, 0.5)
            begin = arm.now()
            ros.drive(FORWARD, 1.0)
            cycles = arm.cycles(since=begin)
            fastest = np.abs(cycles.velocities[:, np.abs(cycles.velocities).mean(axis=0).argmax()])
            shares.append(np.mean(fastest < 0.2 * np.median(fastest)))
            assert cycles.refused[-1] == 0
        assert shares[-1] < 0.2, shares


def test_an_output_that_nobody_hears_is_named(tmp_path):
    with station() as (ros, processes):
        started(ros, processes, tmp_path, heard=False)
        ros.drive_until(
            FORWARD, lambda: says(ros, 'nobody listens to velocity_commands on /velocity_comm'),
            'an error')


def test_go_to_ends_with_the_reason(tmp_path):
    with station() as (ros, processes):
        started(ros, processes, tmp_path, active=False)
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.node.context.get_domain_id())}
        child = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.go_to', '--position', '0.4', '0.2',
             '0.4', '--wait'], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True)
        try:
            ros.wait_for(lambda: child.poll() is not None, 'the end')
        finally:
            child.kill()
        assert child.returncode == 1
        assert 'does not follow: joint' in child.stderr.read()
