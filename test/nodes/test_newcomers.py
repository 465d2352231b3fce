"""Nodes that join and leave around a moving arm do not interrupt its commands."""

from __future__ import annotations

from itertools import pairwise
import os
from pathlib import Path

from bench import ARM_VALUES, FILE
from live_helpers import LIVE, station
import numpy as np
from passers_by import PasserBy
import pytest
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from redundant_planner.io.resources import share_directory
from redundant_planner.nodes.messages import seconds_of
from redundant_planner.nodes.runtime import keep_off_shared_memory

PROFILE = str(share_directory() / 'config' / 'middleware' / 'localhost_udp.xml')
RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
TRANSPORTS, LOCALHOST_ONLY = 'FASTDDS_BUILTIN_TRANSPORTS', 'ROS_LOCALHOST_ONLY'
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
OURS = {TRANSPORTS: 'UDPv4', RANGE: 'SYSTEM_DEFAULT', **dict.fromkeys(PROFILES, PROFILE)}
# What joint_command may pause for while nodes come and go [s].
LONGEST = 0.020
COUNT = 20
# Of the package's nodes and of the passers-by that listen at the same time.
AT_ONCE = 4


@pytest.mark.parametrize(('given', 'expected'), [
    ({}, {TRANSPORTS: 'UDPv4'}),
    ({RANGE: 'SUBNET'}, {TRANSPORTS: 'UDPv4'}),
    ({RANGE: 'SUBNET', PEERS: '10.0.0.2'}, {TRANSPORTS: 'UDPv4'}),
    ({RANGE: 'LOCALHOST'}, OURS),
    ({LOCALHOST_ONLY: '1'}, {**OURS, LOCALHOST_ONLY: '0'}),
    ({RANGE: 'LOCALHOST', PEERS: '10.0.0.2'}, {TRANSPORTS: 'UDPv4'}),
    (OURS, OURS),  # a child of one of our processes
    ({**OURS, RANGE: 'LOCALHOST'}, OURS),
    ({RANGE: 'LOCALHOST', TRANSPORTS: 'SHM'}, {}),
    ({RANGE: 'LOCALHOST', PROFILES[0]: '/my.xml'}, {}),
    ({RANGE: 'LOCALHOST', PROFILES[1]: '/my.xml'}, {}),
])
def test_shared_memory_is_left_out_unless_the_user_has_chosen(
        monkeypatch, tmp_path, given, expected):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, 'environ', dict(given))
    keep_off_shared_memory()
    assert os.environ == {**given, **expected}


def test_a_profile_in_the_working_directory_is_a_choice(monkeypatch, tmp_path):
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, 'environ', {RANGE: 'LOCALHOST'})
    keep_off_shared_memory()
    assert os.environ == {RANGE: 'LOCALHOST'}


@pytest.mark.long
@LIVE
@pytest.mark.parametrize('discovery_range', ['LOCALHOST', 'SUBNET'])
def test_twenty_nodes_join_and_leave_or_hang_or_are_killed(machine, discovery_range):
    """Every third of them each, with the middleware's own choice of transports."""
    with station() as (ros, processes):
        environment = processes.environment
        for name in PROFILES:
            environment.pop(name, None)
        environment[RANGE] = discovery_range
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        # The arm's own pauses are not the planner's.
        planner = processes.start('planner_node', FILE, {'joint_state_timeout': 5.0})
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
        assert '/dev/shm/fastrtps' not in Path(f'/proc/{planner.pid}/maps').read_text(), (
            'the planner has shared memory open')
        commands = []
        ros.node.create_subscription(
            JointState, 'joint_command', commands.append, QoSProfile(depth=5000))
        forward = np.array([0.0, -0.02, 0.0, 0.0, 0.0, 0.0])
        ros.drive_until(forward, ros.moves, 'motion')

        present, left = [], []

        def one_goes():
            oldest, leaves = present.pop(0)
            if leaves:
                ros.drive_until(forward, lambda: oldest.heard > 0, 'a command at a newcomer')
                oldest.leave()
                left.append(oldest)
            else:
                oldest.kill()

        for i in range(COUNT):
            fate = ('leaves', 'is killed', 'hangs')[i % 3]
            passer_by = PasserBy(int(environment['ROS_DOMAIN_ID']), discovery_range,
                                 0.0 if fate == 'hangs' else np.inf)
            present.append((passer_by, fate == 'leaves'))
            ros.drive(forward, 0.2)
            if len(present) == AT_ONCE:
                one_goes()
            if i % 6 == 5:
                forward = -forward
        while present:
            one_goes()
        ros.drive(forward, 0.5)
        for passer_by in left:
            passer_by.kill()
    stamps = np.array([seconds_of(message.header.stamp) for message in commands])
    periods = np.diff(stamps)
    assert len(stamps) > 200.0 * 0.2 * COUNT
    pauses = [(begin, end, machine.lost(begin, end)) for begin, end in pairwise(stamps)
              if end - begin > LONGEST]
    for begin, end, lost in pauses:
        assert end - begin - lost < LONGEST, (
            f'{1e3 * (end - begin):.1f} ms without a command {begin - stamps[0]:.2f} s after the '
            f'beginning, of which the machine stood still for {1e3 * lost:.1f} ms')
    print(f'\n{discovery_range}: longest period {1e3 * periods.max():.1f} ms; '
          f'{len(pauses)} above {1e3 * LONGEST:g} ms')
