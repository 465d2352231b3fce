"""What may go wrong around a moving arm, with real processes: it always comes to rest smoothly."""

from __future__ import annotations

import signal
import time

from bench import ARM, ARM_VALUES, assert_smooth, Bench, FILE, most_commands, RATE, START
from conftest import make_panda, PANDA_READY, PANDA_URDF, ROBOTS
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from live_helpers import LIVE, PATIENCE, station
import numpy as np
import pinocchio as pin
import pytest
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.nodes.messages import markers_of, seconds_of, twist_to_message

pytestmark = LIVE
# The fixtures of the bench.
pytest_plugins = ['bench']


def test_joint_states_stop(bench):
    """The planner brakes within the limits, falls silent, and goes on from where the arm is."""
    bench.move()
    bench.arm.send_signal(signal.SIGSTOP)
    fault = time.time()
    bench.until_rest(bench.forward)
    assert bench.commands_until_rest(fault) <= most_commands('joint_states stop')
    assert_smooth(bench.ros.commands, 'joint_states stop')
    bench.ros.drive_until_silent(bench.forward)
    bench.says('no usable joint_states', DiagnosticStatus.ERROR)
    bench.arm.send_signal(signal.SIGCONT)
    bench.until_motion()
    bench.ros.drive_until(bench.forward, lambda: len(bench.ros.commands) > 20, 'commands')
    assert_smooth(bench.ros.commands)


@pytest.mark.long
def test_joint_states_turn_into_nonsense(bench):
    """Good states stop while bad ones stream in."""
    names = list(ARM.joint_names)
    bench.move()
    bench.arm.send_signal(signal.SIGSTOP)

    def nonsense():
        bench.ros.joint_states.publish(JointState(name=names, position=[np.nan] * 7))
        bench.ros.joint_states.publish(JointState(name=names[:-1], position=[0.0] * 6))
        bench.ros.drive(bench.forward, 0.01)

    bench.ros.wait_for(bench.ros.stops, 'a stop', meanwhile=nonsense)
    assert_smooth(bench.ros.commands, 'joint_states turn into nonsense')
    bench.arm.send_signal(signal.SIGCONT)
    bench.ros.commands.clear()
    bench.until_motion()


def test_the_arm_restarts_elsewhere_in_the_middle_of_a_motion(own_bench):
    own_bench.move()
    own_bench.arm.kill()
    own_bench.processes.start('fake_hardware_node', FILE, {
        'initial_joints': ['d1', 'd2', 'theta4'], 'initial_positions': [0.3, 0.3, 1.0]})
    ros = own_bench.ros
    ros.wait_for(lambda: ros.states and ros.state(['theta4'])[0] > 0.9, 'the new arm')
    ros.commands.clear()
    own_bench.until_motion()
    ros.drive_until(own_bench.forward, lambda: len(ros.commands) > 20, 'commands')
    assert_smooth(ros.commands)
    at = ros.commands[-1].name.index('theta4')
    assert abs(ros.commands[-1].position[at] - 1.0) < 0.3


def test_pause_leaves_the_arm_alone_and_resumes_from_where_it_is(bench):
    bench.move()
    assert bench.request(SetBool, 'pause', True).success
    bench.until_rest(bench.forward)
    assert bench.braking_commands() <= most_commands('a request')
    assert_smooth(bench.ros.commands, 'pause')
    bench.says('paused', DiagnosticStatus.WARN)
    bench.ros.commands.clear()
    # Somebody else moves the arm meanwhile.
    other = bench.ros.node.create_publisher(JointState, 'joint_command', 10)

    def push():
        other.publish(JointState(name=['theta6'], velocity=[-0.5]))
        bench.ros.drive(np.zeros(6), 0.01)

    bench.ros.wait_for(lambda: bench.ros.state(['theta6'])[0] < START['theta6'] - 0.1,
                       'the push', meanwhile=push)
    bench.ros.node.destroy_publisher(other)
    # A push counts for 0.05 s from its arrival on.
    settled = time.time() + 0.2
    bench.ros.wait_for(lambda: seconds_of(bench.ros.states[-1].header.stamp) > settled
                       and not np.any(bench.ros.states[-1].velocity), 'an arm at rest')
    here = bench.ros.state(ARM.joint_names)
    bench.ros.commands.clear()
    assert 'where the arm is' in bench.ros.call(
        SetBool, 'pause', SetBool.Request(data=False)).message
    bench.ros.wait_for(lambda: len(bench.ros.commands) > 20, 'commands')
    np.testing.assert_allclose(bench.ros.commands[-1].position, here, atol=1e-6)
    bench.move()


def test_reset_forgets_where_the_motion_was_going(bench):
    bench.move()
    assert bench.request(Trigger, 'reset').success
    bench.until_rest(bench.forward)
    assert bench.braking_commands() <= most_commands('a request')
    assert_smooth(bench.ros.commands, 'reset')
    bench.ros.commands.clear()
    bench.until_motion()


def test_two_senders_of_commands_are_refused_by_name_and_not_mixed(bench):
    bench.move()
    other = bench.ros.node.create_publisher(Twist, 'cmd_vel', 10)
    fault = time.time()
    bench.until_rest(bench.forward)
    assert bench.commands_until_rest(fault) <= most_commands('a second cmd_vel')
    assert_smooth(bench.ros.commands, 'a second sender of cmd_vel')
    bench.says('cmd_vel has 2 publishers, which are not mixed: /station, /station')
    bench.ros.node.destroy_publisher(other)
    bench.ros.commands.clear()
    bench.until_motion()


def test_a_second_planner_on_the_same_arm_stops_both(bench):
    bench.move()
    second = bench.processes.start('planner_node', FILE, remap={'__node': 'rival'})
    try:
        bench.until_rest(bench.forward)
        assert_smooth(bench.ros.commands, 'a second planner')
        bench.says('joint_command has 2 publishers: /planner_node, /rival',
                   DiagnosticStatus.ERROR)
    finally:
        second.terminate()
    bench.ros.commands.clear()
    bench.until_motion()


def test_the_end_in_the_middle_of_a_motion_is_a_smooth_stop(own_bench):
    own_bench.move()
    own_bench.planner.send_signal(signal.SIGTERM)
    own_bench.ros.wait_for(lambda: own_bench.planner.poll() is not None, 'exit')
    assert own_bench.planner.returncode == 0
    own_bench.ros.wait_for(own_bench.ros.stops, 'a stop')
    assert own_bench.braking_commands() <= most_commands('a request')
    assert_smooth(own_bench.ros.commands, 'SIGTERM to the planner')


def test_the_command_stops_coming(bench):
    bench.move()
    fault = time.time()
    bench.until_rest()
    assert bench.commands_until_rest(fault) <= most_commands('cmd_vel stops')
    assert_smooth(bench.ros.commands, 'cmd_vel stops')


def test_publishers_of_any_quality_of_service_are_heard(bench):
    """Best effort and reliable, volatile and latched; and obstacles from a latched topic."""
    ros = bench.ros
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL,
                         reliability=ReliabilityPolicy.RELIABLE)
    ros.node.destroy_publisher(ros.twist)
    for qos in (qos_profile_sensor_data, latched):
        ros.twist = ros.node.create_publisher(Twist, 'cmd_vel', qos)
        ros.wait_for(ros.twist.get_subscription_count, 'listener')
        ros.drive_until(bench.forward, ros.moves, f'motion with {qos}')
        ros.wait_for(ros.at_rest, 'rest')
        ros.node.destroy_publisher(ros.twist)


@pytest.mark.long
def test_stamped_commands_in_the_tips_frame_and_the_other_outputs():
    with station() as (ros, processes):
        heard = {'position_commands': [], 'velocity_commands': [], 'joint_trajectory': []}
        for name, listed in heard.items():
            kind = JointTrajectory if name == 'joint_trajectory' else Float64MultiArray
            ros.node.create_subscription(kind, name, listed.append, 10)
        ros.node.destroy_publisher(ros.twist)
        ros.twist = ros.node.create_publisher(TwistStamped, 'cmd_vel', 10)
        names = [f'panda_joint{i}' for i in range(1, 8)]
        values = {'urdf': PANDA_URDF, 'initial_joints': names,
                  'initial_positions': PANDA_READY.tolist()}
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], values)
        processes.start('planner_node', [ROBOTS / 'panda.yaml'], {
            'urdf': PANDA_URDF, 'enable_stamped_cmd_vel': True, 'outputs': list(heard)})
        ros.wait_for(lambda: ros.commands and ros.states
                     and ros.twist.get_subscription_count(), 'start')
        robot = make_panda()
        before = robot.kinematics(ros.state(robot.joint_names))

        def publish():
            message = TwistStamped(twist=twist_to_message([0.0, 0.0, 0.0, 0.0, 0.0, 0.5]))
            message.header.frame_id = robot.tip_frame
            message.header.stamp = ros.node.get_clock().now().to_msg()
            ros.twist.publish(message)

        def now():
            return robot.kinematics(ros.state(robot.joint_names))

        def turned():
            return pin.log3(before.tip_rotation.T @ now().tip_rotation)

        # A turn about the tip's own z axis leaves the tip where it is.
        ros.wait_for(lambda: turned()[2] > 0.5, 'a turn', meanwhile=publish)
        ros.wait_for(ros.at_rest, 'rest')
        after = now()
        assert np.abs(turned()[:2]).max() < 2e-3
        assert np.linalg.norm(after.tip_position - before.tip_position) < 5e-4
        last = ros.commands[-1]
        assert list(heard['position_commands'][-1].data) == pytest.approx(
            list(last.position), abs=1e-5)  # maybe of another tick
        assert len(heard['velocity_commands'][-1].data) == 7
        trajectory = heard['joint_trajectory'][-1]
        assert trajectory.joint_names == list(last.name)
        point, = trajectory.points
        assert point.time_from_start.nanosec == 8_000_000 and not point.velocities


def test_markers_show_the_planners_world_to_whoever_looks():
    with station() as (ros, processes):
        pictures = []
        ros.node.create_subscription(MarkerArray, '/planner_node/markers', pictures.append, 10)
        Bench(ros, processes, values={
            'static_obstacles': ['wall'], 'static_obstacle.wall.center': [1.0, 1.0, 1.0],
            'static_obstacle.wall.semi_axes': [0.1, 0.2, 0.3]})
        ros.obstacles.publish(markers_of([Obstacle('o', np.array([0.0, 0.7, 0.9]),
                                                   np.full(3, 0.02))], 'base_link'))
        ros.wait_for(lambda: pictures and len(
            [m for m in pictures[-1].markers if m.ns == 'obstacle']) == 3, 'markers')
        kinds = {m.ns for m in pictures[-1].markers}
        assert kinds == {'link', 'nearest', 'reference', 'obstacle'}
        nearest = next(m for m in pictures[-1].markers if m.ns == 'nearest')
        assert nearest.type == Marker.LINE_LIST and len(nearest.points) == 2
        ros.wait_for(lambda: any(
            {v.key: v.value for v in s.values}.get('obstacles') == '2' for s in ros.statuses))
        values = {v.key: v.value for v in ros.statuses[-1].values}
        assert values['method'] == 'dynamic_factor' and values['overruns'].isdigit()
        assert float(values['nearest distance [m]']) > 0.0


@pytest.mark.long
def test_two_arms_in_namespaces_do_not_disturb_each_other():
    with station() as (ros, processes):
        heard = {name: [] for name in ('left', 'right')}
        twists = {}
        for name, listed in heard.items():
            remap = {'__ns': f'/{name}'}
            ros.node.create_subscription(
                JointState, f'/{name}/joint_command', listed.append, 100)
            twists[name] = ros.node.create_publisher(Twist, f'/{name}/cmd_vel', 10)
            processes.start('fake_hardware_node', FILE, ARM_VALUES,
                remap, name=f'{name} arm')
            processes.start('planner_node', FILE, remap=remap, name=f'{name} planner')
        ros.wait_for(lambda: all(heard.values()) and all(
            t.get_subscription_count() for t in twists.values()), 'both')
        forward = twist_to_message([0.0, -0.1, 0.0, 0.0, 0.0, 0.0])
        ros.wait_for(lambda: sum(np.any(m.velocity) for m in heard['left']) > 100, 'motion',
                     meanwhile=lambda: twists['left'].publish(forward))
        assert not any(np.any(m.velocity) for m in heard['right'])


def test_simulated_time_sets_the_pace_and_may_start_anew():
    """At half the speed the loop ticks half as often; a reset simulator does not move the arm."""
    with station() as (ros, processes):
        clock = ros.node.create_publisher(Clock, '/clock', 10)
        now, step = [100.0], 0.5 / RATE

        def pass_time(seconds, factor, twist=None):
            """So many simulated ones, in steps that do not depend on how busy the machine is."""
            end = now[0] + seconds
            while now[0] < end:
                now[0] += step
                clock.publish(Clock(clock=Time(nanoseconds=round(now[0] * 1e9)).to_msg()))
                if twist is not None:
                    ros.twist.publish(twist_to_message(twist))
                until = time.monotonic() + step / factor
                while (left := until - time.monotonic()) > 0.0:
                    ros.spin(left)

        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        processes.start('planner_node', FILE, {'use_sim_time': True})
        ros.wait_for(lambda: ros.commands, 'commands', meanwhile=lambda: pass_time(0.2, 1.0))
        forward = np.array([0.0, -0.05, 0.0, 0.0, 0.0, 0.0])
        ros.wait_for(ros.moves, 'motion', meanwhile=lambda: pass_time(0.1, 0.5, forward))
        ros.commands.clear()
        pass_time(0.5, 0.5, forward)
        ticks = RATE * 0.5
        assert 0.5 * ticks < len(ros.commands) < 1.2 * ticks
        assert abs(seconds_of(ros.commands[-1].header.stamp) - now[0]) < 0.5
        ros.commands.clear()
        now[0] = 3.0
        ros.wait_for(ros.at_rest, 'rest', meanwhile=lambda: pass_time(0.2, 1.0))
        assert seconds_of(ros.commands[-1].header.stamp) < 3.0 + PATIENCE
