"""Real processes talking over real topics."""

from __future__ import annotations

import signal
import time

from bench import ARM_VALUES, FILE, START
from conftest import make_panda, make_paper_arm, PANDA_READY, PANDA_URDF, ROBOTS
from live_helpers import LIVE, run_node, station
import numpy as np
import pinocchio as pin
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
import yaml

from redundant_planner.core.obstacles.obstacle import Obstacle
from redundant_planner.io.recording import read_recording
from redundant_planner.io.resources import share_directory
from redundant_planner.io.scenario import load_scenario
from redundant_planner.nodes.child_processes import Processes
from redundant_planner.nodes.messages import markers_of
from redundant_planner.tools.demo import summarise

pytestmark = LIVE
PAPER = share_directory() / 'config' / 'scenarios' / 'paper.yaml'


def panda_values():
    names = [f'panda_joint{i}' for i in range(1, 8)]
    return {'urdf': PANDA_URDF, 'initial_joints': names,
            'initial_positions': PANDA_READY.tolist()}


def configuration(ros):
    """The parameters that the planner says it runs with."""
    said = []
    ros.node.create_subscription(
        String, 'planner_node/configuration', lambda message: said.append(message.data),
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    ros.wait_for(lambda: said, 'configuration')
    return yaml.safe_load(said[-1])['/**']['ros__parameters']


def tip_twist(robot, command):
    """What a command moves the tip with."""
    return robot.kinematics(np.array(command.position)).jacobian @ np.array(command.velocity)


def test_the_papers_motion_live(paper_runs):
    """The tip keeps within 1 mm of its line while whole links clear the ellipsoid."""
    scenario = load_scenario(PAPER)
    recording = read_recording(paper_runs['dynamic_factor'])
    robot = scenario.load_robot()
    summary = summarise(robot, recording)
    assert summary.path_error < 1e-3
    assert summary.distance > 0.0 and summary.clearance.obstacle == 'ellipsoid/0'
    moved = (robot.kinematics(summary.states.positions[-1]).tip_position
             - robot.kinematics(summary.states.positions[0]).tip_position)
    np.testing.assert_allclose(moved, [-0.087, -0.150, 0.011], atol=2e-3)
    assert recording.robot_description.lstrip().startswith('<?xml')
    assert summary.periods.median == pytest.approx(0.004, rel=0.05)


def test_looking_ahead_live_takes_the_shorter_joint_path(paper_runs):
    """variational, told by the player what comes, moves the joints less than the default."""
    robot = load_scenario(PAPER).load_robot()
    length = {}
    for method in ('dynamic_factor', 'variational'):
        summary = summarise(robot, read_recording(paper_runs[method]))
        assert summary.path_error < 1e-3 and summary.distance > 0.0
        length[method] = summary.path.sum()
    assert length['variational'] < 0.93 * length['dynamic_factor']


def test_a_panda_follows_a_typed_twist_for_five_seconds():
    """With a gripper that the planner holds where it finds it."""
    robot, arm = make_panda(), panda_values()
    arm['initial_joints'] += ['panda_finger_joint1']
    arm['initial_positions'] += [0.03]
    with station() as (ros, processes):
        processes.start('fake_hardware_node', [ROBOTS / 'panda.yaml'], arm)
        processes.start('planner_node', [ROBOTS / 'panda.yaml'],
                        {'urdf': PANDA_URDF, 'locked_joints': ['*=measured']})
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
        ros.wait_for(lambda: ros.states and 'panda_finger_joint1' in ros.states[-1].name, 'arm')
        said = configuration(ros)
        (name, _, position), = (entry.partition('=') for entry in said['locked_joints'])
        assert name == 'panda_finger_joint1' and float(position) == pytest.approx(0.03)
        before = robot.kinematics(ros.state(robot.joint_names))
        twist = np.array([0.02, 0.024, -0.016, 0.0, 0.0, 0.04])
        ros.drive_until(twist, ros.moves, 'motion')
        ros.commands.clear()
        ros.drive(twist, 5.0, rate=20.0)
        ros.wait_for(ros.at_rest, 'rest')
        ros.states.clear()
        ros.wait_for(lambda: ros.states)
        after = robot.kinematics(ros.state(robot.joint_names))
        moved = after.tip_position - before.tip_position
        direction = twist[:3] / np.linalg.norm(twist[:3])
        travelled = moved @ direction
        # Five seconds, the command's timeout and the stop, or less where the machine stood still;
        # off the line by less than 0.5 mm.
        assert 0.5 < travelled / (5.0 * np.linalg.norm(twist[:3])) < 1.08
        assert np.linalg.norm(moved - travelled * direction) < 5e-4
        # The rotation that belongs to the distance travelled, to 0.1°.
        angle = pin.log3(after.tip_rotation @ before.tip_rotation.T)
        expected = twist[3:] * travelled / np.linalg.norm(twist[:3])
        assert np.linalg.norm(angle - expected) < np.radians(0.1)


def test_nothing_is_said_before_a_state_and_bad_input_hurts_nobody():
    """NaN twists, broken joint states and impossible obstacles: the good ones go on counting."""
    robot = make_paper_arm()
    start = [START.get(name, 0.0) for name in robot.joint_names]
    names = list(robot.joint_names)
    with station() as (ros, processes):
        planner = processes.start('planner_node', FILE)
        ros.wait_for(lambda: ros.joint_states.get_subscription_count() > 1
                     and ros.twist.get_subscription_count(), 'planner')
        for bad in (JointState(name=names[:-1], position=start[:-1]),
                    JointState(name=names, position=start[:-1]),
                    JointState(name=names[:-1] + ['d1'], position=start),
                    JointState(name=names, position=[np.nan] * 7)):
            ros.joint_states.publish(bad)
        ros.drive(np.zeros(6), 0.5)
        assert not ros.commands

        arm = processes.start('fake_hardware_node', FILE, ARM_VALUES)
        ros.wait_for(lambda: ros.commands, 'a command')
        ros.wait_for(ros.at_rest, 'rest')
        assert list(ros.commands[-1].name) == names
        np.testing.assert_allclose(ros.commands[-1].position, start, atol=1e-9)

        away = markers_of([Obstacle('o', np.zeros(3), np.ones(3))], 'nowhere')
        flat = markers_of([Obstacle('o', np.zeros(3), np.ones(3))], 'base_link')
        flat.markers[0].scale.x = 0.0
        ros.obstacles.publish(away)
        ros.obstacles.publish(flat)
        ros.drive(np.array([np.nan, 0, 0, 0, 0, 0]), 0.3)
        assert ros.at_rest()
        forward = np.array([0.0, -0.02, 0, 0, 0, 0])
        ros.drive_until(forward, ros.moves, 'motion')

        # Nothing but nonsense any more: zero after the timeout, and the arm comes to rest.
        ros.drive(np.array([np.inf, 0, 0, 0, 0, 0]), 0.3)
        ros.wait_for(ros.at_rest, 'rest')

        # The arm's process hangs: the last command is a stop. It comes back: so does the planner.
        ros.drive_until(forward, ros.moves, 'motion')
        arm.send_signal(signal.SIGSTOP)
        ros.drive_until(forward, ros.stops, 'a stop')
        ros.drive_until_silent(forward)
        arm.send_signal(signal.SIGCONT)
        ros.drive_until(forward, ros.moves, 'motion')
        assert planner.poll() is None


def test_an_arm_that_restarts_elsewhere_is_not_pulled_back():
    robot = make_paper_arm()
    names = list(robot.joint_names)
    with station() as (ros, processes):
        processes.start('planner_node', FILE)
        here = np.array([START.get(name, 0.0) for name in names])
        there = here + np.array([0.1, 0.1, 0.0, 0.2, 0.0, 0.0, 0.0])

        def hold_until(q, condition, what, twist=(0.0,) * 6):
            def publish():
                ros.joint_states.publish(JointState(name=names, position=q.tolist()))
                ros.drive(np.array(twist), 0.01)
            ros.wait_for(condition, what, meanwhile=publish)

        def silent():
            begin, count = time.monotonic(), len(ros.commands)
            hold_until(there, lambda: time.monotonic() > begin + 0.2, 'the end')
            return len(ros.commands) == count

        # Later than a position controller with joints in another order would leap.
        hold_until(here, lambda: len(ros.commands) > 150, 'commands')
        hold_until(there, silent, 'silence')
        ros.commands.clear()
        hold_until(there, lambda: ros.commands, 'a new start', (0.0, -0.01, 0.0, 0.0, 0.0, 0.0))
        assert np.abs(np.array(ros.commands[0].position) - there).max() < 1e-3


def test_an_interrupt_in_motion_ends_in_a_stop_and_a_clean_exit():
    # Not forked: how an interpreter of its own ends is in question.
    with station(Processes) as (ros, processes):
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        planner = processes.start('planner_node', FILE)
        ros.wait_for(lambda: ros.commands and ros.twist.get_subscription_count(), 'start')
        ros.drive_until(np.array([0.0, -0.03, 0, 0, 0, 0]), ros.moves, 'motion')
        # Under `ros2 launch` it comes at least twice.
        ros.wait_for(lambda: planner.poll() is not None, 'exit',
                     meanwhile=lambda: planner.send_signal(signal.SIGINT))
        assert planner.returncode == 0
        ros.wait_for(ros.stops, 'a stop')
        ros.wait_for(lambda: ros.states and not np.any(ros.states[-1].velocity), 'rest')


def test_the_fake_arm_keeps_its_limits_and_refuses_strangers():
    with station() as (ros, processes):
        arm = processes.start('fake_hardware_node', FILE, {**ARM_VALUES, 'noise': 0.0})
        joint_command = ros.node.create_publisher(JointState, 'joint_command', 10)
        ros.wait_for(lambda: ros.states and joint_command.get_subscription_count() > 1)
        begin = ros.state(['d1', 'd2'])
        for bad in (JointState(name=['nose'], velocity=[1.0]),
                    JointState(name=['d1'], velocity=[np.nan]),
                    JointState(name=['d1', 'd2'], velocity=[1.0])):
            joint_command.publish(bad)
        ros.drive(np.zeros(6), 0.2)
        np.testing.assert_array_equal(ros.state(['d1', 'd2']), begin)
        fast = JointState(name=['d1'], velocity=[100.0])
        ros.wait_for(lambda: ros.state(['d1'])[0] >= 0.4, 'the limit',
                     meanwhile=lambda: joint_command.publish(fast))
        for _ in range(100):
            joint_command.publish(fast)
            ros.spin()
        assert max(m.position[0] for m in ros.states) == 0.4
        assert arm.poll() is None


def set_parameter(ros, name, value):
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return ros.call(SetParameters, 'set_parameters', request).results[0]


def test_parameters_change_while_running_or_are_refused_with_the_reason():
    with station() as (ros, processes):
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        planner = processes.start('planner_node', FILE)
        ros.wait_for(lambda: ros.commands, 'start')
        assert set_parameter(ros, 'limits.linear_speed', 0.01).successful
        assert set_parameter(ros, 'criteria.k_alpha', 1).successful
        for name, value, reason in (
                ('criteria.k_alpha', -1.0, 'out of range'),
                ('criteria.k_alpha', 'much', 'must be a number'),
                ('method', 'magic', 'it must be one of'), ('rate', 100, 'rate'),
                ('tip_frame', 'nose', 'tip_frame'),
                ('limits.position_margin', 0.45, "joint 'd1'")):
            result = set_parameter(ros, name, value)
            assert not result.successful and reason in result.reason, (name, result.reason)
        robot, fast = make_paper_arm(), np.array([0.0, -0.1, 0, 0, 0, 0])

        ros.drive_until(fast, lambda: np.linalg.norm(
            tip_twist(robot, ros.commands[-1])) > 0.0095, '10 mm/s')
        ros.commands.clear()
        ros.drive_until(fast, lambda: len(ros.commands) > 100, 'commands')
        speeds = [np.linalg.norm(tip_twist(robot, command)) for command in ros.commands]
        assert max(speeds) < 0.012, 'of 100 asked for 10 mm/s, and what corrects drift'
        assert planner.poll() is None


def test_grouped_names_count_wherever_they_are_given(tmp_path):
    """Nested and dotted in a file, on the command line, at run time; refusals change nothing."""
    file = tmp_path / 'groups.yaml'
    file.write_text('/**:\n  ros__parameters:\n    criteria: {k_w: 4.0, k_s: 0.5}\n'
                    '    horizon.duration: 2.0\n    clearance.margin: 0.02\n')
    with station() as (ros, processes):
        processes.start('fake_hardware_node', [*FILE, file], ARM_VALUES)
        processes.start('planner_node', [*FILE, file], {'clearance.margin': 0.03})
        ros.wait_for(lambda: ros.commands, 'start')
        assert set_parameter(ros, 'criteria.k_s', 1.5).successful
        for name, value, reason in (
                ('method', 'paper', "a planner that began with one of 'gradient_projection', "
                                    "'dynamic_factor', 'variational' keeps to these"),
                ('k_s', 9.0, 'undeclared')):
            result = set_parameter(ros, name, value)
            assert not result.successful and reason in result.reason, (name, result.reason)
        ros.wait_for(lambda: configuration(ros)['criteria.k_s'] == 1.5, 'the new configuration')
        said = configuration(ros)
    assert said['method'] == 'dynamic_factor' and 'k_s' not in said
    assert said['criteria.k_w'] == 4.0 and said['criteria.k_s'] == 1.5
    assert said['horizon.duration'] == 2.0 and said['clearance.margin'] == 0.03


def test_the_urdf_may_come_by_topic():
    with station() as (ros, processes):
        processes.start('planner_node', values={'tip_frame': 'tool_tip', 'link_shapes': 'straight',
                                                'axes': ['vx', 'vy', 'vz']})
        processes.start('fake_hardware_node', FILE, ARM_VALUES)
        ros.wait_for(lambda: ros.commands, 'a command after robot_description')


FROM_FILE = ['--params-file', str(ROBOTS / 'paper_2p5r.yaml')]
ARM_FAULTS = [
    ([], "'urdf' is empty"),
    (['-p', 'urdf:=/no/such.urdf'], "'/no/such.urdf' is not a file"),
    (['-p', 'initial_joints:=[nose]', '-p', 'initial_positions:=[1.0]', '-p',
      f'urdf:={ROBOTS}/paper_2p5r.urdf'], "unknown joint 'nose'"),
    (['-p', 'initial_joints:=[d1]', '-p', f'urdf:={ROBOTS}/paper_2p5r.urdf'],
     "'initial_positions' has 0 entries; it takes 1"),
]
PLANNER_FAULTS = [
    (['-p', f'urdf:={ROBOTS}/paper_2p5r.urdf'], "'tip_frame' is empty"),
    ([*FROM_FILE, '-p', 'tip_frame:=nose'], "tip_frame 'nose' is not in the URDF"),
    ([*FROM_FILE, '-p', 'urdf:=/no/such.urdf'], "'/no/such.urdf' is not a file"),
    ([*FROM_FILE, '-p', f'urdf:={ROBOTS}/panda.yaml'], 'the URDF is not well-formed XML'),
    ([*FROM_FILE, '-p', 'rate:=5000'], "'rate' is 5000; it must lie in [1, 1000] Hz"),
    ([*FROM_FILE, '-p', 'rate:=fast'], "'rate' is 'fast'; it must be a whole number"),
    ([*FROM_FILE, '-p', 'axes:=[vx, up]'], "'axes' is 'up'; it must be one of"),
    ([*FROM_FILE, '-p', 'criteria.joint_weights:=[1.0]'],
     "'criteria.joint_weights' has 1 entries; it takes 7"),
    ([*FROM_FILE, '-p', 'limits.linear_sped:=0.1'],
     "'limits.linear_sped' is not known; did you mean 'limits.linear_speed'?"),
    ([*FROM_FILE, '-p', 'static_obstacles:=[o]'], "obstacle 'o' lacks 'center'"),
    ([*FROM_FILE, '-p', 'static_obstacles:=[o]', '-p', 'static_obstacle.o.center:=[0.0, 0.0]'],
     "'static_obstacle.o.center' is [0.0, 0.0]; it takes 3 finite numbers"),
    ([*FROM_FILE, '-p', 'static_obstacles:=[o]', '-p', 'static_obstacle.o.center:=[0.0, 0.0, 1.0]',
      '-p', 'static_obstacle.o.semi_axes:=[0.1, 0.0, 1.0]'], 'all three must be positive'),
    (['--params-file', '/no/such.yaml'], '/no/such.yaml'),
]
FAULTS = [*(('fake_hardware_node', *fault) for fault in ARM_FAULTS),
          *(('planner_node', *fault) for fault in PLANNER_FAULTS)]


@pytest.fixture(scope='module')
def endings():
    """How the nodes end that FAULTS describes.

    One after another: of processes started in two threads, multiprocessing may lose an exit status
    (it is 255 then), as either thread asks for those of all.
    """
    return [run_node(fault[0], *fault[1]) for fault in FAULTS]


@pytest.mark.parametrize('fault', range(len(FAULTS)), ids=[fault[2] for fault in FAULTS])
def test_a_node_ends_with_one_readable_line(endings, fault):
    status, text = endings[fault]
    assert status == 2 and FAULTS[fault][2] in text and 'Traceback' not in text, text
