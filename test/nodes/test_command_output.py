"""What ros2_control's controllers make of a motion that the planner commands, without any node."""

from __future__ import annotations

from copy import copy
import time
from types import SimpleNamespace

from hypothesis import given, strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from benchmark.ros2_control import Manager, Point, POSITION, Settings, TRAJECTORY, VELOCITY
from redundant_planner.core.safety.jerk import SmoothStop
from redundant_planner.io.mobile_base import BASE_JOINTS
from redundant_planner.io.node_parameters import OUTPUTS
from redundant_planner.nodes.command_output import CommandOutput, FOUND_WITHIN, NEVER_ENDING
from redundant_planner.nodes.messages import seconds_of

NAMES, T = ('a', 'b'), 0.004
ACCELERATION, JERK = np.array([15.0, 7.5]), np.array([7500.0, 3750.0])
TOP = np.array([0.5, -0.3])


class Topic(list):
    """A publisher that keeps what it publishes."""

    def __init__(self, name):
        super().__init__()
        self.topic_name, self.listeners = f'/arm/{name}', 0

    def get_subscription_count(self):
        return self.listeners

    def publish(self, message):
        self.append(copy(message))


def output(topics, low=-2.0, high=2.0, outputs=OUTPUTS, names=NAMES):
    def create_publisher(kind, name, depth):
        topics[name] = Topic(name)
        return topics[name]

    return CommandOutput(SimpleNamespace(create_publisher=create_publisher), names, outputs, T,
                         np.full(len(names), low), np.full(len(names), high))


def motion():
    """Velocities from rest and back, the braking being the planner's own stop."""
    up = TOP * np.sin(np.linspace(0.0, 0.5 * np.pi, 60))[:, None]**2
    stop = SmoothStop(ACCELERATION, JERK, T)
    velocities = [*up, *[TOP] * 200]
    for dq in velocities:
        stop.moving(dq)
    while velocities[-1].any():
        velocities.append(stop.next())
    return np.array([*velocities, *[np.zeros(2)] * 20])


VELOCITIES = motion()
# When each would arrive if the way took no time [s].
TIMES = np.arange(len(VELOCITIES)) * T


def published():
    """Return name of a topic → all that is published there during the motion."""
    topics = {}
    to, q = output(topics), np.zeros(2)
    for dq in VELOCITIES:
        q = q + dq * T
        to.publish(0, q, dq)
    return topics


PUBLISHED = published()


def follow(controller, arrivals, manager_period=T):
    """Have a controller take messages that arrive at times.

    Returns the velocities (cycles, 2), and how far from the end of the motion the arm stands.
    """
    arm = Manager(NAMES, np.zeros(2), controller, NAMES, manager_period, Settings())
    messages = PUBLISHED['joint_trajectory' if controller == TRAJECTORY
                         else f'{controller}_commands']
    arrived, moved = 0, []
    for i in range(int(arrivals[-1] / manager_period) + 10):
        while arrived < len(arrivals) and arrivals[arrived] <= i * manager_period:
            message, arrived = messages[arrived], arrived + 1
            if controller == TRAJECTORY:
                assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)
                point, = message.points
                arm.trajectory(message.joint_names, [Point(
                    seconds_of(point.time_from_start), point.positions, point.velocities)])
            else:
                arm.forward(message.data)
        arm.cycle()
        moved.append(arm.dq)
    assert not arm.refused
    return np.array(moved), np.abs(arm.q - VELOCITIES.sum(axis=0) * T).max()


def while_moving(moved):
    begin, end = np.flatnonzero(np.abs(moved).max(axis=1) > 0.01)[[0, -1]]
    return np.abs(moved[begin:end]).max(axis=1)


def roughness(velocities):
    """The root mean square of the accelerations."""
    return np.sqrt(np.square(np.diff(velocities, axis=0) / T).mean())


@pytest.mark.parametrize('phase', [0.1, 0.5, 0.9])
@pytest.mark.parametrize('controller', [VELOCITY, POSITION, TRAJECTORY])
def test_at_equal_rates_the_arm_moves_as_evenly_as_it_is_told_to(controller, phase):
    moved, left = follow(controller, TIMES + phase * T)
    assert roughness(moved) <= 1.3 * roughness(VELOCITIES)
    assert (while_moving(moved) > 0.005).all()
    assert left < 1e-6 and np.abs(moved[-1]).max() < 1e-9


@pytest.mark.parametrize('manager_rate', [500.0, 1000.0])
def test_a_faster_manager_fills_the_trajectorys_gaps_and_not_those_between_positions(manager_rate):
    moved, _ = follow(TRAJECTORY, TIMES + 0.1 * T, 1.0 / manager_rate)
    assert (while_moving(moved) > 0.005).all()
    assert np.abs(moved).max() < 1.01 * np.abs(TOP).max()
    moved, _ = follow(POSITION, TIMES + 0.1 * T, 1.0 / manager_rate)
    assert np.mean(while_moving(moved) < 1e-9) > 0.45


@given(st.integers(70, 200), st.floats(0.1, 0.9))
def test_a_trajectory_does_not_stand_still_when_one_message_comes_late(late, phase):
    arrivals = TIMES + phase * T
    arrivals[late] = arrivals[late + 1]
    moved, left = follow(TRAJECTORY, arrivals)
    assert (np.abs(moved[70:200]).max(axis=1) > 0.99 * np.abs(TOP).max()).all()
    assert np.abs(moved).max() < 1.01 * np.abs(TOP).max() and left < 1e-6


@given(st.floats(-0.2, 0.2), st.floats(-2.0, 2.0))
def test_no_trajectory_leads_beyond_the_limits_or_further_out(position, velocity):
    topics = {}
    output(topics, -0.1, 0.1).publish(0, np.full(2, position), np.full(2, velocity))
    (point,), = (message.points for message in topics['joint_trajectory'])
    reached = position + velocity * T
    bound = max(0.1, abs(position))
    assert list(point.positions) == pytest.approx([min(max(reached, -bound), bound)] * 2)


def test_outputs_that_nobody_hears_are_named_once_the_arm_should_move():
    topics = {}
    commands = output(topics, outputs=('velocity_commands', 'joint_trajectory'))
    velocities, trajectories = topics['velocity_commands'], topics['joint_trajectory']
    assert commands.unheard() == ''
    commands.moved_at = time.monotonic() - 0.5 * FOUND_WITHIN
    assert commands.unheard() == ''
    assert commands.unheard(patience=0.0) == (
        'nobody listens to velocity_commands on /arm/velocity_commands: load the controller, or '
        "remap velocity_commands to the controller's topic; nobody listens to joint_trajectory "
        'on /arm/joint_trajectory: load the controller, or remap joint_trajectory to the '
        "controller's topic")
    velocities.listeners = trajectories.listeners = 1
    commands.moved_at -= FOUND_WITHIN
    assert commands.unheard() == ''
    velocities.listeners = 0
    assert commands.unheard() == (
        'nobody listens to velocity_commands on /arm/velocity_commands any more: load the '
        "controller, or remap velocity_commands to the controller's topic")


def test_joint_command_counts_where_there_is_no_other_output():
    topics = {}
    commands = output(topics, outputs=())
    topics['joint_command'].listeners = 1
    commands.moved_at = time.monotonic()
    assert commands.unheard() == ''
    topics['joint_command'].listeners = 0
    assert commands.unheard().startswith(
        'nobody listens to joint_command on /arm/joint_command any more: load the driver')


@pytest.mark.parametrize('names', [NAMES, (*BASE_JOINTS, *NAMES)])
def test_the_second_process_waits_for_as_many_listeners_as_it_can_find(names):
    """It counts those of all its outputs, a base's too."""
    planners, seconds = {}, {}
    planner = output(planners, names=names)
    second = output(seconds, outputs=[name for name in OUTPUTS if name in NEVER_ENDING],
                    names=names)
    for topic in (*planners.values(), *seconds.values()):
        topic.listeners = 1
    assert sum(second.listeners().values()) == sum(
        planner.listeners().get(name, 0) for name in NEVER_ENDING)


def positions(topics):
    """Those that are published, on each topic that has some."""
    state = deserialize_message(topics['joint_command'][-1], JointState)
    return [np.array(state.position), np.array(topics['position_commands'][-1].data),
            np.array(topics['joint_trajectory'][-1].points[0].positions)]


def test_positions_are_told_in_the_count_of_the_arms_driver():
    """A whole turn off for one joint; a trajectory stays within its limits all the same."""
    turned = np.array([-2.0 * np.pi, 0.0])
    for q in (np.array([1.0, 0.5]), np.array([1.999, 0.5])):
        plain, counted = {}, {}
        output(plain).publish(0, q, TOP)
        output(counted).publish(0, q, TOP, turned)
        for there, here in zip(positions(counted), positions(plain)):
            np.testing.assert_allclose(there, here + turned, atol=1e-12)
        assert counted['velocity_commands'][-1].data == plain['velocity_commands'][-1].data
        assert positions(plain)[2][0] <= 2.0


@pytest.mark.parametrize('outputs, periods', [
    ((), np.inf), (('velocity_commands',), np.inf), (('joint_trajectory',), 1.0),
    (('velocity_commands', 'position_commands'), 0.0)])
def test_an_arm_that_takes_velocities_goes_on_by_its_last_one(outputs, periods):
    assert output({}, outputs=outputs).goes_on == periods
