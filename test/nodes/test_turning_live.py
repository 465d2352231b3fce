"""Arms whose driver wraps joints that turn without end, and joint states in parts, live."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
import time

from bench import CREEPING
from conftest import EXAMPLE_ROBOTS
from joint_states_in_parts import PREFIX
from live_helpers import LIVE, station
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from topic_recorder import TopicRecorder
from trajectory_msgs.msg import JointTrajectory

from redundant_planner.analysis.bag_analysis import analyse
from redundant_planner.analysis.replay_inputs import read_inputs
from redundant_planner.core.parameters import PlannerParameters
from redundant_planner.core.robot.model import Robot
from redundant_planner.core.robot.turns import TURN
from redundant_planner.io.bag_reader import open_bag
from redundant_planner.io.joint_turns import wrapped
from redundant_planner.io.parameter_files import settings_of
from redundant_planner.tools.replayed_ticks import again, differences

pytestmark = LIVE

URDF = EXAMPLE_ROBOTS / 'kinova_description' / 'robots' / 'kinova.urdf'
ROBOT = Robot(URDF.read_text(), 'j2s6s200_end_effector', link_radius=0.03)
NAMES = list(ROBOT.joint_names)
START = [-2.5, 2.3, 4.4, 0.5, 1.7, np.pi]
ARM = {'urdf': URDF, 'initial_joints': NAMES, 'initial_positions': START,
       'wrap_continuous': True, 'noise': 1e-4}
PLANNER = {'urdf': URDF, 'tip_frame': 'j2s6s200_end_effector', 'link_radius': 0.03,
           'command_frame': 'tool', 'publish_ticks': True,
           'outputs': ['position_commands', 'joint_trajectory']}
TOPICS = {'joint_states': JointState, 'joint_command': JointState,
          'planner_node/configuration': String, 'planner_node/ticks': Float64MultiArray}
PARTS = Path(__file__).parents[1] / 'joint_states_in_parts.py'
# About the last joint's axis, and nothing else.
TURNING = [0.0, 0.0, 0.0, -0.8, 0.0, 0.0]


@pytest.fixture
def ros():
    with station() as (ros, processes):
        ros.processes, ros.said = processes, []
        ros.node.create_subscription(Log, '/rosout', lambda m: ros.said.append(m.msg), 100)
        ros.silent = ros.node.create_publisher(String, 'silent', QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        ros.targets = ros.node.create_publisher(JointState, 'target_joints', 10)
        ros.recorder = TopicRecorder(ros, TOPICS)
        yield ros


def start(ros, in_parts=False, **arm):
    """Start arm and planner, and a process between them that says joint states in parts."""
    if in_parts:
        ros.processes.start(PARTS)
        # It knows what to leave out before there is anything.
        ros.wait_for(ros.silent.get_subscription_count, 'the parts')
    ros.processes.start(
        'fake_hardware_node', [], {**ARM, **({'rate': 100} if in_parts else {}), **arm},
        remap={'joint_states': 'whole'} if in_parts else None)
    # One more process that a busy machine makes late.
    late = {'joint_state_timeout': 0.5, 'follow.tolerance': 0.2} if in_parts else {}
    ros.processes.start('planner_node', [], {**PLANNER, **late})


def silence(ros, names):
    """Have joints be left out of the parts."""
    ros.silent.publish(String(data=' '.join(names)))


def until_ready(ros):
    ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count()
                 and ros.targets.get_subscription_count(), 'start')


class Turned:
    """How far the last joint has turned since this began, as its wrapped positions tell [rad]."""

    def __init__(self, ros):
        self.now, self.most, self.least, self._last = 0.0, 0.0, 0.0, None
        ros.node.create_subscription(JointState, 'joint_states', self._take, 100)

    def _take(self, message):
        if NAMES[5] in message.name:
            q = message.position[message.name.index(NAMES[5])]
            self.now += np.angle(np.exp(1j * (q - (q if self._last is None else self._last))))
            self.most, self.least, self._last = (
                max(self.most, self.now), min(self.least, self.now), q)


def seconds(messages):
    return np.array([m.header.stamp.sec % 10**6 + 1e-9 * m.header.stamp.nanosec
                     for m in messages])


def assert_undisturbed(ros):
    """No restart, no word of what is nobody's business, no step beyond a limit."""
    bad = [said for said in ros.said if 'jumped' in said or 'ignored' in said
           or 'no usable' in said or 'does not follow' in said]
    assert not bad, bad[:3]
    velocities = np.array([m.velocity for m in ros.commands])
    ticks = np.maximum(np.round(np.diff(seconds(ros.commands)) * 250.0), 1.0)[:, None]
    assert (np.abs(np.diff(velocities, axis=0)) * 250.0 / ticks
            <= ROBOT.acceleration_max * (1.0 + 1e-6)).all()


def exact_replay(ros, path):
    """The largest difference between recorded and replayed commands."""
    ros.recorder.write(path)
    with open_bag(path) as bag:
        inputs = read_inputs(bag, None, '', '')
    found = differences(inputs, again(inputs, settings_of(PlannerParameters, inputs.values)))
    assert len(found) > 100
    return found.max(), inputs


def test_a_joint_at_the_seam_is_as_good_as_any(ros):
    """With noise its driver says π and −π in turn."""
    start(ros)
    until_ready(ros)
    before = len(ros.commands)
    ros.drive(np.zeros(6), 1.0)
    said = np.array([m.position[5] for m in ros.states])
    assert said.min() < -3.1 and said.max() > 3.1
    assert len(ros.commands) - before > 200
    assert_undisturbed(ros)


@pytest.mark.long
def test_a_joint_turns_by_eight_rad_across_the_seam(ros, tmp_path):
    start(ros)
    positions, trajectories = [], []
    ros.node.create_subscription(Float64MultiArray, 'position_commands', positions.append, 100)
    ros.node.create_subscription(JointTrajectory, 'joint_trajectory', trajectories.append, 100)
    until_ready(ros)
    turned = Turned(ros)
    ros.drive_until(TURNING, lambda: turned.now > 8.0, '8 rad')
    ros.wait_for(ros.at_rest, 'rest')
    assert_undisturbed(ros)
    # All positions are the driver's, and go on without a step but where it crosses its seam.
    for said in ([m.position[5] for m in ros.commands], [m.data[5] for m in positions],
                 [m.points[0].positions[5] for m in trajectories]):
        assert (np.abs(np.diff(said)) > 6.0).sum() >= 2  # it began on the seam
        assert np.abs(said).max() < np.pi + 0.05
        assert np.ptp(np.unwrap(said)) > 8.0
    commanded = np.unwrap([m.position[5] for m in ros.commands])
    ticks = np.round(np.diff(seconds(ros.commands)) * 250.0)  # one that was lost, or late
    assert (np.abs(np.diff(commanded)) < 0.84 * 0.004 * (ticks + 2.0)).all()
    largest, inputs = exact_replay(ros, tmp_path / 'bag')
    assert largest == 0.0
    planned_at = np.array([tick.q[5] for _, tick in inputs.ticks])
    assert np.ptp(planned_at) > 8.0 and np.abs(np.diff(planned_at)).max() < 0.1
    # The report's curve goes on, too.
    curve = analyse(tmp_path / 'bag').curves.positions[:, 5]
    assert np.ptp(curve) > 8.0 and np.abs(np.diff(curve)).max() < 0.1


@pytest.mark.long
@pytest.mark.parametrize('wraps', [True, False])
def test_a_joint_target_is_reached_the_short_way_round(ros, wraps):
    """3.5 and −2.78 are the same place; from the former on, a turn further is it, too."""
    start(ros, wrap_continuous=wraps, initial_positions=[*START[:5], 3.0])
    until_ready(ros)
    turned = Turned(ros)
    for target in (3.5, 3.0, -2.78, 3.0 + 10.0 * TURN):
        message = JointState(name=[NAMES[5]], position=[target])
        ros.commands.clear()
        ros.targets.publish(message)
        ros.wait_for(lambda: ros.moves() and len(ros.commands) > 20, 'motion')
        ros.wait_for(lambda to=target: ros.at_rest() and abs(np.sin(
            0.5 * (ros.states[-1].position[5] - to))) < 1e-3, 'arrival')
    assert 0.48 < turned.most < 0.6 and turned.least > -0.1  # as late as this machine is
    assert_undisturbed(ros)


@pytest.mark.long
def test_go_to_takes_the_short_way_round_too(ros):
    """With joint states in parts, for which the tool waits."""
    start(ros, in_parts=True, initial_positions=[*START[:5], 3.0])
    until_ready(ros)
    turned = Turned(ros)
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.node.context.get_domain_id())}
    for target in ('3.5', '-2.78'):
        process = subprocess.Popen(
            [sys.executable, '-m', 'redundant_planner.tools.go_to', '--joints',
             f'{NAMES[5]}={target}', '--wait'], env=environment, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        ros.wait_for(lambda process=process: process.poll() is not None, 'the end of go_to')
        assert process.returncode == 0, process.communicate()
        assert turned.now == pytest.approx(0.5, abs=0.01)
    assert turned.most < 0.6 and turned.least > -0.1  # as late as this machine is


@pytest.mark.long
def test_joint_states_come_in_parts(ros, tmp_path):
    """At two rates, in another order, with a gripper and doubles of the joints in between."""
    start(ros, in_parts=True)
    until_ready(ros)
    turned = Turned(ros)
    ros.drive_until(TURNING, lambda: turned.now > 2.0, '2 rad')
    ros.wait_for(ros.at_rest, 'rest')
    assert_undisturbed(ros)
    assert all(s.level.hex() == '00' or 'others' in s.message or 'listening' in s.message
               or 'waiting' in s.message or 'nobody listens' in s.message
               for s in ros.statuses), {s.message for s in ros.statuses}
    assert exact_replay(ros, tmp_path / 'bag')[0] == 0.0
    analysis = analyse(tmp_path / 'bag')
    assert analysis.joint_names == ROBOT.joint_names
    assert np.ptp(analysis.curves.positions[:, 5]) == pytest.approx(2.0, abs=0.3)
    assert np.abs(np.diff(analysis.curves.positions[:, 5])).max() < 0.1
    # As joints are interpolated between their measurements, none seems to accelerate more.
    assert analysis.joints.peak_velocity[5] < 0.85


def test_a_missing_part_is_named_and_stops_the_arm(ros):
    silence(ros, NAMES[4:])
    start(ros, in_parts=True)
    missing = f"'{NAMES[4]}', '{NAMES[5]}'"
    ros.wait_for(lambda: any(s.message.startswith(
        f'waiting for joint_states of {missing}: missing for') for s in ros.statuses), 'word')
    ros.wait_for(lambda: any(said.startswith(f'waiting for joint_states of {missing}')
                             for said in ros.said), 'word in the log')
    assert not ros.commands
    silence(ros, [])
    until_ready(ros)
    ros.drive(TURNING, 1.0)
    assert ros.moves()
    silence(ros, NAMES[4:])
    ros.drive_until(TURNING, lambda: any(s.message.startswith(
        f'no usable joint_states of {missing} for') for s in ros.statuses), 'the fault')
    ros.wait_for(ros.stops, 'a stop')
    assert np.abs(ros.commands[-1].velocity).max() < CREEPING
    silence(ros, [])
    ros.commands.clear()
    # Where the machine delivers a part so late that the arm seems not to follow, a driver has to
    # let go before it moves again.
    drive = ros.driver(TURNING)
    ros.wait_for(ros.moves, 'motion again',
                 meanwhile=lambda: drive() if time.monotonic() % 2.0 < 1.2 else None)


def test_joint_states_of_others_alone_are_named(ros):
    """As where everything has a prefix that the URDF has not."""
    silence(ros, NAMES)
    start(ros, in_parts=True)
    ros.wait_for(lambda: any(
        s.message.startswith(f"waiting for joint_states of '{NAMES[0]}', ")
        and '; those that come are of ' in s.message and f"'{PREFIX}{NAMES[0]}'" in s.message
        for s in ros.statuses), 'word of the others')
    ros.wait_for(lambda: any('; those that come are of ' in said for said in ros.said),
                 'word in the log')
    assert not any('ignored' in said for said in ros.said)


def test_the_simulated_arm_wraps_within_minus_pi_and_pi(ros):
    start(ros, initial_positions=[4.0, 4.0, 4.0, -4.0, 4.0, 7.0], noise=0.0)
    np.testing.assert_allclose(ros.state(NAMES), wrapped(
        np.array([4.0, 4.0, 4.0, -4.0, 4.0, 7.0]), ROBOT.position_max))


def test_the_simulated_arm_with_mass_wraps_and_is_told_wrapped_positions(ros):
    """Its servo takes positions: whichever turn they are of, it stays where it is."""
    pytest.importorskip('mujoco')
    ros.processes.start('mujoco_hardware_node', [], {
        **ARM, 'tip_frame': PLANNER['tip_frame'], 'link_radius': 0.03, 'servo': 'position',
        'initial_positions': [*START[:5], 3.5], 'gravity': [0.0, 0.0, 0.0]})
    ros.wait_for(lambda: ros.states, 'joint_states')
    first = ros.state(NAMES)
    assert first[5] == pytest.approx(3.5 - TURN, abs=1e-2)
    turned = Turned(ros)
    commander = ros.node.create_publisher(JointState, 'joint_command', 10)
    ros.wait_for(commander.get_subscription_count, 'the arm')
    for turns in (0.0, TURN, -2.0 * TURN):
        end = time.monotonic() + 0.5
        told = [*START[:5], 3.6 - TURN + turns]
        ros.wait_for(lambda end=end: time.monotonic() > end, 'the end', meanwhile=lambda told=told:
                     commander.publish(JointState(name=NAMES, position=told, velocity=[0.0] * 6)))
    assert turned.now == pytest.approx(0.1, abs=0.02)
    assert turned.most < 0.15 and turned.least > -0.05
