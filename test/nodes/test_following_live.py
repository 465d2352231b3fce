"""Targets behind a sleeping controller, and what is no fault of an arm's, with real processes."""

from __future__ import annotations

import signal
import time

from bench import CREEPING
from builtin_interfaces.msg import Time
from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticStatus
from live_helpers import every, LIVE, station
import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from ros2_control_stand_in import StandIn
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from benchmark.ros2_control import (
    CONTROLLERS,
    Manager,
    OUTPUTS as CONTROLLED_BY,
    Point,
    POSITION,
    Settings,
    TRAJECTORY,
    VELOCITY,
)
from redundant_planner.nodes.joint_messages import JointWriter
from redundant_planner.nodes.messages import seconds_of

pytestmark = LIVE

FORWARD = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
UPWARD = np.array([0.0, 0.0, 0.15, 0.0, 0.0, 0.0])
RATE = 250.0
# Period of /diagnostics [s].
REPORTS = 0.2
PANDA = make_panda()
OUTPUTS = [POSITION, VELOCITY, TRAJECTORY]


class Arm:
    """An arm behind a controller, its planner, and somebody who sends targets."""

    def __init__(self, ros, processes, folder, controller, **options):
        self.ros = ros
        self.arm = StandIn(ros, processes, folder, controller, start=list(PANDA_READY), **options)
        self.planner = processes.start('planner_node', [ROBOTS / 'panda.yaml'], {
            'urdf': str(PANDA_URDF), 'outputs': [self.arm.output]}, remap=self.arm.remap)
        self.targets = ros.node.create_publisher(JointState, 'target_joints', 10)
        self.arm.wait_until_heard()
        ros.wait_for(self.targets.get_subscription_count, 'a listener to targets')

    def go_to(self, away):
        """Send a target that is so far from the start in each joint [rad]."""
        self.targets.publish(JointState(
            name=list(PANDA.joint_names), position=(PANDA_READY + away).tolist()))

    def stream(self):
        """Return a function that sends targets to and fro, called as often as one likes."""
        begin = time.monotonic()
        return every(1.0 / 30.0, lambda: self.go_to(
            0.3 * np.sin(2.0 * (time.monotonic() - begin))))

    def errors(self):
        """What was said as errors, as `ros.statuses` are collected."""
        return [s.message for s in self.ros.statuses if s.level == DiagnosticStatus.ERROR]

    def for_a_while(self, seconds, meanwhile=lambda: None):
        end = time.monotonic() + seconds
        self.ros.wait_for(lambda: time.monotonic() > end, 'the end', meanwhile=meanwhile)

    def comes_to_rest_at(self, away):
        def is_there():
            cycles = self.arm.cycles()
            return (np.abs(cycles.positions[-1] - PANDA_READY - away).max() < CREEPING
                    and np.abs(cycles.velocities[-50:]).max() < CREEPING)

        self.ros.wait_for(is_there, 'arrival')

    def begin_anew(self):
        self.ros.statuses.clear()
        self.ros.commands.clear()

    def stops_with_an_error(self, meanwhile=lambda: None):
        """Wait for the error and for silence; hold both to what is promised."""
        ros, said = self.ros, []

        def is_said():
            said.extend([time.time()] * (not said and bool(self.errors())))
            return said

        ros.wait_for(is_said, 'an error', meanwhile=meanwhile)
        # Commanded positions come back to the arm before that.
        ros.wait_for(lambda: time.time() - seconds_of(ros.commands[-1].header.stamp) > 0.2,
                     'silence', meanwhile=meanwhile)
        assert all('does not follow' in error for error in self.errors())
        moving = [seconds_of(m.header.stamp) for m in ros.commands
                  if np.abs(m.velocity).max() > CREEPING]
        # A stream that begins slowly has told the arm little by then.
        assert said[0] - moving[0] <= 0.6 + REPORTS
        assert moving[-1] - moving[0] <= 1.0

    def wakes_up_at_rest(self, meanwhile=lambda: None):
        """Activate the controller, and see that nothing has waited for that."""
        begin = self.arm.now()
        self.arm.set(active=True)
        self.for_a_while(0.5, meanwhile)
        awake = self.arm.cycles(since=begin)
        assert np.abs(awake.velocities).max() <= 0.05
        assert np.abs(awake.positions - awake.positions[0]).max() <= 2e-3

    def follows(self, meanwhile=lambda: None):
        """Wait until the arm has moved on, and nobody complains."""
        at = self.arm.cycles().positions[-1]
        self.ros.statuses.clear()
        self.ros.wait_for(lambda: np.abs(self.arm.cycles().positions[-1] - at).max() > 0.1,
                          'motion', meanwhile=meanwhile)
        self.ros.wait_for(
            lambda: self.ros.statuses and self.ros.statuses[-1].level == DiagnosticStatus.OK,
            'no error any more', meanwhile=meanwhile)


@pytest.mark.first_alone
@pytest.mark.parametrize('controller', OUTPUTS)
def test_targets_do_not_wait_for_a_controller_that_wakes_up(controller, tmp_path):
    with station() as (ros, processes):
        arm = Arm(ros, processes, tmp_path, controller, active=False)
        # Somebody sends a target once.
        arm.begin_anew()
        arm.go_to(0.5)
        arm.stops_with_an_error()
        arm.wakes_up_at_rest()
        arm.go_to(0.2)
        arm.follows()
        # A stream that begins where the arm is: one that turns round at once is noticed later.
        arm.go_to(0.0)
        arm.comes_to_rest_at(0.0)
        # Somebody sends one after the other, and goes on with that all the while.
        arm.arm.set(active=False)
        arm.begin_anew()
        send = arm.stream()
        arm.stops_with_an_error(send)
        arm.wakes_up_at_rest(send)
        arm.for_a_while(0.4)
        arm.follows(arm.stream())


class SlowTime:
    """Controllers and /clock in this process: each period takes as long as one likes."""

    def __init__(self, ros, controller):
        self.ros, self.periods = ros, 0
        self.manager = Manager(PANDA.joint_names, PANDA_READY.tolist(), controller,
                               PANDA.joint_names, 1.0 / RATE, Settings())
        self._writer = JointWriter(PANDA.joint_names)
        self._clock = ros.node.create_publisher(Clock, '/clock', 10)
        if controller == TRAJECTORY:
            ros.node.create_subscription(
                JointTrajectory, CONTROLLERS[TRAJECTORY], self._on_trajectory, 10)
        else:
            ros.node.create_subscription(
                Float64MultiArray, CONTROLLERS[controller],
                lambda m: self.manager.forward(m.data), qos_profile_sensor_data)

    def _on_trajectory(self, message):
        self.manager.trajectory(message.joint_names, [
            Point(seconds_of(point.time_from_start), point.positions, point.velocities)
            for point in message.points])

    def _period(self):
        self.periods += 1
        self.manager.cycle()
        seconds, rest = divmod(self.periods, round(RATE))
        stamp = Time(sec=seconds, nanosec=round(1e9 * rest / RATE))
        self.ros.joint_states.publish(self._writer.message(
            10**9 * stamp.sec + stamp.nanosec, self.manager.measured,
            self.manager.measured_velocities))
        self._clock.publish(Clock(clock=stamp))

    def at(self, factor):
        """Return a function that has time pass at a share of real time, called often."""
        return every(1.0 / (RATE * factor), self._period)


@pytest.mark.first_alone
@pytest.mark.parametrize('controller, seconds', [
    (VELOCITY, 0.4), (VELOCITY, 2.0), (POSITION, 2.0), (TRAJECTORY, 2.0)])
def test_a_tenth_of_real_time_raises_no_alarm(controller, seconds):
    with station() as (ros, processes):
        time_is = SlowTime(ros, controller)
        processes.start('planner_node', [ROBOTS / 'panda.yaml'], {
            'urdf': str(PANDA_URDF), 'outputs': [CONTROLLED_BY[controller]],
            'use_sim_time': True}, remap={CONTROLLED_BY[controller]: CONTROLLERS[controller]})
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start',
                     meanwhile=time_is.at(1.0))
        ros.statuses.clear()
        end = time_is.periods + seconds * RATE
        goes_on, drive = time_is.at(0.1), ros.driver(FORWARD, rate=10.0)
        ros.wait_for(lambda: time_is.periods >= end, 'the end',
                     meanwhile=lambda: (goes_on(), drive()))
        assert np.abs(time_is.manager.q - PANDA_READY).max() > 0.1 * seconds
        assert ros.statuses and {s.message for s in ros.statuses} == {'planning'}


def test_an_arm_that_cannot_lift_its_load_stops_and_says_so():
    """Its drive has half of the torque that it takes to hold seven times the mass."""
    names = list(PANDA.joint_names)
    with station() as (ros, processes):
        processes.start('mujoco_hardware_node', [ROBOTS / 'panda.yaml'], {
            'urdf': PANDA_URDF, 'initial_joints': names, 'mass_error': 6.0,
            'initial_positions': PANDA_READY.tolist()})
        processes.start('planner_node', [ROBOTS / 'panda.yaml'], {'urdf': str(PANDA_URDF)})
        ros.wait_for(lambda: ros.commands and ros.states, 'start')
        drive = ros.driver(UPWARD)
        said = []

        def is_said():
            said.extend(s.message for s in ros.statuses if 'does not follow' in s.message)
            return said

        ros.wait_for(is_said, 'an error', meanwhile=drive)
        assert "'panda_joint4' stays behind by" in said[0]
        ros.drive_until_silent(UPWARD)


def steps(commands, stopped):
    """Steps between successive commanded positions, as shares of v_max T.

    A command that was lost on its way here leaves a step of several periods; while the planner was
    stopped it sent none.
    """
    stamps = np.array([seconds_of(m.header.stamp) for m in commands])
    moved = np.abs(np.diff([m.position for m in commands], axis=0)) / PANDA.velocity_max * RATE
    periods = np.maximum(np.round(np.diff(stamps) * RATE), 1.0)
    for begin, end in stopped:
        periods[(stamps[1:] > begin) & (stamps[:-1] < end)] = 1.0
    return moved.max(axis=1) / periods


@pytest.mark.first_alone
@pytest.mark.parametrize('controller', OUTPUTS)
def test_processes_that_stand_for_a_moment_raise_no_alarm(controller, tmp_path):
    with station() as (ros, processes):
        arm = Arm(ros, processes, tmp_path, controller)
        back_and_forth = [0]
        stopped = []

        def in_motion(sender, process):
            """Stop a process of an arm in motion for 300 ms, and go on."""
            back_and_forth[0] += 1
            drive = ros.driver(FORWARD if back_and_forth[0] % 2 else -FORWARD)
            ros.wait_for(lambda: len(ros.commands) > 150 and all(
                np.linalg.norm(m.velocity) > 0.1 for m in ros.commands[-150:]), 'motion',
                meanwhile=drive)
            begin = time.time()
            process.send_signal(signal.SIGSTOP)
            arm.for_a_while(0.3, drive)
            process.send_signal(signal.SIGCONT)
            if process is arm.planner:
                stopped.append((begin, time.time()))
            arm.for_a_while(0.6, drive)
            assert ros.moves()

        arm.begin_anew()
        for process in (arm.planner, arm.arm.process):
            in_motion(ros, process)
        # Hardware that says nothing is a fault for as long as it does.
        assert {error.partition(' for ')[0] for error in arm.errors()} <= {
            'no usable joint_states'}
        assert steps(ros.commands, stopped).max() <= 1.05
