"""mujoco_hardware_node with a planner, as real processes over real topics."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticArray
from live_helpers import LIVE, PATIENCE, run_node, station
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.nodes.messages import markers_of, twist_to_message
from redundant_planner.nodes.mujoco_hardware_node import parsed
from redundant_planner.nodes.physics_report import CONTACTS, TORQUE_SHARE

pytestmark = LIVE
NAMES = make_panda().joint_names
ARM = {'urdf': PANDA_URDF, 'initial_joints': list(NAMES), 'initial_positions': list(PANDA_READY)}
SIDEWAYS = (0.0, 0.08, 0.0, 0.0, 0.0, 0.0)
NEAR_THE_HAND = ('link5', 'link6', 'link7', 'hand', 'fingers')
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def physics(live):
    """The latest entry of the arm in /diagnostics."""
    values = [s.values for s in live.statuses if s.name == '/mujoco_hardware_node: physics']
    return {v.key: v.value for v in values[-1]} if values else {}


def stamp_ns(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_an_arm_with_mass_is_driven_among_obstacles():
    """The same topics as fake_hardware_node; a ball that the hand is pushed into is told."""
    with station() as (live, processes):
        heard, contacts = [], []
        live.node.create_subscription(String, 'robot_description', heard.append, LATCHED)
        live.node.create_subscription(
            DiagnosticArray, '/mujoco_hardware_node/contacts', contacts.append, LATCHED)
        processes.start('mujoco_hardware_node', [ROBOTS / 'panda.yaml'], ARM)
        processes.start('planner_node', [ROBOTS / 'panda.yaml'], {'urdf': PANDA_URDF})
        live.wait_for(lambda: live.commands and heard, 'the first command')
        assert heard[-1].data == PANDA_URDF.read_text()
        np.testing.assert_allclose(live.state(NAMES), PANDA_READY, atol=1e-3)
        hand = make_panda().kinematics(PANDA_READY).tip_position
        wall = markers_of([Obstacle.box('wall', hand + (0.0, 0.35, 0.0), (0.5, 0.1, 0.5))],
                          'panda_link0')
        live.wait_for(lambda: physics(live).get('obstacles') == '1', 'the wall',
                      meanwhile=lambda: live.obstacles.publish(wall))
        # It moves, and stops before the wall.
        robot = make_panda()
        live.drive_until(SIDEWAYS, lambda: robot.kinematics(
            live.state(NAMES)).tip_position[1] > hand[1] + 0.05, 'motion')
        live.drive(SIDEWAYS, 3.0)
        state = physics(live)
        assert state[CONTACTS] == '0' and 0.0 < float(state[TORQUE_SHARE]) < 0.9, state
        efforts = dict(zip(live.states[-1].name, live.states[-1].effort))
        assert 5.0 < abs(efforts['panda_joint4']) < 40.0
        # A wall that moves onto the arm touches it.
        tip = robot.kinematics(live.state(NAMES)).tip_position
        onto = markers_of([Obstacle.box('wall', tip, (0.1, 0.1, 0.1))], 'panda_link0')
        live.wait_for(lambda: physics(live)[CONTACTS] != '0' and contacts, 'a contact',
                      meanwhile=lambda: live.obstacles.publish(onto))
        touched = {v.key: v.value for v in contacts[-1].status[0].values}
        assert touched['other'].startswith('wall') and touched['link'] in NEAR_THE_HAND


@pytest.mark.long
def test_with_a_clock_planner_and_arm_go_in_step():
    """Every period has one command, for as much as this machine is busy, and none comes late."""
    with station() as (live, processes):
        times = []
        live.node.create_subscription(Clock, '/clock', lambda m: times.append(
            m.clock.sec * 10**9 + m.clock.nanosec), 1000)
        processes.start('mujoco_hardware_node', [ROBOTS / 'panda.yaml'], {
            **ARM, 'clock': True, 'wait_for_cmd_vel': True, 'answer_timeout': 30.0})
        processes.start('planner_node', [ROBOTS / 'panda.yaml'], {
            'urdf': PANDA_URDF, 'use_sim_time': True})
        live.wait_for(lambda: live.commands and times and physics(live), 'the first command')
        answered = [0]
        message = twist_to_message(SIDEWAYS)

        def answer():
            if stamp_ns(live.commands[-1]) > answered[0]:
                answered[0] = stamp_ns(live.commands[-1])
                live.twist.publish(message)

        def wait_until(time_ns):
            live.wait_for(lambda: times[-1] >= time_ns, 'simulated time', meanwhile=answer)

        wait_until(times[-1] + 200_000_000)
        begin, first = times[-1], len(live.commands)
        missed = physics(live)['answers missed']  # while the planner was starting
        before = make_panda().kinematics(live.state(NAMES)).tip_position
        wait_until(begin + 1_000_000_000)
        stamps = [stamp_ns(command) for command in live.commands[first:]]
        assert len(stamps) >= 240 and set(np.diff(stamps)) == {4_000_000}
        assert physics(live)['answers missed'] == missed
        after = make_panda().kinematics(live.state(NAMES)).tip_position
        np.testing.assert_allclose(after - before, np.array(SIDEWAYS[:3]), atol=3e-3)


def test_without_mujoco_it_says_what_to_install(tmp_path):
    (tmp_path / 'mujoco.py').write_text("raise ImportError('No module named mujoco')\n")
    done = subprocess.run(
        [sys.executable, '-m', 'redundant_planner.nodes.mujoco_hardware_node', '--ros-args',
         '--params-file', str(ROBOTS / 'paper_2p5r.yaml')],
        env=dict(os.environ, PYTHONPATH=os.pathsep.join(
            [str(tmp_path), *filter(None, [os.environ.get('PYTHONPATH')])])),
        capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 2 and 'Traceback' not in done.stderr
    assert "pip install 'redundant_planner[mujoco]'" in done.stderr


@pytest.mark.long
def test_no_other_node_needs_mujoco(tmp_path):
    (tmp_path / 'mujoco.py').write_text('raise ImportError\n')
    names = ('planner_node', 'fake_hardware_node', 'scenario_player', 'cloud_obstacles')
    code = ''.join(f'import redundant_planner.nodes.{name}\n' for name in names) + (
        'import redundant_planner.tools.demo\n')
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, timeout=PATIENCE,
        env=dict(os.environ, PYTHONPATH=os.pathsep.join(
            [str(tmp_path), *filter(None, [os.environ.get('PYTHONPATH')])])))
    assert done.returncode == 0, done.stderr


def test_bad_parameters_end_it_with_one_line():
    status, said = run_node('mujoco_hardware_node', '-p', 'servo:=strong')
    assert status == 2 and "'servo' is 'strong'; it must be one of" in said
    status, said = run_node('mujoco_hardware_node')
    assert status == 2 and "'urdf' is empty" in said and 'Traceback' not in said


def test_options_stand_beside_those_of_ros():
    line = ['--viewer', '--record', 'a.gif', '--ros-args', '-p', 'rate:=100']
    assert parsed(line) == (True, Path('a.gif'))
    assert parsed(['--ros-args', '-p', 'rate:=100']) == (False, None)
