"""Faults that nobody foresaw, in a planner that moves a simulated arm: none leaves it moving."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from bench import ARM_VALUES, assert_smooth, Bench, FILE, most_commands
from diagnostic_msgs.msg import DiagnosticStatus
from live_helpers import LIVE, PATIENCE, station
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from redundant_planner.nodes.messages import seconds_of, twist_to_message

pytestmark = LIVE
# The fixtures of the bench.
pytest_plugins = ['bench']
FAULTY = Path(__file__).parent.parent / 'faulty_planner.py'


def second_process(planner) -> int:
    """Return the number of the process that is to stop the arm in a planner's place."""
    number, = Path(f'/proc/{planner.pid}/task/{planner.pid}/children').read_text().split()
    return int(number)


def has_ended(number: int) -> bool:
    """Return whether a process has ended, even if nobody has asked for its exit status yet."""
    try:
        state = Path(f'/proc/{number}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return True
    return state == 'Z'


class FaultyBench(Bench):
    """A bench with a planner that breaks on demand."""

    def __init__(self, ros, processes):
        self.fault = ros.node.create_publisher(String, 'fault', 10)
        super().__init__(ros, processes, FAULTY)
        ros.wait_for(self.fault.get_subscription_count, 'the listener for faults')
        ros.wait_for(lambda: self.value('last word') == 'ready', 'the last word')

    def break_at(self, place):
        self.fault.publish(String(data=place))


@pytest.fixture(scope='module')
def make_bench():
    return FaultyBench


@pytest.mark.parametrize('place, said', [
    ('message', "a message on 'fault': ZeroDivisionError: a bad message"),
    ('executor', 'outside of every callback of ours')])
def test_an_exception_costs_its_message_and_not_the_motion(bench, place, said):
    bench.move()
    bench.break_at(place)
    bench.ros.drive_until(
        bench.forward, lambda: said in (bench.value('last fault') or ''), 'the fault')
    assert int(bench.value('faults')) >= 1
    bench.move(20)
    assert bench.planner.poll() is None


@pytest.mark.parametrize('place, said', [
    ('tick', 'ZeroDivisionError: a bad tick'),
    ('nan', 'the planner asked for the velocities [nan'),
    ('braking', 'ZeroDivisionError: a bad tick')])
def test_a_tick_that_fails_brakes_the_arm_until_a_reset(bench, place, said):
    """Even where the braking fails as well, for three ticks."""
    bench.move()
    bench.break_at(place)
    bench.until_rest(bench.forward)
    assert bench.braking_commands() <= most_commands('a request')
    assert_smooth(bench.ros.commands, f'a fault of the kind {place}')
    bench.says(said, DiagnosticStatus.ERROR)
    bench.ros.drive_until_silent(bench.forward)
    bench.ros.statuses.clear()
    bench.says(said, DiagnosticStatus.ERROR)
    assert bench.planner.poll() is None

    assert bench.ros.call(Trigger, 'reset', Trigger.Request()).success
    bench.ros.commands.clear()
    bench.until_motion()
    bench.ros.drive_until(bench.forward, lambda: len(bench.ros.commands) > 20, 'commands')
    assert_smooth(bench.ros.commands)


def test_a_crowd_of_requests_does_not_come_between_two_commands(bench):
    """300 changes of parameters at once; the last one is what the node says in the end."""
    ros = bench.ros
    client = ros.node.create_client(SetParameters, '/planner_node/set_parameters')
    said = []
    subscription = ros.node.create_subscription(
        String, '/planner_node/configuration', lambda message: said.append(message.data), 10)
    ros.wait_for(lambda: client.service_is_ready()
                 and subscription.get_publisher_count(), 'services')
    bench.move()
    times = []
    reports = ros.node.create_subscription(
        Float64MultiArray, 'command_times', lambda message: times.append(message.data), 1)
    ros.wait_for(reports.get_publisher_count, 'reports')
    bench.break_at('nothing')
    ros.wait_for(lambda: times, 'times')
    # Of requests that wait, the middleware keeps ten: ten requests with thirty changes each.
    requests = [SetParameters.Request(parameters=[
        Parameter('criteria.k_alpha', value=0.8 + 1e-4 * (30 * i + j)).to_parameter_msg()
        for j in range(30)]) for i in range(10)]
    answers = [client.call_async(request) for request in requests]
    ros.drive_until(bench.forward, lambda: all(a.done() for a in answers), 'answers')
    ros.drive_until(
        bench.forward, lambda: said and 'criteria.k_alpha: 0.8299' in said[-1], 'the last change')
    assert all(r.successful for a in answers for r in a.result().results)
    times.clear()
    bench.break_at('nothing')
    ros.wait_for(lambda: times, 'times')
    longest = np.diff(times[0]).max()
    print(f'\n300 changes at once: at most {1e3 * longest:.1f} ms of work between two commands')
    assert longest < 0.02
    assert len(said) < 20, 'not said for each change'
    ros.node.destroy_subscription(subscription)


@pytest.mark.first_alone
@pytest.mark.parametrize('end, status', [
    ('kill', -signal.SIGKILL), ('segfault', -signal.SIGSEGV), ('system_exit', 3),
    ('bad_finish', 4)])
def test_whatever_ends_the_process_its_last_command_is_a_smooth_stop(own_bench, end, status):
    ros, planner = own_bench.ros, own_bench.planner
    second = second_process(planner)
    own_bench.move()
    begin = time.time()
    if end == 'kill':
        planner.kill()
    else:
        own_bench.break_at(end)
    ros.wait_for(lambda: planner.poll() is not None, 'the end of the planner')
    assert planner.returncode == status
    ros.wait_for(ros.stops, 'a stop')
    ros.wait_for(lambda: has_ended(second), 'the end of the last word')
    assert ros.stops()
    assert own_bench.braking_commands() <= most_commands('the end of the process')
    assert_smooth(ros.commands)
    rest = next(seconds_of(m.header.stamp) for m in ros.commands if not np.any(m.velocity))
    print(f'\n{end}: at rest {1e3 * (rest - begin):.0f} ms later')


def test_an_interrupt_while_modules_load_ends_without_a_word():
    # What comes early, and what takes longest: Numba.
    for node, module in (('planner_node', 'llvmlite'), ('fake_hardware_node', 'numpy')):
        child = subprocess.Popen([sys.executable, '-m', f'redundant_planner.nodes.{node}'],
                                 stderr=subprocess.PIPE, text=True)
        maps = Path(f'/proc/{child.pid}/maps')
        deadline = time.monotonic() + PATIENCE
        while module not in maps.read_text():
            assert time.monotonic() < deadline and child.poll() is None
            time.sleep(0.005)
        child.send_signal(signal.SIGINT)
        _, said = child.communicate(timeout=PATIENCE)
        assert (child.returncode, said) == (-signal.SIGINT, '')


def test_negative_time_stops_the_arm_and_says_so():
    with station() as (ros, processes):
        clock = ros.node.create_publisher(Clock, '/clock', 10)
        forward = twist_to_message([0.0, -0.1, 0.0, 0.0, 0.0, 0.0])
        start = time.monotonic()

        def pass_time():
            clock.publish(Clock(clock=Time(
                nanoseconds=int(1e9 * (time.monotonic() - start + 100.0))).to_msg()))
            ros.twist.publish(forward)
            ros.spin(0.004)

        def negative():
            message = Clock()
            message.clock.sec = -3
            clock.publish(message)
            ros.spin(0.004)

        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        planner = processes.start('planner_node', FILE, {'use_sim_time': True})
        ros.wait_for(lambda: len(ros.commands) > 20 and all(
            np.any(m.velocity) for m in ros.commands[-20:]), 'motion', meanwhile=pass_time)
        ros.statuses.clear()
        ros.wait_for(ros.stops, 'a stop', meanwhile=negative)
        ros.wait_for(lambda: any(
            '/clock says -3 s; time must not be negative' in s.message
            and s.level == DiagnosticStatus.ERROR for s in ros.statuses), 'the reason',
            meanwhile=negative)
        ros.commands.clear()
        ros.wait_for(ros.moves, 'motion', meanwhile=pass_time)
        assert planner.poll() is None


@pytest.mark.long
def test_the_other_process_leaves_with_the_planner(own_bench):
    """And no sooner: it is deaf to the signals that end the planner."""
    planner = own_bench.planner
    second = second_process(planner)
    os.kill(second, signal.SIGINT)
    os.kill(second, signal.SIGTERM)
    own_bench.move()
    assert own_bench.value('last word') == 'ready'
    planner.send_signal(signal.SIGINT)
    assert planner.wait(PATIENCE) == 0
    assert has_ended(second)
    own_bench.ros.wait_for(own_bench.ros.stops, 'a stop')
