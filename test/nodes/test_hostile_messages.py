"""What others may send to a planner whose arm is in motion: it moves on, on time."""

from __future__ import annotations

from bench import ARM, ARM_VALUES, FILE, RATE, START
from geometry_msgs.msg import Twist
from live_helpers import LIVE, station
import numpy as np
import pytest
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from standstill import Standstill
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.horizon.preview import Preview
from redundant_planner.io.marker_reader import MOST_MARKERS
from redundant_planner.nodes.messages import preview_to_message, seconds_of, twist_to_message

pytestmark = LIVE
# The longest time between two commands [s].
LONGEST_PERIOD = 0.02
# Nobody may lose a tick: while we publish megabytes, commands overflow what receives them here.
ALL_TICKS = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Bench:
    """An arm that moves back and forth, and what its planner says."""

    def __init__(self, ros, processes, standstill):
        self.ros, self.way, self.standstill = ros, 0.05, standstill
        self.said: list[str] = []
        self.sent_at: list[float] = []
        node = ros.node
        node.create_subscription(
            Float64MultiArray, 'planner_node/ticks',
            lambda m: self.sent_at.append(m.data[0] + 1e-9 * m.data[1]), ALL_TICKS)
        node.create_subscription(Log, '/rosout', lambda m: self.said.append(m.msg), 100)
        self.previews = node.create_publisher(MultiDOFJointTrajectory, 'cmd_vel_preview', 1)
        self.parameters = node.create_client(SetParameters, '/planner_node/set_parameters')
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        static = {f'static_obstacle.{name}.{key}': values for name in ('wall', 'my.wall')
                  for key, values in (('center', [5.0, 5.0, 5.0]), ('semi_axes', [0.1] * 3))}
        self.planner = processes.start(
            'planner_node', FILE, {
                'static_obstacles': ['wall', 'my.wall'], **static, 'joint_state_timeout': 1.0,
                'incoming_command_timeout': 1.0, 'publish_ticks': True})
        ros.wait_for(lambda: ros.commands and self.sent_at
                     and self.previews.get_subscription_count()
                     and ros.twist.get_subscription_count()
                     and ros.obstacles.get_subscription_count()
                     and self.parameters.service_is_ready(), 'start')

    def drive_until(self, condition, what):
        """Drive towards the other side until a condition holds."""
        self.ros.drive_until(np.array([0.0, self.way, 0.0, 0.0, 0.0, 0.0]), condition, what)

    def endures(self, attack, answered, what):
        """Attack while the arm moves; wait for the answer, and look at the commands meanwhile."""
        self.way, commands = -self.way, self.ros.commands
        commands.clear()
        self.drive_until(lambda: len(commands) > 50 and np.any(commands[-1].velocity), 'motion')
        del commands[:-1]
        attack()
        self.drive_until(answered, what)
        count = len(commands)
        self.drive_until(lambda: len(commands) > count + 50 or self.planner.poll() is not None,
                         'commands after it')
        assert self.planner.poll() is None
        begin, end = (seconds_of(commands[i].header.stamp) for i in (0, -1))
        self.ros.wait_for(lambda: self.sent_at[-1] >= end, 'ticks')
        velocities = np.array([m.velocity for m in commands])
        positions = np.array([m.position for m in commands])
        stamps = np.array([seconds_of(m.header.stamp) for m in commands])
        ticks = np.maximum(np.round(np.diff(stamps) * RATE), 1.0)[:, None]
        steps = np.abs(np.diff(velocities, axis=0))
        assert (steps <= ARM.acceleration_max * ticks / RATE * (1.0 + 1e-6)).all()
        assert (np.abs(velocities) <= ARM.velocity_max * (1.0 + 1e-6)).all()
        assert ((positions >= ARM.position_min) & (positions <= ARM.position_max)).all()
        assert velocities[-1].any()
        sent_at = np.array([at for at in self.sent_at if begin <= at <= end])
        periods = np.diff(sent_at)
        for i in np.flatnonzero(periods >= LONGEST_PERIOD).tolist():
            lost = self.standstill.lost(sent_at[i], sent_at[i + 1])
            assert periods[i] - lost < LONGEST_PERIOD, (
                f'{1e3 * periods[i]:.1f} ms between commands; the machine stood still for '
                f'{1e3 * lost:.1f} ms of them')

    def says(self, text):
        """Return a condition: that the planner has logged a text from now on."""
        self.said.clear()
        return lambda: any(text in said for said in self.said)


@pytest.fixture(scope='module')
def bench():
    with Standstill() as standstill, station() as (ros, processes):
        yield Bench(ros, processes, standstill)


def markers(count, **fields):
    listed = [Marker(**{'id': i, 'type': Marker.SPHERE, **fields}) for i in range(count)]
    for marker in listed:
        marker.pose.position.x = 5.0
        marker.pose.orientation.w = 1.0
        marker.scale.x = marker.scale.y = marker.scale.z = 0.1
    return bytes(serialize_message(MarkerArray(markers=listed)))


def test_a_detector_that_sees_nothing_any_more(bench):
    def attack():
        for raw in (markers(3), markers(0), markers(0), markers(3, action=Marker.DELETE),
                    markers(0), markers(0), markers(1, type=Marker.ARROW)):
            bench.ros.obstacles.publish(raw)

    bench.endures(attack, bench.says('is a marker of type 0'), 'refusal of the last message')


def test_joint_states_that_are_cut_short(bench):
    whole = bytes(serialize_message(JointState(name=list(START), position=[0.0] * 5)))

    def attack():
        for length in (8, 0, 4, 5, 11, 30, len(whole) - 5):
            bench.ros.joint_states.publish(whole[:length])
        bench.ros.joint_states.publish(b'\0\1\0\0' + b'\xff' * 64)

    bench.endures(attack, bench.says('joint_states ignored'), 'refusal')


def test_commands_that_are_no_numbers(bench):
    said = bench.says('cmd_vel ignored')

    def attack():
        for value in (np.nan, np.inf, 1e308):
            bench.ros.twist.publish(twist_to_message(np.full(6, value)))
        bench.ros.twist.publish(bytes(serialize_message(Twist()))[:9])

    bench.endures(attack, said, 'refusal')


def test_parameters_of_the_wrong_type(bench):
    string = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value='hello')
    strings = ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY,
                             string_array_value=['a', 'b', 'c'])
    numbers = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY,
                             double_array_value=[5.0, 5.0, 6.0])
    far = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY,
                         double_array_value=[np.inf, 1e308, 0.0])
    tries = [('static_obstacle.wall.center', string), ('static_obstacle.wall.center', strings),
             ('static_obstacle.my.wall.center', numbers), ('static_obstacle.wall.center', far),
             ('criteria.k_w', strings)]
    futures = []

    def attack():
        for name, value in tries:
            futures.append(bench.parameters.call_async(SetParameters.Request(
                parameters=[Parameter(name=name, value=value)])))

    bench.endures(attack, lambda: all(f.done() for f in futures), 'answers')
    results = [f.result().results[0] for f in futures]
    assert [r.successful for r in results] == [False, False, True, False, False]
    assert "'static_obstacle.wall.center' is 'hello'; it takes 3 finite numbers" in (
        results[0].reason)


@pytest.mark.parametrize('points', [30_000, 60_000])
def test_a_preview_of_very_many_points(bench, points):
    preview = preview_to_message(Preview(
        np.linspace(0.0, 60.0, 30), np.tile((0.0, 0.01, 0.0, 0.0, 0.0, 0.0), (30, 1))))
    preview.points = [point for point in preview.points for _ in range(points // 30)]
    raw = bytes(serialize_message(preview))
    answered = (bench.says('points; up to') if points > 50_000 else
                lambda: len(bench.ros.commands) > 100)
    bench.endures(lambda: bench.previews.publish(raw), answered, 'refusal')


def test_very_many_markers(bench):
    raws = [markers(10_000), markers(10_000, action=Marker.DELETE)]
    two = markers(2, action=Marker.DELETE)
    raws.append(two[:4] + (100_000).to_bytes(4, 'little')
                + 50_000 * (two[8:] + bytes(-len(two) % 4)))

    def attack():
        for raw in raws:
            bench.ros.obstacles.publish(raw)

    bench.endures(attack, bench.says(f'100000 markers; up to {MOST_MARKERS}'), 'refusal')
